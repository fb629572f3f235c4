"""Replacement of jumps and branches in registered laws by modes and events.

Each ``sign``, ``floor`` or comparison of variables becomes a mode, which the law reads from an
additional field. Kinks of a ``Piecewise`` also become events, so that no step crosses them.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import replace
from functools import partial, reduce
from typing import TYPE_CHECKING, Any

from cotree.components import OWN, Law, Terminal
from cotree.components.component import Field
from cotree.components.terminal import integral_of
from cotree.dag.nodes import PARAMETER, STATE, Dag, Node
from cotree.domains import DOMAINS
from cotree.errors import SceneError
from cotree.scene.expressions import (
    COMPARISONS,
    FUNCTIONS,
    Expression,
    fill,
    map_tree,
    name_tree,
    names_in,
    number_tree,
)

if TYPE_CHECKING:
    from cotree.scene.description import Edge, SceneDescription


def jumps_in(tree: ast.expr) -> list[ast.expr]:
    """Return the signs, and the comparisons of two values, in a tree."""
    return [
        node
        for node in ast.walk(tree)
        if (isinstance(node, ast.Call) and getattr(node.func, "id", "") == "sign")
        or (isinstance(node, ast.Compare) and len(node.ops) == 1)
    ]


def boundary_of(part: ast.expr) -> tuple[ast.expr, bool]:
    """Return the switching function of a sign or comparison, and whether it is true above zero."""
    if isinstance(part, ast.Compare):
        is_larger, _ = COMPARISONS[type(part.ops[0])]
        return fill("a - b", part.left, part.comparators[0]), is_larger
    assert isinstance(part, ast.Call)
    return part.args[0], True


def _lowering(names: Iterable[str], parameters: Container[str]) -> Callable[[ast.expr], Node]:
    """Return a function from trees to nodes of one graph, in which equal trees become one node."""
    dag = Dag()
    symbols = {
        name: dag.symbol(PARAMETER if name in parameters else STATE, i)
        for i, name in enumerate(sorted(names))
    }
    return lambda tree: Expression.of_tree(tree).lower(dag, symbols.__getitem__)


def has_only_kink(whole: ast.expr, part: ast.expr, parameters: Container[str]) -> bool:
    """Return whether an expression is continuous at the zeros of one jump's argument."""
    from cotree.dag.continuity import agree_at

    lowered = _lowering(names_in(whole), parameters)
    looked_at, is_larger = boundary_of(part)
    if isinstance(part, ast.Compare):
        # A comparison of equal numbers folds to one of its two values: >= to true, > to false.
        same = ast.Constant(0.5)
        kinds = (ast.GtE(), ast.Gt()) if is_larger else (ast.Gt(), ast.GtE())
        sides: list[ast.expr] = [ast.Compare(same, [op], [same]) for op in kinds]
    else:
        # A sign jumps from -1 to 1; its value 0 occurs only at the event itself.
        sides = [number_tree(1.0), number_tree(-1.0)]
    try:
        above, below = (lowered(_with(whole, part, side)) for side in sides)
        return agree_at(above, below, lowered(looked_at))
    except (ArithmeticError, ValueError):  # an undefined expression cannot be proved continuous
        return False


def clipped(branch: ast.expr, boundary: ast.expr, parameters: Container[str]) -> ast.expr:
    """Return a branch in which ``sqrt(x - b)`` is ``sqrt(max(x - b, 0))`` if b is its boundary.

    A step stays on the branch on which it begins, and may evaluate this branch beyond the boundary.
    """
    ends = partial(_vanishes_at, boundary, parameters)

    def change(node: ast.expr) -> ast.expr | None:
        match node:
            case ast.Call(func=ast.Name(id="sqrt"), args=[x]) if ends(x):
                return fill("sqrt(max(a, 0.0))", x)
            case ast.BinOp(left=x, op=ast.Pow(), right=power) if not _is_whole(power) and ends(x):
                return fill("max(a, 0.0)**b", x, power)
        return None

    return map_tree(branch, change)


def _vanishes_at(boundary: ast.expr, parameters: Container[str], tree: ast.expr) -> bool:
    """Return whether a tree is zero wherever a boundary is zero."""
    from cotree.dag.continuity import agree_at

    lowered = _lowering(names_in(tree) | names_in(boundary), parameters)
    try:
        value = lowered(tree)
        return agree_at(value, value.dag.zero, lowered(boundary))
    except (ArithmeticError, ValueError):  # raised if the expression is undefined everywhere
        return False


def _is_whole(power: ast.expr) -> bool:
    return isinstance(power, ast.Constant) and float(power.value).is_integer()  # type: ignore[arg-type]


def _with(whole: ast.expr, part: ast.expr, by: ast.expr) -> ast.expr:
    """Copy a tree with one part replaced; equal parts at other places remain."""
    return map_tree(whole, lambda own: by if own is part else None)


#: Function (tree of a jump, text for messages) that returns the mode's name or its tree.
Rewrite = Callable[[ast.expr, str], ast.expr]

_LAWS = ("across", "through", "storage", "content")

#: Kinks of these laws are jumps of a capacity or inertance, so they become events.
_OF_RATES = ("storage", "content")


def branches(law: Law | None) -> bool:
    """Return whether a law contains jumps or branches."""
    import sympy

    # Absolute values, maxima and minima are not listed, because they have kinks but no jumps.
    kinds = (sympy.Piecewise, sympy.sign, sympy.floor, sympy.ceiling, sympy.Mod, sympy.Heaviside)
    return law is not None and law.expression is not None and law.expression.has(*kinds)


def may_branch(edge: Edge) -> bool:
    """Return whether an edge has a registered law with branches; built-in laws do not jump."""
    component = edge.component
    laws = [component.law, *(getattr(port, name) for port in component.ports for name in _LAWS)]
    return component.name not in OWN and any(branches(law) for law in laws)


def check_located(edge: Edge, parameters: Container[str]) -> None:
    """Raise if the law of a registered force element jumps: no event can locate the jump."""
    law = edge.component.law
    if edge.component.name in OWN or law is None or not branches(law):
        return
    names: dict[str, ast.expr] = {name: ast.Name(name) for name in law.arguments}
    # Kinks need no event, because the sensitivities of the states are continuous there.
    tree = to_tree(plain_jumps(law.expression), names)
    if tree is not None:
        # Floors jump at all integers, but ``has_only_kink`` only tests zeros.
        has_floor = any(getattr(node, "id", "") == "floor" for node in ast.walk(tree))
        if not has_floor and all(has_only_kink(tree, part, parameters) for part in jumps_in(tree)):
            return
    raise SceneError(
        f"the law of edge '{edge.name}', of type '{edge.component.name}', jumps, which "
        "sensitivities cannot follow: move the jump into a field of the edge, where it "
        "becomes an event, or compile without sensitivities"
    )


def check_contents(scene: SceneDescription, edge: Edge) -> None:
    """Raise if the content law of a storage jumps, because its rate would be an impulse."""
    for i, port in enumerate(edge.component.ports):
        if port.content is None:
            continue
        from cotree.dag.continuity import may_jump

        dag, own = Dag(), _names(edge, port, i)
        time, seen = dag.symbol("t", 0), dict[str, Node]()

        def resolve(name: str, dag: Dag = dag, seen: dict[str, Node] = seen) -> Node:
            # In expressions, a parameter takes precedence over an output of the same name.
            if name in scene.outputs and name not in scene.parameters:
                return scene.outputs[name].lower(dag, resolve)
            # Outputs are replaced by their expressions; all other names are variables.
            kind = "p" if name in scene.parameters else "x"
            return seen.setdefault(name, dag.symbol("t" if name == "t" else kind, len(seen)))

        # All expressions share one symbol for time.
        seen["t"] = time
        trees = {name: own[name] for name in port.content.arguments if name not in edge.fields}
        given = {name: Expression.of_tree(tree) for name, tree in trees.items()}
        known = {**edge.fields, **given}
        value = port.content.value(
            dag,
            {name: known[name].lower(dag, resolve) for name in port.content.arguments},  # type: ignore[union-attr]
        )
        moving = [symbol for symbol in seen.values() if symbol.data[0] != "p"]
        if may_jump(value, moving, time):
            what = f"port '{port.port}' of edge" if port.port else "edge"
            raise SceneError(
                f"the content of {what} '{edge.name}' is discontinuous, or its continuity is not "
                "proved: a jump would be an impulse in a storage; use expressions whose branches "
                "agree at their boundaries, for all values of the parameters"
            )


def with_branches(edge: Edge, rewrite: Rewrite, parameters: Container[str]) -> Edge:
    """Replace jumps in a scalar component's laws by the trees that ``rewrite`` returns."""
    fields: dict[str, Expression] = {}
    ports = []
    for i, port in enumerate(edge.component.ports):
        names = _names(edge, port, i)
        changed: dict[str, Any] = {}
        for name in _LAWS:
            if branches(law := getattr(port, name)):
                kept = set() if name in _OF_RATES else _kinks(law, names, parameters)
                changed[name] = _branched(law, names, edge, rewrite, fields, kept, parameters)
        ports.append(replace(port, **changed))
    if not fields:
        return edge
    # Laws refer to the modes as fields of the edge, which may vary during a run.
    rows = tuple(Field(name, "", "", required=True, constant=False) for name in fields)
    component = replace(edge.component, ports=tuple(ports), fields=(*edge.component.fields, *rows))
    return replace(edge, component=component, fields={**edge.fields, **fields})


def _names(edge: Edge, port: Terminal, place: int) -> dict[str, ast.expr]:
    found: dict[str, ast.expr] = {"t": ast.Name("t")}
    for other in edge.component.ports:
        row = DOMAINS[other.domain]
        for quantity, symbol in (("across", row.across_symbol), ("through", row.through_symbol)):
            # Expressions refer to variables as ``edge.symbol`` or ``edge.port.symbol``.
            own = _dotted(edge.name, other.port, symbol)
            if other is port:
                found[quantity] = own
            if other.port:
                found[f"{quantity}_{other.port}"] = own
    integral = integral_of(port)
    if integral is not None:
        found["stretch"] = _dotted(edge.name, port.port, integral.name)
    ends = edge.ports[place]
    for name, node in (("potential_head", ends.head), ("potential_tail", ends.tail)):
        # Node potentials are relative to the ground.
        symbol = DOMAINS[port.domain].across_symbol
        found[name] = ast.Constant(0.0) if node == "ground" else _dotted(node, "", symbol)
    for name, value in edge.fields.items():
        if isinstance(value, Expression):
            found[name] = value.tree
    return found


def _dotted(first: str, port: str, last: str) -> ast.expr:
    return name_tree(".".join(filter(None, (first, port, last))))


def _branched(
    law: Law,
    names: Mapping[str, ast.expr],
    edge: Edge,
    rewrite: Rewrite,
    fields: dict[str, Expression],
    kept: set[Any],
    parameters: Container[str],
) -> Law:
    import sympy

    where = f"the law of edge '{edge.name}'"
    whole, known = _clipped_law(plain_jumps(law.expression), names, kept, parameters), dict(names)
    while True:
        found = [
            atom
            for atom in whole.atoms(sympy.sign, sympy.floor, sympy.core.relational.Relational)
            if atom not in kept
        ]
        if not found:
            return Law.of(whole)
        # Inner jumps come first, in a reproducible order.
        atom = min(found, key=lambda item: (sympy.count_ops(item), str(item)))
        is_upper = isinstance(atom, (sympy.Ge, sympy.Gt))
        tree = to_tree(atom.negated if is_upper else atom, known)
        mode = None if tree is None else rewrite(tree, where)
        # ``rewrite`` replaces comparisons by ``mode > 0.5``; the field contains only the mode.
        mode = mode.left if isinstance(mode, ast.Compare) else mode
        if not isinstance(mode, ast.Name):
            kept.add(atom)  # depends only on parameters or known times, or has no tree
            continue
        # A jump that occurs in several laws of an edge has one mode and one field.
        name = next((n for n, value in fields.items() if value.text == mode.id), "")
        if not name:
            name = f"jump_{len(fields)}"
            while name in edge.fields:
                name += "_"
            fields[name] = Expression(mode.id, where, mode, frozenset([mode.id]))
        known[name] = mode
        symbol = sympy.Symbol(name, real=True)
        if isinstance(atom, sympy.core.relational.Relational):
            holds = symbol > sympy.Rational(1, 2)
            # Comparisons with a mode jump only at events, so they are kept.
            kept |= {holds, holds.negated}
            whole = whole.xreplace({atom: sympy.Not(holds) if is_upper else holds})
        else:
            whole = whole.xreplace({atom: symbol})


def _clipped_law(
    whole: Any, names: Mapping[str, ast.expr], kept: set[Any], parameters: Container[str]
) -> Any:
    """Clip roots in the branches of a law at the comparisons at which they end; see ``clipped``."""
    import sympy

    relations = whole.atoms(sympy.core.relational.Relational) - kept
    powers = [
        power
        for piecewise in whole.atoms(sympy.Piecewise)
        for power in piecewise.atoms(sympy.Pow)
        if not power.exp.is_integer and not power.exp.is_negative
    ]
    new = {}
    for relation in sorted(relations, key=str) if powers else ():
        boundary = to_tree(relation.lhs - relation.rhs, names)
        if boundary is None:
            continue
        ends = partial(_vanishes_at, boundary, parameters)
        for power in powers:
            base = to_tree(power.base, names)
            if base is not None and ends(base):
                new[power] = sympy.Max(power.base, 0) ** power.exp
    return whole.xreplace(new)


def _kinks(law: Law, names: Mapping[str, ast.expr], parameters: Container[str]) -> set[Any]:
    """Return the signs and comparisons at which a law as a whole is continuous."""
    import sympy

    whole = plain_jumps(law.expression)
    tree = to_tree(whole, names)
    if tree is None:
        return set()
    atoms = whole.atoms(sympy.sign, sympy.core.relational.Relational)
    parts = {atom: ast.unparse(own) for atom in atoms if (own := to_tree(atom, names)) is not None}
    kinks = {ast.unparse(part) for part in jumps_in(tree) if has_only_kink(tree, part, parameters)}
    return {atom for atom, text in parts.items() if text in kinks}


def plain_jumps(expression: Any) -> Any:
    """Return a law in which signs, floors and comparisons are the only jumps."""
    import sympy

    return (
        expression.replace(sympy.Mod, lambda a, b: a - b * sympy.floor(a / b))
        .replace(sympy.ceiling, lambda a: -sympy.floor(-a, evaluate=False))
        .replace(sympy.Heaviside, lambda a, *_: sympy.Piecewise((1, a > 0), (0, True)))
    )


#: SymPy operations by class name, as expressions of their arguments.
_FORMS = {
    **{"StrictLessThan": "a < b", "LessThan": "a <= b"},
    **{"StrictGreaterThan": "a > b", "GreaterThan": "a >= b"},
    **{"Not": "not a", "Pow": "a**b", "Add": "a + b", "Mul": "a*b"},
    **{"Max": "max(a, b)", "Min": "min(a, b)", "Abs": "abs(a)"},
}


def to_tree(expression: Any, names: Mapping[str, ast.expr]) -> ast.expr | None:
    """Return a SymPy expression as a tree of the expression grammar, or None if impossible."""
    import sympy

    if expression.is_Symbol:
        return names.get(expression.name)
    # Numbers in SymPy include rationals, pi and roots, which all become floats.
    if getattr(expression, "is_number", False):
        return number_tree(float(expression))
    if isinstance(expression, sympy.Piecewise):
        return _conditional(expression, names)
    args = [to_tree(arg, names) for arg in expression.args]
    if None in args:
        return None
    trees = [arg for arg in args if arg is not None]
    kind = type(expression).__name__
    if kind in ("And", "Or"):
        return ast.BoolOp(ast.And() if kind == "And" else ast.Or(), trees)
    if kind in _FORMS:
        form = _FORMS[kind]
        # Sums, products, maxima and minima may have any number of arguments.
        return reduce(partial(fill, form), trees) if len(trees) > 2 else fill(form, *trees)
    # Functions outside the grammar have no tree.
    if FUNCTIONS.get(kind) != len(trees):
        return None
    return ast.Call(ast.Name(kind), trees, [])


def _conditional(expression: Any, names: Mapping[str, ast.expr]) -> ast.expr | None:
    """Return a ``Piecewise`` as nested conditionals, or None if one of its parts has no tree."""
    # The last branch, which has no condition, is the innermost one.
    whole = to_tree(expression.args[-1][0], names)
    for value, condition in reversed(expression.args[:-1]):
        own, holds = to_tree(value, names), to_tree(condition, names)
        if own is None or holds is None or whole is None:
            return None
        whole = fill("where(a, b, c)", holds, own, whole)
    return whole
