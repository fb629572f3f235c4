"""Scalar networks that act on a multibody system; they are formed only if a scene has any."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.dag.derivative import tangents
from cotree.dag.nodes import Node, symbols_in
from cotree.formulation.constraints import along_speeds
from cotree.formulation.laws import Applied
from cotree.formulation.outputs import observe_motion
from cotree.scene.events import event_expressions

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cotree.formulation.across import Motion, View
    from cotree.formulation.networks.couplings import Coupling
    from cotree.formulation.networks.network import Network
    from cotree.formulation.networks.unilateral_forces import Holding
    from cotree.formulation.system import System
    from cotree.scene.description import SceneDescription


@dataclass(frozen=True)
class Attached:
    """Networks and their couplings to a multibody system."""

    network: Network | None  # the networks; None if the scene has none
    observed: Mapping[str, Node]  # values of network variables used in outputs and fields
    couplings: Mapping[str, Coupling]  # ports that act on the multibody system, by name
    throughs: Mapping[str, Node]  # symbols of these ports' through variables
    #: Derivatives of these variables by index of the acceleration: the inertia of coupled storages.
    slopes: Mapping[str, Mapping[int, Node]]
    #: Names used only in fields of friction and dampers on the mechanism; they may be reactions.
    reacting: frozenset[str] = frozenset()

    @property
    def holding(self) -> tuple[Holding, ...]:
        """Friction and stops on the mechanism whose forces are multipliers."""
        return self.network.holding if self.network else ()

    @property
    def loads(self) -> list[Applied]:
        """Through variables of the couplings, as loads on the multibody system."""
        found = []
        for name, own in self.couplings.items():
            # The port absorbs the power across * through, so the mechanism receives the reaction.
            load = -self.throughs[name]
            place = own.port.edge.name, f"{name}.law"
            found.append(Applied(*place, own.measure, own.pull, load, load))
        return found

    def with_inertia(
        self, mass: Sequence[Sequence[Node]], motion: Motion
    ) -> tuple[tuple[Node, ...], ...]:
        """Add to a mass matrix the inertia of storages that are coupled to joints."""
        rows = [list(row) for row in mass]
        for name, slopes in self.slopes.items():
            pull = along_speeds(motion, self.couplings[name].pull)
            for i, gradient in enumerate(pull):
                for j, slope in slopes.items():
                    # The through variable s_j v_j' + ... acts along its pull p: add p_i s_j.
                    rows[i][j] = rows[i][j] + gradient * slope
        return tuple(tuple(row) for row in rows)


def attach_network(scene: SceneDescription, view: View) -> Attached:
    """Form a scene's scalar networks, with symbolic accelerations of the mechanism."""
    # A purely multibody scene has no networks.
    if not any(edge.component.role is Role.NETWORK for edge in scene.edges.values()):
        return Attached(None, {}, {}, {}, {})
    from cotree.formulation.networks.couplings import form_couplings, through_name
    from cotree.formulation.networks.network import form_network
    from cotree.scene.networks import scalar_ports

    system = view.motion.system
    couplings = form_couplings(scalar_ports(scene), view)
    named = set(system.signals.measured)  # network variables in fields of the mechanism
    throughs = {
        name: system.signals.node(through_name(coupling.port))
        for name, coupling in couplings.items()
    }
    observing = (*scene.outputs.values(), *event_expressions(scene.events.values()))
    # Form only the parts of networks that outputs, events and fields of the mechanism require.
    names = {name for expression in observing for name in expression.names}
    before = system.signals.measured
    wanted = sorted(names.union(before))

    def is_motion(name: str) -> bool:
        return observe_motion(view.motion, name) is not None

    form = partial(form_network, scene, system, couplings, wanted, is_motion=is_motion)
    network, observed = form(has_multipliers=True)
    if network.holding and not _is_linear(network, couplings, observed, named):
        network, observed = form(has_multipliers=False)  # the forces are algebraic unknowns instead
    reacting = frozenset(
        name
        for name in system.signals.measured
        if name not in before and system.signals.node(name) in network.of_friction
    )
    slopes = {}
    for name, coupling in couplings.items():
        own = _slopes(observed[through_name(coupling.port)], system)
        if own:
            slopes[name] = own
    return Attached(network, observed, couplings, throughs, slopes, reacting)


def _is_linear(
    network: Network,
    couplings: Mapping[str, Coupling],
    observed: Mapping[str, Node],
    named: Collection[str],
) -> bool:
    """Return whether forces on the mechanism are linear in the multipliers."""
    from cotree.formulation.networks.couplings import through_name

    multipliers = [row.multiplier for row in network.holding]
    one = multipliers[0].dag.one
    forces = [observed[through_name(coupling.port)] for coupling in couplings.values()]
    slopes = [d for symbol in multipliers for d in tangents(forces, {symbol: one})]
    # A field of the mechanism must not contain a force that depends on a multiplier.
    acting = [observed[name] for name in named if name in observed]
    return set(multipliers).isdisjoint(symbols_in([*slopes, *acting]))


def _slopes(through: Node, system: System) -> dict[int, Node]:
    """Return the derivatives of a through variable with respect to the accelerations."""
    found = {}
    occurring = set(symbols_in([through]))
    for speed in system.speeds:
        # Only storages coupled to joints depend on accelerations, as an inertia does.
        if speed.acceleration not in occurring:
            continue
        # The variable is affine in accelerations: slopes enter the mass matrix, the rest is a load.
        (slope,) = tangents([through], {speed.acceleration: through.dag.one})
        if not slope.is_zero:
            found[speed.index] = slope
    return found
