"""The header says how much of the stack each kernel takes; gcc counts it."""

from __future__ import annotations

import re
import shutil
import subprocess
from functools import cache

import pytest
from made_up_scenes import closed_scene
from rod_chain import rod_chain

from cotree import load
from cotree.codegen.context import model_context
from cotree.codegen.render import render_model
from cotree.pipeline import formulate, generate

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc"),
]

SCENES = {
    "slider-pendulum": lambda: (load("slider-pendulum"), ["L"]),
    "motor-linkage": lambda: (load("motor-linkage"), []),
    "closed loop": lambda: (closed_scene(), []),
    "chain": lambda: rod_chain(10),  # has maps and blocks
}


@cache
def _files(scene):
    described, wanted = SCENES[scene]()
    context = model_context(generate(formulate(described, wanted, None)[1])[0])
    return context.prefix, render_model(context)


def _taken(source, folder, flags):
    """Give what each function takes with those that it calls, but for the C library's."""
    wanted = ["-fcallgraph-info=su", "-c", source, "-o", "model.o"]
    subprocess.run(["gcc", "-std=c99", *flags, *wanted], cwd=folder, check=True)
    graph = (folder / "model.ci").read_text()
    name = r'name: "(?:[^":]*:)?(\w+)"'
    own = dict(re.findall(rf'node: {{ title{name[4:]} label: ".*?\\n(\d+) bytes', graph))
    calls = re.findall(f"source{name} target{name}", graph)

    @cache
    def depth(name):
        return int(own.get(name, 0)) + max((depth(b) for a, b in calls if a == name), default=0)

    return {name: depth(name) for name in own}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("flags", [("-O0",), ("-Og",), ("-O2",), ("-O0", "-march=native")])
@pytest.mark.parametrize("scene", SCENES)
def test_no_kernel_takes_more_of_the_stack_than_stated(scene, flags, tmp_path):
    prefix, files = _files(scene)
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    heads = r"Stack: (\d+) bytes at most\. \*/\nCOTREE_EXPORT int (\w+)\("
    stated = {name: int(size) for size, name in re.findall(heads, files[f"{prefix}.h"])}
    taken = _taken(f"{prefix}.c", tmp_path, flags)
    assert f"{prefix}_rhs" in stated
    for name, size in stated.items():
        assert taken[name] <= size, name
    # Nor is it far above: vectors may be half as wide, and what each function is granted besides
    # matters where it is small.
    largest = max(stated, key=stated.__getitem__)
    if "-O0" in flags:
        assert stated[largest] < 2 * taken[largest] + 2500
