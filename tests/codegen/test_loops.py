"""Repeated statements to loops: what the text says, and how long it gets."""

from __future__ import annotations

import numpy as np
import pytest
from rod_chain import rod_chain

from cotree.codegen.context import model_context
from cotree.codegen.ir import Assign, Comment, apply, element, number, temporary
from cotree.codegen.loops import roll
from cotree.codegen.printing import print_lines
from cotree.errors import ParameterError
from cotree.pipeline import formulate, generate


def _let(i, value):
    return Assign((temporary("v", i),), value)


def _links(first, last, places=lambda i: i):
    """Three statements for each link, under a comment with its name."""
    rows = []
    v = [temporary("v", i) for i in range(3 * last)]
    for i in range(first, last):
        rows += [
            Comment(f"f-cutset of h{i}"),
            _let(3 * i, apply("mul", element("p", places(i)), element("x", i))),
            _let(3 * i + 1, apply("add", v[3 * i], v[3 * i - 1])),
            _let(3 * i + 2, apply("sin", v[3 * i + 1])),
        ]
    return rows


def _rolled(*links, array="v"):
    return print_lines(roll([_let(2, number(0.5)), *_links(*links)], array))


def test_a_comment_of_each_time_is_one_of_the_loop():
    result = Assign((element("dx", 0),), temporary("v", 89))
    lines = print_lines(roll([_let(2, number(0.5)), *_links(1, 30), result]))
    assert lines == [
        "double v[88];",
        "v[0] = 0.5;",
        "for (int i = 0; i < 29; ++i) {",
        "    /* f-cutset of h1 to h29 */",
        "    v[3 * i + 1] = p[i + 1] * x[i + 1];",
        "    v[3 * i + 2] = v[3 * i + 1] + v[3 * i];",
        "    v[3 * i + 3] = sin(v[3 * i + 2]);",
        "}",
        "dx[0] = v[87];",
    ]


def test_loops_without_tables_are_taken_where_they_cover_about_as_much():
    """The place in p grows evenly up to link 20, and evenly after it."""
    lines = _rolled(1, 40, lambda i: i if i < 20 else 90 - i)
    assert sum(line.startswith("for (") for line in lines) == 2
    assert not any(line.startswith("static const int") for line in lines)


def test_tables_serve_where_places_grow_unevenly():
    lines = _rolled(1, 40, lambda i: i * i)
    assert sum(line.startswith("for (") for line in lines) == 1
    assert "static const int j_0[39] = {" in lines


def test_the_array_may_have_another_name():
    assert _rolled(1, 30, array="z")[:2] == ["double z[88];", "z[0] = 0.5;"]


@pytest.mark.slow
@pytest.mark.compiler
def test_a_guard_in_a_loop_names_its_parameter():
    """The number that prepare returns is of the guard that failed, not of a neighbour."""
    scene, _ = rod_chain(30)
    model = scene.compile()
    prepare = model.kernels.source.split("_prepare(")[1].split("\n}")[0]
    assert "return -(" in prepare
    for name in ("m0", "m17", "m29"):
        with pytest.raises(ParameterError, match=f"b{name[1:]}'"):
            model.rhs(0.0, np.zeros(60), model.kernels.parameter_array({name: -1.0}))


@pytest.mark.slow
def test_the_rates_of_a_chain_are_as_long_for_any_number_of_rods():
    lines = []
    for n in (30, 40):
        program = generate(formulate(rod_chain(n)[0], (), None)[1])[0]
        kernel = next(k for k in model_context(program).kernels if "_rhs(" in k.signature)
        lines.append(sum(not line.strip()[:1].isdigit() for line in kernel.body.lines))
    # Loops end where links are left over: a line or two either way. Tables are not counted.
    assert abs(lines[1] - lines[0]) <= 4
    assert max(lines) < 200
