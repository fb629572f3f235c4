"""Repeated statements to loops: what the text says, and how long it gets."""

from __future__ import annotations

import numpy as np
import pytest
from rod_chain import rod_chain

from cotree.codegen.context import model_context
from cotree.codegen.loops import roll
from cotree.errors import ParameterError
from cotree.pipeline import formulate, generate


def _links(first, last, places=lambda i: i):
    """Three statements for each link, under a comment with its name."""
    lines = []
    for i in range(first, last):
        lines += [
            f"/* f-cutset of h{i} */",
            f"const double v{3 * i} = p[{places(i)}] * x[{i}];",
            f"const double v{3 * i + 1} = v{3 * i} + v{3 * i - 1};",
            f"const double v{3 * i + 2} = sin(v{3 * i + 1});",
        ]
    return lines


def test_a_comment_of_each_time_is_one_of_the_loop():
    lines = roll(["const double v2 = 0.5;", *_links(1, 30), "dx[0] = v89;"])
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
    lines = roll(["const double v2 = 0.5;", *_links(1, 40, lambda i: i if i < 20 else 90 - i)])
    assert sum(line.startswith("for (") for line in lines) == 2
    assert not any(line.startswith("static const int") for line in lines)


def test_tables_serve_where_places_grow_unevenly():
    lines = roll(["const double v2 = 0.5;", *_links(1, 40, lambda i: i * i)])
    assert sum(line.startswith("for (") for line in lines) == 1
    assert "static const int j_0[39] = {" in lines


def test_the_array_may_have_another_name():
    lines = roll(["const double v2 = 0.5;", *_links(1, 30)], "z")
    assert lines[:2] == ["double z[88];", "z[0] = 0.5;"]


@pytest.mark.compiler
def test_a_guard_in_a_loop_names_its_parameter():
    """The number that prepare returns is of the guard that failed, not of a neighbour."""
    scene, _ = rod_chain(30)
    model = scene.compile()
    prepare = model.source.split("_prepare(")[1].split("\n}")[0]
    assert "return -(" in prepare
    for name in ("m0", "m17", "m29"):
        with pytest.raises(ParameterError, match=f"b{name[1:]}'"):
            model.rhs(0.0, np.zeros(60), model.parameter_array({name: -1.0}))


def test_the_rates_of_a_chain_are_as_long_for_any_number_of_rods():
    lines = []
    for n in (30, 40):
        program = generate(formulate(rod_chain(n)[0], (), None)[1])[0]
        kernel = next(k for k in model_context(program).kernels if "_rhs(" in k.signature)
        lines.append(sum(not line.strip()[:1].isdigit() for line in kernel.lines))
    # Loops end where links are left over: a line or two either way. Tables are not counted.
    assert abs(lines[1] - lines[0]) <= 4
    assert max(lines) < 200
