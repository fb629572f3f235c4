"""Entries that vanish along a column of a map are left out, and the others are unchanged."""

from __future__ import annotations

import ctypes
import random
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cotree.codegen import maps
from cotree.codegen.maps import map_context
from cotree.codegen.node_statements import own_rows
from cotree.codegen.render import render, with_runtime
from cotree.codegen.targets import DOUBLE
from cotree.dag.multi_output import BLOCK, apply_map, form_map
from cotree.dag.nodes import Dag
from cotree.program.columns import gather_columns

pytestmark = pytest.mark.compiler

WIDTHS = (1, 2, 4, 8)
_INTS = ctypes.POINTER(ctypes.c_int)


def _random_map(seed):
    """Build a map of random sums and products; inputs are zero in random blocks of columns."""
    rng, dag = random.Random(seed), Dag()
    inputs = [dag.symbol("a", i) for i in range(rng.randint(1, 8))]
    factors = [dag.symbol("x", i) for i in range(rng.randint(1, 6))]
    values = list(inputs)
    for _ in range(rng.randint(5, 80)):
        a, b = rng.choice(values), rng.choice(values)
        values.append(rng.choice([a * rng.choice(factors), a + b, a - b, -a, a * 0.5]))
    results = [rng.choice(values) for _ in range(rng.randint(1, 10))]
    n_columns = rng.randint(1, 21)
    blocks = range(-(-n_columns // BLOCK))
    given_in = [{k for k in blocks if rng.random() < 0.4} for _ in inputs]
    columns = [
        [
            dag.symbol("c", j * len(inputs) + i)
            if j // BLOCK in given_in[i] and rng.random() < 0.8
            else dag.zero
            for i in range(len(inputs))
        ]
        for j in range(n_columns)
    ]
    formed = form_map(dag, results, inputs, columns)
    return dag, *formed, columns


def _library(run_compiler, linear, node):
    """Compile a map for vectors of each width."""
    arguments = "const double *shared, const double *own, const int *starts, double *results"
    heads = "\n".join(f"void take_{n}({arguments});" for n in WIDTHS)
    parts = ["#include <string.h>", "#define COTREE_RESTRICT restrict", "#define COTREE_APART"]
    parts += [heads, "#define TARGET", "#define LEAVE (void)0"]
    model = SimpleNamespace(
        title="m", generator="", digest="", prefix="m", packs_sines=False,
        maps=[map_context(node, "map", DOUBLE)],
    )  # fmt: skip
    text = render("c/vectors.h.jinja", model=model)
    for n in WIDTHS:
        parts += [f"#undef LANES\n#define LANES {n}", "#undef NAMED"]
        parts += [f"#define NAMED(name) name##_{n}", text]
        call = f"map_{n}(shared, own, own, starts, results);"
        parts.append(f"void take_{n}({arguments})\n{{\n    {call}\n}}\n")
    # Vectors of eight are wider than this machine's may be, which gcc remarks on.
    flags = ("-O1", "-shared", "-fPIC", "-ffp-contract=off", "-Wno-psabi")
    path = run_compiler(with_runtime({"map.c": "\n".join(parts)}), *flags)
    # A library that is loaded must not be written over.
    return ctypes.CDLL(str(path.rename(path.with_name(f"{len(list(path.parent.iterdir()))}.so"))))


def _applied(library, width, rows, shared, columns):
    """Apply the compiled map to numbers, column by column, and row by row."""
    linear = rows.linear
    own = np.zeros(rows.length)
    for j, column in enumerate(columns):
        for i, value in enumerate(column):
            if linear.given[j] >> i & 1:
                own[rows.place(i, j)] = value
    n, function = len(linear.results), getattr(library, f"take_{width}")
    by_columns, by_rows = (
        np.full((linear.n_columns, n + 1), np.nan),
        np.full((n, rows.width), np.nan),
    )
    starts = np.arange(linear.n_columns, dtype=np.intc) * (n + 1)
    given_shared = np.array([*shared, 0.0])
    function(_at(given_shared), _at(own), None, _at(by_rows))
    function(_at(given_shared), _at(own), starts.ctypes.data_as(_INTS), _at(by_columns))
    assert np.all(np.isnan(by_columns[:, n]))  # what lies between columns is left alone
    np.testing.assert_array_equal(by_rows.T[: linear.n_columns], by_columns[:, :n])
    return by_columns[:, :n].ravel()


def _at(array):
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


@settings(
    max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True
)
@given(seed=st.integers(0, 10**6), longest=st.sampled_from([4, 1000]), in_turn=st.booleans())
def test_segments_give_the_bits_of_all_statements(run_compiler, seed, longest, in_turn):
    dag, linear, shared, columns = _random_map(seed)
    node = apply_map(dag, linear, shared, columns)[0][0].args[0]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(maps, "_LONGEST_BLOCK", longest)
        patch.setattr(maps, "_LONGEST_IN_TURN", longest)
        patch.setattr(maps, "_is_waiting", lambda _: in_turn)
        patch.setattr(maps, "_SKIPPED", -1.0)  # segments, however little they leave out
        library = _library(run_compiler, linear, node)
    rng = np.random.default_rng(seed)
    factors = rng.normal(size=linear.n_shared)
    numbers = [[0.0 if v.is_zero else rng.normal() for v in column] for column in columns]
    # Every statement for every column: products with zeros and sums of these.
    expected = linear.evaluate([*factors, *(value for column in numbers for value in column)])
    found = [_applied(library, width, own_rows(node), factors, numbers) for width in WIDTHS]
    for values in found:
        np.testing.assert_array_equal(values, expected)
        np.testing.assert_array_equal(np.signbit(values), np.signbit(found[0]))


@given(seed=st.integers(0, 10**6))
def test_columns_that_are_gathered_take_no_more(seed):
    _, linear, _, columns = _random_map(seed)
    gathered, order = gather_columns(linear)
    in_order = replace(linear, given=tuple(linear.given[j] for j in sorted(order)))
    assert gathered.n_times <= in_order.n_times
    assert gathered.counts == linear.counts
    assert [linear.given[j] for j in order] == list(gathered.given)
    left_out = set(range(len(columns))) - set(order)
    assert not any(linear.supports[root] >> j & 1 for root in linear.results for j in left_out)
