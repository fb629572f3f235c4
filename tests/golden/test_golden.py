"""The C text of the shipped scenes, byte for byte as in generated/, for people to read."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest
from component_files import examples_text

from cotree.codegen.c_files import render_model
from cotree.codegen.context import model_context
from cotree.components import OWN

PAGES = Path(__file__).resolve().parents[2] / "docs" / "components"
SENSITIVITIES = {"slider-pendulum": ["L"], "spring-mass-damper": ["k"]}


@pytest.mark.parametrize("name", SENSITIVITIES)
def test_generated_text(golden, program_of, name):
    context = model_context(program_of(name, SENSITIVITIES[name]))
    # A word in place of the version: a release changes no golden file.
    files = render_model(dataclasses.replace(context, generator="x.y.z"))
    assert len(files) == 4
    for file, text in files.items():
        golden(f"{name}/{file}", text)


def test_examples_of_components_are_those_of_their_pages(golden):
    pages = {name: (PAGES / f"{name}.md").read_text(encoding="utf-8") for name in OWN}
    scenes = {
        name: re.search(r"```toml\n(.*?)```", text, re.DOTALL)[1] for name, text in pages.items()
    }
    golden("examples.toml", examples_text(scenes), "src/cotree/components")
