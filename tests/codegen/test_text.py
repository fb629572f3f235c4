"""The text of C files: literals, parentheses, names and texts of a scene, contexts of templates."""

from __future__ import annotations

import dataclasses
import math
import re

import jinja2
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from jinja2 import meta, nodes
from made_up_scenes import HOSTILE, busy_scene

from cotree.build.compile import included_files
from cotree.codegen.c_files import STEPPERS, cdef, engine_files, render_model
from cotree.codegen.context import KernelContext, ModelContext, model_context
from cotree.codegen.maps import MapContext
from cotree.codegen.node_statements import print_nodes
from cotree.codegen.printing import Constants, print_expression, print_lines
from cotree.codegen.render import environment
from cotree.codegen.targets import DOUBLE
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import Dag
from cotree.dag.operations import OPERATIONS
from cotree.equations import EventRow, Quantity
from cotree.files import template_folder
from cotree.naming import c_comment, c_string
from cotree.pipeline import formulate, generate
from cotree.program.layout import Layout
from cotree.program.passes import run_passes


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_literals_read_back_equal_and_are_doubles(value):
    text = DOUBLE.literal(value)
    assert float(text) == value
    assert re.fullmatch(r"-?\d+(\.\d+)?(e[-+]?\d+)?", text)
    assert "." in text or "e" in text


def _text(node, prepared=None):
    return print_expression(print_nodes([node], prepared or {}, {}).values[0])


def _lines(*roots):
    return print_lines(print_nodes(roots, {}, {}).statements)


def _trees():
    leaves = st.integers(0, 2) | st.floats(-4.0, 4.0)
    return st.recursive(
        leaves,
        lambda children: st.one_of(
            st.tuples(st.sampled_from(["add", "sub", "mul", "div"]), children, children),
            st.tuples(st.sampled_from(["neg", "sin", "exp"]), children),
        ),
        max_leaves=25,
    )


def _grow(dag, tree):
    if isinstance(tree, int):
        return dag.symbol("x", tree)
    if isinstance(tree, float):
        return dag.constant(tree)
    op, *args = tree
    args = [_grow(dag, arg) for arg in args]
    return dag.function(op, *args) if op in ("sin", "exp") else getattr(dag, op)(*args)


@given(_trees())
def test_statements_compute_in_the_order_of_the_program(tree):
    """Sums, products and calls are spelt in C as in Python: read the C text as Python."""
    dag, x = Dag(), [0.7, -1.3, 2.9]
    try:
        root = _grow(dag, tree)
        (expected,) = evaluate([root], {dag.symbol("x", i): x[i] for i in range(3)})
    except (ArithmeticError, ValueError):
        assume(False)
    assume(math.isfinite(expected))  # Python raises where C gives an infinity
    printed = print_nodes([root], {}, {})
    known = {"x": x, "sin": math.sin, "exp": OPERATIONS["exp"].real}  # infinite as in C
    for line in print_lines(printed.statements):
        name, expression = re.fullmatch(r"const double (v\d+) = (.*);", line).groups()
        known[name] = eval(expression, known)
    # To the last bit: parentheses regroup nothing.
    assert eval(print_expression(printed.values[0]), known) == expected


def test_parentheses_stand_only_where_they_must():
    dag = Dag()
    a, b, c = (dag.symbol("x", i) for i in range(3))
    assert _text(a - (b + c)) == "x[0] - (x[1] + x[2])"
    assert _text(a / (b * c)) == "x[0] / (x[1] * x[2])"
    assert _text(a - b - c) == "x[0] - x[1] - x[2]"
    assert _text(-(a * b)) == "-(x[0] * x[1])"
    assert _text(a * b / c) == "x[0] * x[1] / x[2]"


def test_what_is_used_twice_becomes_a_constant():
    dag = Dag()
    x = dag.symbol("x", 0)
    root = dag.function("sin", x)
    printed = print_nodes([root * root, root + 1.0], {}, {})
    assert print_lines(printed.statements) == ["const double v0 = sin(x[0]);"]
    assert [*map(print_expression, printed.values)] == ["v0 * v0", "1.0 + v0"]
    assert printed.n_statements == 1


def test_long_expressions_are_broken():
    dag = Dag()
    total = dag.zero
    for i in range(200):
        total = total + dag.function("cos", dag.symbol("x", i))
    assert max(map(len, _lines(total))) < 120


def test_prepared_values_are_read():
    dag = Dag()
    root = dag.function("sin", dag.symbol("p", 0))
    assert _text(root * dag.symbol("x", 0), {root: 7}) in ("k[7] * x[0]", "x[0] * k[7]")


def test_sections_become_comments_without_escape():
    dag = Dag()
    with dag.labelled(f"joint {HOSTILE}"):
        root = dag.function("sin", dag.symbol("x", 0))
    comment, statement = _lines(root * root)
    assert statement == "const double v0 = sin(x[0]);"
    _check_comment(comment)


def _check_comment(text):
    """See that a text is one C comment from its first to its last character."""
    assert text.startswith("/*")
    assert text.index("*/", 2) == len(text) - 2
    assert "/*" not in text[2:]
    assert "??" not in text
    assert "\\" not in text
    assert text.isascii()
    assert text.isprintable()


@given(st.text(st.characters(codec="utf-8"), max_size=80))
def test_any_text_is_harmless_in_a_comment(text):
    _check_comment(f"/* {c_comment(text)} */")


@given(st.text(st.characters(codec="utf-8"), max_size=80))
def test_any_text_is_one_string_literal(text):
    literal_text = c_string(text)
    assert re.fullmatch(r'"([^"\\?]|\\["\\?])*"', literal_text)
    assert literal_text.isascii()
    assert literal_text.isprintable()


def test_hostile_texts_stay_texts():
    scene = busy_scene()
    program, _ = generate(formulate(scene, ["m"], None)[1])
    files = render_model(model_context(program))
    headers = {"cotree_abi.h", "cotree_dense.h", "cotree_lookups.h", "cotree_real.h"}
    assert set(files) == headers | {"double_.h", "double_.c"}
    for text in files.values():
        bare = re.sub(r'/\*.*?\*/|"(?:[^"\\]|\\.)*"', "", text, flags=re.DOTALL)
        assert "system" not in bare
        assert "??" not in text
        assert text.isascii()
        assert set(text) - {"\n"} <= set(map(chr, range(32, 127)))


def test_names_of_c_are_avoided():
    files = render_model(model_context(generate(formulate(busy_scene(), [], None)[1])[0]))
    assert "double__rhs" in files["double_.c"]


def test_cffi_reads_the_marked_part_of_the_header(program_of, scene_name):
    from cffi import FFI

    files = render_model(model_context(program_of(scene_name)))
    ffi = FFI()
    ffi.cdef(cdef(files["cotree_abi.h"], "some_model"))
    assert ffi.sizeof("cotree_quantity") == 2 * ffi.sizeof("void *")


def test_the_digest_follows_the_program_and_not_the_version(program_of, made_up):
    one = model_context(program_of("slider-pendulum", ["L"]))
    two = model_context(program_of("slider-pendulum", ["r"]))
    assert one.digest != two.digest
    assert model_context(program_of("slider-pendulum", ["L"])).digest == one.digest


def test_contexts_are_plain_data(program_of, scene_name):
    def check(value):
        if isinstance(value, (list, tuple, range)):
            for item in value:
                check(item)
        elif isinstance(value, dict):
            check([*value, *value.values()])
        elif dataclasses.is_dataclass(value):
            for field in dataclasses.fields(value):
                check(getattr(value, field.name))
        else:
            assert type(value) in (str, int, bool, float, type(None))

    check(model_context(program_of(scene_name)))


#: What the templates of a model call the contexts that they walk through.
_VARIABLES = {
    "model": ModelContext,
    "kernel": KernelContext,
    "table": Constants,
    "row": Quantity,
    "event": EventRow,
    "layout": Layout,
    "map": MapContext,
}
_TEMPLATES = [
    "cotree_abi.h.jinja",
    "model.c.jinja",
    "kernels.c.jinja",
    "model.h.jinja",
    "macros.jinja",
    "vectors.c.jinja",
    "vectors.h.jinja",
]


def _used():
    """Collect the attributes that the templates read, by variable."""
    environment = jinja2.Environment()
    used = {name: set() for name in _VARIABLES}
    for file in _TEMPLATES:
        tree = environment.parse((template_folder() / "c" / file).read_text())
        for read in tree.find_all(nodes.Getattr):
            if isinstance(read.node, nodes.Name) and read.node.name in used:
                used[read.node.name].add(read.attr)
    return used


def test_templates_use_the_fields_of_their_contexts_and_all_of_them():
    # What serves other stages: the flags of the compiler, of cotree_abi.h, and properties.
    elsewhere = {"model": {"generator", "upper"}, "map": {"n_stack"}}
    for name, used in _used().items():
        kind = _VARIABLES[name]
        if kind in (Quantity, EventRow, Layout):  # rows of the program, which others read, too
            elsewhere[name] = {*kind.__dataclass_fields__, *vars(kind)}
        fields = {field.name for field in dataclasses.fields(kind)}
        known = fields | elsewhere.get(name, set())
        assert used <= known, f"{name}: {used - known}"
        unused = fields - used - elsewhere.get(name, set())
        assert not unused, f"{name}: {unused}"


@pytest.mark.parametrize("file", _TEMPLATES)
def test_templates_read_their_context_only(file):
    tree = environment().parse((template_folder() / "c" / file).read_text())
    expected = {"cotree_abi.h.jinja": {"abi_version", "generator", "kernels"}}
    expected |= {"macros.jinja": set()}
    found = meta.find_undeclared_variables(tree)
    # What the target tells every template.
    target = environment().globals.keys() - jinja2.Environment().globals.keys()
    assert found - target == expected.get(file, {"model"})


def test_counts_in_comments_are_those_of_the_program(made_up):
    dag = Dag()
    x, p = dag.symbol("x", 0), dag.symbol("p", 0)
    program, _ = run_passes(made_up(dag, rhs=[dag.function("sin", x * p) / p]))
    context = model_context(program)
    rhs = next(k for k in context.kernels if k.signature.startswith("int made_up_rhs("))
    assert (rhs.n_results, rhs.n_operations) == (1, program.kernels["rhs"].operations.total)
    assert math.isclose(rhs.n_operations, 3)


def test_engines_share_the_objects_of_the_runtime():
    first = engine_files(STEPPERS[0])
    for stepper in STEPPERS:
        files = engine_files(stepper)
        for module in ("assembly", "events", "job", "jumps", "least", "run"):
            name = f"cotree_{module}.c"
            assert included_files(files, name) == included_files(first, name)
