"""Corners of right-hand sides that depend on the state: each step keeps to the pieces it began on.

In: equations that hold absolute values, selections and piecewise linear tables of what moves. Out:
the same equations with a symbol in each condition and each table that says which piece is to be
taken; where it is zero, the argument decides. The engine holds the pieces while it takes a step,
looks for the time at which an argument leaves its piece as it looks for events, and begins anew
from there on the next piece. States and their sensitivities are continuous at a corner, so that
nothing else happens there.

A sign, or a selection whose two sides differ, is a corner where what reads it is continuous, as in
``x*sign(x)``. Where a power of more than one ends, as ``max(x, 0)**1.5`` does, a piece has no value
beyond its end: steps end there, too, but its argument decides at all times.

Left as they are: conditions that do not evidently lead to a continuous value, which would be jumps;
those that are known functions of time, where integration stops anyway; corners within roots,
logarithms, exponentials, divisors and constraints, and corners where a root or a power below one
ends, since a piece has no value beyond its end there, or a huge one; and tables with very many
points, whose corners are small.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING

from cotree.dag.clips import SINGULAR, is_singular
from cotree.dag.continuity import meets, ways_to_zero
from cotree.dag.lookup import HeldPlane, HeldTable, PlaneTable
from cotree.dag.multi_output import Table
from cotree.dag.stops import stops_within
from cotree.dag.symbols import INPUT, PIECE, STATE, TIME, UNKNOWN
from cotree.dag.traverse import dependent, reachable, substitute, symbols_in
from cotree.equations import CornerRow

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.equations import Equations
    from cotree.program.program import Program

#: Functions that have a value beyond any corner, and no large one. Of a quotient it is the dividend
#: alone that may have corners, and of a linear system the right-hand side.
_TAME = frozenset({"add", "sub", "mul", "neg", "sin", "cos", "tanh", "atan", "erf", "abs"})
_TAME |= {"select", "sign", "table", "result", "sines"}
_BRANCHING = frozenset({"select", "abs", "sign"})

#: Tables with more points than this along an axis are left to the error test: a run would stop at
#: each of them.
_MOST_POINTS = 1000

#: So many values are tried between one that jumps and those in which it no longer does.
_MOST_READERS = 8

#: Sums of more terms than this are compared as they stand.
_MOST_TERMS = 64


def hold_pieces(equations: Equations) -> Equations:
    """Return the equations whose steps hold the pieces of what has corners."""
    found = _find(equations)
    if not found:
        return equations
    new, held = _held(equations, found)

    def again(nodes: Iterable[Node]) -> tuple[Node, ...]:
        return tuple(substitute(nodes, new))

    return replace(
        equations.with_derivatives(new),
        forcing=again(equations.forcing),
        rates=again(equations.rates),
        output_values=again(equations.output_values),
        corners=tuple(held.rows),
        pieces=tuple(held.pieces),
    )


def without_corners(program: Program) -> Program:
    """Let no engine look for corners, so that all pieces are those that arguments decide."""
    layout, kernels = program.layout, dict(program.kernels)
    n, m = len(layout.events), len(layout.corners)
    if not m:
        return program

    def cut(name: str, n_blocks: int = 1) -> None:
        results = kernels[name].results
        width = len(results) // n_blocks
        blocks = [results[i * width : (i + 1) * width] for i in range(n_blocks)]
        left = [block[:n] + block[n + m :] for block in blocks] if n else []
        kernels[name] = replace(kernels[name], results=tuple(chain.from_iterable(left)))

    n_before, ranges = n + m + layout.n_pieces, layout.ranges[:n]
    values = kernels["events"].results
    kernels["events"] = replace(kernels["events"], results=values[:n] + values[n_before:])
    # Ranges are numbered in the order of what they are of, and those of events come first.
    ends = kernels["event_ranges"].results[: 4 * (1 + max(ranges, default=-1))]
    kernels["event_ranges"] = replace(kernels["event_ranges"], results=ends)
    cut("event_rates")
    if kernels["event_sensitivity"].results:
        cut("event_sensitivity", len(layout.sensitivities))
    layout = replace(layout, corners=(), n_pieces=0, ranges=ranges)
    return replace(program, layout=layout, kernels=kernels)


def _find(equations: Equations) -> dict[Node, bool]:
    """List the conditions and the tables that are followed, and whether steps hold their pieces."""
    order = reachable([*equations.forcing, *equations.rates])
    moving = dependent(order, _moving(order, equations))
    wild = _wild(order, equations, _TAME)
    steep = _wild(order, equations, _TAME | {"pow"}) if wild else wild
    conditions: dict[_Key, int] = {}
    looked_at: dict[_Key, Node] = {}
    tables: dict[Node, bool] = {}
    keys, jumps = _Keys(), _Jumps(order, [*equations.forcing, *equations.rates])
    reading = [node for node in order if not moving.isdisjoint(node.args)]
    branching = [node for node in reading if node.op in _BRANCHING and node.args[0] in moving]
    # One condition serves all that it decides: one of these may rule it out.
    ruled_out = {keys.of(node.args[0])[0] for node in branching if node in steep}
    for node in reading:
        if node.op in _BRANCHING:
            if node.args[0] not in moving:
                continue
            key, _ = keys.of(node.args[0])
            looked_at.setdefault(key, node.args[0])
            kind = _JUMP if key in ruled_out else jumps.kind(node)
            if kind == _JUMP:
                ruled_out.add(key)
            kind = min(kind, _SEEN if node in wild else _HELD)
            conditions[key] = min(conditions.get(key, _HELD), kind)
        elif _is_table(node) and node not in wild and _n_points(node) <= _MOST_POINTS:
            tables[node] = True
    known = stops_within(equations.dag, order)
    timed = {node.args[0] for node, stops in known.items() if stops and _is_timed(node.args[0])}
    located = {looked_at[key]: kind == _HELD for key, kind in conditions.items() if kind != _JUMP}
    kept = {node: is_held for node, is_held in located.items() if node not in timed}
    return kept | {node: True for node in tables if not timed.issuperset(node.args)}


#: What a condition decides: a jump; a corner beside which a power has no value or, of a slope that
#: is infinite further on, a wrong one, so that steps end there but hold no piece; or a corner.
_JUMP, _SEEN, _HELD = range(3)


class _Jumps:
    """Follow what jumps where a condition is zero, up to where the whole is continuous.

    Parameters
    ----------
    order : sequence of Node
        All values, arguments first.
    roots : sequence of Node
        Those that must not jump.
    """

    def __init__(self, order: Sequence[Node], roots: Sequence[Node]) -> None:
        self._order, self._roots = order, set(roots)
        self._readers: dict[Node, list[Node]] = {}

    def kind(self, node: Node) -> int:
        """Return what a selection, a sign or an absolute value decides."""
        if node.op == "abs":
            return _HELD
        dag, (condition, *sides) = node.dag, node.args
        above, below = sides or (dag.one, -dag.one)
        kind = _kind(condition, above, below)
        if kind != _JUMP:
            return kind
        kind = _HELD
        for item in self._order if not self._readers else ():
            for arg in dict.fromkeys(item.args):
                self._readers.setdefault(arg, []).append(item)
        jumping = [node]
        for _ in range(_MOST_READERS):
            if not jumping:
                return kind
            last = jumping.pop()
            if last in self._roots:
                return _JUMP
            for reader in self._readers.get(last, ()):
                if reader.op not in _TAME:
                    return _JUMP
                own, other = (substitute([reader], {node: side})[0] for side in (above, below))
                found = _kind(condition, own, other)
                if found == _JUMP:
                    jumping.append(reader)
                else:
                    kind = min(kind, found)
        return _JUMP


def _kind(condition: Node, above: Node, below: Node) -> int:
    """Return what a condition decides that selects one of two values."""
    roots = [node for node in reachable([above, below]) if node.op in SINGULAR]
    kind = _HELD
    try:
        for way in ways_to_zero(condition) if roots else ():
            for node in roots:
                if _ends(node, way):
                    if not _is_flat(node):
                        return _JUMP
                    kind = _SEEN
    except (ArithmeticError, ValueError):  # it has no value there
        return _JUMP
    return kind if meets(above, below, condition) else _JUMP


def _is_flat(node: Node) -> bool:
    """Return whether the slope of an operation is finite where its value ends."""
    power = node.args[-1].value
    return node.op == "pow" and power is not None and power > 1.0


def _ends(node: Node, way: Mapping[Node, Node]) -> bool:
    """Return whether a root or a power has no value beyond where its condition is zero."""
    first, *others = substitute(node.args, way)
    if node.op == "pow":
        return first.value is not None and first.value <= 0.0
    return is_singular(node.op, (first, *others))


def _moving(order: Iterable[Node], equations: Equations) -> list[Node]:
    """List the symbols that change between events; modes do not."""
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
    return type(node.data) in (Table, PlaneTable)  # not one that is held already


def _n_points(node: Node) -> int:
    return max(map(len, _axes(node)))


def _axes(node: Node) -> tuple[tuple[float, ...], ...]:
    """List the points of a table along each of its axes."""
    return node.data.axes if isinstance(node.data, PlaneTable) else (node.data.x,)


def _wild(order: list[Node], equations: Equations, tame: frozenset[str]) -> set[Node]:
    """List the values that something reads which must not be given a piece beyond its end."""
    held = equations.constraints
    found = set(reachable(list(chain.from_iterable(equations.matrix))))
    values = [node for node in held.values if node is not None]
    found |= set(reachable([*values, *held.rates]))
    for node in reversed(order):
        is_tame = (node.op in tame and (node.op != "pow" or _is_flat(node))) or _is_table(node)
        if node in found or not is_tame:
            found |= set(node.args[1:] if node.op == "div" and node not in found else node.args)
    return found


#: A sum as its terms by their numbers, with coefficients; the first of these is one.
_Key = tuple[tuple[int, float], ...]


class _Keys:
    """Tells conditions that are the same but for their sign, a factor, or the order of their terms.

    Derivatives of laws write the conditions of the laws themselves in other ways.
    """

    def __init__(self) -> None:
        self._terms: dict[Node, dict[Node, float]] = {}

    def of(self, condition: Node) -> tuple[_Key, float]:
        """Give the key of a condition, and the factor by which it is what the key says."""
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
    """Rows and symbols that are found while pieces are numbered."""

    rows: list[CornerRow]
    pieces: list[Node]


def _held(equations: Equations, found: Mapping[Node, bool]) -> tuple[dict[Node, Node], _Held]:
    """Form what takes the place of each value that has a corner, from the inside out."""
    dag, held = equations.dag, _Held([], [])
    new: dict[Node, Node] = {}
    keys = _Keys()
    signs: dict[_Key, tuple[Node, float]] = {}
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
            held.rows.append(CornerRow(of(condition), signs[key][0].data[1], 0))
        piece, first = signs[key]
        # Minus its size is zero or more where it is zero itself.
        own = piece if scale * first > 0.0 else -piece
        return dag.select(-dag.function("abs", piece), of(condition), own)

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
                continue  # another table with these arguments at the same value
            low, high, which = data.ends(i)
            held.pieces[number] = made[which]
            held.rows.append(CornerRow(at - made[low], number, -1))
            held.rows.append(CornerRow(at - made[high], number, 1))
        return made

    results: dict[Node, tuple[Node, ...]] = {}
    followed = {keys.of(node)[0]: is_held for node, is_held in found.items() if not _is_table(node)}
    for node in order:
        if node in found and _is_table(node):
            results[node] = table(node)
            continue
        if node.op == "result" and node.args[0] in results:
            new[node] = results[node.args[0]][node.data]
            continue
        key, scale = keys.of(node.args[0]) if node.op in _BRANCHING else ((), 0.0)
        if key and key in followed:
            own = sign(node.args[0], key, scale)
            if not followed[key]:
                # The step ends there, but its values decide by themselves.
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
    return new, held
