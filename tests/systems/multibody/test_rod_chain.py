"""A chain of 20 rods with sensitivities to all masses and lengths: the architecture's own test."""

from __future__ import annotations

import cProfile
import pstats

import pytest
import sympy
from rod_chain import rod_chain

from cotree.codegen.c_files import render_model
from cotree.codegen.context import model_context
from cotree.pipeline import formulate, generate
from cotree.program import columns


def to_c_text(n):
    scene, wanted = rod_chain(n)
    _, equations, _ = formulate(scene, wanted, None)
    program, _ = generate(equations)
    return program, render_model(model_context(program))


def test_no_sympy_call_sees_assembled_expressions(monkeypatch):
    """Component laws are SymPy, formed once; after that SymPy is not asked for anything."""
    to_c_text(2)

    def refuse(*args, **kwargs):
        raise AssertionError("SymPy was called while equations were assembled")

    for name in ("diff", "simplify", "cse", "expand", "sympify", "Matrix", "Symbol"):
        monkeypatch.setattr(sympy, name, refuse)
    monkeypatch.setattr(sympy.Basic, "__new__", refuse)
    monkeypatch.setattr(sympy.Expr, "diff", refuse)
    to_c_text(5)


@pytest.mark.slow
def test_operations_grow_no_faster_than_back_substitution(monkeypatch):
    """n coordinates, 2n parameters, O(n^2) each: cubic, so 8 times from 5 to 10 and less than
    16; a differentiated assembled system grows faster."""
    monkeypatch.setattr(columns, "_WORTH", 0.0)  # all is written out
    counts = [to_c_text(n)[0].operations["augmented_rhs"].total for n in (5, 10)]
    assert counts[0] <= 2700  # what it is today
    assert counts[1] <= 13900  # the bar set by an earlier prototype
    assert counts[1] / counts[0] < 8.0


@pytest.mark.slow
def test_a_map_of_all_parameters_grows_with_the_length_of_the_chain():
    """One column of the map is a back-substitution along the tree, O(n)."""
    maps = [
        next(
            node.data for node in to_c_text(n)[0].kernels["augmented_rhs"].order if node.op == "map"
        )
        for n in (20, 40)
    ]
    assert [linear.n_columns for linear in maps] == [40, 80]
    short, long = (len(linear.statements) for linear in maps)
    assert 1.9 * short < long < 2.1 * short


@pytest.mark.slow
def test_twenty_rods_reach_c_text_in_nine_million_calls():
    """Calls of Python's functions, which other work on the machine does not change: 8.1 million."""
    with cProfile.Profile() as profile:
        program, _ = to_c_text(20)
    assert program.operations["augmented_rhs"].total <= 72_000  # the bar of the same prototype
    assert pstats.Stats(profile).total_calls < 9_000_000
