"""Transducer ports that act on a multibody system: on a joint, or between two nodes.

The across variable of such a port is the rate of a measure, as for a chord parallel to the joint.
The through variable acts along the measure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Kind
from cotree.dag import vector
from cotree.domains import DOMAINS
from cotree.errors import SceneError, nearest
from cotree.formulation.contact_measures import touching
from cotree.formulation.laws import JointElement, joint_measure
from cotree.formulation.measures import Distance, Ends, Pull, Spin, carried_by, chord_ends

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Node
    from cotree.formulation.across import Motion, View
    from cotree.formulation.measures import Measure
    from cotree.scene.networks import Port


@dataclass(frozen=True)
class Coupling:
    """A port of a network that acts on a multibody system."""

    port: Port
    measure: Measure  # measure along which the port acts
    #: Time integral of the across variable, the across variable, and its time derivative.
    value: Node
    rate: Node
    acceleration: Node
    pull: Pull  # wrenches and efforts per unit of the port's through variable


def form_couplings(ports: Mapping[str, Port], view: View) -> dict[str, Coupling]:
    """Return the couplings of all transducers, with symbolic accelerations of the mechanism."""
    found = {}
    for name, port in ports.items():
        if port.is_coupling:
            measure = _measure(port, view.motion)
            found[name] = Coupling(
                port,
                measure,
                measure.value(view),
                measure.rate(view),
                # Accelerations are symbols: storages coupled to the joint need their coefficients.
                measure.acceleration(view),
                measure.pull(view),
            )
    return found


def _measure(port: Port, motion: Motion) -> Measure:
    touch = port.terminal.touch
    if touch is not None and touch.quantity.startswith("spin"):
        ends = chord_ends(motion, motion.system.edges[port.ends.acts_on[0]])
        axis = vector.identity(motion.system.dag)[int(touch.quantity[-1]) - 1]
        return Spin(ends, carried_by(motion, ends, 0, axis))
    if touch is not None:
        _check_nodes(port, motion)
        return touching(motion, motion.system.edges[port.edge.name], touch)
    # Between two nodes, the port acts along the line that connects the nodes.
    if len(port.ends.acts_on) == 2:
        return _line(port, motion)
    turns = port.terminal.domain == "rotational"
    element = JointElement(port.edge.name, port.edge.component.name, turns)
    return joint_measure(element, port.ends.acts_on[0], motion)


def _check_nodes(port: Port, motion: Motion) -> None:
    points = motion.clusters.points
    for node in port.ends.acts_on:
        if node not in points:
            raise SceneError(
                f"edge '{port.edge.name}' acts between '{port.ends.acts_on[0]}' and "
                f"'{port.ends.acts_on[1]}', but no multibody component has node '{node}'"
                f"{nearest(node, points)}"
            )


def _line(port: Port, motion: Motion) -> Measure:
    _check_nodes(port, motion)
    if port.kind is Kind.ACROSS_SOURCE:
        raise SceneError(
            f"edge '{port.edge.name}' prescribes a velocity along a line; use a distance "
            'between its nodes with length = "...", an expression of t whose rate is that '
            "velocity"
        )
    if port.terminal.domain == "rotational":
        raise SceneError(
            f"edge '{port.edge.name}' rotates, so that it cannot act along a line: name a "
            'revolute joint as joint = "..."'
        )
    first, second = (motion.clusters.points[node] for node in port.ends.acts_on)
    # Across times through is power, as required: the rate of the distance times the force.
    return Distance(Ends.of(motion.clusters, first, second))


def through_name(port: Port) -> str:
    """Return the name of a port's through variable in scenes."""
    return f"{port.name}.{DOMAINS[port.terminal.domain].through_symbol}"
