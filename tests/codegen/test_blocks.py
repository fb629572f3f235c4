"""Long kernels cut into blocks: the same values to the last bit, whatever the length."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rod_chain import rod_chain

import cotree
from cotree import load
from cotree.codegen import context, loops
from cotree.codegen.context import model_context
from cotree.codegen.ir import (
    Argument,
    Assign,
    SetStatus,
    apply,
    call,
    element,
    named,
    number,
    temporary,
)
from cotree.codegen.kernel_blocks import cut_into_blocks
from cotree.codegen.printing import print_body
from cotree.pipeline import formulate, generate
from cotree.program import passes as order

SCENES = sorted(path.stem for path in (Path(cotree.__file__).parent / "scenes").glob("*.toml"))


@pytest.fixture
def cut_at(monkeypatch):
    """Set the number of operations from which kernels are cut."""

    def change(longest):
        cut = partial(cut_into_blocks, longest=longest)
        monkeypatch.setattr(context, "cut_into_blocks", cut)

    return change


def _program(scene, sensitivities):
    return generate(formulate(scene, list(sensitivities), None)[1])[0]


def _all_values(kernels, program):
    """Return the results of every kernel at one point."""
    layout = program.layout
    n, m = len(layout.states), len(layout.sensitivities)
    rng = np.random.default_rng(3)
    x, s = rng.uniform(0.2, 1.0, n), rng.uniform(-1.0, 1.0, n * max(m, 1))
    u = rng.uniform(0.2, 1.0, len(layout.inputs))
    kernels.prepare(np.array(layout.parameter_values))
    return {
        name: kernels(name, 0.7, x, s, u).copy()
        for name, kernel in program.kernels.items()
        if kernel.results and name != "prepare"
    }


def _n_blocks(program):
    return sum(len(kernel.body.blocks) for kernel in model_context(program).kernels)


@pytest.mark.sampled(1)
@pytest.mark.compiler
@pytest.mark.parametrize("name", SCENES)
def test_shipped_scenes_compute_the_same(name, cut_at, load_kernels):
    scene = load(name)
    program = _program(scene, list(scene.parameters)[:2])
    cut_at(10**9)
    assert _n_blocks(program) == 0
    whole = _all_values(load_kernels(program), program)
    cut_at(3)
    cut = _all_values(load_kernels(program), program)
    assert _n_blocks(program) > 0
    assert whole.keys() == cut.keys()
    for kernel, values in whole.items():
        assert np.array_equal(values, cut[kernel], equal_nan=True), kernel


@pytest.mark.sampled(2)
@pytest.mark.compiler
@pytest.mark.parametrize("name", SCENES)
def test_shipped_scenes_compute_the_same_in_loops(name, monkeypatch, load_kernels):
    scene = load(name)
    program = _program(scene, list(scene.parameters)[:2])
    monkeypatch.setattr(loops, "_MUCH_SHORTER", 10.0)  # wherever statements repeat
    rolled = _all_values(load_kernels(program), program)
    monkeypatch.setattr(context, "roll", lambda lines, array="v": list(lines))
    for kernel, values in _all_values(load_kernels(program), program).items():
        assert np.array_equal(values, rolled[kernel], equal_nan=True), kernel


@pytest.mark.slow
@pytest.mark.compiler
@pytest.mark.parametrize("longest", [60, 300])
def test_chains_with_loops_compute_the_same(longest, cut_at, load_kernels, monkeypatch):
    monkeypatch.setattr(order, "_MANY", 0)  # links in their order, one like the other
    scene, wanted = rod_chain(30)
    program = _program(scene, wanted[::20])
    cut_at(10**9)
    whole = _all_values(load_kernels(program), program)
    cut_at(longest)
    cut = _all_values(load_kernels(program), program)
    for kernel in ("rhs", "jacobian", "augmented_rhs"):
        assert np.array_equal(whole[kernel], cut[kernel]), kernel
    rolled = [
        line
        for kernel in model_context(program).kernels
        for block in kernel.body.blocks
        for line in block.lines
        if line.startswith("for (")
    ]
    assert rolled


def _let(i, op, *args):
    return Assign((temporary("v", i),), apply(op, *args))


def _result(i, value):
    return Assign((element("dx", i),), temporary("v", value))


ARGUMENTS = [Argument("x"), Argument("dx", is_constant=False)]


def test_a_long_kernel_is_cut_where_little_crosses():
    """Two groups that share one value: the cut falls between them."""
    v = [temporary("v", i) for i in range(21)]
    rows = [_let(0, "mul", element("x", 0), element("x", 0))]
    for first in (1, 11):
        rows.append(_let(first, "add", v[0], number(first)))
        rows += [_let(i, "mul", v[i - 1], v[first]) for i in range(first + 1, first + 9)]
        rows.append(_let(first + 9, "sub", v[first + 8], v[0]))
    rows += [_result(0, 10), _result(1, 20)]
    cut = cut_into_blocks("f_{}", rows, ARGUMENTS, ("dx",), longest=14)
    body = print_body(cut)
    assert [block.lines[-1] for block in body.blocks] == ["dx[0] = v10;", "dx[1] = v20;"]
    assert body.lines == ["double w[1];", "f_1(x, dx, w);", "f_2(dx, w);"]
    assert body.blocks[0].lines[0] == "const double v0 = w[0] = x[0] * x[0];"
    assert body.blocks[1].lines[0] == "const double v11 = w[0] + 11.0;"


def test_places_serve_again_when_their_values_are_read_no_more():
    rows = [_let(0, "add", element("x", 0), number(1.0))]
    rows += [_let(i, "add", temporary("v", i - 1), number(1.0)) for i in range(1, 100)]
    cut = cut_into_blocks("f_{}", [*rows, _result(0, 99)], ARGUMENTS, ("dx",), longest=10)
    assert len(cut.functions) >= 10
    # One that is handed over, and the next, made while that may still be read.
    assert print_body(cut).lines[0] == "double w[2];"


def test_a_status_is_told_to_the_caller():
    args = [temporary("v", i) for i in range(30)]
    rows = [_let(0, "add", element("x", 0), number(1.0))]
    rows += [_let(i, "add", args[i - 1], number(1.0)) for i in range(1, 30)]
    rows.insert(15, SetStatus(apply("fails", call("swirl", named("x"))), "COTREE_FAILED_CALL"))
    cut = cut_into_blocks("f_{}", [*rows, _result(0, 29)], ARGUMENTS, ("dx",), longest=10)
    body = print_body(cut)
    (block,) = (block for block in body.blocks if "int *status" in block.signature)
    assert "if (swirl(x) != 0) *status = COTREE_FAILED_CALL;" in block.lines
    assert any(line.endswith("&status);") for line in body.lines)


def test_the_longest_function_of_a_long_chain_is_short():
    """Compilers take long for the longest function: its length stays bounded as the text grows."""
    program = _program(rod_chain(12)[0], [])
    jacobian = next(k for k in model_context(program).kernels if "_jacobian(" in k.signature)
    assert jacobian.n_operations > 8_000
    assert max(jacobian.body.written) <= 1_000
