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
from cotree.codegen.c_files import render_model
from cotree.codegen.context import model_context
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
    """Return the stack size of each function with its callees, without the C library."""
    wanted = ["-fcallgraph-info=su", "-c", source, "-o", "model.o"]
    subprocess.run(["gcc", "-std=c99", *flags, *wanted], cwd=folder, check=True)
    graph = (folder / "model.ci").read_text()
    name = r'name: "(?:[^":]*:)?([\w.]+)"'
    own = dict(re.findall(rf'node: {{ title{name[4:]} label: ".*?\\n(\d+) bytes', graph))
    calls = re.findall(f"source{name} target{name}", graph)

    @cache
    def depth(name):
        return int(own.get(name, 0)) + max((depth(b) for a, b in calls if a == name), default=0)

    return {name: depth(name) for name in own}


#: What the header says covers these: no optimisation needs most, also with the widest vectors.
FLAGS = ("-O0", "-O1", "-Og", "-O2", "-Os", "-O0 -march=skylake-avx512")


def _stated(prefix, files, folder):
    for name, text in files.items():
        (folder / name).write_text(text)
    heads = r"Stack: (\d+) bytes at most\. \*/\nCOTREE_EXPORT int (\w+)\("
    return {name: int(size) for size, name in re.findall(heads, files[f"{prefix}.h"])}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("scene", SCENES)
def test_the_stack_that_the_header_states_is_what_gcc_takes(scene, tmp_path):
    prefix, files = _files(scene)
    stated = _stated(prefix, files, tmp_path)
    assert f"{prefix}_rhs" in stated
    # Below the stack pointer functions that call none may use 128 bytes that gcc does not report.
    found = [_taken(f"{prefix}.c", tmp_path, [*row.split(), "-mno-red-zone"]) for row in FLAGS]
    for name, size in stated.items():
        most = max(taken[name] for taken in found)
        # Six words: small functions differ by what registers they save.
        assert most <= size <= max(1.25 * most, most + 48), name
