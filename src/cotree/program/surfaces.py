"""Switching surfaces of right-hand sides: each step keeps the branches on which it began.

In: equations with absolute values, selections and piecewise linear tables of variables. Out: the
same equations with a symbol in each condition and each table, which selects the branch; if the
symbol is zero, the argument selects it. The engine freezes the branches during a step, locates the
time at which an argument leaves its branch, as for an event, and restarts there on the next branch.
States and their sensitivities are continuous at a kink, so nothing else is changed there.

A sign, or a selection whose sides differ, is a kink if its user is continuous, as in ``x*sign(x)``.
Roots, powers, logarithms and quotients may be undefined beyond the end of a branch. Steps also end
there, but the argument always selects the branch. The other side of such a kink is frozen if it is
constant, as in ``sqrt(max(x, 0))``.

These switching surfaces are ignored: conditions without a provably continuous user, which would be
jumps; known functions of time, at which integration restarts anyway; conditions within roots and
similar functions whose users are twice differentiable, as in the law of an orifice; kinks within
masses and constraints; tables within roots and similar functions; and tables with very many points,
whose kinks are small. If the slope is infinite on both sides, as for ``sqrt(abs(x))``, the argument
selects the branch, and roots are replaced near zero (:class:`SteepRoots`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING

from cotree.dag.continuity import agree_at
from cotree.dag.derivative import SINGULAR, Clips, Tangents, is_singular, tangent
from cotree.dag.lookup import HeldPlane, HeldTable, LinearTable, PlaneTable
from cotree.dag.multi_output import SEVERAL
from cotree.dag.nodes import (
    INPUT,
    PIECE,
    STATE,
    TIME,
    UNKNOWN,
    dependent,
    reachable,
    substitute,
    symbols_in,
    ways_to_zero,
)
from cotree.dag.switching_times import time_events_within
from cotree.equations import KinkRow

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.equations import Equations
    from cotree.program.program import Program


def find_roots(
    nodes: Iterable[Node], condition: Node, is_same: Callable[[Node], bool]
) -> dict[Node, Node] | None:
    """Return the roots whose domain ends at the zero of a condition, each with its signed argument.

    ``is_same`` returns whether a value has the same zero as the condition and changes sign there.
    The result is None if the domain of another operation ends at this zero, or if an argument
    touches zero with a slope of zero.
    """
    found: dict[Node, Node] = {}
    for way in ways_to_zero(condition):
        moved = next(reversed(way))
        for node in nodes:
            if node.op not in SINGULAR or node in found or not ends(node, way):
                continue
            if node.op not in ("sqrt", "pow"):
                return None
            signed = _signed(node.args[0], is_same)
            slope = tangent(signed, {moved: condition.dag.one})
            if substitute([slope], way)[0].is_zero:
                return None
            found[node] = signed
    return found or None


def ends(node: Node, way: Mapping[Node, Node]) -> bool:
    """Return whether the domain of an operation ends at the zero of a condition."""
    first, *others = substitute(node.args, way)
    if node.op == "pow":
        return first.value is not None and first.value <= 0.0
    return is_singular(node.op, (first, *others))


def _signed(value: Node, is_same: Callable[[Node], bool]) -> Node:
    """Return a value in which the absolute value of the condition is replaced by the condition."""
    known: dict[Node, Node] = {}
    stack = [value]
    while stack:
        node = stack.pop()
        if node.op == "abs" and is_same(node.args[0]):
            known[node] = node.args[0]
        else:
            stack += node.args
    return substitute([value], known)[0]


def _exponent(root: Node) -> Node:
    return root.dag.constant(0.5) if root.op == "sqrt" else root.args[1]


@dataclass(frozen=True)
class SteepRoots:
    """Roots whose slope is infinite on both sides of zero, with their signed arguments.

    A flow with the law ``sign(v)*sqrt(abs(v))`` comes to rest in a finite time, but the law has no
    derivative at rest. Within a band of half-width b around zero, the root r(z) is replaced by
    ``r(b)*(z/b)**3``, whose slope is zero at rest. If the law drives the state to zero from both
    sides, the solutions with both laws remain within the band and differ by at most b. The engine
    sets b to the tolerance of z while z is near zero (``runtime/hybrid/cotree_branches.c``);
    otherwise b is zero or negative, and the root is exact.
    """

    signed: Mapping[Node, Node]

    @cached_property
    def _slopes(self) -> dict[Node, Node]:
        """Powers that occur in the derivatives of the roots, each with its root."""
        return {root.dag.pow(root.args[0], _exponent(root) - 1.0): root for root in self.signed}

    def root_of(self, node: Node) -> Node | None:
        """Return the root if a value is a root or the slope of one, else None."""
        if node.op == "div" and node.args[1].op == "sqrt":
            node = node.args[1]
        node = self._slopes.get(node, node)
        return node if node in self.signed else None

    def replaced(self, node: Node, args: tuple[Node, ...], distance: Node, width: Node) -> Node:
        """Form a root, or a part of its slope, with the replacement inside the band.

        ``node`` is the root r, a quotient c/r, or a power z**(e - 1); ``args`` are its new
        arguments, for a quotient c and z. ``distance`` is z with its sign, ``width`` the half-width
        b of the band.
        """
        dag, root = node.dag, self.root_of(node)
        assert root is not None
        z = args[0] if node.op != "div" else args[1]
        exponent = _exponent(root)
        share = z / width
        inside = dag.pow(width, exponent) * share * share
        if node is root:
            exact = dag.rebuild(node, args)
            inside = inside * share
        elif node.op == "div":  # c/r contributes 2 c r'
            exact = args[0] / dag.function("sqrt", z)
            inside = args[0] * (6.0 * inside / width)
        else:  # z**(e - 1) contributes r'/e
            exact = dag.rebuild(node, args)
            inside = 3.0 * inside / (exponent * width)
        return dag.select(dag.function("abs", distance) - width, exact, inside)


#: Operations that are defined on both sides of any kink of their arguments; for a linear system, of
#: a kink in its right-hand side. Quotients with a kink in the dividend are also defined.
_DEFINED_AT_KINKS = frozenset({"add", "sub", "mul", "neg", "sin", "cos", "tanh", "atan", "erf"})
_DEFINED_AT_KINKS |= {"abs", "exp", "sinh", "cosh", "select", "sign", "table", "result"}
_DEFINED_AT_KINKS |= {"sines", "solve"}
_BRANCHING = frozenset({"select", "abs", "sign"})

#: Tables with more points along an axis keep their kinks, which the error test resolves.
_MOST_POINTS = 1000

#: Maximum numbers of values that are examined: from a jump to continuous users; from a branch up.
_MOST_READERS, _MOST_ABOVE = 8, 64

#: Maximum number of terms in sums that are expanded for comparison.
_MOST_TERMS = 64


def freeze_branches(equations: Equations) -> Equations:
    """Return the equations with symbols for the branches that steps freeze."""
    found = _find(equations)
    if not found.conditions and not found.tables and not found.steep.signed:
        return equations
    new, held = _held(equations, found)

    def again(nodes: Iterable[Node]) -> tuple[Node, ...]:
        return tuple(substitute(nodes, new))

    return replace(
        equations.with_derivatives(new),
        forcing=again(equations.forcing),
        rates=again(equations.rates),
        output_values=again(equations.output_values),
        kinks=tuple(held.rows),
        pieces=tuple(held.pieces),
    )


def strip_switching_surfaces(program: Program) -> Program:
    """Remove the switching functions, so that arguments always select the branches."""
    layout, kernels = program.layout, dict(program.kernels)
    n, m = len(layout.events), len(layout.kinks)
    if not m:
        return program

    def cut(name: str, n_blocks: int = 1) -> None:
        results = kernels[name].results
        width = len(results) // n_blocks
        blocks = [results[i * width : (i + 1) * width] for i in range(n_blocks)]
        left = [block[:n] + block[n + m :] for block in blocks] if n else []
        kernels[name] = replace(kernels[name], results=tuple(chain.from_iterable(left)))

    n_before, ranges = n + m + layout.n_pieces, layout.ranges[:n]
    # Ranges are in the order of their values, so that those of events precede those of kinks.
    ends = kernels["event_ranges"].results[: 4 * (1 + max(ranges, default=-1))]
    kernels["event_ranges"] = replace(kernels["event_ranges"], results=ends)
    n_quantities = layout.n_quantities if ends else 0
    values = kernels["events"].results
    values = values[:n] + values[n_before : n_before + n_quantities]
    kernels["events"] = replace(kernels["events"], results=values)
    cut("event_rates")
    if kernels["event_sensitivity"].results:
        cut("event_sensitivity", len(layout.sensitivities))
    layout = replace(layout, kinks=(), n_pieces=0, ranges=ranges, n_quantities=n_quantities)
    return replace(program, layout=layout, kernels=kernels)


@dataclass
class _Found:
    """Conditions and tables whose branches are frozen during steps."""

    #: Sides on which the branch is frozen, by the key of the condition (:class:`_Keys`).
    conditions: dict[_Key, frozenset[int]]
    tables: set[Node]  # tables whose intervals are frozen
    steep: SteepRoots


def _find(equations: Equations) -> _Found:
    """Find the conditions and tables whose switching surfaces are located."""
    roots = [*equations.forcing, *equations.rates]
    order = reachable(roots)
    symbols = _moving(order, equations)
    moving = dependent(order, symbols)
    heavy, wild = _heavy(order, equations), _wild(order)
    conditions: dict[_Key, _Sides | None] = {}
    looked_at: dict[_Key, Node] = {}
    keys, kinks = _Keys(), _Kinks(order, roots, symbols)
    reading = [node for node in order if not moving.isdisjoint(node.args)]
    for node in reading:
        if node.op not in _BRANCHING or node.args[0] not in moving:
            continue
        if node in wild and kinks.is_smooth(node):
            continue
        key, scale = keys.of(node.args[0])
        looked_at.setdefault(key, node.args[0])
        # Nodes with the same key are one condition; it is ignored if one of them jumps.
        sides = None if node in heavy else kinks.sides(node)
        if node in wild:
            sides = _in_common(sides, kinks.sides_above(node))
        sides = None if sides is None else sides.turned(scale)
        conditions[key] = _in_common(conditions.get(key, _OPEN), sides)
    tables = {node for node in reading if _is_table(node) and node not in heavy | wild}
    known = time_events_within(equations.dag, order)
    timed = {node.args[0] for node, events in known.items() if events and _is_timed(node.args[0])}
    located = {k: v for k, v in conditions.items() if v is not None and looked_at[k] not in timed}
    signed: dict[Node, Node] = {}
    for key in [key for key, sides in located.items() if sides.steep == _BOTH]:
        del located[key]
        steep = find_roots(order, looked_at[key], lambda node: keys.of(node)[0] == key)  # noqa: B023
        if steep is not None and heavy.isdisjoint(steep):
            signed |= steep
    return _Found(
        {k: sides.held for k, sides in located.items()},
        {
            node
            for node in tables
            if max(map(len, _axes(node))) <= _MOST_POINTS and not timed >= {*node.args}
        },
        SteepRoots(signed),
    )


@dataclass(frozen=True)
class _Sides:
    """Properties of a kink by side: 1 if its condition is positive, -1 if it is negative."""

    held: frozenset[int]  # sides with a frozen branch; on any other side the argument selects it
    steep: frozenset[int]  # sides on which the slope at the kink is infinite

    def turned(self, scale: float) -> _Sides:
        """Return the sides of the condition after division by a factor."""
        if scale > 0.0:
            return self
        held, steep = (frozenset(-side for side in sides) for sides in (self.held, self.steep))
        return _Sides(held, steep)


_BOTH = frozenset({-1, 1})
#: Sides of a kink whose branches are both defined beyond it.
_OPEN = _Sides(_BOTH, frozenset())


def _in_common(a: _Sides | None, b: _Sides | None) -> _Sides | None:
    """Return the sides of a kink that two values permit, or None if one of them jumps."""
    return None if a is None or b is None else _Sides(a.held & b.held, a.steep | b.steep)


class _Kinks:
    """Analysis of values, and of their users, at the zeros of conditions.

    ``roots`` must not jump; ``order`` has all values, arguments first; the symbols ``moving``
    change between events.
    """

    def __init__(
        self, order: Sequence[Node], roots: Sequence[Node], moving: Sequence[Node]
    ) -> None:
        self._order, self._roots, self._moving = order, set(roots), set(moving)
        self._tangents: dict[Node, Tangents] = {}
        self._clips = Clips({})

    @cached_property
    def _places(self) -> dict[Node, int]:
        return {node: place for place, node in enumerate(self._order)}

    @cached_property
    def _reading(self) -> dict[Node, list[Node]]:
        found: dict[Node, list[Node]] = {}
        for item in self._order:
            for arg in dict.fromkeys(item.args):
                found.setdefault(arg, []).append(item)
        return found

    def _readers(self, node: Node) -> Sequence[Node]:
        return self._reading.get(node, ())

    def sides(self, node: Node) -> _Sides | None:
        """Return the sides of a selection, sign or absolute value, or None if a user jumps."""
        if node.op == "abs":
            return _OPEN
        condition, *branches = _branches(node)
        sides = _sides(condition, branches)
        if sides is not None:
            return sides
        sides, jumping = _OPEN, [node]
        for _ in range(_MOST_READERS):
            if not jumping or sides is None:
                return sides
            last = jumping.pop()
            if last in self._roots:
                return None
            for reader in self._readers(last):
                own = [substitute([reader], {node: value})[0] for value in branches]
                # Of a node with several results, the users compare each result.
                found = None if reader.op in SEVERAL else _sides(condition, own)
                if found is None:
                    jumping.append(reader)
                else:
                    sides = _in_common(sides, found)
        return None

    def is_smooth(self, node: Node) -> bool:
        """Return whether all users of a branching value are twice differentiable at its kink."""
        condition, positive, negative = _branches(node)
        if self._agree_twice(positive, negative, condition):
            return True
        if node in self._roots:
            return False
        above, below = {node: positive}, {node: negative}
        # Users are examined in evaluation order, so that all their arguments come first.
        waiting = set(self._readers(node))
        for _ in range(_MOST_ABOVE):
            if not waiting:
                return True
            reader = min(waiting, key=self._places.__getitem__)
            waiting.remove(reader)
            if reader in self._roots or reader.op in SEVERAL:
                return False
            try:
                above[reader], below[reader] = (
                    substitute([reader], known)[0] for known in (above, below)
                )
                if self._agree_twice(above[reader], below[reader], condition):
                    del above[reader], below[reader]
                    continue
            except (ArithmeticError, ValueError):  # undefined at the kink
                return False
            waiting.update(self._readers(reader))
        return False

    def _agree_twice(self, above: Node, below: Node, boundary: Node) -> bool:
        """Return whether values and their first two derivatives agree at the zero of a boundary."""
        pairs = [(above, below)]
        symbols = sorted(self._moving.intersection(symbols_in([boundary])), key=repr)
        for order in range(3):
            if order > 0:
                pairs = [
                    (self._derivative(a, symbol), self._derivative(b, symbol))
                    for a, b in pairs
                    for symbol in symbols
                ]
            if not all(agree_at(*pair, boundary) for pair in pairs):
                return False
        return True

    def _derivative(self, value: Node, symbol: Node) -> Node:
        # Tangents are stored by symbol: derivatives of a value occur in those of its users.
        if symbol not in self._tangents:
            self._tangents[symbol] = Tangents([{symbol: symbol.dag.one}], self._clips)
        (row,) = self._tangents[symbol].of([value])
        return row.get(0, value.dag.zero)

    def sides_above(self, node: Node) -> _Sides:
        """Return the sides on which all users of a branching value permit frozen branches."""
        condition, *branches = _branches(node)
        ways = ways_to_zero(condition)
        return _sides_of([self._end_above(node, value, ways) for value in branches])

    def _end_above(self, node: Node, value: Node, ways: _Ways) -> int:
        """Return how a branch ends, judging by its users; see :data:`_NOWHERE`."""
        known, waiting, end = {node: value}, [node], _NOWHERE
        for _ in range(_MOST_ABOVE):
            if not waiting:
                return end
            for reader in self._readers(waiting.pop()):
                if reader in known:
                    continue
                try:
                    known[reader] = substitute([reader], known)[0]
                except (ArithmeticError, ValueError):  # undefined at the kink
                    return _STEEP
                if self._moving.isdisjoint(symbols_in([known[reader]])):
                    continue
                is_dividend = reader.op == "div" and reader.args[1] not in known
                if not _is_defined_at_kinks(reader) and not is_dividend:
                    end = max(end, _ENDS, _end_within([known[reader]], ways))
                waiting.append(reader)
        return max(end, _ENDS)


def _branches(node: Node) -> tuple[Node, Node, Node]:
    """Return the condition of a branching value, and its values on both sides."""
    dag, (condition, *sides) = node.dag, node.args
    if node.op == "abs":
        return condition, condition, -condition
    above, below = sides or (dag.one, -dag.one)
    return condition, above, below


#: How a branch ends at a kink: it continues; it is undefined beyond the kink, but its slope is
#: finite; its slope is infinite or undefined.
_NOWHERE, _ENDS, _STEEP = range(3)

#: Substitutions, each of which makes a condition zero.
_Ways = list[dict["Node", "Node"]]


def _sides(condition: Node, branches: Sequence[Node]) -> _Sides | None:
    """Return the sides of a condition that selects one of two values, or None if they jump."""
    above, below = branches
    if not agree_at(above, below, condition):
        return None
    ways = ways_to_zero(condition)
    return _sides_of([_end_within(reachable([value]), ways) for value in branches])


def _sides_of(ends: Sequence[int]) -> _Sides:
    """Return the sides of a condition, given how its branches above and below zero end."""
    pairs = list(zip((1, -1), ends, strict=True))
    return _Sides(
        frozenset(side for side, end in pairs if end == _NOWHERE),
        frozenset(side for side, end in pairs if end == _STEEP),
    )


def _end_within(nodes: Iterable[Node], ways: _Ways) -> int:
    """Return how roots and similar functions in ``nodes`` end at the zero of a condition."""
    roots = [node for node in nodes if node.op in SINGULAR]
    try:
        ending = [node for node in roots for way in ways if ends(node, way)]
    except (ArithmeticError, ValueError):  # undefined at the zero
        return _STEEP
    if not ending:
        return _NOWHERE
    return _ENDS if all(map(_is_flat, ending)) else _STEEP


def _is_flat(node: Node) -> bool:
    """Return whether the slope of an operation is finite at the end of its domain."""
    power = node.args[-1].value
    return node.op == "pow" and power is not None and power > 1.0


def _moving(order: Iterable[Node], equations: Equations) -> list[Node]:
    """Return the symbols that change between events; modes do not."""
    still = {
        state.symbol
        for state, rate in zip(equations.states, equations.rates, strict=True)
        if rate.is_zero
    }
    kinds = (TIME, STATE, INPUT, UNKNOWN)
    symbols = [node for node in order if node.op == "symbol" and node.data[0] in kinds]
    return [node for node in symbols if node not in still]


def _is_timed(node: Node) -> bool:
    return all(symbol.data[0] not in (STATE, INPUT, UNKNOWN) for symbol in symbols_in([node]))


def _is_table(node: Node) -> bool:
    return type(node.data) in (LinearTable, PlaneTable)  # without tables that are already frozen


def _axes(node: Node) -> tuple[tuple[float, ...], ...]:
    return node.data.axes if isinstance(node.data, PlaneTable) else (node.data.x,)


def _heavy(order: Iterable[Node], equations: Equations) -> set[Node]:
    """Return values in masses, constraints, matrices and pivot scales, whose kinks are ignored."""
    held = equations.constraints
    values = [node for node in held.values if node is not None]
    values += [*chain.from_iterable(equations.matrix), *held.rates]
    for node in order:
        if node.op == "solve":
            n = node.data.size
            values += [*node.args[: n * n], *node.args[n * n + n :]]
        elif node.op in ("map", "call"):
            values += node.args
    return set(reachable(values))


def _is_defined_at_kinks(node: Node) -> bool:
    """Return whether an operation is defined beyond any kink of its arguments."""
    if node.op == "pow":
        base = node.args[0].value
        return base is not None and base > 0.0
    return node.op in _DEFINED_AT_KINKS or _is_table(node)


def _wild(order: Sequence[Node]) -> set[Node]:
    """Return the values with a user that may be undefined if a branch continues beyond its end."""
    found: set[Node] = set()
    for node in reversed(order):
        if node in found or not _is_defined_at_kinks(node):
            found |= set(node.args[1:] if node.op == "div" and node not in found else node.args)
    return found


#: Key of a sum: node indices of its terms with coefficients, scaled so that the first one is 1.
_Key = tuple[tuple[int, float], ...]


class _Keys:
    """Keys of conditions, which are equal up to their factor and the order of their terms."""

    def __init__(self) -> None:
        self._terms: dict[Node, dict[Node, float]] = {}

    def of(self, condition: Node) -> tuple[_Key, float]:
        """Return the key of a condition, and its factor relative to the key."""
        terms = sorted((node.index, factor) for node, factor in self._sum(condition).items())
        scale = terms[0][1] if terms else 1.0
        return tuple((index, factor / scale) for index, factor in terms), scale

    def _sum(self, node: Node) -> dict[Node, float]:
        found = self._terms.get(node)
        if found is None:
            found = self._terms[node] = self._formed(node)
        return found

    def _formed(self, node: Node) -> dict[Node, float]:
        if node.op in ("add", "sub", "neg"):
            factors = {"add": (1.0, 1.0), "sub": (1.0, -1.0), "neg": (-1.0,)}[node.op]
            total: dict[Node, float] = {}
            for arg, factor in zip(node.args, factors, strict=True):
                for term, own in self._sum(arg).items():
                    total[term] = total.get(term, 0.0) + factor * own
            if len(total) <= _MOST_TERMS:
                return {term: factor for term, factor in total.items() if factor != 0.0}
        if node.op == "mul" and node.args[0].value is not None:
            factor = node.args[0].value
            return {term: factor * own for term, own in self._sum(node.args[1]).items()}
        return {node.dag.one: node.value} if node.value else {node: 1.0}


@dataclass
class _Held:
    """Kinks and branch symbols, collected during the replacement."""

    rows: list[KinkRow]
    pieces: list[Node]


def _held(equations: Equations, found: _Found) -> tuple[dict[Node, Node], _Held]:
    """Return the replacements of values with kinks, and the kinks; inner kinks come first."""
    dag, held = equations.dag, _Held([], [])
    new: dict[Node, Node] = {}
    keys = _Keys()
    signs: dict[_Key, tuple[Node, float]] = {}
    widths: dict[_Key, tuple[Node, float]] = {}
    slots: dict[tuple[object, Node], Node] = {}
    motion = [] if equations.motion is None else [equations.motion]
    motion += [] if equations.direction is None else [equations.direction]
    rows = [*equations.sensitivities, *equations.columns, *motion]
    derived = chain.from_iterable(row.nodes for row in rows)
    order = reachable([*equations.forcing, *equations.rates, *equations.output_values, *derived])

    def of(node: Node) -> Node:
        return new.get(node, node)

    def slot() -> Node:
        held.pieces.append(dag.zero)
        return dag.symbol(PIECE, len(held.pieces) - 1)

    def sign(condition: Node, key: _Key, scale: float) -> Node:
        if key not in signs:
            signs[key] = slot(), scale
            held.rows.append(KinkRow(of(condition), signs[key][0].data[1], 0))
        piece, first = signs[key]
        own = piece if scale * first > 0.0 else -piece
        sides = found.conditions[key]
        if sides == _BOTH:
            # The condition selects the branch if the symbol is zero: -abs(x) >= 0 only at zero.
            return dag.select(-dag.function("abs", piece), of(condition), own)
        # The condition selects the branch if no branch is frozen, or its side is not frozen.
        decides = of(condition)
        for side in (own_side if scale > 0.0 else -own_side for own_side in sides):
            decides = dag.select(side * own - 0.5, dag.constant(side), decides)
        return decides

    def steep(node: Node, root: Node) -> Node:
        signed = found.steep.signed[root]
        key, scale = keys.of(signed)
        distance = substitute([signed], new)[0]
        if key not in widths:
            widths[key] = slot(), scale
            held.rows.append(KinkRow(distance, widths[key][0].data[1], 0, is_steep=True))
        width, first = widths[key]
        given = [of(arg) for arg in node.args]
        if node.op == "div":
            given[1] = of(root.args[0])
        return found.steep.replaced(node, tuple(given), distance, abs(scale / first) * width)

    def piece_of(axis: tuple[float, ...], at: Node) -> Node:
        if (axis, at) not in slots:
            slots[axis, at] = slot()
        return slots[axis, at]

    def table(node: Node) -> tuple[Node, ...]:
        given = [of(arg) for arg in node.args]
        pairs = zip(_axes(node), node.args, strict=True)
        pieces = [piece_of(axis, arg) for axis, arg in pairs]
        data: HeldTable | HeldPlane
        if isinstance(node.data, PlaneTable):
            data = HeldPlane(node.data.x, node.data.y, node.data.z)
        else:
            data = HeldTable(node.data.x, node.data.y)
        made = dag.several("lookup", [*given, *pieces], data, len(data.results))
        for i, (at, piece) in enumerate(zip(given, pieces, strict=True)):
            number = piece.data[1]
            if not held.pieces[number].is_zero:
                continue  # defined by a table with the same axis and argument
            low, high, which = data.ends(i)
            held.pieces[number] = made[which]
            held.rows.append(KinkRow(at - made[low], number, -1))
            held.rows.append(KinkRow(at - made[high], number, 1))
        return made

    results: dict[Node, tuple[Node, ...]] = {}
    for node in order:
        if node in found.tables:
            results[node] = table(node)
            continue
        if node.op == "result" and node.args[0] in results:
            new[node] = results[node.args[0]][node.data]
            continue
        key, scale = keys.of(node.args[0]) if node.op in _BRANCHING else ((), 0.0)
        root = found.steep.root_of(node)
        if root is not None:
            made = steep(node, root)
        elif key and key in found.conditions:
            own = sign(node.args[0], key, scale)
            if not found.conditions[key]:
                # Steps end at this kink, but the argument always selects the branch.
                made = dag.rebuild(node, tuple([of(arg) for arg in node.args]))
            elif node.op == "select":
                made = dag.select(own, of(node.args[1]), of(node.args[2]))
            else:
                made = dag.function("sign", own)
                made = made if node.op == "sign" else made * of(node.args[0])
        elif new.keys().isdisjoint(node.args):
            continue
        else:
            made = dag.rebuild(node, tuple([of(arg) for arg in node.args]))
        if made is not node:
            new[node] = made
            if node in dag.origins:
                dag.note_origin(made, dag.origins[node])
    return new, held
