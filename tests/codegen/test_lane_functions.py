"""Functions of vectors against those of the C library, lane by lane."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cotree.build import BuildOptions, find_toolchain, obtain_library
from cotree.build.compile import cpu_features
from cotree.codegen.lanes import Lanes
from cotree.codegen.render import render, with_runtime
from cotree.dag.operations import OPERATIONS

pytestmark = pytest.mark.compiler

# Cheaper than a division, and no result of a model.
_INVERSE = "inverse"
_NAMES = ("sin", "cos", "exp", "log", "sqrt", "abs", "tanh", "floor", "atan")

_SOURCE = """
#define COTREE_APART __attribute__((noinline))
#define ALWAYS_INLINE static inline __attribute__((always_inline))
#include <math.h>
#include <string.h>
typedef double VECTOR __attribute__((vector_size(8 * LANES)));
typedef long long MASK __attribute__((vector_size(8 * LANES)));
typedef unsigned long long BITS __attribute__((vector_size(8 * LANES)));
#define ALL(number) ((number) - (VECTOR){0.0})
#define ZERO ((VECTOR){0.0})
"""

_LOOP = """
void lanes_%(name)s(int n, const double *x, double *y)
{
    VECTOR v;
    int i;
    for (i = 0; i + LANES <= n; i += LANES) {
        memcpy(&v, x + i, sizeof v);
        v = cotree_%(name)s(v);
        memcpy(y + i, &v, sizeof v);
    }
}
void c_%(name)s(int n, const double *x, double *y)
{
    int i;
    for (i = 0; i < n; ++i) y[i] = %(c)s;
}
"""


@pytest.fixture(scope="module", params=[(2, True), (4, True), (4, False)])
def functions(request):
    toolchain = find_toolchain()
    if toolchain is None:
        pytest.skip("there is no compiler")
    library = {"tanh": "tanh", "floor": "floor", "atan": "atan"}
    width, is_fused = request.param
    lanes = Lanes(width, 1, "", is_fused)
    model = SimpleNamespace(library=library, packs_sines=False, tables=[], lanes=lanes)
    text = f"#define LANES {width}\n{_SOURCE}"
    if {"avx2", "fma"} <= set(cpu_features().split()) and not toolchain.is_clang:
        text = f'#pragma GCC target("avx2,fma")\n{text}'
    text += render("c/lanes/functions.c.jinja", model=model)
    declarations = ""
    for name in (*_NAMES, _INVERSE):
        c = "1.0 / x[i]" if name == _INVERSE else OPERATIONS[name].c.format("x[i]")
        text += _LOOP % {"name": name, "c": c}
        for kind in ("lanes", "c"):
            declarations += f"void {kind}_{name}(int, const double *, double *);\n"
    options = BuildOptions("-O2")
    _, loaded = obtain_library(
        with_runtime({"functions.c": text}),
        declarations,
        abi_version=0,
        n_operations=1,
        options=options,
        toolchain=toolchain,
    )

    def both(name, x):
        x = np.ascontiguousarray(x, dtype=float)
        found = [np.full_like(x, -7.0) for _ in range(2)]
        for kind, y in zip(("lanes", "c"), found, strict=True):
            pointers = [loaded.ffi.from_buffer("double[]", a) for a in (x, y)]
            getattr(loaded.lib, f"{kind}_{name}")(len(x), *pointers)
        return found

    return both


def _ulps(a, b):
    """Count the numbers between two arrays; equal values, and nan beside nan, are none apart."""
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore", over="ignore"):
        far = np.abs(a - b) / np.spacing(np.minimum(np.abs(a), np.abs(b)))
    return np.where(same, 0.0, far)


def _arguments(name):
    rng = np.random.default_rng(1)
    sign = np.array([1.0, -1.0])[rng.integers(0, 2, 4096)]

    def powers(low, high):
        return 10 ** rng.uniform(low, high, 4096)

    if name in ("sin", "cos"):
        near = 0.5 * np.pi * rng.integers(-1000, 1000, 1024) * (1.0 + 1e-15 * rng.normal(size=1024))
        return np.concatenate([rng.uniform(-20, 20, 4096), sign * powers(-30, 30), near])
    if name == "exp":
        return np.concatenate([rng.uniform(-750, 712, 4096), sign * powers(-30, 0)])
    if name in ("log", "sqrt"):
        return np.concatenate([powers(-323, 308), 1.0 + sign * powers(-16, -0.1)])
    return sign * powers(-20, 20)


_LARGEST = 1.7976931348623157e308
_SPECIAL = [
    *(0.0, -0.0, np.inf, -np.inf, np.nan, 5e-324, 2.2250738585072014e-308, 1.0, -1.0),
    *(_LARGEST, -_LARGEST, 709.78, 709.79, -745.13, -745.14, 1e6),
]


@pytest.mark.parametrize("name", _NAMES)
def test_functions_of_lanes_are_those_of_the_c_library_to_one_unit_in_the_last_place(
    functions, name
):
    own, c = functions(name, _arguments(name))
    # fdlibm promises less than one unit, and the C library about half of one, of the true value.
    assert _ulps(own, c).max() <= 1.0
    if name in ("sqrt", "abs", "tanh", "floor", "atan"):
        assert np.array_equal(own, c)


@pytest.mark.parametrize("name", _NAMES)
def test_special_values_are_those_of_the_c_library(functions, name):
    own, c = functions(name, np.array(_SPECIAL))
    assert _ulps(own, c).max() <= 1.0
    # As sines that are taken together, the sine of minus zero is zero.
    if name != "sin":
        assert np.array_equal(np.signbit(own[own == 0.0]), np.signbit(c[c == 0.0]))


def test_inverses_of_positive_numbers_are_as_good_as_divisions(functions):
    # Numbers from the smallest that is no denormal; the largest have inverses that are.
    x = 10.0 ** np.random.default_rng(3).uniform(-307.6, 307.0, 4096)
    own, c = functions(_INVERSE, x)
    # Without fused products what is left of one is rounded, too.
    assert _ulps(own, c).max() <= 2.0
    assert not np.isfinite(functions(_INVERSE, np.array([np.inf, np.nan] * 4))[0]).any()


def test_one_lane_that_is_special_changes_no_other(functions):
    for name in _NAMES:
        x = np.full(8, 0.7)
        plain = functions(name, x)[0][0]
        x[2] = np.inf
        x[5] = 1e300
        found = functions(name, x)[0]
        assert (found[[0, 1, 3, 4, 6, 7]] == plain).all()
