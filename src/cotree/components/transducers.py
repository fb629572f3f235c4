"""Transducers: components that couple several graphs, with a port in each.

A mechanical port may also act on a multibody system: on a joint, or along a line.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cotree.components.component import optional, value
from cotree.components.law import Law, argument
from cotree.components.ports import ideal_gyration, scalar
from cotree.components.terminal import Kind, active_port

if TYPE_CHECKING:
    from cotree.components.component import Adapted, Component, Field, Given, Nodes


# Only the winding has losses; electromechanical conversion is lossless.
_LOSS = Law(lambda through_electrical, resistance: resistance * through_electrical**2)


def _motor(name: str, doc: str, domain: str, port: str, constant: Field) -> Component:
    """Build a lossless machine with v = R i + L di/dt + K w and a torque or force K i."""
    moving = f"across_{port}"
    voltage = Law.taking(
        ("through", "resistance", "constant", moving), lambda i, r, k, w: r * i + k * w
    )
    current = Law.taking(
        ("across", "resistance", "constant", moving), lambda v, r, k, w: (v - k * w) / r
    )
    # The coupling with the moving part makes the equations unsymmetric: the port is not passive.
    resistive = active_port(
        "electrical", Kind.DISSIPATOR, "electrical", across=voltage, through=current
    )
    winding = replace(
        resistive, kind=Kind.THROUGH_STORAGE, through=None, storage=argument("inductance")
    )
    effort = Law(lambda constant, through_electrical: -constant * through_electrical)
    output = active_port(domain, Kind.THROUGH_SOURCE, port, through=effort)
    fields = (
        value("resistance", "ohm", "resistance of the winding"),
        optional("inductance", "H", "inductance of the winding; zero if omitted", None, "positive"),
        constant,
    )
    made = scalar(name, doc, fields, winding, output, loss=_LOSS)

    def adapt(edge: str, nodes: Nodes, given: Given) -> Adapted:
        """Replace the winding by a resistance if the scene gives no inductance."""
        if "inductance" in given:
            return made, nodes, given
        return replace(made, ports=(resistive, output)), nodes, given

    return replace(made, adapt=adapt)


DC_MOTOR = _motor(
    "dc_motor",
    "direct current motor or generator with a constant field",
    "rotational",
    "shaft",
    value("constant", "N m/A", "motor constant: torque per current, and voltage per speed", ""),
)

VOICE_COIL = _motor(
    "voice_coil",
    "linear motor or generator with a constant field: a coil in the gap of a magnet",
    "translational",
    "coil",
    value("constant", "N/A", "motor constant: force per current, and voltage per velocity", ""),
)

HYDRAULIC_CYLINDER = ideal_gyration(
    "hydraulic_cylinder",
    "ideal cylinder: pressure times area pushes the rod out",
    value("area", "m^2", "area of the piston"),
    ("hydraulic", "chamber"),
    ("translational", "rod"),
)

HYDRAULIC_MACHINE = ideal_gyration(
    "hydraulic_machine",
    "ideal pump or motor: pressure times displacement turns the shaft",
    value("displacement", "m^3/rad", "volume per radian", ""),
    ("hydraulic", "chamber"),
    ("rotational", "shaft"),
)


# The reluctances of iron and air gap add up; that of the air gap is proportional to its length.
def _inductance(stretch: Any, inductance: Any, gap: Any, leakage: Any) -> Any:
    return leakage + inductance / (1 + stretch / gap)


def _slope(stretch: Any, inductance: Any, gap: Any) -> Any:
    return -inductance / (gap * (1 + stretch / gap) ** 2)


def _solenoid_voltage(
    through: Any,
    resistance: Any,
    stretch_plunger: Any,
    across_plunger: Any,
    inductance: Any,
    gap: Any,
) -> Any:
    # v = R i + d(L(s) i)/dt. The storage provides L di/dt, this law R i + L'(s) s_dot i.
    induced = _slope(stretch_plunger, inductance, gap) * across_plunger
    return resistance * through + induced * through


SOLENOID = scalar(
    "solenoid",
    "coil that pulls a plunger in: inductance L(s) = leakage + inductance / (1 + s/gap)",
    (
        value("resistance", "ohm", "resistance of the coil"),
        value("inductance", "H", "inductance with closed gap (s = 0), without the leakage"),
        value("gap", "m", "opening at which the inductance is halved"),
        optional("leakage", "H", "leakage inductance, independent of position", 0.0, "nonnegative"),
    ),
    active_port(
        "electrical",
        Kind.THROUGH_STORAGE,
        "electrical",
        across=Law(_solenoid_voltage),
        storage=Law.taking(("stretch_plunger", "inductance", "gap", "leakage"), _inductance),
    ),
    # Through is minus the derivative of the coenergy L(s) i^2 / 2 with respect to s.
    active_port(
        "translational",
        Kind.THROUGH_SOURCE,
        "plunger",
        through=Law(
            lambda stretch, through_electrical, inductance, gap: (
                -0.5 * through_electrical**2 * _slope(stretch, inductance, gap)
            )
        ),
    ),
    loss=_LOSS,
)

COMPONENTS = (DC_MOTOR, VOICE_COIL, HYDRAULIC_CYLINDER, HYDRAULIC_MACHINE, SOLENOID)
