"""Vectorised C gives the same results for every width of vectors."""

from __future__ import annotations

import ctypes

import mpmath
import numpy as np
import pytest
from hard_scenes import bennett_loop
from rod_chain import rod_chain

from cotree import load
from cotree.build import find_toolchain
from cotree.codegen import maps
from cotree.codegen.context import model_context
from cotree.codegen.render import with_runtime
from cotree.program import columns

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(find_toolchain() is None, reason="needs a C compiler"),
]


def _model(n=10):
    scene, wanted = rod_chain(n)
    return scene.compile(wanted)


def _values(model):
    rng = np.random.default_rng(3)
    n, m = len(model.states), len(model.sensitivities)
    x, s = rng.uniform(-1.0, 1.0, n), rng.uniform(-1.0, 1.0, (n, m))
    return model.sensitivity_rhs(0.0, x, s), model.jacobian(0.0, x)


def _ops(model, kernel):
    return [node.op for node in model.kernels.program.kernels[kernel].order]


@pytest.mark.slow
def test_maps_give_the_bits_of_any_width(monkeypatch):
    """The compiler's own command may name definitions."""
    compiler = find_toolchain().command[0]
    found = {}
    for flags in ("", " -DCOTREE_NO_DISPATCH"):
        monkeypatch.setenv("CC", compiler + flags)
        found[flags] = _values(_model())
    for wide, narrow in zip(*found.values(), strict=True):
        np.testing.assert_array_equal(wide, narrow)
    # One number at a time: sines are those of the C library, which differ in the last place. The
    # mass matrix enlarges that some hundred times.
    monkeypatch.setenv("CC", f"{compiler} -DCOTREE_NO_VECTORS")
    for wide, single in zip(found[""], _values(_model()), strict=True):
        np.testing.assert_allclose(wide, single, rtol=1e-11, atol=1e-11 * np.abs(single).max())


@pytest.mark.slow
def test_blocks_of_a_map_give_the_same_bits(monkeypatch):
    found, n_blocks = {}, {}
    for longest in (10_000, 50):
        monkeypatch.setattr(maps, "_LONGEST_BLOCK", longest)
        monkeypatch.setattr(maps, "_LONGEST_IN_TURN", longest)
        model = _model()
        found[longest] = _values(model)
        rows = model_context(model.kernels.text.program).maps
        n_blocks[longest] = [len(row.body.blocks) for row in rows]
        # Each rod waits for the one before, so that two vectors of the Jacobian go in turn.
        assert max(row.n_together for row in rows) == (2 if longest == 50 else 1)
    assert not any(n_blocks[10_000])
    assert min(n_blocks[50]) > 1
    for whole, cut in zip(*found.values(), strict=True):
        np.testing.assert_array_equal(whole, cut)


@pytest.mark.slow
def test_loops_of_a_map_give_the_same_bits(monkeypatch):
    """Of fifty rods and more the statements of a map are loops."""
    scene, wanted = rod_chain(50)
    model = scene.compile(wanted[:8])
    rows = model_context(model.kernels.text.program).maps
    lines = [line for row in rows for line in row.body.text]
    assert any(line.strip().startswith("for (") for line in lines)
    assert any(line.strip().startswith("VECTOR v[") for line in lines)
    monkeypatch.setattr(maps, "roll", list)
    written_out = scene.compile(wanted[:8])
    for rolled, other in zip(_values(model), _values(written_out), strict=True):
        np.testing.assert_array_equal(rolled, other)


@pytest.mark.slow
def test_maps_agree_with_statements_written_out(monkeypatch):
    model = _model()
    assert "map" in _ops(model, "augmented_rhs")
    assert "map" in _ops(model, "jacobian")
    monkeypatch.setattr(columns, "_WORTH", 0.0)
    longhand = _model()
    assert "map" not in _ops(longhand, "augmented_rhs")
    for mapped, expected in zip(_values(model), _values(longhand), strict=True):
        # Both sum up in orders of their own.
        np.testing.assert_allclose(
            mapped, expected, rtol=1e-10, atol=1e-12 * np.abs(expected).max()
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "kernel"),
    [
        pytest.param(lambda: load("motor-linkage"), "augmented_rhs", id="loop"),
        pytest.param(bennett_loop, "jacobian", id="redundant loop", marks=pytest.mark.slow),
    ],
)
def test_maps_of_closed_loops_agree_with_statements_written_out(monkeypatch, make, kernel):
    """Multipliers are solved for at run time, along each column by the same factors."""

    def values():
        scene = make()
        model = scene.compile(list(scene.parameters))
        x = model.start().y  # constraints that depend on each other agree there
        s = np.random.default_rng(3).uniform(-1.0, 1.0, (len(x), len(model.sensitivities)))
        found = model.jacobian(0.0, x), model.sensitivity_rhs(0.0, x, s)
        return found, _ops(model, kernel)

    mapped, ops = values()
    assert {"map", "solve"} <= set(ops)
    monkeypatch.setattr(columns, "_WORTH", 0.0)
    expected, ops = values()
    assert "map" not in ops
    for one, other in zip(mapped, expected, strict=True):
        # Sums in orders of their own.
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10)


def test_the_jacobian_of_a_map_keeps_its_zeros():
    """Two chains on one ground do not feel each other."""
    scene, _ = rod_chain(6)
    end = "ground"
    for i in range(6):
        scene.edge(f"k{i}", "revolute", end, f"X{i}", axis=[0, 0, 1])
        scene.edge(f"d{i}", "arm", f"X{i}", f"Y{i}", vector=[0.5, 0, 0])
        scene.edge(f"f{i}", "arm", f"X{i}", f"Z{i}", vector=[1.0, 0, 0])
        scene.edge(f"w{i}", "rigid_body", "ground", f"Y{i}", mass=1.0, inertia=0.1)
        end = f"Z{i}"
    model = scene.compile()
    x = np.random.default_rng(1).uniform(-1.0, 1.0, len(model.states))
    matrix = model.jacobian(0.0, x)
    first = [i for i, name in enumerate(model.states) if name.startswith("h")]
    second = [i for i, name in enumerate(model.states) if name.startswith("k")]
    assert not matrix[np.ix_(first, second)].any()
    assert not matrix[np.ix_(second, first)].any()
    # Accelerations of each chain by its own angles and speeds, and angles by speeds.
    assert len(model.kernels.program.layout.row_indices) == 2 * (6 * 12 + 6)


@pytest.fixture
def sines(run_compiler):
    """The function, with vectors of two."""
    head = "void take(int n, const double *a, double *s, double *c)"
    lines = [
        "#include <math.h>",
        "#include <string.h>",
        "#define LANES 2",
        "#define EACH(f) f(0), f(1)",
        "#define NAMED(name) name##_2",
        "#define TARGET",
        "#define LEAVE (void)0",
        "typedef double VECTOR __attribute__((vector_size(16)));",
        '#include "cotree_real.h"',
        '#include "cotree_sines.h"',
        f"{head};",
        f"{head} {{ cotree_sines_2(n, a, s, c); }}\n",
    ]
    path = run_compiler(
        with_runtime({"sines.c": "\n".join(lines)}), "-O1", "-shared", "-fPIC", "-lm"
    )
    return ctypes.CDLL(str(path)).take


def _taken(sines, angles):
    pointer = ctypes.POINTER(ctypes.c_double)
    given = np.ascontiguousarray(angles)
    found = np.zeros_like(given), np.zeros_like(given)
    sines(len(given), *(array.ctypes.data_as(pointer) for array in (given, *found)))
    return found


def test_sines_are_good_to_the_last_place(sines):
    rng = np.random.default_rng(0)
    # Where reduction cancels most, too: next to multiples of pi/2.
    near = np.arange(-500, 500) * np.pi / 2.0
    angles = np.concatenate([rng.uniform(-10, 10, 1000), rng.uniform(-1e6, 1e6, 1000), near])
    found = _taken(sines, angles)
    with mpmath.workprec(200):
        for exact, values in zip((mpmath.sin, mpmath.cos), found, strict=True):
            expected = [exact(mpmath.mpf(float(angle))) for angle in angles]
            errors = [
                float(abs(mpmath.mpf(float(value)) - e) / mpmath.mpf(float(np.spacing(abs(value)))))
                for value, e in zip(values, expected, strict=True)
            ]
            # 0.71 at 20 000 angles; the polynomials' own error is a hundredth of a place.
            assert max(errors) < 0.8


def test_angles_far_off_and_what_is_no_number_are_left_to_the_library(sines):
    angles = np.array([1e300, np.inf, np.nan, 0.0])
    with np.errstate(invalid="ignore"):
        for found, expected in zip(_taken(sines, angles), (np.sin, np.cos), strict=True):
            # Both are libraries of mathematics: the last place is their own.
            np.testing.assert_allclose(found, expected(angles), rtol=4e-16)
