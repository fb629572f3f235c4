"""The scalar networks of a scene, attached to its multibody system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.dag.derivative import tangents
from cotree.dag.traverse import symbols_in
from cotree.formulation.constraints import along_speeds
from cotree.formulation.networks.couplings import coupling_loads, form_couplings, through_name
from cotree.formulation.networks.network import form_network
from cotree.scene.events import event_expressions
from cotree.scene.networks import scalar_ports

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.formulation.across import Motion
    from cotree.formulation.laws import Applied
    from cotree.formulation.networks.couplings import Coupling
    from cotree.formulation.networks.network import Network
    from cotree.formulation.system import System
    from cotree.formulation.views import View
    from cotree.scene.description import SceneDescription


@dataclass(frozen=True)
class Attached:
    """Networks beside a multibody system.

    Attributes
    ----------
    network : Network or None
        The networks; None where the scene has none.
    observed : mapping of str to Node
        What names of the networks in outputs and fields stand for.
    couplings : mapping of str to Coupling
        The ports that act on the multibody system.
    throughs : mapping of str to Node
        The symbols that stand for their through variables.
    slopes : mapping of str to mapping of int to Node
        How through variables change with accelerations, by their number: inertia of storages
        that are tied to joints.
    reacting : frozenset of str
        Names that only fields of dry friction on the mechanism use: they may be reactions.
    """

    network: Network | None
    observed: Mapping[str, Node]
    couplings: Mapping[str, Coupling]
    throughs: Mapping[str, Node]
    slopes: Mapping[str, Mapping[int, Node]]
    reacting: frozenset[str] = frozenset()

    @property
    def loads(self) -> list[Applied]:
        """Put the through variables of the couplings on the multibody system."""
        return coupling_loads(self.couplings, self.throughs)

    def with_inertia(
        self, mass: Sequence[Sequence[Node]], motion: Motion
    ) -> tuple[tuple[Node, ...], ...]:
        """Add to a mass matrix the storages that are tied to joints."""
        rows = [list(row) for row in mass]
        for name, slopes in self.slopes.items():
            pull = along_speeds(motion, self.couplings[name].pull)
            for i, gradient in enumerate(pull):
                for j, slope in slopes.items():
                    # A through variable tau = s_j v_j' + ... acts along its pull p: the balance
                    # gains p_i s_j.
                    rows[i][j] = rows[i][j] + gradient * slope
        return tuple(tuple(row) for row in rows)


def attach_network(scene: SceneDescription, view: View) -> Attached:
    """Form the scalar networks of a scene, where it has any.

    Parameters
    ----------
    scene : SceneDescription
        The scene.
    view : View
        Its multibody system, at the symbols of its accelerations.
    """
    # Purely multibody scenes form no network at all.
    if not any(edge.component.role is Role.NETWORK for edge in scene.edges.values()):
        return Attached(None, {}, {}, {}, {})
    system = view.motion.system
    couplings = form_couplings(scalar_ports(scene), view)
    throughs = {
        name: system.signals.node(through_name(coupling.port))
        for name, coupling in couplings.items()
    }
    observing = (*scene.outputs.values(), *event_expressions(scene.events.values()))
    # Networks are formed as far as outputs, events and fields of the mechanism ask for them.
    names = {name for expression in observing for name in expression.names}
    before = system.signals.measured
    wanted = sorted(names.union(before))
    network, observed = form_network(scene, system, couplings, wanted)
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


def _slopes(through: Node, system: System) -> dict[int, Node]:
    """Differentiate a through variable by the accelerations."""
    found = {}
    occurring = set(symbols_in([through]))
    for speed in system.speeds:
        # Only storages that are tied to joints react to accelerations: as inertia.
        if speed.acceleration not in occurring:
            continue
        # Through variables are affine in accelerations, so that the slope goes into the mass matrix
        # and the rest is a load.
        (slope,) = tangents([through], {speed.acceleration: through.dag.one})
        if not slope.is_zero:
            found[speed.index] = slope
    return found
