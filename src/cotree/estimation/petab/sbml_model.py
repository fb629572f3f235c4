"""The model of a PEtab problem: a scene from an SBML file, with outputs for measured values.

Overrides in the measurement table replace placeholders in formulas, and each distinct formula
becomes an output. Noise formulas without names become numbers. The condition table takes precedence
over the parameter table, and both over the model. After a preequilibration, each state keeps its
value unless the condition sets it.
"""

from __future__ import annotations

import ast
import math
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from cotree.api import Scene
from cotree.dag.nodes import Dag, Node
from cotree.errors import ExpressionError, ModelError, SceneError, brief, nearest
from cotree.estimation.conditions import Condition, Measured
from cotree.readers.formulas import GROUP, Rewriter, python_text
from cotree.readers.names import Namer
from cotree.readers.sbml.scene import SbmlModel, read_sbml_model
from cotree.scene.expressions import fill, parse, shared_tree

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from cotree.compiled import Model
    from cotree.estimation.petab.tsv_tables import (
        ConditionRow,
        MeasurementRow,
        ObservableRow,
        Tables,
    )


#: Value set by a condition: the name of an estimated parameter, or a number.
Setting = str | float


@dataclass(frozen=True)
class Entities:
    """Model quantities that tables may set: their names in the scene, by identifier."""

    #: Scene parameters for constants of the model, and for parameters used only in formulas.
    parameters: Mapping[str, str]
    states: Mapping[str, str]  # states of the scene for quantities that change with time
    #: Scene parameters for the initial values of these states, if they are numbers.
    initial: Mapping[str, str]
    #: Identifiers in ``parameters`` and ``states`` without a value in the model.
    valueless: frozenset[str] = frozenset()
    #: Values of ``parameters`` that are numbers in the model.
    numbers: Mapping[str, float] = field(default_factory=dict)


class Link(NamedTuple):
    """A run, with the values set by its condition; keys are names in the scene."""

    name: str  # name of the run in messages
    parameters: dict[str, Setting]
    initial: dict[str, Setting]


class ConditionReader:
    """Determines the values that conditions set."""

    def __init__(self, tables: Tables, entities: Entities) -> None:
        self._tables, self._entities = tables, entities
        known = {*entities.parameters, *entities.states}
        for condition in tables.conditions.values():
            for name in condition.cells:
                if name not in known:
                    raise condition.row.error(
                        f"the column '{name}' is not a parameter, compartment or species of the "
                        f"model that can be set{nearest(name, known)}"
                    )

    def chain(self, condition: str, before: str, is_at_rest: bool) -> tuple[Link, ...]:
        """Return the runs that lead to measured values; all but the last end at a steady state.

        ``before`` is the preequilibration condition, or empty. ``is_at_rest`` is true if values
        were measured at the steady state of the condition itself.
        """
        first = (self._link(before, before),) if before else ()
        name = f"{condition} after {before}" if before else condition
        own = self._link(condition, name, *first)
        # Values at a steady state are the initial values of a run that starts there.
        last = (Link(f"{name} at rest", own.parameters, {}),) if is_at_rest else ()
        return (*first, own, *last)

    def _link(self, key: str, name: str, before: Link | None = None) -> Link:
        """Return the run of a condition, which may follow the steady state of ``before``."""
        condition, entities = self._tables.conditions[key], self._entities
        found = Link(name, {}, {})
        for identifier, parameter in entities.parameters.items():
            value = self._setting(condition, identifier)
            if value is not None:
                found.parameters[parameter] = value
        # Parameters of initial values keep their values: runs from a steady state do not use them.
        for parameter in entities.initial.values() if before else ():
            if before and parameter in before.parameters:
                found.parameters[parameter] = before.parameters[parameter]
        for identifier, state in entities.states.items():
            if before and condition.cells.get(identifier) is None:
                continue
            value = self._setting(condition, identifier)
            if value is None:
                continue
            # A numeric initial value is a scene parameter, on which others may depend.
            if not before and identifier in entities.initial:
                found.parameters[entities.initial[identifier]] = value
            else:
                found.initial[state] = value
        return found

    def _setting(self, condition: ConditionRow, identifier: str) -> Setting | None:
        """Return the value of a quantity in a condition; None if the model's value applies."""
        if identifier not in condition.cells:
            value = self._listed(identifier)
        else:
            value = condition.cells[identifier]
            if isinstance(value, str):
                value = self._named(condition, identifier, value)
        if value is None and identifier in self._entities.valueless:
            raise condition.row.error(
                f"'{identifier}' has no value in condition '{condition.name}': set it there or in "
                "the parameter table"
            )
        return value

    def _listed(self, name: str) -> Setting | None:
        """Return the name of an estimated parameter, or else its value in the parameter table."""
        row = self._tables.parameters.get(name)
        return name if row and row.is_estimated else row.nominal if row else None

    def _named(self, condition: ConditionRow, identifier: str, cell: str) -> Setting:
        """Return the value of a name in a cell: a parameter or a constant of the model."""
        numbers, named = self._entities.numbers, cell
        for _ in range(len(condition.cells) + 1):
            value = self._listed(named)
            if value is not None:
                return value
            own = condition.cells.get(named)
            if own is None:
                break  # the condition does not set this quantity
            if not isinstance(own, str):
                return own
            named = own
        else:
            raise condition.row.error(
                f"'{identifier}' of condition '{condition.name}' depends on itself through the "
                f"column '{cell}': give a number or an entry of the parameter table"
            )
        if named in numbers:
            return numbers[named]
        hint = nearest(named, {*self._tables.parameters, *numbers})
        raise condition.row.error(
            f"'{identifier}' of condition '{condition.name}' is '{named}', which is neither in the "
            f"parameter table nor a constant of the model with a number{hint}"
        )


_LONGEST = 4000  # maximum length of a formula, as for expressions in scenes
_TIME = "time"

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|(?P<call>[A-Za-z_]\w*)\s*\("
    r"|(?P<name>[A-Za-z_]\w*)|(?P<sign>&&|\|\||[<>=!]=|\*\*|[-+*/^()<>,!]))",
    re.ASCII,
)
_SPELT = {"^": "**", "&&": "and", "||": "or", "!": "~", "true": "1", "false": "0"}
_SPELT |= {"(": f"{GROUP}("}
_FUNCTIONS = (
    *("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "sqrt", "abs", "sign", "min", "max"),
    *("log", "ln", "log10", "log2", "sec", "csc", "cot", "sech", "csch", "coth"),
    *("arcsin", "arccos", "arctan", "arcsec", "arccsc", "arccot"),
    *("arcsinh", "arccosh", "arctanh"),
)


class PetabFormula:
    """A formula in PEtab's syntax; ``names`` lists its names in order, without ``time``."""

    def __init__(self, text: str) -> None:
        found: dict[str, None] = {}

        def spelt(match: re.Match[str]) -> str:
            word = match[0].strip()
            if match["name"] and word not in (*_SPELT, _TIME):
                found[word] = None
            return _SPELT.get(word, word)

        try:
            self._text = python_text(text, _TOKEN, spelt, _LONGEST)
            self.expression(lambda name: name)
        except ExpressionError as error:
            raise ExpressionError(f"'{brief(text)}' {error}") from None
        self.names = tuple(found)

    def expression(self, meaning: Callable[[str], str]) -> str:
        """Return the formula as an expression for scenes; ``meaning`` translates its names."""

        def tree(name: str) -> ast.expr:
            return shared_tree("t" if name == _TIME else meaning(name))

        return _Rewriter(tree, _FUNCTIONS).text(self._text)


def number_of(expression: str, where: str) -> float | None:
    """Return the value of an expression without names, or else None."""
    checked = parse(expression, where)
    return None if checked.names else checked.lower(Dag(), dict[str, Node]().__getitem__).value


class _Rewriter(Rewriter):
    own: ClassVar = {"piecewise": 3, "pow": 2}

    def own_call(self, name: str, args: Sequence[ast.expr]) -> ast.expr | None:
        if name == "piecewise" and len(args) % 2 == 1 and len(args) > 1:
            result = self.value(args[-1])
            for value, condition in reversed(list(zip(args[:-1:2], args[1::2], strict=True))):
                terms = (self.condition(condition), self.value(value), result)
                result = fill("where(a, b, c)", *terms)
            return result
        if name == "log" and len(args) == 2:
            return fill("log(a)/log(b)", *map(self.value, args))
        if name == "pow" and len(args) == 2:
            return fill("a**b", *map(self.value, args))
        return None

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        # These operators have equal precedence in PEtab, but not in Python.
        if any(isinstance(part, ast.BoolOp) for part in node.values):
            raise ExpressionError("mixes && and || in one condition: add parentheses")
        return super().visit_BoolOp(node)


PLACEHOLDER = re.compile(r"(observable|noise)Parameter([0-9]+)_(\w+)\Z")


class PetabOutputs:
    """Outputs for the rows of the measurement table; ``expressions`` maps names to formulas.

    ``meaning`` returns the expression for a name in the model or in the parameter table, or None.
    ``name`` returns an unused name in the scene, similar to its argument.
    """

    def __init__(
        self, tables: Tables, meaning: Callable[[str], str | None], name: Callable[[str], str]
    ) -> None:
        self._tables, self._meaning, self._name = tables, meaning, name
        self._formulas: dict[tuple[str, str], PetabFormula] = {}
        self._found: dict[tuple[object, ...], tuple[str, str | float]] = {}
        self._by_expression: dict[str, str] = {}
        self.expressions: dict[str, str] = {}

    def of_row(self, row: MeasurementRow) -> tuple[str, str | float]:
        """Return the outputs for observable and noise of a row; constant noise is a number."""
        key = (row.observable, row.observable_parameters, row.noise_parameters)
        if key not in self._found:
            observable = self._tables.observables[row.observable]
            self._found[key] = self._pair(row, observable, self._overrides(row, observable))
        return self._found[key]

    def _pair(
        self, row: MeasurementRow, observable: ObservableRow, overrides: Mapping[str, str]
    ) -> tuple[str, str | float]:
        """Return the outputs for an observable and its noise after substituting the overrides."""
        formula = self._formula(observable, "observableFormula")
        wanted = self._expression(row, observable, formula, overrides)
        name = self._output(observable.name, wanted)
        formula = self._formula(observable, "noiseFormula")
        # A noise formula may contain identifiers of observables.
        known = dict(overrides)
        for other in formula.names:
            if other in self._tables.observables and other not in known:
                its = self._tables.observables[other]
                inner = self._formula(its, "observableFormula")
                known[other] = f"({self._expression(row, its, inner, overrides)})"
        noise = self._expression(row, observable, formula, known)
        try:
            number = number_of(noise, "noiseFormula")
        except ExpressionError as error:
            raise observable.row.error(str(error)) from None
        if number is None:
            return name, self._output(f"noise_{observable.name}", noise)
        if not number > 0.0:
            raise row.row.error(f"the noise of '{observable.name}' is {number:g}: not positive")
        return name, number

    def _output(self, wish: str, expression: str) -> str:
        """Return the name of the output for an expression; equal expressions share one."""
        if expression not in self._by_expression:
            name = self._name(wish)
            self._by_expression[expression] = name
            self.expressions[name] = expression
        return self._by_expression[expression]

    def _formula(self, observable: ObservableRow, column: str) -> PetabFormula:
        key = (observable.name, column)
        if key not in self._formulas:
            text = observable.formula if column == "observableFormula" else observable.noise
            try:
                self._formulas[key] = PetabFormula(text)
            except ExpressionError as error:
                raise observable.row.error(f"{column}: {error}") from None
        return self._formulas[key]

    def _expression(
        self,
        row: MeasurementRow,
        observable: ObservableRow,
        formula: PetabFormula,
        overrides: Mapping[str, str],
    ) -> str:
        def meaning(name: str) -> str:
            found = overrides.get(name) or self._meaning(name)
            if found is not None:
                return found
            if (match := PLACEHOLDER.match(name)) is not None:
                raise row.row.error(
                    f"'{observable.name}' needs a value for '{name}': "
                    f"'{match[1]}Parameters' has too few"
                )
            known = sorted(self._tables.parameters)
            raise observable.row.error(
                f"'{name}' in the formula of '{observable.name}' is neither in the model nor a "
                f"parameter{nearest(name, known)}"
            )

        try:
            return formula.expression(meaning)
        except ExpressionError as error:
            raise observable.row.error(str(error)) from None

    def _overrides(self, row: MeasurementRow, observable: ObservableRow) -> dict[str, str]:
        """Return the expression that replaces each placeholder."""
        found = {}
        for kind, given, column in (
            ("observable", row.observable_parameters, "observableFormula"),
            ("noise", row.noise_parameters, "noiseFormula"),
        ):
            names = self._formula(observable, column).names
            for number, value in enumerate(given, start=1):
                placeholder = f"{kind}Parameter{number}_{observable.name}"
                if placeholder not in names:
                    raise row.row.error(
                        f"'{kind}Parameters' has {len(given)} entries, but {column} of "
                        f"'{observable.name}' has no '{placeholder}'"
                    )
                if isinstance(value, str):
                    meaning = self._meaning(value)
                    if meaning is None:
                        hint = nearest(value, self._tables.parameters)
                        raise row.row.error(f"'{value}' in '{kind}Parameters' is unknown{hint}")
                    found[placeholder] = meaning
                else:
                    found[placeholder] = f"({value!r})" if value < 0.0 else repr(value)
        return found


class PetabModel:
    """The scene of a PEtab problem; ``namer`` maps names in tables to names in the scene."""

    def __init__(self, tables: Tables) -> None:
        self._tables = tables
        self._sbml: SbmlModel[Scene] = read_sbml_model(tables.model, Scene, _values(tables))
        self.scene = self._sbml.scene
        self.namer = Namer()
        scene = self.scene
        variables = (*scene.parameters, *scene.outputs, *scene.modes, *scene.inputs)
        for name in (*variables, *scene.edges, *scene.nodes):
            self.namer.own(name)
        self._added = self._added_parameters()
        self.entities = self._entities()

    def meaning(self, name: str) -> str | None:
        """Return the name in the scene for a name in the tables, or None."""
        symbol = self._sbml.symbols.get(name)
        return self._added.get(name) if symbol is None else symbol.name

    def add_outputs(self, outputs: PetabOutputs) -> None:
        """Add the outputs for observables and noise to the scene."""
        for name, expression in outputs.expressions.items():
            try:
                self.scene.output(name, expression)
            except ModelError as error:
                raise SceneError(f"{self._tables.file}: {error}") from None

    def _added_parameters(self) -> dict[str, str]:
        """Declare parameters used only in observable and noise formulas; return their names."""
        tables = self._tables
        names: list[str | float] = []
        for observable in tables.observables.values():
            names += [*_names_in(observable.formula), *_names_in(observable.noise)]
        for row in tables.measurements:
            names += [*row.observable_parameters, *row.noise_parameters]
        added = {}
        for name in dict.fromkeys(name for name in names if isinstance(name, str)):
            if name in tables.settable and name not in self._sbml.symbols:
                added[name] = self.namer.own(name)
                known = tables.parameters.get(name)
                self.scene.parameter(added[name], known.value if known else 1.0)
        return added

    def _entities(self) -> Entities:
        """Return the quantities that tables can set."""
        parameters, states, initial = dict(self._added), {}, {}
        tables = self._tables
        valueless = {*self._added} & tables.columns | self._sbml.assumed
        numbers = {}
        for identifier, symbol in self._sbml.symbols.items():
            if symbol.state:
                if symbol.factor and identifier in tables.settable:
                    raise SceneError(
                        f"{tables.file}: the initial value of '{identifier}' cannot be set, since "
                        "the size of its compartment changes"
                    )
                states[identifier] = symbol.state
                if symbol.initial and self._is_number(symbol.initial):
                    initial[identifier] = symbol.initial
            elif symbol.initial == symbol.name:
                if not self._is_number(symbol.name):
                    if identifier not in tables.settable:
                        continue
                    # A number replaces the initial assignment; the tables set the value.
                    self.scene.set(symbol.name, 1.0)
                    valueless.add(identifier)
                elif identifier not in self._sbml.assumed:
                    numbers[identifier] = self.scene.parameters[symbol.name].number
                parameters[identifier] = symbol.name
            elif identifier in tables.parameters:
                raise tables.parameters[identifier].row.error(
                    f"'{identifier}' cannot be set, since a rule of the model determines it"
                )
        return Entities(parameters, states, initial, frozenset(valueless), numbers)

    def _is_number(self, parameter: str) -> bool:
        return not self.scene.parameters[parameter].is_derived


def _names_in(text: str) -> tuple[str, ...]:
    try:
        return tuple(n for n in PetabFormula(text).names if not PLACEHOLDER.match(n))
    except ModelError:
        return ()  # the error is raised later, with the row that uses the formula


def _values(tables: Tables) -> dict[str, float]:
    """Return values in the tables for quantities without a value in the model."""
    found: dict[str, float] = {}
    for condition in tables.conditions.values():
        for name, cell in condition.cells.items():
            found.setdefault(name, cell if isinstance(cell, float) else 1.0)
    for name, row in tables.parameters.items():
        found[name] = row.value
    return found


def mapped(tables: Tables) -> tuple[Scene, tuple[Condition, ...], Measured]:
    """Compile the model; return scene, conditions, and measured values in table order."""
    found = PetabModel(tables)
    outputs = PetabOutputs(tables, found.meaning, found.namer.own)
    pairs = [outputs.of_row(row) for row in tables.measurements]
    found.add_outputs(outputs)
    reader = ConditionReader(tables, found.entities)
    runs = [(row.condition, row.before, math.isinf(row.t)) for row in tables.measurements]
    chains = {run: reader.chain(*run) for run in dict.fromkeys(runs)}
    try:
        model = found.scene.compile(_wanted(chains.values()))
    except ModelError as error:
        raise type(error)(f"{tables.file}: {error}") from None
    place = {run: i for i, run in enumerate(chains)}
    observables = [tables.observables[row.observable] for row in tables.measurements]
    measured = Measured(
        condition=np.array([place[run] for run in runs], dtype=np.intp),
        t=np.array([0.0 if math.isinf(row.t) else row.t for row in tables.measurements]),
        observable=[observable for observable, _ in pairs],
        value=np.array([row.value for row in tables.measurements]),
        noise=[noise for _, noise in pairs],
        transformation=[row.transformation for row in observables],
        distribution=[row.distribution for row in observables],
    )
    return found.scene, _conditions(chains.values(), model), measured


def _wanted(chains: Iterable[Iterable[Link]]) -> list[str]:
    """Return the parameters and initial values to which sensitivities are needed."""
    tables = [table for chain in chains for link in chain for table in link[1:]]
    return list(
        dict.fromkeys(k for table in tables for k, v in table.items() if isinstance(v, str))
    )


def _conditions(chains: Iterable[Iterable[Link]], model: Model) -> tuple[Condition, ...]:
    """Build the conditions; conditions with the same steady state share previous runs."""
    leading: dict[tuple[object, ...], Condition] = {}
    found = []
    for *before, (name, parameters, initial) in chains:
        last: Condition | None = None
        for link in before:
            key = (link.name, last, *(tuple(sorted(table.items())) for table in link[1:]))
            last = leading.setdefault(
                key, Condition(link.name, model, link.parameters, link.initial, before=last)
            )
        found.append(Condition(name, model, parameters, initial, before=last))
    return tuple(found)
