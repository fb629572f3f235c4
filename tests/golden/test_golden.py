"""The C text of the shipped scenes, byte for byte as in generated/, for people to read."""

from __future__ import annotations

import dataclasses

import pytest

from cotree.codegen.context import model_context
from cotree.codegen.render import render_model

SENSITIVITIES = {"slider-pendulum": ["L"], "spring-mass-damper": ["k"]}


@pytest.mark.parametrize("name", SENSITIVITIES)
def test_generated_text(golden, program_of, name):
    context = model_context(program_of(name, SENSITIVITIES[name]))
    # A word in place of the version: a release changes no golden file.
    files = render_model(dataclasses.replace(context, generator="x.y.z"))
    assert len(files) == 3
    for file, text in files.items():
        golden(f"{name}/{file}", text)
