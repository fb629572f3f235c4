"""Sparsity pattern of the sensitivities: the states that may depend on each parameter.

A state is reached by a parameter if its initial value or rate depends explicitly on the parameter,
or if its rate depends on a reached state. Algebraic unknowns that equations connect are reached
together. If a constraint or an event depends on the parameter, all states that it changes are
reached. If a parameter determines the times of kinks or jumps of a rate, the state is reached even
if the rate is constant between such times. Sensitivities of all other states are always zero and
are removed from the equations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.dag.nodes import (
    ENTRY,
    PACKED_SENSITIVITY,
    SENSITIVITY,
    STATE_RATE,
    dependent,
    reachable,
    substitute,
    supports_of,
)
from cotree.dag.switching_times import find_time_events, time_events_within
from cotree.equations import substituted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.equations import Derivative, Equations
    from cotree.program.solved import SolvedSystem

#: Bit mask of a value's symbols, and whether the value may be nonzero if all of them are zero.
_Part = tuple[int, bool]

_CONSTANT: _Part = (0, True)
_ZERO: _Part = (0, False)


def reached_states(
    equations: Equations, solved: SolvedSystem, timed: Sequence[Timed]
) -> tuple[tuple[int, ...], ...]:
    """Return the states that depend on each parameter; ``timed`` results from :func:`timed_by`."""
    rows, n = equations.sensitivities, len(equations.states)
    if not rows:
        return ()
    # A direction contains only its own sensitivities, so bit i means state i in all directions. The
    # bits of the unknowns' tangents follow those of the states.
    bits = {
        equations.dag.symbol(SENSITIVITY, j * n + i): 1 << i
        for j in range(len(rows))
        for i in range(n)
    }
    bits |= {equations.dag.symbol(STATE_RATE, i): 1 << i for i in range(n)}
    bits |= {symbol: 1 << (n + i) for i, symbol in enumerate(equations.unknown_tangents)}
    motion = () if equations.motion is None else (equations.motion,)
    parts = _Parts([node for row in (*rows, *motion) for node in row.nodes], bits)
    solving = _solving(solved)
    directions = [_Direction(row, parts, solving, n) for row in rows]
    choosers = _choosers(equations)
    groups = _connected([part for along in directions for part in along.rates.items()], equations)
    found = []
    for along, own in zip(directions, timed, strict=True):
        along.connect(groups)
        along.follow(followers(equations))
        # Constraints and events may add states, which may add further ones: repeat.
        reached = along.reached(own.states)
        while not reached.issuperset(
            moved := _moved(equations, parts, along, choosers, reached, own.is_event)
        ):
            reached = along.reached(reached | moved)
        found.append(tuple(sorted(reached)))
    return tuple(found)


@dataclass(frozen=True)
class Timed:
    """States and events whose conditions on time depend on a parameter."""

    states: set[int]  # states whose rates have such conditions
    is_event: bool  # whether an event function has such conditions


def timed_by(equations: Equations, rates: Sequence[Node], watched: Sequence[Node]) -> list[Timed]:
    """Find the conditions on time that depend on each parameter; values contain no unknowns."""
    dag, rows, roots = equations.dag, equations.sensitivities, [*rates, *watched]
    given = dict(zip(equations.input_symbols, equations.input_values, strict=True))
    looking = {
        **time_events_within(dag, roots),
        **{symbol: find_time_events(dag, [value]) for symbol, value in given.items()},
    }
    if not any(looking.values()):
        return [Timed(set(), False) for _ in rows]
    from cotree.dag.time_events import time_events_along

    order, found = reachable(roots), []
    for row in rows:
        # A time event depends on the parameter if its first time or period has a derivative.
        moved = [
            node
            for node, own in looking.items()
            if any(
                not d.is_zero
                for event in time_events_along(own, [row.seed])
                for d in event.along[0]
            )
        ]
        depending = dependent(order, moved) if moved else set()
        states = {i for i, rate in enumerate(rates) if rate in depending}
        found.append(Timed(states, not depending.isdisjoint(watched)))
    return found


class _Parts:
    """Table of the symbols on which each value depends."""

    def __init__(self, nodes: Sequence[Node], bits: Mapping[Node, int]) -> None:
        self._known: dict[Node, _Part] = {node: (bit, False) for node, bit in bits.items()}
        for node in reachable(nodes):
            if node in self._known or not any(arg in self._known for arg in node.args):
                continue
            parts = [self[arg] for arg in node.args]
            mask = 0
            for own, _ in parts:
                mask |= own
            remains = [rest for _, rest in parts]
            # A product is zero if one of its factors is zero.
            if node.op in ("mul", "div"):
                is_left = all(remains)
            else:
                # The condition of a selection does not contribute to its value.
                is_left = any(remains[1:] if node.op == "select" else remains)
            self._known[node] = (mask, is_left)

    def __getitem__(self, node: Node) -> _Part:
        return self._known.get(node) or (_ZERO if node.is_zero else _CONSTANT)


class _Direction:
    """A parameter, and the dependences of the derivatives with respect to it."""

    def __init__(self, row: Derivative, parts: _Parts, solving: Sequence[int], n: int) -> None:
        self.row, self._parts, self._n = row, parts, n
        forcing = [parts[node] for node in row.forcing]
        # The elimination combines entries of the forcing; an unknown depends on those of its mask.
        self._tangents = [_either(forcing[k] for k in _places(mask)) for mask in solving]
        self.rates = {i: self.part(node) for i, node in row.rates.items()}

    def part(self, node: Node) -> _Part:
        """Return the dependence of a value on state sensitivities, directly or through unknowns."""
        mask, rest = self._parts[node]
        own = mask & ((1 << self._n) - 1)
        solved = _either(self._tangents[k] for k in _places(mask >> self._n))
        return own | solved[0], rest or solved[1]

    def depends(self, node: Node, reached: set[int]) -> bool:
        """Return whether a value depends on the parameter, given the states ``reached``."""
        mask, rest = self.part(node)
        return rest or not reached.isdisjoint(_places(mask))

    def users(self, states: Iterable[int]) -> set[int]:
        """Return the states whose rates depend on ``states``."""
        wanted = sum(1 << i for i in states)
        return {i for i, (mask, _) in self.rates.items() if mask & wanted}

    def connect(self, groups: Sequence[Sequence[int]]) -> None:
        """Merge the dependences of algebraic unknowns that equations connect."""
        for group in groups:
            whole = _either(self.rates.get(i, _ZERO) for i in group)
            self.rates |= dict.fromkeys(group, whole)

    def follow(self, followers: Sequence[tuple[int, int]]) -> None:
        """Make each storage content also depend on the unknown that it determines."""
        for total, follower in followers:
            mask, rest = self.rates.get(total, _ZERO)
            self.rates[total] = mask | 1 << follower, rest

    def reached(self, known: Iterable[int]) -> set[int]:
        """Return all states that depend on the parameter: those in ``known``, and through rates."""
        users: dict[int, list[int]] = {}
        for i, (mask, _) in self.rates.items():
            for k in _places(mask):
                users.setdefault(k, []).append(i)
        reached = {i for i, node in self.row.initial.items() if not node.is_zero}
        # A rate that is nonzero if all sensitivities are zero depends on the parameter explicitly.
        reached |= {i for i, (_, rest) in self.rates.items() if rest}.union(known)
        stack = list(reached)
        while stack:
            new = [i for i in users.get(stack.pop(), ()) if i not in reached]
            reached.update(new)
            stack += new
        return reached


def followers(equations: Equations) -> tuple[tuple[int, int], ...]:
    """Return pairs of indices: the content of a storage, and the unknown that it determines."""
    places = {state.name: i for i, state in enumerate(equations.states)}
    rows = enumerate(equations.states)
    return tuple((i, places[state.follower]) for i, state in rows if state.follower)


def _places(mask: int) -> Iterator[int]:
    """Yield the positions of the set bits of a number."""
    while mask:
        low = mask & -mask
        yield low.bit_length() - 1
        mask ^= low


def _either(parts: Iterable[_Part]) -> _Part:
    """Return the dependence of a sum from the dependences of its terms."""
    mask, rest = _ZERO
    for own, remains in parts:
        mask, rest = mask | own, rest or remains
    return mask, rest


def _solving(solved: SolvedSystem) -> list[int]:
    """Return for each unknown the bit mask of the forcing entries on which it depends."""
    own = [solved.dag.symbol(ENTRY, k) for k in range(len(solved.unknowns))]
    unknowns = solved.factors.solve(own) if own else []
    parts = _Parts(unknowns, {symbol: 1 << k for k, symbol in enumerate(own)})
    return [parts[node][0] for node in unknowns]


def _connected(rates: Iterable[tuple[int, _Part]], equations: Equations) -> list[list[int]]:
    """Return groups of algebraic unknowns that equations connect."""
    cut = len(equations.states) - equations.n_algebraic
    masks = [1 << i for i in range(cut, len(equations.states))]
    # Groups are bit masks. Each equation merges the groups of its unknowns.
    for i, (mask, _) in rates:
        if i < cut:
            continue
        own = 1 << i | (mask >> cut << cut)
        together = [group for group in masks if group & own]
        masks = [group for group in masks if not group & own]
        masks.append(_either((group, False) for group in together)[0])
    return [list(_places(mask)) for mask in masks]


def _choosers(equations: Equations) -> dict[int, set[int]]:
    """Return for each state that events set the states whose rates depend on it.

    Conditions are included: the derivative of a selection, sign or floor with respect to its
    condition is zero, but the value jumps with the condition.
    """
    targets = {target for event in equations.events for target in event.targets}
    if not targets:
        return {}
    own = {equations.states[target].symbol: 1 << target for target in targets}
    # Assume that all unknowns depend on each event target in the equations.
    matrix = equations.matrix if isinstance(equations.matrix, tuple) else ()
    solved = [*equations.forcing, *(entry for row in matrix for entry in row)]
    # Bit masks of the states set by events on which each value depends.
    mask = supports_of(reachable(solved), own)
    whole = _either((mask[node], False) for node in solved)[0]
    mask |= dict.fromkeys(equations.unknowns, whole)
    mask = supports_of(reachable(equations.rates), mask)
    users: dict[int, set[int]] = {target: set() for target in targets}
    for i, rate in enumerate(equations.rates):
        for target in _places(mask[rate]):
            users[target].add(i)
    return users


def _moved(
    equations: Equations,
    parts: _Parts,
    along: _Direction,
    choosers: Mapping[int, set[int]],
    reached: set[int],
    is_timed: bool,
) -> set[int]:
    """Return the states that constraints or events change in dependence on the parameter."""
    row, constraints = along.row, equations.constraints
    n_coordinates, n_speeds = equations.n_coordinates, equations.n_speeds
    moved: set[int] = set()
    turned = {entry for _, q in constraints.quaternions for entry in q}
    norms = {i for i, state in enumerate(equations.states) if state.symbol in turned}
    held = [*row.held, *row.held_rates, *row.start]
    # A projection changes all coordinates and speeds together. The same is assumed of the
    # normalisation of quaternions that depend on the parameter.
    if any(along.depends(node, reached) for node in held) or not norms.isdisjoint(reached):
        moved.update(range(n_coordinates + n_speeds))
    depending = {k for k, node in row.outputs.items() if along.depends(node, reached)}
    # An event may trigger other events at the same time.
    is_timed = is_timed or any(event.watched in depending for event in equations.events)
    for event in equations.events:
        causes = event.causes
        moved |= {target for target, k in causes.items() if k in depending or target in reached}
        if is_timed:
            # If the time of an event depends on the parameter, the states that the event sets, and
            # the states whose rates it changes, depend on it too.
            moved |= {target for target, k in causes.items() if _moves(equations, parts, target, k)}
            moved |= along.users(causes).union(*(choosers[target] for target in causes))
    return moved


def _moves(equations: Equations, parts: _Parts, target: int, place: int) -> bool:
    """Return whether a state, or the value that an event sets, varies with time; modes do not."""
    assert equations.motion is not None  # models with events have a motion
    rates, slope = equations.rates, equations.motion.outputs.get(place, equations.dag.zero)
    mask, rest = parts[slope]
    is_driven = any(i >= len(rates) or not rates[i].is_zero for i in _places(mask))
    return rest or is_driven or not rates[target].is_zero


def without_vanishing(equations: Equations, reached: Sequence[Sequence[int]]) -> Equations:
    """Replace sensitivities that are identically zero by zero, which simplifies all derivatives."""
    dag, n = equations.dag, len(equations.states)
    gone = {
        dag.symbol(SENSITIVITY, j * n + i): dag.zero
        for j, own in enumerate(reached)
        for i in sorted(set(range(n)).difference(own))
    }
    if not gone:
        return equations
    sensitivities = tuple(
        replace(row, seed={key: node for key, node in row.seed.items() if node not in gone})
        for row in substituted(equations.sensitivities, gone)
    )
    return replace(equations, sensitivities=sensitivities)


def pack_rates(
    dag: Dag, reached: Sequence[Sequence[int]], n: int, rates: Sequence[Node]
) -> list[Node]:
    """Return the rates of sensitivities that are not identically zero, in packed symbols.

    ``rates`` has n entries for each parameter and contains symbols with the same numbering. The
    result has entries only for the states of :func:`reached_states`.
    """
    left = [j * n + i for j, own in enumerate(reached) for i in own]
    if len(left) == len(rates):
        return list(rates)
    known = {dag.symbol(SENSITIVITY, place): dag.zero for place in range(len(rates))}
    for k, place in enumerate(left):
        known[dag.symbol(SENSITIVITY, place)] = dag.symbol(PACKED_SENSITIVITY, k)
    return substitute([rates[place] for place in left], known)
