"""Storage in C of the arguments that columns of a map do not share."""

from __future__ import annotations

from cotree.codegen.node_statements import own_rows
from cotree.dag.multi_output import apply_map, form_map
from cotree.dag.nodes import Dag


def _applied(columns, dag):
    """Apply the sum of all inputs to columns."""
    inputs = [dag.symbol("a", i) for i in range(len(columns[0]))]
    formed = form_map(dag, [sum(inputs[1:], inputs[0])], inputs, columns)
    return apply_map(dag, *formed, columns)[0][0].args[0]


def _diagonal(n, value, dag):
    return [[value(i) if i == j else dag.zero for i in range(n)] for j in range(n)]


def test_pieces_of_zeros_are_one():
    dag = Dag()
    rows = own_rows(_applied(_diagonal(20, lambda i: dag.symbol("p", i), dag), dag))
    assert not rows.is_whole
    # Each row of 20 in three pieces, of which one is other than zero.
    assert rows.length == 8 * (1 + 20)
    assert [sum(place > 0 for place in group) for group in rows.places] == [8, 8, 4]
    places = [rows.places[i // 8][i] + i % 8 for i in range(20)]
    assert [rows.place(i, i) for i in range(20)] == places
    assert len(set(places)) == 20


def test_rows_that_are_known_stay_whole_where_they_are_short():
    dag = Dag()
    short, long = (own_rows(_applied(_diagonal(n, lambda _: dag.one, dag), dag)) for n in (20, 60))
    assert short.is_whole
    assert short.length == 20 * 24
    assert not long.is_whole


def test_sensitivities_are_read_where_they_are():
    dag = Dag()
    columns = [
        [dag.symbol("s", 2 * j), dag.symbol("s", 2 * j + 1), dag.symbol("p", j)] for j in (0, 1)
    ]
    rows = own_rows(_applied(columns, dag))
    assert (rows.first, rows.n_rows) == (2, 1)
    assert set(rows.values(_applied(columns, dag)).values()) == {column[2] for column in columns}
