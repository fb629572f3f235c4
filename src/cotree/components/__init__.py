"""Component types by name, with their terminal equations and the fields that scenes set."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from cotree.components.component import (
    Acts,
    Component,
    Field,
    Freedom,
    FreeRotation,
    MotionStep,
    Role,
    Shape,
)
from cotree.components.law import Law
from cotree.components.terminal import Integral, Kind, Terminal, content_of, integral_of
from cotree.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Callable

#: Names of the built-in types by module; each module defines its types in ``COMPONENTS``.
FAMILIES: Mapping[str, str] = {
    "multibody": "rigid_body arm weld revolute prismatic cylindrical universal spherical planar "
    "free screw distance slot knife_edge rolling_disc rolling_ellipsoid gear constraint spring "
    "damper force torque line_force bushing",
    "contact": "translational_rigid_stop rotational_rigid_stop contact rigid_contact",
    "electrical": "resistor capacitor nonlinear_capacitor three_terminal_capacitor inductor "
    "nonlinear_inductor switch transformer gyrator vcvs vccs ccvs cccs ideal_op_amp nullor "
    "voltage_source current_source sine_voltage sine_current pulse_voltage pulse_current "
    "piecewise_voltage piecewise_current coupled_inductors",
    "semiconductors": "diode bjt_npn bjt_pnp mosfet_n mosfet_p",
    "hydraulic": "hydraulic_resistor orifice valve tank accumulator inertance pipe pump "
    "pressure_source flow_source",
    "thermal": "heat_capacitor thermal_resistor convection radiation temperature_source "
    "heat_source",
    "mechanical": "translational_mass translational_spring translational_damper "
    "translational_stop translational_backlash translational_friction force_source "
    "velocity_source lever rotational_inertia rotational_spring rotational_damper "
    "rotational_stop rotational_backlash rotational_friction torque_source speed_source shaft "
    "ideal_gear planetary_gear rack_and_pinion",
    "friction": "lossy_gear translational_dry_friction rotational_dry_friction "
    "translational_lugre rotational_lugre clutch brake translational_brake one_way_clutch",
    "chemical": "species reaction molar_flow_source concentration_source",
    "electrochemical": "open_circuit_voltage butler_volmer double_layer nernst battery_cell",
    "transducers": "dc_motor voice_coil hydraulic_cylinder hydraulic_machine solenoid",
}


class Catalogue(MutableMapping[str, Component]):
    """Component types by name. A module is imported when one of its types is first used."""

    def __init__(self) -> None:
        #: The component of each type, or the name of its module while this is not imported.
        self._rows: dict[str, Component | str] = {
            name: family for family, names in FAMILIES.items() for name in names.split()
        }

    def __contains__(self, name: object) -> bool:
        return name in self._rows

    def __getitem__(self, name: str) -> Component:
        row = self._rows[name]
        if isinstance(row, str):
            family = import_module(f"{__name__}.{row}").COMPONENTS
            # Keep types that users registered before this import.
            self._rows |= {own.name: own for own in family if self._rows.get(own.name) == row}
        found = self._rows[name]
        assert isinstance(found, Component)
        return found

    def __setitem__(self, name: str, row: Component) -> None:
        self._rows[name] = row

    def __delitem__(self, name: str) -> None:
        del self._rows[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)


#: All component types by their names in scenes.
COMPONENTS = Catalogue()


def register_component(
    name: str,
    law: Callable[..., Any] | Mapping[str, Callable[..., Any]],
    *,
    domain: str = "",
    along: str = "line",
    units: Mapping[str, str] | None = None,
    doc: str = "",
    **ports: Any,
) -> Component:
    """Register a component with a user-defined law, for all scenes made afterwards.

    Sensitivity terminal equations are derived from the law. Without ``domain`` the component is a
    force element of multibody systems, with parameters as in
    :func:`cotree.components.register.make_component`. With ``domain`` it is a component of that
    graph, with parameters as in :func:`cotree.components.register.make_network_component`.

    Parameters
    ----------
    name : str
        Name of the component type in scenes.
    law : callable, or mapping of str to callable
        Function of SymPy symbols that returns the terminal equation, or one such function for each
        port by name. Argument names identify variables; all others become fields.
    domain : str
        The physical domain of a scalar component; empty for a force element.
    along : {'line', 'velocity'}
        Direction along which the force of a force element acts.
    units : mapping of str to str, optional
        SI unit of each field.
    doc : str
        One line that describes the component.
    **ports
        Further options of scalar components.

    Returns
    -------
    Component
        The component, which scenes may use from now on.

    Raises
    ------
    SceneError
        If the name is that of a built-in component, or the law is invalid.

    Examples
    --------
    >>> drag = register_component("air_drag", lambda speed, c: -c * speed**2, along="velocity")
    >>> [field.name for field in drag.fields]
    ['c']
    >>> lamp = register_component(
    ...     "lamp", lambda across, k: k * across**3, domain="electrical", units={"k": "A/V^3"}
    ... )
    >>> lamp.ports[0].kind.name
    'DISSIPATOR'
    """
    from cotree.components.register import make_component, make_network_component

    if name in OWN:
        raise SceneError(f"the component '{name}' is built in: choose another name")
    if domain:
        made = make_network_component(name, law, domain=domain, units=units, doc=doc, **ports)
    elif ports or not callable(law):
        raise SceneError(f"component '{name}' has ports: give the domain of their graph")
    else:
        made = make_component(name, law, along=along, units=units, doc=doc)
    COMPONENTS[name] = made
    return made


#: Names of the built-in types, without types that users register.
OWN = frozenset(COMPONENTS)

__all__ = [
    "COMPONENTS",
    "OWN",
    "Acts",
    "Component",
    "Field",
    "FreeRotation",
    "Freedom",
    "Integral",
    "Kind",
    "Law",
    "MotionStep",
    "Role",
    "Shape",
    "Terminal",
    "content_of",
    "integral_of",
    "register_component",
]
