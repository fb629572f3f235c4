"""The same statements for several targets: types, qualifiers and names are the target's."""

from __future__ import annotations

import pytest

from cotree.codegen.ir import (
    SCALAR,
    Affine,
    Argument,
    Array,
    Assign,
    Comment,
    ConstantTable,
    FunctionPart,
    LeaveUnless,
    Loop,
    apply,
    element,
    function_of,
    n_operations,
    named,
    number,
    temporary,
    uses,
    whole,
)
from cotree.codegen.kernel_blocks import Blocks
from cotree.codegen.node_statements import print_nodes
from cotree.codegen.printing import print_body, print_lines
from cotree.codegen.targets import DOUBLE, LANES, SINGLE, Target
from cotree.dag.nodes import Dag
from cotree.errors import CodegenError

FLOAT = Target(real="float", scalar="float", suffix="f")


def _lines(target, *statements):
    return print_lines(statements, target)


def test_numbers_and_functions_are_of_the_type_of_the_target():
    dag = Dag()
    x = dag.symbol("x", 0)
    root = dag.function("sin", x) * 0.5 + dag.function("sign", x) + dag.select(x, x, dag.one)
    (value,) = print_nodes([root], {}, {}).values
    rows = Assign((temporary("v", 0),), value), LeaveUnless(value, whole(3), is_strict=True)
    texts = [_lines(target, *rows) for target in (DOUBLE, FLOAT)]
    assert texts[1] == [
        text.replace("double", "float")
        .replace("sin(", "sinf(")
        .replace("0.5", "0.5f")
        .replace("1.0", "1.0f")
        .replace("0.0", "0.0f")
        for text in texts[0]
    ]


def test_lanes_compute_with_vectors_and_read_numbers():
    total = Assign((temporary("v", 0),), apply("mul", number(0.5), element("column", 3)))
    assert _lines(LANES, Array("w", 2), total) == [
        "VECTOR w[2];",
        "const VECTOR v0 = 0.5 * column[3];",
    ]
    table = ConstantTable("c_0", SCALAR, (1.0, 2.5))
    assert _lines(LANES, table)[0] == "static const double c_0[2] = {"


def test_functions_that_are_part_of_another_are_named_by_the_target():
    body = [Assign((element("result", 0),), element("shared", 1))]
    arguments = [Argument("shared"), Argument("here"), Argument("result", is_constant=False)]
    function, call = function_of("f_1", body, arguments)
    assert function == FunctionPart("f_1", [arguments[0], arguments[2]], body)
    written = print_body(Blocks([function], [Assign((named("status"),), call)]), LANES)
    assert written.blocks[0].signature.startswith("TARGET COTREE_APART static void NAMED(f_1)(")
    assert written.lines == ["status = NAMED(f_1)(shared, result);"]


def test_places_of_loops_stand_in_parentheses_only_where_they_must():
    place = Assign((element("y", Affine(-2, 9)),), element("x", Affine(1, 0)))
    guard = LeaveUnless(element("x", Affine(3, 1)), whole(Affine(1, 1)), is_strict=False)
    loop = Loop(4, (Comment("a*/b"), place, guard))
    assert _lines(DOUBLE, loop) == [
        "for (int i = 0; i < 4; ++i) {",
        "    /* a* /b */",
        "    y[9 - 2 * i] = x[i];",
        "    if (!(x[3 * i + 1] >= 0.0)) return -(i + 1);",
        "}",
    ]
    # The comparison of i; two to find the place in y; two for x, one for the number, which is
    # negated.
    assert n_operations([loop]) == 1 + 2 + (2 + 1 + 1)
    assert uses(loop) == {"x", "y"}


def test_coefficients_are_decimals_or_quotients_of_the_type():
    assert DOUBLE.constant("19372.0 / 6561.0") == "19372.0 / 6561.0"
    assert SINGLE.constant("19372.0 / 6561.0") == "19372.0f / 6561.0f"
    assert SINGLE.lanes.literal(-0.5) == "-0.5f"


@pytest.mark.parametrize("value", [1e39, -1e-39])
def test_numbers_beyond_the_range_of_the_type_are_refused(value):
    row = Assign((temporary("v", 0),), number(value))
    table = ConstantTable("c_0", SCALAR, (value,))
    assert _lines(DOUBLE, row, table)[0] == f"const double v0 = {value!r};"
    for statement in (row, table):
        with pytest.raises(CodegenError, match="is beyond the range of float"):
            _lines(SINGLE, statement)
