"""Objectives and constraints of a design, parsed from text.

The texts follow the grammar of expressions (:mod:`cotree.scene.expressions`). A few functions
denote quantities of a whole run: ``end(x)``, ``start(x)``, ``at(2.0, x)``, ``integral(x)``,
``mean(x)``, ``maximum(x)``, ``minimum(x)`` and ``time(event)``. Parsing returns these quantities,
and formulas that contain them. No text is executed as Python code.

Expressions become outputs, and integrals become states: each is the voltage of a capacitor of 1 F,
charged by a current equal to the integrand. Sensitivity graphs therefore compute its sensitivities
as for any other state.
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from cotree.dag.derivative import adjoints
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import Dag
from cotree.errors import Error, ExpressionError, ParameterError, brief, check_known, nearest
from cotree.scene.expressions import FUNCTIONS, WHERE, Expression, map_tree, parse, read_tree
from cotree.scene.settings import OPERATING_POINT

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from cotree.scene.description import SceneDescription


#: Functions that denote quantities of a run, with their numbers of arguments.
QUANTITIES = {
    "end": 1,
    "start": 1,
    "at": 2,
    "integral": 1,
    "mean": 1,
    "maximum": 1,
    "minimum": 1,
    "time": 1,
}

#: Quantities that are integrals over the run, whose integrands may jump.
SUMMED = ("integral", "mean")

#: Discontinuous functions, which a gradient-based search cannot use.
_JUMPING = {"sign", "floor", "mod"}

#: Prefix of placeholders; names in scenes are C identifiers, which cannot contain it.
_MARK = "quantity_ö"

_LONGEST = 4000  # maximum length of a goal, as for expressions
_COMPARISONS: dict[type[ast.cmpop], str] = {
    ast.LtE: "<=",
    ast.Lt: "<=",
    ast.GtE: ">=",
    ast.Gt: ">=",
    ast.Eq: "==",
}


@dataclass(frozen=True)
class GoalQuantity:
    """A scalar quantity of a run."""

    kind: str  # name of the function, a key of :data:`QUANTITIES`
    text: str  # argument of the quantity: an expression, or for ``time`` the name of an event
    t: float = 0.0  # time of evaluation, for the kind ``at`` only, [s]


class GoalFunction:
    """A differentiable function of quantities (as placeholders) and design variables."""

    def __init__(self, expression: Expression, n_quantities: int, over: Sequence[str]) -> None:
        dag = Dag()
        self._symbols = [dag.symbol("x", i) for i in range(n_quantities)]
        self._symbols += [dag.symbol("p", i) for i in range(len(over))]
        known = {f"{_MARK}{i}": symbol for i, symbol in enumerate(self._symbols[:n_quantities])}
        known |= dict(zip(over, self._symbols[n_quantities:], strict=True))
        self._node = expression.lower(dag, known.__getitem__)
        self._slopes = adjoints([self._node], [dag.one], self._symbols)

    def value(self, numbers: Sequence[float]) -> tuple[float, list[float]]:
        """Return value and derivatives; ``numbers`` are the quantities, then the variables."""
        found = evaluate(
            [self._node, *self._slopes], dict(zip(self._symbols, numbers, strict=True))
        )
        value, *slopes = (float(number) for number in found)
        return value, slopes


@dataclass(frozen=True)
class GoalCondition:
    """A constraint ``excess <= 0`` or ``excess == 0``."""

    text: str  # the condition as written by the user
    excess: Expression  # left minus right side, with placeholders for quantities
    is_equality: bool  # whether the condition is an equality


class Goals:
    """The goals of a design, parsed from text; names not in ``parameters`` denote final values."""

    def __init__(
        self, minimise: object, subject_to: Sequence[object], parameters: Collection[str]
    ) -> None:
        self.quantities: list[GoalQuantity] = []
        self._varied = set(parameters)
        tree = self._read(minimise, "minimise")
        if isinstance(tree, ast.Compare):
            raise ExpressionError(
                f"minimise: '{brief(minimise)}' is a comparison: constraints belong in subject_to"
            )
        self.objective = self._formula(tree, "minimise")
        self.conditions: list[GoalCondition] = []
        for text in subject_to:
            self.conditions += self._conditions(text)

    def _read(self, text: object, where: str) -> ast.expr:
        if not isinstance(text, str) or len(text) > _LONGEST:
            raise ExpressionError(
                f"{where} must be an expression of at most {_LONGEST} characters, not "
                f"{brief(repr(text))}"
            )
        try:
            return read_tree(text)
        except ExpressionError as error:
            raise ExpressionError(f"{where}: '{brief(text)}' {error}") from None

    def _conditions(self, text: object) -> list[GoalCondition]:
        """Parse a constraint; a chain such as ``0 <= x <= 2`` becomes two conditions."""
        tree = self._read(text, "subject_to")
        if not isinstance(tree, ast.Compare):
            raise ExpressionError(
                f"subject_to: '{brief(text)}' is not a comparison: write it with <=, >= or =="
            )
        sides = [tree.left, *tree.comparators]
        found = []
        for a, op, b in zip(sides[:-1], tree.ops, sides[1:], strict=True):
            sign = _COMPARISONS.get(type(op))
            if sign is None:
                raise ExpressionError(
                    f"subject_to: '{brief(text)}' uses an operator other than <=, >= and =="
                )
            low, high = (b, a) if sign == ">=" else (a, b)
            excess = ast.BinOp(low, ast.Sub(), high)
            shown = f"{ast.unparse(a)} {sign} {ast.unparse(b)}"
            found.append(GoalCondition(shown, self._formula(excess, "subject_to"), sign == "=="))
        return found

    def _formula(self, tree: ast.expr, where: str) -> Expression:
        """Replace the quantities in an expression by placeholders."""
        try:
            marked = ast.unparse(map_tree(tree, lambda part: self._marked(part, where)))
        except RecursionError:
            raise ExpressionError(f"{where} is nested too deeply: split it") from None
        return parse(marked, where)

    def _add(self, kind: str, text: str, t: float = 0.0) -> ast.Name:
        """Register a quantity and return its placeholder."""
        quantity = GoalQuantity(kind, text, t)
        if quantity not in self.quantities:
            self.quantities.append(quantity)
        return ast.Name(f"{_MARK}{self.quantities.index(quantity)}")

    def _marked(self, part: ast.expr, where: str) -> ast.expr | None:
        """Return the placeholder if ``part`` is a quantity, else None."""
        if isinstance(part, (ast.Name, ast.Attribute)):
            # Parameters of parts have dots in their names, as variables do.
            name = ast.unparse(part)
            return part if name == "pi" or name in self._varied else self._add("end", name)
        if not isinstance(part, ast.Call):
            return None
        name, where = _called(part), f"{where}: "
        if name not in QUANTITIES:
            if name in _JUMPING or name == WHERE:
                raise ExpressionError(
                    f"{where}'{name}' is discontinuous, so its gradient is useless to the search: "
                    "use it inside integral(...) only"
                )
            if name not in FUNCTIONS:
                known = nearest(name, [*FUNCTIONS, *QUANTITIES])
                shown = brief(ast.unparse(part.func))
                raise ExpressionError(f"{where}calls '{shown}', which is unknown{known}")
            return None
        if part.keywords or len(part.args) != QUANTITIES[name]:
            raise ExpressionError(
                f"{where}{name} takes {QUANTITIES[name]} argument{'s' * (QUANTITIES[name] > 1)}"
                + (": a time and an expression" if name == "at" else "")
            )
        inner = part.args[-1]
        for own in ast.walk(inner):
            called = _called(own)
            if called in QUANTITIES:
                raise ExpressionError(
                    f"{where}{called}(...) is nested inside {name}(...), which is not supported"
                )
            if called in _JUMPING and name not in SUMMED:
                raise ExpressionError(
                    f"{where}{called} is discontinuous, so {name}(...) of it has no derivative"
                )
        t = _time(part.args[0], where) if name == "at" else 0.0
        return self._add(name, parse(ast.unparse(inner), f"{where}{name}").text, t)


def _time(tree: ast.expr, where: str) -> float:
    expression = parse(ast.unparse(tree), f"{where}the time of at")
    if expression.names - {"pi"}:
        raise ExpressionError(f"{where}the time of at(...) must be a number")
    dag = Dag()
    found = expression.lower(dag, lambda name: dag.zero).value
    assert found is not None  # constant expressions are already numbers
    return float(found)


def _called(part: ast.AST) -> str:
    """Return the name of the function called in a syntax tree node, or an empty string."""
    is_call = isinstance(part, ast.Call) and isinstance(part.func, ast.Name)
    return part.func.id if is_call else ""  # type: ignore[attr-defined]


def check_times(quantities: Sequence[GoalQuantity], span: tuple[float, float]) -> None:
    """Raise an error if the time in ``at(t, ...)`` is outside the run."""
    for quantity in quantities:
        if quantity.kind == "at" and not min(span) <= quantity.t <= max(span):
            raise ParameterError(
                f"at({quantity.t:g}, {quantity.text}) is outside the run from t = {span[0]:g} to "
                f"{span[1]:g}"
            )


_Model = TypeVar("_Model")


def variant_of(
    scene: SceneDescription,
    quantities: Sequence[GoalQuantity],
    compiled: Callable[[SceneDescription], _Model],
) -> tuple[_Model, dict[GoalQuantity, str]]:
    """Compile a scene with an output for each quantity; return the model and the output names."""
    changed = scene.copied()
    taken = {*scene.edges, *scene.outputs, *scene.parameters, *scene.inputs, *scene.modes}
    prefix = "goal"
    while any(name.startswith(prefix) for name in (*taken, *scene.nodes)):
        prefix += "_"
    found: dict[GoalQuantity, str] = {}
    outputs: dict[tuple[bool, str], str] = {}
    for quantity in quantities:
        if quantity.kind == "time":
            what = f"time({quantity.text}): the scene has no event"
            check_known([quantity.text], scene.events, what, error=ParameterError)
            found[quantity] = quantity.text
            continue
        key = (quantity.kind in SUMMED, quantity.text)
        if key not in outputs:
            outputs[key] = f"{prefix}{len(outputs)}"
            _add(changed, outputs[key], *key)
        found[quantity] = outputs[key]
    try:
        return compiled(changed), found
    except Error as error:
        # Error messages quote the user's expressions instead of the outputs derived from them.
        message = str(error)
        for (_, text), name in outputs.items():
            message = message.replace(f"output '{name}'", f"'{text}' in a goal")
        for is_summed, text in outputs:
            # Errors in the integrand name a field of an edge instead of the expression.
            if is_summed and any(f"'{name}'" in message for name in parse(text, text).names):
                message = re.sub(r"^.*? uses '", f"'{text}' in a goal uses '", message)
        raise type(error)(message) from None


def _add(scene: SceneDescription, name: str, is_summed: bool, text: str) -> None:
    try:
        if not is_summed:
            scene.output(name, text)
            return
        if scene.defaults.start == OPERATING_POINT:
            raise ParameterError(
                f"integral({text}) needs a run from initial values, but this scene starts at its "
                "operating point, where an integral over time has no steady value"
            )
        # A factor 1.0 without a unit allows the integrand to have any unit.
        current = f"1.0*({text})"
        scene.edge(f"{name}i", "current_source", "ground", f"{name}n", current=current)
        scene.edge(f"{name}c", "capacitor", f"{name}n", "ground", capacitance=1.0)
        scene.output(name, f"{name}c.v")
    except Error as error:
        raise type(error)(f"'{text}' in a goal: {error}") from None
