"""Every operation is the same with a compiler and without: infinities, nan, signs of zeros."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from evaluated_kernels import EvaluatedKernels

import cotree
from cotree.dag.lookup import CubicTable, LinearTable, PlaneTable
from cotree.dag.multi_output import SEVERAL, sines, table
from cotree.dag.nodes import Dag
from cotree.dag.operations import OPERATIONS
from cotree.errors import SingularSystemError
from cotree.model.model import CompiledModel
from cotree.program.text import ModelText
from cotree.scene.expressions import FUNCTIONS, parse

pytestmark = pytest.mark.compiler

NONE = np.zeros(0)
INF, NAN = math.inf, math.nan
LARGEST, SMALLEST, TINY = 1.7976931348623157e308, 5e-324, 2.2250738585072014e-308
SPECIAL = [
    *(0.0, SMALLEST, TINY, 1e-200, 0.3, 0.5, 1.0, 1.0 + 2.0**-52, 1.5, 2.0, 3.0, 7.0, 64.0),
    *(709.0, 710.5, 745.0, 1000.0, 2.0**53, 1e200, LARGEST, INF),
]
VALUES = [*SPECIAL, *(-value for value in SPECIAL), NAN, math.pi / 2, -math.pi]

#: Functions of C's library, which may round differently where Python was built with another one:
#: a unit in the last place, and one for whoever folds constants.
ROUNDED = {name for name, row in OPERATIONS.items() if row.is_call} - {"sqrt", "abs", "floor"}
ROUNDED -= {"sign", "select"}


@pytest.fixture(scope="module")
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def both(made_up, load_kernels):
    """Evaluate roots of three states with a compiler and without."""

    def make(dag, roots):
        program = made_up(dag, n_states=3, outputs=roots)
        kernels = load_kernels(program), EvaluatedKernels(program)
        for own in kernels:
            own.prepare(np.ones(1))
        return lambda x: [own("outputs", 0.0, np.array(x), NONE, NONE).copy() for own in kernels]

    return make


def check(names, found, known, x):
    """Compare bits, and where functions are rounded two units in the last place."""
    for name, a, b in zip(names, found, known, strict=True):
        is_same = (math.isnan(a) and math.isnan(b)) or a == b
        if is_same and (a != 0.0 or math.isnan(a)):
            continue
        if is_same:
            assert math.copysign(1.0, a) == math.copysign(1.0, b), (name, x, a, b)
            continue
        assert name in ROUNDED, (name, x, a, b)
        assert abs(a - b) <= 2 * math.ulp(b), (name, x, a, b)


def points(rng):
    """Return special values in all pairs, and random ones of all sizes."""
    for pair in itertools.product(VALUES, VALUES):
        yield (*pair, VALUES[rng.integers(len(VALUES))])
    for _ in range(1000):
        yield tuple(rng.normal(size=3) * 10.0 ** rng.uniform(-5, 5, 3))
    for _ in range(200):
        yield tuple(rng.normal(size=3) * 10.0 ** rng.uniform(-300, 300, 3))


def test_every_operation(both, rng):
    dag = Dag()
    x = [dag.symbol("x", i) for i in range(3)]
    roots = [dag._intern(name, tuple(x[: row.arity])) for name, row in OPERATIONS.items()]
    evaluate = both(dag, roots)
    for point in points(rng):
        check(OPERATIONS, *evaluate(point), point)


def test_every_function_of_expressions(both, rng):
    """Those that are no operations are made of some: ``min``, ``max``, ``mod``, powers."""
    dag = Dag()
    names = dict(zip("abc", (dag.symbol("x", i) for i in range(3)), strict=True))
    texts = [f"{name}({', '.join('abc'[:n])})" for name, n in FUNCTIONS.items()]
    texts += ["a**2", "a**-3", "a**0.5", "a**b", "1/(1 + exp(-1000*a)) - a", "where(a < b, b, c)"]
    evaluate = both(dag, [parse(text, "it").lower(dag, names.__getitem__) for text in texts])
    plain = {"min", "max", "mod", "abs", "floor", "sign", "sqrt", "where"}
    rounded = [text for text in texts if text.split("(")[0] not in plain]
    for point in points(rng):
        compiled, python = evaluate(point)
        for text, a, b in zip(texts, compiled, python, strict=True):
            check(["pow" if text in rounded else "add"], [a], [b], (text, point))


def test_what_has_several_results(both):
    """Tables pass nan on; sines of several angles are nan where an angle is infinite."""
    tested = {"table", "lookup", "sines"}  # the others are tested one by one
    assert set(SEVERAL) == {"solve", "call", "map"} | tested
    dag = Dag()
    x = [dag.symbol("x", i) for i in range(3)]
    value, slope = table(dag, LinearTable((-1.0, 0.5, 2.0), (3.0, -1.0, 4.0)), x[0])
    cubic = CubicTable((-1.0, 0.5, 2.0), (3.0, -1.0, 4.0), (0.3, 0.0, 1.7))
    plane = PlaneTable((-1.0, 0.5, 2.0), (0.0, 2.0), (3.0, -1.0, 4.0, 0.5, 1.0, -2.0))
    found = [*dag.several("lookup", x[:1], cubic, 4), *dag.several("lookup", x[:2], plane, 4)]
    tables = both(dag, found)
    evaluate = both(dag, [value, slope, *sines(dag, x)])
    for first, second in itertools.product(VALUES, VALUES):
        point = (first, second, 0.3)
        check(["add"] * len(found), *tables(point), point)
        compiled, python = evaluate(point)
        check(["add"] * 2, compiled[:2], python[:2], point)
        assert math.isnan(compiled[0]) == math.isnan(first)
        assert np.array_equal(np.isfinite(compiled[2:]), np.isfinite(python[2:]))
        # Sines in vectors differ from the library's by less than one unit in the last place.
        np.testing.assert_allclose(compiled[2:], python[2:], rtol=0.0, atol=2.3e-16)


def logistic():
    scene = cotree.Scene("logistic")
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], initial={"s": -1.0})
    scene.edge("body", "rigid_body", "ground", "A", mass=1.0)
    scene.edge("F", "force", "ground", "A", force=["1/(1 + exp(-1000*j.s)) - j.s", 0, 0])
    return scene


def test_an_overflow_that_does_no_harm_does_none_in_python():
    compiled = logistic().compile()
    program = compiled.kernels.program
    python = CompiledModel(ModelText.of(program), EvaluatedKernels(program))
    for s in (-1.0, -0.7, 0.0, 1e-4, 1.0):
        assert np.array_equal(python.rhs(0.0, [s, 0.2]), compiled.rhs(0.0, [s, 0.2]))
        assert np.array_equal(
            python.jacobian(0.0, [s, 0.2]), compiled.jacobian(0.0, [s, 0.2]), True
        )


def test_what_is_not_finite_at_the_end_is_refused():
    scene = cotree.Scene("root")
    scene.parameter("a", -1.0)
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], force="sqrt(a + j.s)")
    scene.edge("body", "rigid_body", "ground", "A", mass=1.0)
    with pytest.raises(SingularSystemError, match=r"'j\.s_dot' is not finite"):
        scene.compile()
