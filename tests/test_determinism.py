"""The same scene gives the same bytes, whatever the hash seed."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

import cotree
from cotree.codegen.c_files import render_model
from cotree.codegen.context import model_context
from cotree.pipeline import formulate, generate

_SCRIPT = """
import hashlib
import cotree
from cotree.codegen.context import model_context
from cotree.codegen.c_files import render_model
from cotree.pipeline import formulate, generate
for name in ("slider-pendulum", "spring-mass-damper"):
    scene = cotree.load(name)
    for wanted in ([], list(scene.parameters), list(scene.parameters)[::-1]):
        files = render_model(model_context(generate(formulate(scene, wanted, None)[1])[0]))
        for file, text in files.items():
            print(name, file, hashlib.sha256(text.encode()).hexdigest())
"""


@pytest.mark.slow
def test_same_bytes_under_several_hash_seeds():
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", _SCRIPT],
            env={**os.environ, "PYTHONHASHSEED": seed},
            stdout=subprocess.PIPE,
            text=True,
        )
        for seed in ("0", "1", "4711")
    ]
    texts = [run.communicate()[0] for run in runs]
    assert all(run.returncode == 0 for run in runs)
    assert len(texts[0].splitlines()) == 24
    assert texts[0] == texts[1] == texts[2]


def test_same_bytes_twice_in_one_process(scene_name):
    import cotree
    from cotree.codegen.c_files import render_model
    from cotree.codegen.context import model_context
    from cotree.pipeline import formulate, generate

    def text():
        _, equations, _ = formulate(cotree.load(scene_name), ["k"], None)
        return render_model(model_context(generate(equations)[0]))

    assert text() == text()


def test_a_scene_formed_again_gives_the_same_text():
    """Addresses of objects differ each time, and the order of sets with them."""
    scene = cotree.load("resonant-circuit")
    kept, texts = [], set()
    for i in range(8):
        kept.append([object() for _ in range(997 * i % 5000)])
        equations = formulate(scene, list(scene.parameters), None)[1]
        files = render_model(model_context(generate(equations)[0]))
        texts.add("".join(files.values()))
    assert len(texts) == 1
