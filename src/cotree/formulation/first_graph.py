"""The first graph: from a scene and its trees to the equations of motion, step by step.

The steps are: bind the components, lump rigid clusters, form f-circuits (across variables),
terminal equations (loads), and f-cutsets (through variables) projected on the motion spaces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.components import FreeRotation, Role
from cotree.dag.derivative import tangents
from cotree.dag.nodes import PARAMETER, Dag, Node, kinds_in, substitute
from cotree.dag.vector import quaternion_rates
from cotree.equations import EventRow, Guard, State
from cotree.errors import ExpressionError, SceneError, nearest
from cotree.formulation.across import Motion, View, accelerate, move
from cotree.formulation.clusters import lump
from cotree.formulation.constraints import (
    Constraints,
    along_speeds,
    form_constraints,
    multiplier_loads,
    sizes_along_speeds,
)
from cotree.formulation.elements import actions
from cotree.formulation.frames import choose_frames
from cotree.formulation.initial_states import StartValue, body_starts, start_conditions
from cotree.formulation.laws import Applied, applied_laws
from cotree.formulation.mass_matrix import (
    LateMatrix,
    augmented_mass_matrix,
    check_inertia,
    is_deep,
    met_where_idle,
    safe_pivots,
)
from cotree.formulation.networks.attached import Attached, attach_network
from cotree.formulation.outputs import Observer, Outputs, form_outputs, observe_motion
from cotree.formulation.system import System, bind
from cotree.formulation.through import Balance, Loads, balance, loads_of, mass_matrix
from cotree.naming import split_name
from cotree.scene.events import Event, ModePart
from cotree.scene.expressions import entries
from cotree.scene.graphs import Trees, motion_spaces

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cotree.formulation.measures import Measure
    from cotree.formulation.networks.couplings import Coupling
    from cotree.formulation.networks.network import Network
    from cotree.linear.tree_elimination import TreeLink
    from cotree.scene.description import SceneDescription


def bind_events(
    scene: SceneDescription, system: System, states: Sequence[State]
) -> tuple[EventRow, ...]:
    """Bind the events of a scene to the modes and states that they change."""
    places = {state.name: i for i, state in enumerate(states)}
    speeds = {speed.name: places[speed.name] for speed in system.speeds}
    rows: list[EventRow] = []
    # As in ``event_expressions``: outputs, conditions, then new values and restitution by event.
    place, result = len(scene.outputs) + len(scene.events), 0
    for i, event in enumerate(scene.events.values(), start=len(scene.outputs)):
        _check(event, system, states, places, speeds)
        has_impact = event.restitution is not None
        targets = tuple(places[target] for target in event.set)
        new_values = range(place, place + len(targets))
        if has_impact:
            # Constraints transmit an impact, so it may change all speeds of the mechanism.
            targets += tuple(speeds.values())
        rows.append(
            EventRow(
                event.name,
                event.direction,
                event.is_terminal,
                targets,
                i,
                new_values,
                new_values.stop if has_impact else None,
                range(result, result + len(targets)),
                event.is_jump,
                event.is_jump and any(target in event.when.names for target in event.set),
                int(event.part),
                event.part is ModePart.REBOUND,
                event.part is ModePart.FORCE,
                event.part is ModePart.SLIP and len(targets) > 2,
            )
        )
        # The coefficient of restitution follows the new values.
        place, result = new_values.stop + has_impact, result + len(targets)
    return tuple(rows)


def _check(
    event: Event,
    system: System,
    states: Sequence[State],
    places: Mapping[str, int],
    speeds: Collection[str],
) -> None:
    if event.restitution is not None and not speeds:
        raise SceneError(f"event '{event.name}' has an impact, but the scene has no moving mass")
    for target in event.set:
        whose = f"event '{event.name}' sets '{target}'"
        if target in system.inputs:
            raise SceneError(
                f"{whose}, an input, which is given from outside: set a mode, and use the "
                "mode wherever the input is used"
            )
        if target not in places:
            known = [state.name for state in states if not state.is_algebraic]
            raise SceneError(
                f"{whose}, which is neither a state nor a mode{nearest(target, known)}"
            )
        if states[places[target]].is_algebraic:
            raise SceneError(
                f"{whose}, an algebraic unknown, which the equations determine at each "
                "instant: set a state that has a rate, or a mode that these equations use"
            )
        if event.restitution is not None and target in speeds:
            raise SceneError(
                f"{whose}, a speed, but its impact changes all speeds: remove one of the two"
            )


def started(
    states: Sequence[State], jumps: Mapping[str, Node], system: System
) -> tuple[State, ...]:
    """Return the initial modes of jumps: the signs of their expressions at the initial states.

    The time is zero. Modes that depend on more than parameters are set to zero here;
    :func:`cotree.model.start.find_start` determines them.
    """
    if not jumps:
        return tuple(states)
    of_time = dict(zip(system.inputs.values(), system.input_values, strict=True))
    known = {state.symbol: state.initial for state in states} | {system.time: system.dag.zero}
    for state in states:
        if state.name in jumps:
            # Evaluate in this order, since a jump may depend on the modes of earlier jumps.
            known[state.symbol] = _at_start(jumps[state.name], of_time, known)
    return tuple(
        replace(state, initial=known[state.symbol]) if state.name in jumps else state
        for state in states
    )


def _at_start(value: Node, of_time: Mapping[Node, Node], known: Mapping[Node, Node]) -> Node:
    try:
        (found,) = substitute(substitute([value], of_time), known)
    except (ArithmeticError, ValueError):  # later checks report the error
        return value.dag.zero
    is_known = kinds_in([found]) <= {PARAMETER}
    return found if is_known else value.dag.zero


@dataclass(frozen=True, repr=False)
class FirstGraph:
    """The governing equations of a scene, formed from through and across variables."""

    scene: SceneDescription  # the scene from which the equations were formed
    #: Across and through variables in terms of ``unknowns``: accelerations and multipliers.
    motion: Motion
    loads: Loads
    view: View
    balance: Balance
    #: Through variables along measures: first those of laws, then the multipliers.
    applied: tuple[Applied, ...]
    constraints: Constraints  # constraints of the chords
    holdings: tuple[HoldingRow, ...]  # equations for the multipliers of dry friction and stops
    conditions: tuple[StartValue, ...]  # initial values of variables that are not states
    measured: Mapping[Node, Node]  # values of the across variables that are symbols in fields
    reactions: frozenset[Node]  # symbols in ``measured`` that represent accelerations or reactions
    unknowns: tuple[Node, ...]  # symbols of the accelerations, then of the multipliers
    matrix: Sequence[Sequence[Node]]  # mass matrix, bordered by the constraint Jacobian
    forcing: tuple[Node, ...]  # right-hand side of ``matrix @ unknowns = forcing``
    is_safe: tuple[bool, ...]  # whether each pivot of the matrix is positive at every state
    guards: tuple[Guard, ...]  # conditions that parameter values must satisfy
    states: tuple[State, ...]  # coordinates, then their rates
    rates: tuple[Node, ...]  # time derivatives of the states
    outputs: Outputs
    network: Network | None = None  # scalar networks; their states follow the speeds
    couplings: tuple[Coupling, ...] = ()  # ports through which networks act on the multibody system
    #: Whether storages of the networks, coupled to joints, contribute to the mass matrix.
    has_far_inertia: bool = False
    #: Links of the tree if the unknowns are eliminated along it; see :func:`tree_links`.
    links: tuple[TreeLink, ...] = ()
    events: tuple[EventRow, ...] = ()

    @property
    def system(self) -> System:
        """The scene with its fields bound to nodes."""
        return self.motion.system


def form_first_graph(
    scene: SceneDescription, trees: Trees, own_axes: Collection[int] = (), baumgarte: float = 0.0
) -> FirstGraph:
    """Form the governing equations of a scene in the coordinates of its branches.

    Vectors of the clusters ``own_axes`` are resolved in their own axes
    (:mod:`cotree.formulation.frames`). ``baumgarte`` is the rate b, [1/s]: c'' + 2 b c' + b^2 c = 0
    replaces c'' = 0 for a constraint c (J. Baumgarte, Comput. Methods Appl. Mech. Eng. 1 (1972) 1).
    If b is zero, only projection limits c.

    Raise ModelError for invalid expressions and fields, ParameterError if a constraint that no
    motion can affect is violated, SingularSystemError if a coordinate moves no inertia.
    """
    dag, whole = Dag(), scene
    if any(edge.component.role is Role.NETWORK for edge in scene.edges.values()):
        from cotree.hybrid.unilateral import with_friction, with_stops
        from cotree.scene.joint_friction import with_joint_friction

        whole = with_stops(with_friction(with_joint_friction(scene)))
    scene = whole.mechanics
    # The joints determine the initial positions of bodies in the tree, as functions of parameters.
    starts = body_starts(scene, trees, motion_spaces(scene).of, dag)
    edges = [edge for edge in whole.edges.values() if edge.component.role is Role.NETWORK]
    others = frozenset(name for edge in edges for name in (edge.name, *edge.nodes))
    system = bind(scene, trees, dag, starts, names=others)
    clusters = lump(system)
    motion = move(system, clusters, choose_frames(system, clusters, own_axes))
    # Form the f-circuits (Eq. (2)) twice: with zero accelerations for the right-hand side, and with
    # symbolic accelerations for balances and outputs.
    still = View(motion, accelerate(motion, [dag.zero] * len(system.speeds)))
    accelerations = tuple(v.acceleration for v in system.speeds)
    view = View(motion, accelerate(motion, accelerations))
    # Networks come before the loads, since transducers act on the mechanism.
    attached = attach_network(whole, view)
    network, observed = attached.network, attached.observed
    # Terminal equations (Eq. (3)) of laws that depend only on positions and velocities.
    laws = [*applied_laws(motion, still), *attached.loads]
    loads = loads_of(motion, actions(motion)).plus(multiplier_loads(laws))
    # Each chord closes an f-circuit, whose across variables along the reaction space are zero.
    constraints, idle = form_constraints(motion, still, baumgarte)
    idle_guards = met_where_idle(idle, still)
    holdings = form_holdings(motion, still, attached)

    def form_mass() -> Sequence[Sequence[Node]]:
        own = mass_matrix(motion, loads) if trees.is_one else augmented_mass_matrix(motion)
        mass = attached.with_inertia(own, motion)
        check_inertia(system, mass, constraints.gradient)
        return mass

    # Elimination along the tree cannot include inertias of storages that are coupled to joints.
    may_wait = trees.is_one and not attached.slopes and is_deep(motion)
    mass = [] if may_wait else form_mass()
    # f-cutsets, projected on the motion spaces (Eqs. (1) and (5)), have the residual M v' - f - G^T
    # lambda, which is -f at zero accelerations and multipliers.
    at_rest = balance(motion, loads, still.across)
    applied = (*laws, *constraints.applied)
    is_safe, pivot_guards = safe_pivots(system, clusters)
    # The same balance with symbolic unknowns; outputs read reactions from it.
    loaded = loads.plus(multiplier_loads(constraints.applied))
    balanced = balance(motion, loaded, view.across)
    owners = {*whole.nodes, *whole.edges}
    names = network.names if network else None
    observer = Observer(view, loaded, balanced, applied, observed, owners, names)
    measured, reactions = _measured(observer, attached.reacting, whole)
    known = dict(zip(measured, substitute(list(measured.values()), measured), strict=True))
    holdings = tuple(
        replace(
            row,
            column=tuple(substitute(row.column, known)),
            gradient=tuple(substitute(row.gradient, known)),
        )
        for row in holdings
    )
    states = (*_states(scene, system), *system.modes, *(network.states if network else ()))
    outputs = form_outputs(observer, scene)
    return FirstGraph(
        scene=whole,
        motion=motion,
        loads=loaded,
        view=view,
        balance=balanced,
        applied=applied,
        constraints=constraints,
        holdings=holdings,
        conditions=start_conditions(scene, motion, still),
        measured=measured,
        reactions=reactions,
        unknowns=(*accelerations, *constraints.multipliers, *(row.multiplier for row in holdings)),
        # With positive pivots, every coordinate moves inertia: the matrix is only formed if needed.
        matrix=LateMatrix(
            lambda: _bordered(form_mass(), constraints, holdings, dag),
            len(is_safe),
            _border(constraints, holdings, dag),
        )
        if may_wait and all(is_safe)
        else _bordered(mass or form_mass(), constraints, holdings, dag),
        forcing=(
            *(-row for row in at_rest.residual),
            *constraints.biases,
            *(row.jump - row.share * row.bias for row in holdings),
        ),
        # Multipliers have zeros on the diagonal, so their pivots are not positive.
        is_safe=(*is_safe, *(False for _ in (*constraints.rows, *holdings))),
        guards=(*system.guards, *pivot_guards, *idle_guards, *(network.guards if network else ())),
        states=started(states, outputs.jumps, system),
        rates=(
            *_kinematic_rates(system),
            *accelerations,
            # Modes change only at events, so their rates are zero.
            *(dag.zero for _ in system.modes),
            *(network.rate_values if network else ()),
        ),
        outputs=outputs,
        network=network,
        couplings=tuple(attached.couplings.values()),
        has_far_inertia=bool(attached.slopes),
        events=bind_events(whole, system, states),
    )


def _measured(
    observer: Observer, reacting: Collection[str], scene: SceneDescription
) -> tuple[dict[Node, Node], frozenset[Node]]:
    """Return the values of across variables in fields; also symbols that need accelerations."""
    motion, found = observer.motion, {}
    symbols = motion.system.signals.gathered()
    for name, symbol in symbols.items():
        value = observer.networks.get(name)
        if value is None:
            # A variable in a field affects the motion, so an angle must not jump.
            value = observe_motion(motion, name, is_acting=True)
        if value is not None:
            found[symbol] = value
        elif name not in reacting:
            raise ExpressionError(
                f"{_place(name, scene)} uses '{name}', which is not a coordinate, "
                "position, velocity or orientation of this scene; accelerations and reactions can "
                "be used in fields of friction and dampers on joints only"
            )
    late = [name for name, symbol in symbols.items() if symbol not in found]
    # Friction forces inside reactions are symbols: replace them by their values.
    values = substitute([observer.value(name) for name in late], found)
    found |= {symbols[name]: value for name, value in zip(late, values, strict=True)}
    return found, frozenset(symbols[name] for name in late)


def _place(name: str, scene: SceneDescription) -> str:
    """Describe the field or output that uses a name, for error messages."""
    values = (value for edge in scene.edges.values() for value in edge.fields.values())
    fields = (item for value in values for item in entries(value))
    users = (item.where for item in (*fields, *scene.outputs.values()) if name in item.names)
    return next(users, "a field")


def tree_links(first: FirstGraph) -> tuple[TreeLink, ...]:
    """Return the links of the tree; none if pivots may vanish or the trees differ."""
    n = len(first.system.speeds)
    # Articulated inertias require one parent for each body, and no inertia outside the tree.
    is_tree = first.system.trees.is_one and not first.has_far_inertia
    if not (is_tree and all(first.is_safe[:n])):
        return ()
    from cotree.linear.tree_elimination import TreeLink

    links = []
    for geometry in first.motion.geometry:
        branch = geometry.branch
        inertia = first.loads.inertias[branch.child]
        links.append(
            TreeLink(
                branch.parent,
                tuple(speed.index for speed in branch.speeds),
                geometry.turning,
                geometry.shifting,
                geometry.offset,
                first.motion.frames.steps[branch.child],
                None if inertia is None else (inertia.mass, inertia.moment, inertia.tensor),
            )
        )
    return tuple(links)


@dataclass(frozen=True)
class HoldingRow:
    """The equation for the multiplier of a unilateral constraint on the mechanism.

    The equation is s (J v' + b) - jump = (1 - s) multiplier, with ``share`` s. While the edge holds
    (s = 1), the relative acceleration is zero; in all other modes, the multiplier is zero.
    """

    name: str  # name of the force
    multiplier: Node  # symbol of the multiplier
    share: Node  # s: one while the edge sticks or is closed, otherwise zero
    jump: Node  # prescribed change of the rate in impacts, otherwise zero
    measure: Measure  # measure along which the force acts
    gradient: tuple[Node, ...]  # J: derivatives of the measure's rate with respect to the speeds
    column: tuple[Node, ...]  # generalised forces per unit of the multiplier
    #: While the edge holds: for each entry of the gradient, the sum of its squared terms.
    sizes: tuple[Node, ...]
    bias: Node  # b: acceleration of the measure at zero coordinate accelerations


def form_holdings(motion: Motion, view: View, attached: Attached) -> tuple[HoldingRow, ...]:
    """Form the equations of unilateral multipliers; ``view`` has zero accelerations."""
    if not attached.holding:
        return ()
    from cotree.formulation.networks.couplings import through_name

    dag, found = motion.system.dag, []
    gradients = {}
    for name, coupling in attached.couplings.items():
        with dag.labelled(f"force of {coupling.port.edge.name}"):
            gradients[name] = along_speeds(motion, coupling.pull)
    forces = [attached.observed[through_name(own.port)] for own in attached.couplings.values()]
    for own in attached.holding:
        coupling = attached.couplings[own.port]
        column = [dag.zero] * len(motion.system.speeds)
        with dag.labelled(f"force of {coupling.port.edge.name}"):
            slopes = tangents(forces, {own.multiplier: dag.one})
            for gradient, slope in zip(gradients.values(), slopes, strict=True):
                column = [c + slope * entry for c, entry in zip(column, gradient, strict=True)]
            sizes = tuple(own.share * s for s in sizes_along_speeds(motion, coupling.pull))
            bias = coupling.measure.acceleration(view)
        found.append(
            HoldingRow(
                own.port,
                own.multiplier,
                own.share,
                own.jump,
                coupling.measure,
                tuple(gradients[own.port]),
                tuple(column),
                sizes,
                bias,
            )
        )
    return tuple(found)


def _bordered(
    mass: Sequence[Sequence[Node]],
    constraints: Constraints,
    holdings: Sequence[HoldingRow],
    dag: Dag,
) -> tuple[tuple[Node, ...], ...]:
    """Return the mass matrix M bordered by the constraint matrix G: [M, -G^T; -G, 0].

    Unilateral constraints add the rows s J with -(1 - s) on the diagonal, and columns.
    """
    border = _border(constraints, holdings, dag)
    # Sensitivity graphs and L D L^T require a symmetric matrix, hence these signs.
    n = len(constraints.gradient)
    upper = [
        (*row, *(b[i] for b in border[:n]), *(own.column[i] for own in holdings))
        for i, row in enumerate(mass)
    ]
    return (*upper, *border)


def _border(
    constraints: Constraints, holdings: Sequence[HoldingRow], dag: Dag
) -> list[tuple[Node, ...]]:
    """Return the rows of constraints and unilateral multipliers below the mass matrix."""
    n_held, n = len(constraints.gradient), len(constraints.gradient) + len(holdings)
    zeros = [dag.zero] * n
    rows = [(*(-entry for entry in row), *zeros) for row in constraints.gradient]
    for i, own in enumerate(holdings):
        diagonal = [own.share - 1.0 if j == n_held + i else dag.zero for j in range(n)]
        rows.append((*(own.share * entry for entry in own.gradient), *diagonal))
    return rows


def _states(scene: SceneDescription, system: System) -> tuple[State, ...]:
    coordinates = [State(c.name, c.unit, c.symbol, c.initial) for c in system.coordinates]
    speeds = [State(v.name, v.unit, v.symbol, v.initial) for v in system.speeds]
    return tuple(
        replace(state, is_given=_is_given(scene, state.name)) for state in (*coordinates, *speeds)
    )


def _is_given(scene: SceneDescription, name: str) -> bool:
    edge, short = split_name(name)
    initial = scene.edges[edge].initial
    # A scene sets either all four entries of a quaternion or none.
    turn = {"q0", "q1", "q2", "q3"}
    if short in turn:
        return not (turn | {"rotation"}).isdisjoint(initial)
    return short in initial


def _kinematic_rates(system: System) -> tuple[Node, ...]:
    rates: list[Node] = []
    for steps in system.steps.values():
        for step in steps:
            speeds = [speed.symbol for speed in step.speeds]
            if isinstance(step.kind, FreeRotation):
                # q' = q o (0, omega) / 2 yields the rates of four coordinates from three speeds.
                rates += quaternion_rates([c.symbol for c in step.coordinates], speeds)
            else:
                rates += speeds
    return tuple(rates)
