"""Kernels of events: event functions, the values that events set, and the derivatives of both.

Within a step, event functions that are linear in states, inputs and time change direction no more
often than these variables, which the error test resolves. Nonlinear event functions, such as the
sine of a large angle, may cross zero and return within one accurate step. For each of these, the
kernel ``event_ranges`` computes the ranges of its value and of its rate from the ranges of
quantities. Quantities are its largest linear parts, and values whose ranges cannot be computed. The
engine divides a step until the range of each value, or of its rate, excludes zero
(``templates/runtime/hybrid/cotree_scan.c``).

The impulse L of an impact acts along D, the derivatives of the expression's rate with respect to
the speeds, and constraints transmit it without work: ``[M, -G^T; -G, 0] [a; *] = [D; 0]``
determines the change a of the speeds per unit impulse. ``L = -(1 + e) g' / (D a)`` changes the rate
g' of the expression to -e g'.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.dag.lookup import HeldPlane, HeldTable
from cotree.dag.nodes import (
    INPUT,
    PARAMETER,
    PIECE,
    RANGE,
    STATE,
    STATE_RATE,
    TIME,
    Node,
    reachable,
    substitute,
    symbols_in,
)
from cotree.dag.ranges import is_ranged, ranges
from cotree.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from cotree.equations import Equations, EventRow
    from cotree.program.solved import Along, SolvedSystem


#: Monotonic functions, which take each value at no more than one argument.
_MONOTONE = frozenset({"sqrt", "asin", "acos", "atan", "sinh", "tanh", "exp", "log", "erf"})

#: Values with more nodes have no range, because computing it would take longer than a step.
_MOST_NODES = 1000

#: Kinds of dependence on variables that change during a step: none, linear, nonlinear.
_CONSTANT, _LINEAR, _CURVED = range(3)


@dataclass(frozen=True)
class EventRanges:
    """Ranges of event functions and switching functions."""

    #: Index of the range of each event function, then of each kink; -1 if it needs or has none.
    places: tuple[int, ...]
    quantities: tuple[Node, ...]  # quantities on which the functions depend
    #: Four values per nonlinear function: bounds of its value, then of its rate.
    results: tuple[Node, ...]


def find_ranges(
    equations: Equations, values: Sequence[Node], smooth: Collection[Node] = ()
) -> EventRanges:
    """Form the ranges of ``values``, events and then kinks; ``smooth`` nodes count as linear."""
    dag = equations.dag
    kinds = _kinds(equations, values, smooth)
    curved = [
        value
        for value in dict.fromkeys(values)
        if not _is_plain(value, kinds) and len(_inside(value, kinds)) <= _MOST_NODES
    ]
    quantities = _quantities(curved, kinds)
    n = len(quantities)
    symbols = [dag.symbol(RANGE, i) for i in range(4 * n)]
    known = {q: (symbols[i], symbols[n + i]) for i, q in enumerate(quantities)}
    # The rate of a quantity is a symbol with a known range.
    speeds = [dag.symbol(RANGE, 4 * n + i) for i in range(n)]
    known |= {v: (symbols[2 * n + i], symbols[3 * n + i]) for i, v in enumerate(speeds)}
    rates = tangents(curved, dict(zip(quantities, speeds, strict=True)))
    found = ranges([*curved, *rates], known)
    of_values, of_rates = found[: len(curved)], found[len(curved) :]
    numbers = {value: i for i, value in enumerate(curved)}
    return EventRanges(
        tuple(numbers.get(value, -1) for value in values),
        tuple(quantities),
        tuple(end for own, rate in zip(of_values, of_rates, strict=True) for end in (*own, *rate)),
    )


def _kinds(
    equations: Equations, values: Iterable[Node], smooth: Collection[Node]
) -> dict[Node, int]:
    """Classify how each value depends on variables that change during a step."""
    still = {
        state.symbol
        for state, rate in zip(equations.states, equations.rates, strict=True)
        if rate.is_zero
    }
    kinds: dict[Node, int] = {}
    for node in reachable(values):
        if node.op == "symbol":
            moves = node.data[0] in (TIME, STATE, INPUT) and node not in still
            kinds[node] = _LINEAR if moves else _CONSTANT
            continue
        if _is_held(node):
            # Selections by frozen signs are constant; ends of frozen intervals are linear.
            kinds[node] = _CONSTANT if node.op == "select" else _LINEAR
            continue
        given = [kinds[arg] for arg in node.args]
        highest = max(given, default=_CONSTANT)
        if node in smooth:
            kinds[node] = min(highest, _LINEAR)
            continue
        is_linear = (
            node.op in ("add", "sub", "neg")
            or (node.op == "mul" and _CONSTANT in given)
            or (node.op == "div" and given[1] == _CONSTANT)
            # A table is linear in a frozen interval.
            or isinstance(node.data, HeldTable)
            or (node.op == "result" and isinstance(node.args[0].data, HeldTable))
        )
        kinds[node] = highest if is_linear or highest == _CONSTANT else _CURVED
    return kinds


def _is_held(node: Node) -> bool:
    """Return whether a value is a frozen sign, or the end or number of a frozen interval."""
    if node.op == "select":
        return {symbol.data[0] for symbol in symbols_in(node.args[:1])} == {PIECE}
    data = node.args[0].data if node.op == "result" else None
    if not isinstance(data, (HeldTable, HeldPlane)):
        return False
    name: str = data.results[node.data]
    return name.startswith(("low", "high", "piece"))


def _is_plain(node: Node, kinds: dict[Node, int]) -> bool:
    """Return whether a value is linear, or a monotonic function of a linear value."""
    if kinds[node] != _CURVED:
        return True
    moving = [arg for arg in node.args if kinds[arg] != _CONSTANT]
    keeps_order = node.op in _MONOTONE or node.op in ("add", "sub", "neg", "mul", "div")
    if node.op == "div" and kinds[node.args[1]] != _CONSTANT:
        return False
    return keeps_order and len(moving) == 1 and len(node.args) <= 2 and _is_plain(moving[0], kinds)


def _is_leaf(node: Node, kinds: dict[Node, int]) -> bool:
    """Return whether a value that changes during a step is a quantity (linear or without range)."""
    return kinds[node] == _LINEAR or not is_ranged(node)


def _inside(value: Node, kinds: dict[Node, int]) -> list[Node]:
    """Return the values between a value and its quantities, including both."""
    leaves = {
        node for node in reachable([value]) if kinds[node] != _CONSTANT and _is_leaf(node, kinds)
    }
    return reachable([value], stop=leaves)


def _quantities(values: Sequence[Node], kinds: dict[Node, int]) -> list[Node]:
    found = {
        node
        for value in values
        for node in _inside(value, kinds)
        if kinds[node] != _CONSTANT and _is_leaf(node, kinds)
    }
    return sorted(found, key=lambda node: node.index)


@dataclass(frozen=True)
class Impact:
    """One impact, as a function of the state before it."""

    gradient: tuple[Node, ...]  # derivatives D of the gap rate with respect to the speeds
    response: tuple[Node, ...]  # changes of speeds and multipliers per unit impulse
    rate: Node  # gap rate g'
    restitution: Node  # coefficient of restitution e
    speeds: tuple[Node, ...]  # speeds after the impact

    def tangent(
        self, solved: SolvedSystem, seed: Mapping[Node, Node], restitution: Node
    ) -> list[Node]:
        """Differentiate the speeds after the impact; ``restitution`` is the derivative of e."""
        n = len(self.gradient)
        gradient = tangents(self.gradient, seed)
        # The derivative of [M, -G^T; -G, 0] [a; *] = [D; 0] has the same matrix; the zeros on the
        # right-hand side belong to the multipliers.
        forcing = [*gradient, *([solved.dag.zero] * (len(self.response) - n))]
        response = solved.solve_again(forcing, self.response, seed)[:n]
        # The chain rule stops at these values, because their derivatives are known.
        known = {**seed, self.restitution: restitution, self.rate: tangents([self.rate], seed)[0]}
        known |= dict(zip(self.gradient, gradient, strict=True))
        known |= dict(zip(self.response, response, strict=False))
        return tangents(self.speeds, known)


def form_impact(
    equations: Equations, solved: SolvedSystem, event: EventRow, values: Sequence[Node]
) -> Impact:
    """Form an impact; raise SceneError unless its condition is a function of positions."""
    assert event.restitution is not None
    restitution, place, name = values[event.restitution], event.watched, event.name
    dag, n, first = equations.dag, equations.n_speeds, equations.n_coordinates
    _check_positions(equations, place, name)
    rates = equations.rates[:first]
    gradient = []
    # D_k = sum of (dg/dq_i)(dq_i'/dv_k) over the coordinates q_i, since g' = sum of (dg/dq_i) q_i'.
    for state in equations.states[first : first + n]:
        moved = tangents(rates, {state.symbol: dag.one})
        total = dag.zero
        for column, d in zip(equations.columns, moved, strict=False):
            total = total + column.outputs.get(place, dag.zero) * d
        gradient.append(total)
    if all(entry.is_zero for entry in gradient):
        raise SceneError(
            f"when of event '{name}' does not depend on any joint or body of the multibody "
            "system, on which its impact acts: set states instead"
        )
    assert equations.motion is not None  # models with events have a motion
    # The condition depends on positions, so only rates of coordinates occur in its derivative.
    moving = {dag.symbol(STATE_RATE, i): rate for i, rate in enumerate(rates)}
    along = equations.motion.outputs.get(place, dag.zero)
    with dag.labelled(f"impact of {name}"):
        rate = substitute([along], moving)[0]
        zeros = [dag.zero] * len(equations.constraints.rows)
        response = solved.bare.solve([*gradient, *zeros])
        answer = dag.zero
        for d, a in zip(gradient, response, strict=False):
            answer = answer + d * a
        impulse = -((1.0 + restitution) * rate) / answer
        before = [state.symbol for state in equations.states[first : first + n]]
        after = [v + a * impulse for v, a in zip(before, response, strict=False)]
    return Impact(tuple(gradient), tuple(response), rate, restitution, tuple(after))


def _check_positions(equations: Equations, place: int, name: str) -> None:
    """Raise SceneError if an expression depends on more than positions and (constant) modes."""
    first, n = equations.n_coordinates, equations.n_coordinates + equations.n_speeds
    allowed = {*range(first), *range(n, n + equations.n_modes)}
    for symbol in symbols_in([equations.output_values[place]]):
        kind, i = symbol.data
        if kind in (PARAMETER, TIME) or (kind == STATE and i in allowed):
            continue
        named = {STATE: equations.states, INPUT: equations.inputs}.get(kind)
        what = f"'{named[i].name}'" if named is not None else "accelerations or reactions"
        raise SceneError(
            f"when of event '{name}' depends on {what}, but an impact needs an expression of "
            "positions, parameters and t"
        )


def event_kernels(
    equations: Equations,
    solved: SolvedSystem,
    values: Sequence[Node],
    along: Sequence[Along],
    motion: Along,
) -> tuple[dict[str, list[Node]], EventRanges]:
    """Form the event kernels and their ranges; ``values`` are outputs, then events."""
    dag, rows = equations.dag, equations.events
    # Events without restitution only set states.
    impacts = [
        None if row.restitution is None else form_impact(equations, solved, row, values)
        for row in rows
    ]
    # The results of each event are the new values, then the speeds after its impact.
    jumps: list[Node] = []
    for row, impact in zip(rows, impacts, strict=True):
        jumps += [*(values[i] for i in row.new_values), *(impact.speeds if impact else ())]

    kinks = solved.substitute([row.value for row in equations.kinks])
    # Only steep kinks change sensitivities, so that a value that rests there depends on no
    # parameter.
    looked_at = [
        value if row.is_steep else dag.zero
        for row, value in zip(equations.kinks, kinks, strict=True)
    ]
    # The rest threshold is evaluated only in impacts, so it needs no range.
    crossed = [dag.zero if row.is_rest else values[row.watched] for row in rows]
    # Multipliers count as linear, because their ranges would be far too wide.
    first = equations.n_speeds + len(equations.constraints.rows)
    multipliers = {solved.unknowns[symbol] for symbol in equations.unknowns[first:]}
    found_ranges = find_ranges(equations, [*crossed, *kinks], multipliers)
    seed_of_motion = _along_the_motion(equations)

    def derivatives(
        changes: Mapping[int, Node], seed: Mapping[Node, Node], of_kinks: Sequence[Node]
    ) -> list[Node]:
        # As in the kernels of values, event functions and kinks precede the new values of events.
        found = [*(changes.get(row.watched, dag.zero) for row in rows), *of_kinks]
        for row, impact in zip(rows, impacts, strict=True):
            found += [changes.get(i, dag.zero) for i in row.new_values]
            if impact is not None and row.restitution is not None:
                found += impact.tangent(solved, seed, changes.get(row.restitution, dag.zero))
        return found

    directions = zip(along, equations.sensitivities, strict=True)
    # The last states are algebraic unknowns, which have no rates.
    n_rated = len(equations.states) - equations.n_algebraic
    # Instead, the motion contains derivatives of their residuals, which follow all other results.
    residuals = (motion.rates.get(i, dag.zero) for i in range(n_rated, len(equations.states)))
    kernels = {
        "events": [
            *(values[row.watched] for row in rows),
            *kinks,
            *solved.substitute(equations.pieces),
            *found_ranges.quantities,
        ],
        "jumps": jumps,
        "event_sensitivity": [
            node
            for row, own in directions
            for node in derivatives(row.outputs, own.seed, tangents(looked_at, own.seed))
        ],
        "event_rates": [
            *derivatives(motion.outputs, seed_of_motion, tangents(kinks, seed_of_motion)),
            *residuals,
        ],
        "event_ranges": [*found_ranges.results],
    }
    return kernels, found_ranges


def _along_the_motion(equations: Equations) -> Mapping[Node, Node]:
    """Return the time derivatives of states (symbols), of inputs (from the scene) and of time."""
    if equations.motion is not None:
        return equations.motion.seed
    dag = equations.dag
    time = dag.symbol(TIME, 0)
    inputs = zip(
        equations.input_symbols, tangents(equations.input_values, {time: dag.one}), strict=True
    )
    seed = {state.symbol: dag.symbol(STATE_RATE, i) for i, state in enumerate(equations.states)}
    return seed | {s: d for s, d in inputs if not d.is_zero} | {time: dag.one}
