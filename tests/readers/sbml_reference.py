"""Runs of SBML models by another route: libsbml's trees evaluated in Python, integrated by SciPy.

Every species is an amount here, whatever the reader makes of it. Without events, delays and
algebraic rules.
"""

from __future__ import annotations

import math
from typing import Any

import libsbml
import numpy as np
from scipy.integrate import solve_ivp

_PLAIN = {
    libsbml.AST_PLUS: lambda *a: sum(a),
    libsbml.AST_TIMES: lambda *a: math.prod(a),
    libsbml.AST_MINUS: lambda a, *b: a - b[0] if b else -a,
    libsbml.AST_DIVIDE: lambda a, b: a / b,
    libsbml.AST_POWER: lambda a, b: a**b,
    libsbml.AST_FUNCTION_POWER: lambda a, b: a**b,
    libsbml.AST_FUNCTION_EXP: math.exp,
    libsbml.AST_FUNCTION_LN: math.log,
    libsbml.AST_FUNCTION_LOG: lambda base, a: math.log(a, base),
    libsbml.AST_FUNCTION_ROOT: lambda n, a: a ** (1.0 / n),
    libsbml.AST_FUNCTION_ABS: abs,
    libsbml.AST_FUNCTION_CEILING: math.ceil,
    libsbml.AST_FUNCTION_FLOOR: math.floor,
    libsbml.AST_FUNCTION_SIN: math.sin,
    libsbml.AST_FUNCTION_COS: math.cos,
    libsbml.AST_FUNCTION_TAN: math.tan,
    libsbml.AST_FUNCTION_TANH: math.tanh,
    libsbml.AST_FUNCTION_COSH: math.cosh,
    libsbml.AST_FUNCTION_SINH: math.sinh,
    libsbml.AST_FUNCTION_SEC: lambda a: 1.0 / math.cos(a),
    libsbml.AST_FUNCTION_CSC: lambda a: 1.0 / math.sin(a),
    libsbml.AST_FUNCTION_COT: lambda a: 1.0 / math.tan(a),
    libsbml.AST_FUNCTION_ARCSIN: math.asin,
    libsbml.AST_FUNCTION_ARCCOS: math.acos,
    libsbml.AST_FUNCTION_ARCTAN: math.atan,
    libsbml.AST_FUNCTION_ARCSINH: math.asinh,
    libsbml.AST_FUNCTION_ARCCOSH: math.acosh,
    libsbml.AST_FUNCTION_ARCTANH: math.atanh,
    libsbml.AST_FUNCTION_ARCSEC: lambda a: math.acos(1.0 / a),
    libsbml.AST_FUNCTION_ARCCOT: lambda a: math.atan(1.0 / a),
    libsbml.AST_FUNCTION_MAX: max,
    libsbml.AST_FUNCTION_MIN: min,
    libsbml.AST_RELATIONAL_LT: lambda a, b: a < b,
    libsbml.AST_RELATIONAL_LEQ: lambda a, b: a <= b,
    libsbml.AST_RELATIONAL_GT: lambda a, b: a > b,
    libsbml.AST_RELATIONAL_GEQ: lambda a, b: a >= b,
    libsbml.AST_RELATIONAL_EQ: lambda a, b: a == b,
    libsbml.AST_RELATIONAL_NEQ: lambda a, b: a != b,
    libsbml.AST_LOGICAL_AND: lambda *a: all(a),
    libsbml.AST_LOGICAL_OR: lambda *a: any(a),
    libsbml.AST_LOGICAL_NOT: lambda a: not a,
    libsbml.AST_LOGICAL_XOR: lambda a, b: bool(a) != bool(b),
    libsbml.AST_CONSTANT_PI: lambda: math.pi,
    libsbml.AST_CONSTANT_E: lambda: math.e,
    libsbml.AST_CONSTANT_TRUE: lambda: True,
    libsbml.AST_CONSTANT_FALSE: lambda: False,
    libsbml.AST_NAME_AVOGADRO: lambda: 6.02214179e23,
}


Tree = tuple[int, str, float, tuple[Any, ...]]


def tree_of(node: Any) -> Tree:
    """Copy a formula out of libsbml, whose calls take long."""
    parts = tuple(tree_of(node.getChild(i)) for i in range(node.getNumChildren()))
    value = node.getValue() if node.isNumber() else math.nan
    return node.getType(), node.getName() or "", value, parts


class Reference:
    """A model's rates, with what each identifier means found by looking it up in the model."""

    def __init__(self, text: str, changed: dict[str, float] | None = None) -> None:
        self.document = libsbml.readSBMLFromString(text)
        self.model = model = self.document.getModel()
        self.changed = dict(changed or {})  # values at the start, kept as they are found
        rules = model.getListOfRules()
        self.rates = {r.getVariable(): tree_of(r.getMath()) for r in rules if r.isRate()}
        self.rules = {r.getVariable(): tree_of(r.getMath()) for r in rules if r.isAssignment()}
        rows = model.getListOfInitialAssignments()
        self.begins = {a.getSymbol(): tree_of(a.getMath()) for a in rows}
        self.functions = {
            f.getId(): (
                [f.getArgument(i).getName() for i in range(f.getNumArguments())],
                tree_of(f.getBody()),
            )
            for f in model.getListOfFunctionDefinitions()
        }
        self.laws = {
            r.getId(): (
                tree_of(r.getKineticLaw().getMath()),
                {p.getId(): p.getValue() for p in r.getKineticLaw().getListOfParameters()},
            )
            for r in model.getListOfReactions()
        }
        self.place = {  # of species that formulas take as concentrations
            s.getId(): s.getCompartment()
            for s in model.getListOfSpecies()
            if not s.getHasOnlySubstanceUnits()
        }
        ruled = {*self.rules, *self.rates}
        reacting = [
            s.getId()
            for s in model.getListOfSpecies()
            if not (s.getBoundaryCondition() or s.getConstant() or s.getId() in ruled)
        ]
        self.moved = {id: i for i, id in enumerate([*self.rates, *reacting])}
        self.flows = [
            (self.moved[part.getSpecies()], r.getId(), sign * part.getStoichiometry())
            for r in model.getListOfReactions()
            for sign, side in ((-1.0, r.getListOfReactants()), (1.0, r.getListOfProducts()))
            for part in side
            if part.getSpecies() in reacting
        ]

    def start(self, id: str) -> float:
        """Return the value of an identifier at the start."""
        if id not in self.changed:
            self.changed[id] = self._start(id)
        return self.changed[id]

    def _start(self, id: str) -> float:
        model = self.model
        if id in self.begins or id in self.rules:
            return self.value(self.begins.get(id) or self.rules[id], None, 0.0)
        if id in self.laws:
            law, local = self.laws[id]
            return self.value(law, None, 0.0, local)
        if species := model.getSpecies(id):
            size = self.start(species.getCompartment())
            if species.isSetInitialAmount():
                amount = species.getInitialAmount()
                return amount / size if id in self.place else amount
            given = species.getInitialConcentration()
            return given if id in self.place else given * size
        compartment = model.getCompartment(id)
        return compartment.getSize() if compartment else model.getParameter(id).getValue()

    def now(self, id: str, x: Any, t: float) -> float:
        """Return the value of an identifier in a state; at the start without one."""
        if x is None:
            return self.start(id)
        if id in self.moved:
            value = x[self.moved[id]]
            if id in self.place and id not in self.rates:
                return value / self.now(self.place[id], x, t)
            return value
        if id in self.rules:
            return self.value(self.rules[id], x, t)
        if id in self.laws:
            law, local = self.laws[id]
            return self.value(law, x, t, local)
        return self.start(id)

    def value(self, tree: Tree, x: Any, t: float, bound: dict[str, float] | None = None) -> Any:
        """Evaluate a formula."""
        kind, name, number, parts = tree
        if kind == libsbml.AST_NAME:
            return bound[name] if bound and name in bound else self.now(name, x, t)
        if kind == libsbml.AST_NAME_TIME:
            return t
        if kind == libsbml.AST_FUNCTION_PIECEWISE:
            for value, condition in zip(parts[::2], parts[1::2], strict=False):
                if self.value(condition, x, t, bound):
                    return self.value(value, x, t, bound)
            return self.value(parts[-1], x, t, bound)
        values = [self.value(part, x, t, bound) for part in parts]
        if kind == libsbml.AST_FUNCTION:
            names, body = self.functions[name]
            return self.value(body, x, t, dict(zip(names, values, strict=True)))
        return _PLAIN[kind](*values) if kind in _PLAIN else number

    def rate(self, t: float, x: Any) -> np.ndarray:
        """Return the rates of the states: amounts, and what rate rules change."""
        dx = np.zeros(len(self.moved))
        for id, tree in self.rates.items():
            dx[self.moved[id]] = self.value(tree, x, t)
        flow = {id: self.now(id, x, t) for id in self.laws}
        for row, id, count in self.flows:
            dx[row] += count * flow[id]
        return dx

    def run(self, times: Any, method: str = "LSODA") -> dict[str, Any]:
        """Integrate, and give the values of what changes by identifier.

        Values are what formulas of the model mean: concentrations, or amounts.
        """
        x0 = [self.start(id) for id in self.moved]
        for id, i in self.moved.items():
            if id in self.place and id not in self.rates:
                x0[i] *= self.start(self.place[id])
        span = (times[0], times[-1])
        found = solve_ivp(self.rate, span, x0, method, times, rtol=1e-10, atol=1e-12)
        assert found.success, found.message
        rows = list(zip(found.t, found.y.T, strict=True))
        return {id: np.array([self.now(id, x, t) for t, x in rows]) for id in self.moved}
