"""A method of scenes for each component that cotree comes with.

Generated from the table of components: ``pytest tests/golden --update-golden`` writes it anew.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

_Scalar = float | str | np.floating[Any] | np.integer[Any]
_Table = Mapping[str, Any]  # over an expression, or a value with its unit
_Value = _Scalar | _Table
_Vector = Sequence[_Value] | npt.NDArray[Any] | _Table
_Rotation = _Vector | Sequence[Sequence[float]]
_Inertia = _Value | _Vector | Sequence[Sequence[_Value]]
_Nodes = tuple[str, str] | list[str]
_Initial = Mapping[str, _Value | _Rotation]

class ComponentMethod:
    """The method of one component, made when it is first used."""

    type: str
    def __init__(self, type: str) -> None: ...
    def __get__(self, scene: object, owner: object = None) -> Callable[..., None]: ...

class ComponentMethods:
    """Methods that add an edge of each component: ``scene.revolute("h", "D", "B", axis=...)``.

    Fields take numbers in SI, names of parameters, expressions in quotes, and values with a unit,
    ``{"value": 35, "unit": "mm"}``.
    """

    def accumulator(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        capacity: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add an ``accumulator``: elastic volume.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.p`` and so on.
        plus, minus : str
            Its nodes.
        capacity : float, str or table, [m^3/Pa]
            Volume taken up per pressure.
        initial : mapping, optional
            Initial values of ``p``, ``q``.

        Examples
        --------
        ::

            scene.accumulator("B", "n", "ground", capacity="C")
        """

    def arm(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        vector: _Vector,
        rotation: _Rotation | None = None,
    ) -> None:
        """Add an ``arm``: a vector fixed in a body, from the first node to the second.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        vector : three of float or str, [m]
            In the first node's axes.
        rotation : three angles, or a matrix, [rad], optional
            Of the second node: roll, pitch and yaw about the first node's axes, or a matrix.

        Examples
        --------
        ::

            scene.arm("offset", "A", "C", vector=["l", 0, 0])
        """

    def battery_cell(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        open_circuit_voltage: _Value,
        capacity: _Value,
        resistance: _Value,
        resistance1: _Value | None = None,
        capacitance1: _Value | None = None,
        resistance2: _Value | None = None,
        capacitance2: _Value | None = None,
        resistance3: _Value | None = None,
        capacitance3: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``battery_cell``.

        open-circuit voltage by the state of charge, a resistance and up to three RC pairs.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.soc`` and so on.
        plus, minus : str
            Its nodes.
        open_circuit_voltage : float, str or table, [V]
            By a table or an expression of NAME.soc.
        capacity : float, str or table, [C]
            Charge from empty to full.
        resistance : float, str or table, [ohm]
            In series.
        resistance1 : float, str or table, [ohm], optional
            Of pair 1; both or none.
        capacitance1 : float, str or table, [F], optional
            Of pair 1; both or none.
        resistance2 : float, str or table, [ohm], optional
            Of pair 2; both or none.
        capacitance2 : float, str or table, [F], optional
            Of pair 2; both or none.
        resistance3 : float, str or table, [ohm], optional
            Of pair 3; both or none.
        capacitance3 : float, str or table, [F], optional
            Of pair 3; both or none.
        initial : mapping, optional
            Initial values of ``soc``, ``series.v``, ``series.i``, ``resistor1.v``,
            ``resistor1.i``, ``pair1.v``, ``pair1.i``, ``resistor2.v``, ``resistor2.i``,
            ``pair2.v``, ``pair2.i``, ``resistor3.v``, ``resistor3.i``, ``pair3.v``,
            ``pair3.i``.

        Examples
        --------
        ::

            scene.battery_cell(
                "cell",
                "p",
                "ground",
                open_circuit_voltage="3.0 + 1.1*cell.soc",
                capacity="Q",
                resistance="R0",
                resistance1="R1",
                capacitance1="C1",
                initial={"soc": 0.9},
            )
        """

    def bjt_npn(
        self,
        name: str,
        collector: str,
        base: str,
        emitter: str,
        substrate: str = ...,
        /,
        *,
        saturation_current: _Value,
        forward_gain: _Value,
        reverse_gain: _Value = 1.0,
        thermal_voltage: _Value = 0.02585,
        forward_ideality: _Value = 1.0,
        reverse_ideality: _Value = 1.0,
        forward_early_voltage: _Value | None = None,
        reverse_early_voltage: _Value | None = None,
        forward_knee_current: _Value | None = None,
        reverse_knee_current: _Value | None = None,
        be_recombination: _Value = 0.0,
        bc_recombination: _Value = 0.0,
        leakage: _Value = 0.0,
        base_resistance: _Value = 0.0,
        collector_resistance: _Value = 0.0,
        emitter_resistance: _Value = 0.0,
        be_capacitance: _Value = 0.0,
        bc_capacitance: _Value = 0.0,
        forward_transit_time: _Value = 0.0,
        reverse_transit_time: _Value = 0.0,
        substrate_capacitance: _Value = 0.0,
        be_recombination_ideality: _Value = 1.5,
        bc_recombination_ideality: _Value = 2.0,
        be_potential: _Value = 0.75,
        be_grading: _Value = 0.33,
        bc_potential: _Value = 0.75,
        bc_grading: _Value = 0.33,
        substrate_potential: _Value = 0.75,
        substrate_grading: _Value = 0.0,
        forward_share: _Value = 0.5,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``bjt_npn``: bipolar transistor after Ebers and Moll, npn.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.be.v`` and so on.
        collector, base, emitter, substrate : str
            Its nodes; substrate may be left out.
        saturation_current : float, str or table, [A]
            Of both junctions.
        forward_gain : float, str or table
            Collector current per base current.
        reverse_gain : float, str or table, default 1
            The same with collector and emitter exchanged.
        thermal_voltage : float, str or table, [V], default 0.02585
            K T / e, times an ideality factor.
        forward_ideality : float, str or table, default 1
            Factor of V forwards.
        reverse_ideality : float, str or table, default 1
            Factor of V backwards.
        forward_early_voltage : float, str or table, [V], optional
            Infinite where left out.
        reverse_early_voltage : float, str or table, [V], optional
            Infinite where left out.
        forward_knee_current : float, str or table, [A], optional
            Infinite where left out.
        reverse_knee_current : float, str or table, [A], optional
            Infinite where left out.
        be_recombination : float, str or table, [A], default 0
            Saturation current of it.
        bc_recombination : float, str or table, [A], default 0
            Saturation current of it.
        leakage : float, str or table, [S], default 0
            Beside each junction.
        base_resistance : float, str or table, [ohm], default 0
            Between terminal and junctions.
        collector_resistance : float, str or table, [ohm], default 0
            The same of the collector.
        emitter_resistance : float, str or table, [ohm], default 0
            The same of the emitter.
        be_capacitance : float, str or table, [F], default 0
            Of its charge at no voltage.
        bc_capacitance : float, str or table, [F], default 0
            Of its charge at no voltage.
        forward_transit_time : float, str or table, [s], default 0
            Charge per current forwards.
        reverse_transit_time : float, str or table, [s], default 0
            Charge per current backwards.
        substrate_capacitance : float, str or table, [F], default 0
            Of its charge at no voltage.
        be_recombination_ideality : float, str or table, default 1.5
            Factor of V for it.
        bc_recombination_ideality : float, str or table, default 2
            Factor of V for it.
        be_potential : float, str or table, [V], default 0.75
            Built in.
        be_grading : float, str or table, default 0.33
            Exponent of the doping.
        bc_potential : float, str or table, [V], default 0.75
            Built in.
        bc_grading : float, str or table, default 0.33
            Exponent of the doping.
        substrate_potential : float, str or table, [V], default 0.75
            Built in.
        substrate_grading : float, str or table, default 0
            Exponent of the doping.
        forward_share : float, str or table, default 0.5
            Of the potential built in, where the capacitance goes on straight.
        initial : mapping, optional
            Initial values of ``be.v``, ``be.i``, ``bc.v``, ``bc.i``.

        Examples
        --------
        ::

            scene.bjt_npn("Q1", "c", "b", "ground", saturation_current=1e-14, forward_gain="b")
        """

    def bjt_pnp(
        self,
        name: str,
        collector: str,
        base: str,
        emitter: str,
        substrate: str = ...,
        /,
        *,
        saturation_current: _Value,
        forward_gain: _Value,
        reverse_gain: _Value = 1.0,
        thermal_voltage: _Value = 0.02585,
        forward_ideality: _Value = 1.0,
        reverse_ideality: _Value = 1.0,
        forward_early_voltage: _Value | None = None,
        reverse_early_voltage: _Value | None = None,
        forward_knee_current: _Value | None = None,
        reverse_knee_current: _Value | None = None,
        be_recombination: _Value = 0.0,
        bc_recombination: _Value = 0.0,
        leakage: _Value = 0.0,
        base_resistance: _Value = 0.0,
        collector_resistance: _Value = 0.0,
        emitter_resistance: _Value = 0.0,
        be_capacitance: _Value = 0.0,
        bc_capacitance: _Value = 0.0,
        forward_transit_time: _Value = 0.0,
        reverse_transit_time: _Value = 0.0,
        substrate_capacitance: _Value = 0.0,
        be_recombination_ideality: _Value = 1.5,
        bc_recombination_ideality: _Value = 2.0,
        be_potential: _Value = 0.75,
        be_grading: _Value = 0.33,
        bc_potential: _Value = 0.75,
        bc_grading: _Value = 0.33,
        substrate_potential: _Value = 0.75,
        substrate_grading: _Value = 0.0,
        forward_share: _Value = 0.5,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``bjt_pnp``: bipolar transistor after Ebers and Moll, pnp.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.be.v`` and so on.
        collector, base, emitter, substrate : str
            Its nodes; substrate may be left out.
        saturation_current : float, str or table, [A]
            Of both junctions.
        forward_gain : float, str or table
            Collector current per base current.
        reverse_gain : float, str or table, default 1
            The same with collector and emitter exchanged.
        thermal_voltage : float, str or table, [V], default 0.02585
            K T / e, times an ideality factor.
        forward_ideality : float, str or table, default 1
            Factor of V forwards.
        reverse_ideality : float, str or table, default 1
            Factor of V backwards.
        forward_early_voltage : float, str or table, [V], optional
            Infinite where left out.
        reverse_early_voltage : float, str or table, [V], optional
            Infinite where left out.
        forward_knee_current : float, str or table, [A], optional
            Infinite where left out.
        reverse_knee_current : float, str or table, [A], optional
            Infinite where left out.
        be_recombination : float, str or table, [A], default 0
            Saturation current of it.
        bc_recombination : float, str or table, [A], default 0
            Saturation current of it.
        leakage : float, str or table, [S], default 0
            Beside each junction.
        base_resistance : float, str or table, [ohm], default 0
            Between terminal and junctions.
        collector_resistance : float, str or table, [ohm], default 0
            The same of the collector.
        emitter_resistance : float, str or table, [ohm], default 0
            The same of the emitter.
        be_capacitance : float, str or table, [F], default 0
            Of its charge at no voltage.
        bc_capacitance : float, str or table, [F], default 0
            Of its charge at no voltage.
        forward_transit_time : float, str or table, [s], default 0
            Charge per current forwards.
        reverse_transit_time : float, str or table, [s], default 0
            Charge per current backwards.
        substrate_capacitance : float, str or table, [F], default 0
            Of its charge at no voltage.
        be_recombination_ideality : float, str or table, default 1.5
            Factor of V for it.
        bc_recombination_ideality : float, str or table, default 2
            Factor of V for it.
        be_potential : float, str or table, [V], default 0.75
            Built in.
        be_grading : float, str or table, default 0.33
            Exponent of the doping.
        bc_potential : float, str or table, [V], default 0.75
            Built in.
        bc_grading : float, str or table, default 0.33
            Exponent of the doping.
        substrate_potential : float, str or table, [V], default 0.75
            Built in.
        substrate_grading : float, str or table, default 0
            Exponent of the doping.
        forward_share : float, str or table, default 0.5
            Of the potential built in, where the capacitance goes on straight.
        initial : mapping, optional
            Initial values of ``be.v``, ``be.i``, ``bc.v``, ``bc.i``.

        Examples
        --------
        ::

            scene.bjt_pnp("Q1", "c", "b", "e", saturation_current=1e-14, forward_gain="b")
        """

    def brake(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        normal_force: _Value,
        friction: _Value,
        radius: _Value,
        peak: _Value | None = None,
        stribeck_speed: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``brake``: brake of a shaft.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        normal_force : float, str or table, [N]
            That presses the faces together; none below zero.
        friction : float, str or table
            Coefficient in sliding.
        radius : float, str or table, [m]
            Mean radius of the faces, times their number.
        peak : float, str or table, optional
            Coefficient at rest over that in sliding; 1.
        stribeck_speed : float, str or table, [rad/s], optional
            Speed over which the force falls from that at rest; at once where left out.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.brake(
                "B",
                "ground",
                "A",
                normal_force="where(t < t1, 0, N)",
                friction="mu",
                radius="r",
            )
        """

    def bushing(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        stiffness: _Vector | None = None,
        damping: _Vector | None = None,
        rotation_stiffness: _Vector | None = None,
        rotation_damping: _Vector | None = None,
    ) -> None:
        """Add a ``bushing``: springs and dampers along and about the three axes of the first node.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        stiffness : three of float or str, [N/m], optional
            Along each axis.
        damping : three of float or str, [N s/m], optional
            Along each axis.
        rotation_stiffness : three of float or str, [N m/rad], optional
            About each axis.
        rotation_damping : three of float or str, [N m s/rad], optional
            About each axis.

        Examples
        --------
        ::

            scene.bushing(
                "mount",
                "ground",
                "P",
                stiffness=["kx", "kx", "kz"],
                rotation_stiffness=["kt", "kt", "kt"],
            )
        """

    def butler_volmer(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        exchange_current: _Value,
        symmetry: _Value = 0.5,
        electrons: _Value = 1.0,
        temperature: _Value = 298.15,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``butler_volmer``: current of an electrode by its overpotential.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        exchange_current : float, str or table, [A]
            Both ways at equilibrium.
        symmetry : float, str or table, default 0.5
            Share of the overpotential that drives oxidation.
        electrons : float, str or table, default 1
            That a turn of the reaction exchanges.
        temperature : float, str or table, [K], default 298.15
            Of the cell.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.butler_volmer("electrode", "n", "ground", exchange_current="i0")
        """

    def capacitor(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        capacitance: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``capacitor``: linear capacitance, or one that depends on states.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        capacitance : float, str or table, [F]
            Current per rate of voltage.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.capacitor("C1", "b", "ground", capacitance="C")
        """

    def cccs(
        self,
        name: str,
        /,
        *nodes: str,
        control: _Nodes | None = None,
        output: _Nodes | None = None,
        gain: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``cccs``: current in proportion to a current elsewhere.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.control.v`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        control : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        output : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        gain : float, str or table
            Current per current.
        initial : mapping, optional
            Initial values of ``control.v``, ``control.i``, ``output.v``, ``output.i``.

        Examples
        --------
        ::

            scene.cccs("F1", control=["c", "ground"], output=["ground", "d"], gain="b")
        """

    def ccvs(
        self,
        name: str,
        /,
        *nodes: str,
        control: _Nodes | None = None,
        output: _Nodes | None = None,
        transresistance: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``ccvs``: voltage in proportion to a current elsewhere.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.control.v`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        control : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        output : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        transresistance : float, str or table, [ohm]
            Voltage per current.
        initial : mapping, optional
            Initial values of ``control.v``, ``control.i``, ``output.v``, ``output.i``.

        Examples
        --------
        ::

            scene.ccvs("H1", "c", "d", transresistance="r")
        """

    def clutch(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        normal_force: _Value,
        friction: _Value,
        radius: _Value,
        peak: _Value | None = None,
        stribeck_speed: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``clutch``: clutch between two shafts.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        normal_force : float, str or table, [N]
            That presses the faces together; none below zero.
        friction : float, str or table
            Coefficient in sliding.
        radius : float, str or table, [m]
            Mean radius of the faces, times their number.
        peak : float, str or table, optional
            Coefficient at rest over that in sliding; 1.
        stribeck_speed : float, str or table, [rad/s], optional
            Speed over which the force falls from that at rest; at once where left out.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.clutch("C", "A", "B", normal_force="N", friction="mu", radius="r")
        """

    def concentration_source(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        concentration: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``concentration_source``: given concentration: a species in excess, a bath.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.c`` and so on.
        plus, minus : str
            Its nodes.
        concentration : float, str or table, [mol/m^3]
            Plus minus minus; the ground is at 0 mol/m^3.
        initial : mapping, optional
            Initial values of ``c``, ``n``.

        Examples
        --------
        ::

            scene.concentration_source("water", "W", "ground", concentration="w")
        """

    def constraint(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        expression: _Scalar,
    ) -> None:
        """Add a ``constraint``.

        Holds an expression of coordinates, node positions, parameters and t at zero.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        expression : str
            What stays zero.

        Examples
        --------
        ::

            scene.constraint("rope", "A", "B", expression="A.y + B.y + L")
        """

    def contact(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        normal: _Vector | None = None,
        ball: _Value | None = None,
        radius: _Value | None = None,
        axis: _Vector | None = None,
        length: _Value | None = None,
        semiaxes: _Vector | None = None,
        size: _Vector | None = None,
        stiffness: _Value,
        exponent: _Value = 1.5,
        dissipation: _Value = 0.0,
        friction: _Value | None = None,
        transition: _Value = 0.001,
    ) -> None:
        """Add a ``contact``: elastic contact of two bodies, with friction.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        normal : three of float or str, optional
            Of the first node's plane, which points to the second.
        ball : float or str, [m], optional
            Radius of the first node's sphere, in place of a plane.
        radius : float or str, [m], optional
            Of the second node's sphere, or of its disc where there is an axis; none of a point.
        axis : three of float or str, optional
            Of the second node's disc or cylinder, in its axes.
        length : float or str, [m], optional
            Of the second node's cylinder.
        semiaxes : three of float or str, [m], optional
            Of the second node's ellipsoid, along its axes.
        size : three of float or str, [m], optional
            Edges of the second node's box, in its axes.
        stiffness : float or str
            Force per depth to the exponent.
        exponent : float or str, default 1.5
            Of the depth: 1.5 of spheres, 1 of a linear spring; a number.
        dissipation : float, str or table, [s/m], default 0
            Loss in proportion to the speed of approach.
        friction : float, str or table, optional
            Coefficient of friction; none where left out.
        transition : float, str or table, [m/s], default 0.001
            Speed below which friction sets in.

        Examples
        --------
        ::

            scene.contact(
                "lane",
                "ground",
                "P",
                normal=[0, 1, 0],
                radius="R",
                stiffness="k",
                friction="mu",
                transition=1e-06,
            )
        """

    def convection(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        coefficient: _Value,
        area: _Value,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``convection``: heat transfer between a surface and a fluid.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.T`` and so on.
        plus, minus : str
            Its nodes.
        coefficient : float, str or table, [W/(m^2 K)]
            Heat flow per area and temperature.
        area : float, str or table, [m^2]
            Of the surface.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``T``, ``q``.

        Examples
        --------
        ::

            scene.convection("surface", "n", "air", coefficient="h", area="A")
        """

    def coupled_inductors(
        self,
        name: str,
        /,
        *nodes: str,
        primary: _Nodes | None = None,
        secondary: _Nodes | None = None,
        inductance1: _Value,
        inductance2: _Value,
        coupling: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``coupled_inductors``: windings that share a part of their flux.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.primary.v`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        primary : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        secondary : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        inductance1 : float, str or table, [H]
            Of primary alone.
        inductance2 : float, str or table, [H]
            Of secondary alone.
        coupling : float, str or table
            Mutual inductance, by the root of the product of the two.
        initial : mapping, optional
            Initial values of ``primary.v``, ``primary.i``, ``secondary.v``, ``secondary.i``.

        Examples
        --------
        ::

            scene.coupled_inductors(
                "K1",
                "b",
                "c",
                inductance1="L1",
                inductance2="L2",
                coupling="k",
            )
        """

    def current_source(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        current: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``current_source``: given current, from plus to minus inside.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        current : float, str or table, [A]
            From plus to minus inside.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.current_source("I1", "ground", "a", current="I*cos(w*t)")
        """

    def cylindrical(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        axis: _Vector,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``cylindrical``: translation along an axis and rotation about it.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.s`` and so on.
        first, second : str
            Its nodes.
        axis : three of float or str
            Direction in the first node's axes.
        initial : mapping, optional
            Initial values of ``s``, ``s_dot``, ``theta``, ``theta_dot``.

        Examples
        --------
        ::

            scene.cylindrical("bore", "ground", "A", axis=[0, 0, 1], initial={"s_dot": "v0"})
        """

    def damper(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        axis: _Vector | None = None,
        damping: _Value,
    ) -> None:
        """Add a ``damper``: linear damper.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        axis : three of float or str, optional
            Acts along it, fixed in the first node's axes; else along the line.
        damping : float, str or table, [N s/m]
            Force per rate of length.

        Examples
        --------
        ::

            scene.damper("oil", "ground", "P", axis=[0, 1, 0], damping="c")
        """

    def dc_motor(
        self,
        name: str,
        /,
        *nodes: str,
        electrical: _Nodes | None = None,
        shaft: _Nodes | None = None,
        joint: str | None = None,
        resistance: _Value,
        inductance: _Value | None = None,
        constant: _Value,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``dc_motor``: direct current motor or generator with a constant field.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        electrical : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        shaft : pair of str, optional
            Its nodes in the rotational graph: first, second.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        resistance : float, str or table, [ohm]
            Of the winding.
        inductance : float, str or table, [H], optional
            Of the winding; none where absent.
        constant : float, str or table, [N m/A]
            Torque per current, and voltage per speed.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``v``, ``i``, ``w``, ``tau``, ``theta``, ``electrical.v``,
            ``electrical.i``, ``shaft.w``, ``shaft.tau``, ``shaft.theta``.

        Examples
        --------
        ::

            scene.dc_motor(
                "M",
                electrical=["a", "ground"],
                shaft=["ground", "s"],
                resistance=2.5,
                inductance=1.0,
                constant=1.0,
            )
        """

    def diode(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        saturation_current: _Value,
        thermal_voltage: _Value = 0.02585,
        leakage: _Value = 0.0,
        series_resistance: _Value = 0.0,
        breakdown_voltage: _Value | None = None,
        junction_capacitance: _Value = 0.0,
        transit_time: _Value = 0.0,
        breakdown_current: _Value = 0.001,
        junction_potential: _Value = 1.0,
        junction_grading: _Value = 0.5,
        forward_share: _Value = 0.5,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``diode``: Shockley diode: I (exp(v / V) - 1).

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        saturation_current : float, str or table, [A]
            I, what flows backwards.
        thermal_voltage : float, str or table, [V], default 0.02585
            K T / e, times an ideality factor.
        leakage : float, str or table, [S], default 0
            Beside the junction.
        series_resistance : float, str or table, [ohm], default 0
            Of the material and its contacts.
        breakdown_voltage : float, str or table, [V], optional
            backwards; none where left out.
        junction_capacitance : float, str or table, [F], default 0
            Of its charge at no voltage.
        transit_time : float, str or table, [s], default 0
            Charge stored per current.
        breakdown_current : float, str or table, [A], default 0.001
            What flows at that voltage.
        junction_potential : float, str or table, [V], default 1
            Built in.
        junction_grading : float, str or table, default 0.5
            Exponent of the doping.
        forward_share : float, str or table, default 0.5
            Of the potential built in, where the capacitance goes on straight.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.diode("D1", "a", "ground", saturation_current="I", thermal_voltage="U")
        """

    def distance(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        length: _Value,
    ) -> None:
        """Add a ``distance``: a massless rod: holds the distance between two nodes.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        length : float, str or table, [m]
            The distance.

        Examples
        --------
        ::

            scene.distance("rod", "ground", "P", length="L")
        """

    def double_layer(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        specific_capacitance: _Value,
        area: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``double_layer``: capacitance of an electrode's surface.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        specific_capacitance : float, str or table, [F/m^2]
            Of a unit of the surface.
        area : float, str or table, [m^2]
            Of the surface.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.double_layer(
                "layer",
                "n",
                "ground",
                specific_capacitance="c",
                area="A",
                initial={"v": "v0"},
            )
        """

    def flow_source(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        flow: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``flow_source``: given flow, from plus to minus inside.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.p`` and so on.
        plus, minus : str
            Its nodes.
        flow : float, str or table, [m^3/s]
            From plus to minus inside.
        initial : mapping, optional
            Initial values of ``p``, ``q``.

        Examples
        --------
        ::

            scene.flow_source("F", "ground", "n", flow="q")
        """

    def force(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        force: _Vector,
    ) -> None:
        """Add a ``force``: given force on the second node.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        force : three of float or str, [N]
            Components in the first node's axes.

        Examples
        --------
        ::

            scene.force("drive", "ground", "P", force=["push", 0, 0])
        """

    def force_source(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        line: _Nodes | None = None,
        force: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``force_source``: given force on the second node.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint or along a line.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        force : float, str or table, [N]
            On the second node.
        initial : mapping, optional
            Initial values of ``v``, ``f``, ``s``.

        Examples
        --------
        ::

            scene.force_source("drive", "ground", "A", force="F*sin(om*t)")
        """

    def free(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``free``: every motion of the second node: no reaction.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.x`` and so on.
        first, second : str
            Its nodes.
        initial : mapping, optional
            Initial values of ``x``, ``vx``, ``y``, ``vy``, ``z``, ``vz``, ``q0``, ``q1``,
            ``q2``, ``q3``, ``w1``, ``w2``, ``w3``, ``rotation``.

        Examples
        --------
        ::

            scene.free("flight", "ground", "H", initial={"vx": 2.0, "vz": "v", "w2": "w"})
        """

    def gear(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        coordinate1: _Scalar,
        coordinate2: _Scalar,
        ratio: _Value,
        phase: _Value = 0.0,
    ) -> None:
        """Add a ``gear``: couples two coordinates: coordinate1 = ratio * coordinate2 + phase.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        coordinate1 : str, [rad or m]
            Such as j1.theta.
        coordinate2 : str, [rad or m]
            Such as j2.theta.
        ratio : float or str, [1, m or 1/m]
            Negative for wheels that mesh outside.
        phase : float or str, [rad or m], default 0
            coordinate1 where coordinate2 is zero.

        Examples
        --------
        ::

            scene.gear(
                "mesh",
                "A",
                "B",
                coordinate1="motor.theta",
                coordinate2="wheel.theta",
                ratio="ratio",
            )
        """

    def gyrator(
        self,
        name: str,
        /,
        *nodes: str,
        primary: _Nodes | None = None,
        secondary: _Nodes | None = None,
        conductance: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``gyrator``.

        Current of each port in proportion to the voltage of the other, without losses.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.primary.v`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        primary : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        secondary : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        conductance : float, str or table, [S]
            Current of the primary per voltage of the secondary.
        initial : mapping, optional
            Initial values of ``primary.v``, ``primary.i``, ``secondary.v``, ``secondary.i``.

        Examples
        --------
        ::

            scene.gyrator("G1", "b", "c", conductance="g")
        """

    def heat_capacitor(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        capacity: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``heat_capacitor``: heat capacity of one temperature.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.T`` and so on.
        plus, minus : str
            Its nodes.
        capacity : float, str or table, [J/K]
            Heat per temperature.
        initial : mapping, optional
            Initial values of ``T``, ``q``.

        Examples
        --------
        ::

            scene.heat_capacitor("body", "n", "ground", capacity="C", initial={"T": "T0"})
        """

    def heat_source(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        heat_flow: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``heat_source``: given heat flow, from plus to minus inside.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.T`` and so on.
        plus, minus : str
            Its nodes.
        heat_flow : float, str or table, [W]
            From plus to minus inside.
        initial : mapping, optional
            Initial values of ``T``, ``q``.

        Examples
        --------
        ::

            scene.heat_source("heater", "ground", "n", heat_flow="Q")
        """

    def hydraulic_cylinder(
        self,
        name: str,
        /,
        *nodes: str,
        chamber: _Nodes | None = None,
        rod: _Nodes | None = None,
        joint: str | None = None,
        line: _Nodes | None = None,
        area: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``hydraulic_cylinder``.

        Ideal cylinder: pressure pushes the rod out with a force of pressure times area.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.p`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        chamber : pair of str, optional
            Its nodes in the hydraulic graph: plus, minus.
        rod : pair of str, optional
            Its nodes in the translational graph: first, second.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        area : float, str or table, [m^2]
            Of the piston.
        initial : mapping, optional
            Initial values of ``p``, ``q``, ``v``, ``f``, ``s``, ``chamber.p``, ``chamber.q``,
            ``rod.v``, ``rod.f``, ``rod.s``.

        Examples
        --------
        ::

            scene.hydraulic_cylinder("cyl", chamber=["a", "ground"], rod=["ground", "x"], area="A")
        """

    def hydraulic_machine(
        self,
        name: str,
        /,
        *nodes: str,
        chamber: _Nodes | None = None,
        shaft: _Nodes | None = None,
        joint: str | None = None,
        displacement: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``hydraulic_machine``.

        Ideal pump or motor: pressure turns the shaft with a torque of pressure times
        displacement.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.p`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        chamber : pair of str, optional
            Its nodes in the hydraulic graph: plus, minus.
        shaft : pair of str, optional
            Its nodes in the rotational graph: first, second.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        displacement : float, str or table, [m^3/rad]
            Volume for each radian.
        initial : mapping, optional
            Initial values of ``p``, ``q``, ``w``, ``tau``, ``theta``, ``chamber.p``,
            ``chamber.q``, ``shaft.w``, ``shaft.tau``, ``shaft.theta``.

        Examples
        --------
        ::

            scene.hydraulic_machine(
                "M",
                chamber=["a", "ground"],
                shaft=["ground", "s"],
                displacement="D",
            )
        """

    def hydraulic_resistor(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        resistance: _Value,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``hydraulic_resistor``: linear resistance: laminar flow.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.p`` and so on.
        plus, minus : str
            Its nodes.
        resistance : float, str or table, [Pa s/m^3]
            Pressure per flow.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``p``, ``q``.

        Examples
        --------
        ::

            scene.hydraulic_resistor("K", "n", "ground", resistance="R")
        """

    def ideal_gear(
        self,
        name: str,
        /,
        *nodes: str,
        input: _Nodes | None = None,
        output: _Nodes | None = None,
        joint: str | None = None,
        ratio: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add an ``ideal_gear``: ideal gear.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.input.w`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        input : pair of str, optional
            Its nodes in the rotational graph: first, second.
        output : pair of str, optional
            Its nodes in the rotational graph: first, second.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        ratio : float, str or table
            Speed of input per speed of output; negative where they turn against.
        initial : mapping, optional
            Initial values of ``input.w``, ``input.tau``, ``input.theta``, ``output.w``,
            ``output.tau``, ``output.theta``.

        Examples
        --------
        ::

            scene.ideal_gear("G", input=["ground", "A"], output=["ground", "B"], ratio="n")
        """

    def ideal_op_amp(
        self,
        name: str,
        plus: str,
        minus: str,
        output: str,
        /,
        *,
        initial: _Initial | None = None,
    ) -> None:
        """Add an ``ideal_op_amp``: operational amplifier of infinite gain, with feedback.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.input.v`` and so on.
        plus, minus, output : str
            Its nodes.
        initial : mapping, optional
            Initial values of ``input.v``, ``input.i``, ``output.v``, ``output.i``.

        Examples
        --------
        ::

            scene.ideal_op_amp("A1", "ground", "m", "out")
        """

    def inductor(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        inductance: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add an ``inductor``: linear inductance, or one that depends on states.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        inductance : float, str or table, [H]
            Voltage per rate of current.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.inductor("L1", "a", "ground", inductance="L0/(1 + a*L1.i)")
        """

    def inertance(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        inertance: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add an ``inertance``: inertia of a liquid column.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.p`` and so on.
        plus, minus : str
            Its nodes.
        inertance : float, str or table, [Pa s^2/m^3]
            Pressure per rate of flow: density times length by area.
        initial : mapping, optional
            Initial values of ``p``, ``q``.

        Examples
        --------
        ::

            scene.inertance("L", "n", "ground", inertance="I")
        """

    def knife_edge(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        axis: _Vector,
    ) -> None:
        """Add a ``knife_edge``.

        Holds the velocity of the second node, against the first, across a blade at zero.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        axis : three of float or str
            Direction across the blade, in the second node's axes.

        Examples
        --------
        ::

            scene.knife_edge("blade", "ground", "P", axis=[0, 1, 0])
        """

    def lever(
        self,
        name: str,
        /,
        *nodes: str,
        input: _Nodes | None = None,
        output: _Nodes | None = None,
        joint: str | None = None,
        line: _Nodes | None = None,
        ratio: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``lever``: ideal lever, at small angles.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.input.v`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        input : pair of str, optional
            Its nodes in the translational graph: first, second.
        output : pair of str, optional
            Its nodes in the translational graph: first, second.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        ratio : float, str or table
            Velocity of input per velocity of output; negative about a pivot.
        initial : mapping, optional
            Initial values of ``input.v``, ``input.f``, ``input.s``, ``output.v``, ``output.f``,
            ``output.s``.

        Examples
        --------
        ::

            scene.lever("L", "A", "B", ratio="n")
        """

    def line_force(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        axis: _Vector | None = None,
        force: _Scalar,
    ) -> None:
        """Add a ``line_force``.

        Force along the line of its nodes, or an axis, by an expression of length and rate.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        axis : three of float or str, optional
            Acts along it, fixed in the first node's axes; else along the line.
        force : str, [N]
            On the second node: an expression of length, rate, t, inputs and coordinates.

        Examples
        --------
        ::

            scene.line_force("pull", "ground", "P", force="-mu*m/length**2")
        """

    def lossy_gear(
        self,
        name: str,
        input: str,
        output: str,
        /,
        *,
        ratio: _Value,
        efficiency: _Value,
        back_efficiency: _Value | None = None,
        torque: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``lossy_gear``: gear with losses in teeth and bearings, which may lock it.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.input.w`` and so on.
        input, output : str
            Its nodes.
        ratio : float, str or table
            Speed of input per speed of output.
        efficiency : float, str or table
            Of the teeth, where the input drives.
        back_efficiency : float, str or table, optional
            Where the output drives; `efficiency`.
        torque : float, str or table, [N m], optional
            Of friction in the bearings, at the input.
        initial : mapping, optional
            Initial values of ``input.w``, ``input.tau``, ``input.theta``, ``output.w``,
            ``output.tau``, ``output.theta``, ``teeth.w``, ``teeth.tau``, ``teeth.theta``.

        Examples
        --------
        ::

            scene.lossy_gear("G", "A", "B", ratio="n", efficiency="e")
        """

    def molar_flow_source(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        flow: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``molar_flow_source``: given molar flow, from plus to minus inside.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.c`` and so on.
        plus, minus : str
            Its nodes.
        flow : float, str or table, [mol/s]
            From plus to minus inside.
        initial : mapping, optional
            Initial values of ``c``, ``n``.

        Examples
        --------
        ::

            scene.molar_flow_source("feed", "ground", "A", flow="n")
        """

    def mosfet_n(
        self,
        name: str,
        drain: str,
        gate: str,
        source: str,
        bulk: str = ...,
        /,
        *,
        factor: _Value,
        threshold: _Value,
        modulation: _Value = 0.0,
        leakage: _Value = 1e-12,
        body_effect: _Value = 0.0,
        surface_potential: _Value = 0.6,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``mosfet_n``: field-effect transistor by the square law, n channel.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.ds.v`` and so on.
        drain, gate, source, bulk : str
            Its nodes; bulk may be left out.
        factor : float, str or table, [A/V^2]
            Of the square law: mobility, oxide, width by length.
        threshold : float, str or table, [V]
            Of the gate against the source.
        modulation : float, str or table, [1/V], default 0
            Of the channel's length.
        leakage : float, str or table, [S], default 1e-12
            Between drain and source.
        body_effect : float, str or table, [V^0.5], default 0
            Of the bulk's voltage.
        surface_potential : float, str or table, [V], default 0.6
            Of the channel at threshold.
        initial : mapping, optional
            Initial values of ``ds.v``, ``ds.i``, ``gs.v``, ``gs.i``.

        Examples
        --------
        ::

            scene.mosfet_n("M1", "d", "g", "ground", factor="k", threshold="U", leakage=0.0)
        """

    def mosfet_p(
        self,
        name: str,
        drain: str,
        gate: str,
        source: str,
        bulk: str = ...,
        /,
        *,
        factor: _Value,
        threshold: _Value,
        modulation: _Value = 0.0,
        leakage: _Value = 1e-12,
        body_effect: _Value = 0.0,
        surface_potential: _Value = 0.6,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``mosfet_p``: field-effect transistor by the square law, p channel.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.ds.v`` and so on.
        drain, gate, source, bulk : str
            Its nodes; bulk may be left out.
        factor : float, str or table, [A/V^2]
            Of the square law: mobility, oxide, width by length.
        threshold : float, str or table, [V]
            Of the gate against the source.
        modulation : float, str or table, [1/V], default 0
            Of the channel's length.
        leakage : float, str or table, [S], default 1e-12
            Between drain and source.
        body_effect : float, str or table, [V^0.5], default 0
            Of the bulk's voltage.
        surface_potential : float, str or table, [V], default 0.6
            Of the channel at threshold.
        initial : mapping, optional
            Initial values of ``ds.v``, ``ds.i``, ``gs.v``, ``gs.i``.

        Examples
        --------
        ::

            scene.mosfet_p("M1", "d", "g", "s", factor="k", threshold="U", leakage=0.0)
        """

    def nernst(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        standard_potential: _Value,
        oxidised: _Value,
        reduced: _Value,
        electrons: _Value = 1.0,
        temperature: _Value = 298.15,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``nernst``: equilibrium potential of an electrode by concentrations.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        standard_potential : float, str or table, [V]
            At equal activities.
        oxidised : float, str or table, [any]
            Activity or concentration of the oxidised side.
        reduced : float, str or table, [any]
            The same of the reduced side.
        electrons : float, str or table, default 1
            That a turn of the reaction exchanges.
        temperature : float, str or table, [K], default 298.15
            Of the cell.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.nernst(
                "N",
                "p",
                "ground",
                standard_potential="E",
                oxidised="A.c",
                reduced=1.0,
                temperature="T",
            )
        """

    def nonlinear_capacitor(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        charge: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``nonlinear_capacitor``: charge by voltage.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        charge : float, str or table, [C]
            An expression of NAME.v.
        initial : mapping, optional
            Initial values of ``v``, ``i``, ``q``.

        Examples
        --------
        ::

            scene.nonlinear_capacitor("C1", "n", "ground", charge="c*(C1.v + a*C1.v**2/2)")
        """

    def nonlinear_inductor(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        flux: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``nonlinear_inductor``: flux linkage by current.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        flux : float, str or table, [V s]
            An expression of NAME.i.
        initial : mapping, optional
            Initial values of ``v``, ``i``, ``flux``.

        Examples
        --------
        ::

            scene.nonlinear_inductor("L1", "n", "ground", flux="L*I*atan(L1.i/I)")
        """

    def nullor(
        self,
        name: str,
        /,
        *nodes: str,
        input: _Nodes | None = None,
        output: _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``nullor``: ideal amplifier whose output may float.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.input.v`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        input : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        output : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        initial : mapping, optional
            Initial values of ``input.v``, ``input.i``, ``output.v``, ``output.i``.

        Examples
        --------
        ::

            scene.nullor("N1", input=["a", "b"], output=["c", "b"])
        """

    def one_way_clutch(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        normal_force: _Value,
        friction: _Value,
        radius: _Value,
        peak: _Value | None = None,
        stribeck_speed: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add an ``one_way_clutch``: clutch that turns freely one way, and locks the other.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        normal_force : float, str or table, [N]
            That presses the faces together; none below zero.
        friction : float, str or table
            Coefficient in sliding.
        radius : float, str or table, [m]
            Mean radius of the faces, times their number.
        peak : float, str or table, optional
            Coefficient at rest over that in sliding; 1.
        stribeck_speed : float, str or table, [rad/s], optional
            Speed over which the force falls from that at rest; at once where left out.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.one_way_clutch("C", "A", "B", normal_force=0, friction=0.4, radius=0.2)
        """

    def open_circuit_voltage(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        voltage: _Value,
        capacity: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add an ``open_circuit_voltage``.

        Voltage of a cell without current, with its state of charge.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        voltage : float, str or table, [V]
            Plus minus minus, by NAME.soc.
        capacity : float, str or table, [C]
            Charge from empty to full.
        initial : mapping, optional
            Initial values of ``v``, ``i``, ``soc``.

        Examples
        --------
        ::

            scene.open_circuit_voltage(
                "cell",
                "p",
                "ground",
                voltage="U0 + U1*cell.soc",
                capacity="Q",
                initial={"soc": 0.9},
            )
        """

    def orifice(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        area: _Value,
        coefficient: _Value = 0.62,
        density: _Value = 1000.0,
        transition: _Value = 1.0,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add an ``orifice``: turbulent flow through an opening.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.p`` and so on.
        plus, minus : str
            Its nodes.
        area : float, str or table, [m^2]
            Of the opening.
        coefficient : float, str or table, default 0.62
            Of discharge.
        density : float, str or table, [kg/m^3], default 1000
            Of the liquid.
        transition : float, str or table, [Pa], default 1
            Below it the law is smoothed.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``p``, ``q``.

        Examples
        --------
        ::

            scene.orifice("hole", "n", "ground", area="a", coefficient=0.6)
        """

    def piecewise_current(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        times: Sequence[float] | npt.NDArray[Any],
        values: Sequence[float] | npt.NDArray[Any],
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``piecewise_current``: linear between given points.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        times : list of float, [s]
            That increase.
        values : list of float, [A]
            At these times; constant outside them.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.piecewise_current(
                "I1",
                "ground",
                "a",
                times=[0.2, 0.7, 1.7],
                values=[0.0, 3.0, 0.0],
            )
        """

    def piecewise_voltage(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        times: Sequence[float] | npt.NDArray[Any],
        values: Sequence[float] | npt.NDArray[Any],
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``piecewise_voltage``: linear between given points.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        times : list of float, [s]
            That increase.
        values : list of float, [V]
            At these times; constant outside them.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.piecewise_voltage(
                "V1",
                "a",
                "ground",
                times=[0.2, 0.7, 1.7],
                values=[0.0, 3.0, 0.0],
            )
        """

    def pipe(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        resistance: _Value = 0.0,
        inertance: _Value,
        capacity: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``pipe``: liquid column with friction, elastic where a capacity is given.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.p`` and so on.
        plus, minus : str
            Its nodes.
        resistance : float, str or table, [Pa s/m^3], default 0
            Pressure per flow.
        inertance : float, str or table, [Pa s^2/m^3]
            Pressure per rate of flow.
        capacity : float, str or table, [m^3/Pa], optional
            Volume per pressure, half at each end.
        initial : mapping, optional
            Initial values of ``p``, ``q``.

        Examples
        --------
        ::

            scene.pipe("P", "n", "ground", resistance="R", inertance="I")
        """

    def planar(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        normal: _Vector,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``planar``: translation in a plane and rotation about its normal.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.x`` and so on.
        first, second : str
            Its nodes.
        normal : three of float or str
            Normal of the plane, in the first node's axes.
        initial : mapping, optional
            Initial values of ``x``, ``x_dot``, ``y``, ``y_dot``, ``theta``, ``theta_dot``.

        Examples
        --------
        ::

            scene.planar(
                "slide",
                "T",
                "P",
                normal=[0, 0, 1],
                initial={"x": "a", "y_dot": "-w*a", "theta_dot": "-w"},
            )
        """

    def planetary_gear(
        self,
        name: str,
        sun: str,
        carrier: str,
        ring: str,
        /,
        *,
        ratio: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``planetary_gear``: ideal planetary gear: a sun, a ring, and planets on a carrier.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.sun.w`` and so on.
        sun, carrier, ring : str
            Its nodes.
        ratio : float, str or table
            Teeth of the ring per teeth of the sun.
        initial : mapping, optional
            Initial values of ``sun.w``, ``sun.tau``, ``sun.theta``, ``ring.w``, ``ring.tau``,
            ``ring.theta``.

        Examples
        --------
        ::

            scene.planetary_gear("G", "S", "C", "ground", ratio="r")
        """

    def pressure_source(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        pressure: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``pressure_source``: given pressure.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.p`` and so on.
        plus, minus : str
            Its nodes.
        pressure : float, str or table, [Pa]
            Plus minus minus.
        initial : mapping, optional
            Initial values of ``p``, ``q``.

        Examples
        --------
        ::

            scene.pressure_source("S", "s", "ground", pressure="a*t")
        """

    def prismatic(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        axis: _Vector,
        stiffness: _Value = 0.0,
        free_length: _Value = 0.0,
        damping: _Value = 0.0,
        force: _Value = 0.0,
        motion: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``prismatic``: translation of the second node along an axis through the first.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.s`` and so on.
        first, second : str
            Its nodes.
        axis : three of float or str
            Direction in the first node's axes.
        stiffness : float, str or table, [N/m], default 0
            Of a spring in the joint.
        free_length : float, str or table, [m], default 0
            Coordinate at which that spring is at rest.
        damping : float, str or table, [N s/m], default 0
            Of a damper in the joint.
        force : float, str or table, [N], default 0
            Drives the second node along the axis.
        motion : float, str or table, [rad or m], optional
            Prescribes the coordinate as a function of time.
        initial : mapping, optional
            Initial values of ``s``, ``s_dot``.

        Examples
        --------
        ::

            scene.prismatic("table", "ground", "A", axis=[0, 0, 1], motion="a*sin(w*t)")
        """

    def pulse_current(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        low: _Value = 0.0,
        high: _Value,
        delay: _Value = 0.0,
        rise: _Value = 1e-09,
        fall: _Value = 1e-09,
        width: _Value,
        period: _Value = 1e30,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``pulse_current``: one pulse with straight edges, or many.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        low : float, str or table, [A], default 0
            Before, between and after.
        high : float, str or table, [A]
            For its width.
        delay : float, str or table, [s], default 0
            When the first edge begins.
        rise : float, str or table, [s], default 1e-09
            Length of the first edge.
        fall : float, str or table, [s], default 1e-09
            Length of the second edge.
        width : float, str or table, [s]
            Between the edges.
        period : float, str or table, [s], default 1e+30
            From one pulse to the next; by default there is one.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.pulse_current(
                "I1",
                "ground",
                "a",
                high="I",
                rise="a",
                width="w",
                fall="b",
                period="T",
            )
        """

    def pulse_voltage(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        low: _Value = 0.0,
        high: _Value,
        delay: _Value = 0.0,
        rise: _Value = 1e-09,
        fall: _Value = 1e-09,
        width: _Value,
        period: _Value = 1e30,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``pulse_voltage``: one pulse with straight edges, or many.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        low : float, str or table, [V], default 0
            Before, between and after.
        high : float, str or table, [V]
            For its width.
        delay : float, str or table, [s], default 0
            When the first edge begins.
        rise : float, str or table, [s], default 1e-09
            Length of the first edge.
        fall : float, str or table, [s], default 1e-09
            Length of the second edge.
        width : float, str or table, [s]
            Between the edges.
        period : float, str or table, [s], default 1e+30
            From one pulse to the next; by default there is one.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.pulse_voltage(
                "V1",
                "a",
                "ground",
                high="V",
                delay="d",
                rise="a",
                width="w",
                fall="b",
            )
        """

    def pump(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        pressure: _Value,
        resistance: _Value,
        quadratic: _Value = 0.0,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``pump``: a pump by its curve, which raises the pressure from minus to plus.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.p`` and so on.
        plus, minus : str
            Its nodes.
        pressure : float, str or table, [Pa]
            Rise without flow.
        resistance : float, str or table, [Pa s/m^3]
            Linear fall of the curve.
        quadratic : float, str or table, [Pa s^2/m^6], default 0
            Quadratic fall of the curve.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``p``, ``q``.

        Examples
        --------
        ::

            scene.pump("P", "n", "ground", pressure="p0", resistance="a", quadratic="b")
        """

    def rack_and_pinion(
        self,
        name: str,
        /,
        *nodes: str,
        rack: _Nodes | None = None,
        pinion: _Nodes | None = None,
        joint: str | None = None,
        line: _Nodes | None = None,
        radius: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``rack_and_pinion``: ideal rack and pinion.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        rack : pair of str, optional
            Its nodes in the translational graph: first, second.
        pinion : pair of str, optional
            Its nodes in the rotational graph: first, second.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        radius : float, str or table, [m/rad]
            Velocity of the rack per speed of the pinion.
        initial : mapping, optional
            Initial values of ``v``, ``f``, ``s``, ``w``, ``tau``, ``theta``, ``rack.v``,
            ``rack.f``, ``rack.s``, ``pinion.w``, ``pinion.tau``, ``pinion.theta``.

        Examples
        --------
        ::

            scene.rack_and_pinion("G", "A", "B", radius="r")
        """

    def radiation(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        area: _Value,
        emissivity: _Value = 1.0,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``radiation``: radiation between grey surfaces.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.T`` and so on.
        plus, minus : str
            Its nodes.
        area : float, str or table, [m^2]
            Of the surface, times its view factor.
        emissivity : float, str or table, default 1
            Of the pair of surfaces.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``T``, ``q``.

        Examples
        --------
        ::

            scene.radiation("sky", "n", "ground", area="A", emissivity="e")
        """

    def reaction(
        self,
        name: str,
        /,
        *,
        reactants: Sequence[str] | None = None,
        products: Sequence[str] | None = None,
        rate: _Value,
        reverse_rate: _Value | None = None,
        volume: _Value = 1.0,
    ) -> None:
        """Add a ``reaction``: a reaction by the law of mass action.

        Parameters
        ----------
        name : str
            Name of the edge.
        reactants : list of str, optional
            Nodes of what it takes, each as often as it counts.
        products : list of str, optional
            Nodes of what it makes, each as often as it counts.
        rate : float, str or table, [any]
            Times the product of the reactants' concentrations.
        reverse_rate : float, str or table, [any], optional
            The same of the products.
        volume : float, str or table, [m^3], default 1
            That it takes place in.

        Examples
        --------
        ::

            scene.reaction("R", reactants=["A", "A"], products=["B"], rate="k")
        """

    def resistor(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        resistance: _Value,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``resistor``: linear resistance.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        resistance : float, str or table, [ohm]
            Voltage per current.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.resistor("R1", "a", "ground", resistance="R")
        """

    def revolute(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        axis: _Vector,
        stiffness: _Value = 0.0,
        free_angle: _Value = 0.0,
        damping: _Value = 0.0,
        torque: _Value = 0.0,
        motion: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``revolute``: rotation of the second node about an axis through both.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.theta`` and so on.
        first, second : str
            Its nodes.
        axis : three of float or str
            Direction in the first node's axes.
        stiffness : float, str or table, [N m/rad], default 0
            Of a torsional spring in the joint.
        free_angle : float, str or table, [rad], default 0
            Angle at which that spring is at rest.
        damping : float, str or table, [N m s/rad], default 0
            Of a torsional damper in the joint.
        torque : float, str or table, [N m], default 0
            Drives the second node about the axis.
        motion : float, str or table, [rad or m], optional
            Prescribes the coordinate as a function of time.
        initial : mapping, optional
            Initial values of ``theta``, ``theta_dot``.

        Examples
        --------
        ::

            scene.revolute(
                "wire",
                "ground",
                "A",
                axis=[0, 0, 1],
                stiffness="k",
                damping="2*J*d",
                initial={"theta": "theta0"},
            )
        """

    def rigid_body(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        mass: _Value,
        inertia: _Inertia | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``rigid_body``.

        Inertia of a body whose centre of mass is the second node; the first node is ground.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.x`` and so on.
        first, second : str
            Its nodes.
        mass : float or str, [kg]
            Mass.
        inertia : float, str, three of them, or a matrix, [kg m^2], optional
            About the centre of mass, in the second node's axes; not modelled where absent.
        initial : mapping, optional
            Initial values of ``x``, ``vx``, ``y``, ``vy``, ``z``, ``vz``, ``q0``, ``q1``,
            ``q2``, ``q3``, ``w1``, ``w2``, ``w3``, ``x_dot``, ``y_dot``, ``theta``,
            ``theta_dot``, ``rotation``.

        Examples
        --------
        ::

            scene.rigid_body(
                "top",
                "ground",
                "P",
                mass=1.0,
                inertia=["A", "A", "C"],
                initial={"w1": "n", "w3": "w0"},
            )
        """

    def rigid_contact(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        normal: _Vector | None = None,
        ball: _Value | None = None,
        radius: _Value | None = None,
        axis: _Vector | None = None,
        length: _Value | None = None,
        semiaxes: _Vector | None = None,
        size: _Vector | None = None,
        restitution: _Value = 0.0,
        rest_speed: _Value = 0.001,
        friction: _Value | None = None,
    ) -> None:
        """Add a ``rigid_contact``: rigid contact of two bodies, with impacts and dry friction.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        normal : three of float or str, optional
            Of the first node's plane, which points to the second.
        ball : float or str, [m], optional
            Radius of the first node's sphere, in place of a plane.
        radius : float or str, [m], optional
            Of the second node's sphere, or of its disc where there is an axis; none of a point.
        axis : three of float or str, optional
            Of the second node's disc or cylinder, in its axes.
        length : float or str, [m], optional
            Of the second node's cylinder.
        semiaxes : three of float or str, [m], optional
            Of the second node's ellipsoid, along its axes.
        size : three of float or str, [m], optional
            Edges of the second node's box, in its axes.
        restitution : float, str or table, default 0
            Speed after an impact over that before.
        rest_speed : float, str or table, [m/s], default 0.001
            After an impact, below it is held.
        friction : float, str or table, optional
            Coefficient of friction; none where left out.

        Examples
        --------
        ::

            scene.rigid_contact("floor", "ground", "P", normal=[0, 1, 0], radius="R", friction="mu")
        """

    def rolling_disc(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        normal: _Vector,
        axis: _Vector,
        radius: _Value,
    ) -> None:
        """Add a ``rolling_disc``.

        A thin disc about the second node rolls without slip on a plane through the first.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        normal : three of float or str
            Of the plane, in the first node's axes.
        axis : three of float or str
            Of the disc, in the second node's axes.
        radius : float or str, [m]
            Of the disc.

        Examples
        --------
        ::

            scene.rolling_disc(
                "contact",
                "ground",
                "P",
                normal=[0, 1, 0],
                axis=[0, 0, 1],
                radius="R",
            )
        """

    def rolling_ellipsoid(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        normal: _Vector,
        semiaxes: _Vector,
    ) -> None:
        """Add a ``rolling_ellipsoid``.

        An ellipsoid about the second node rolls without slip on a plane through the first.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        normal : three of float or str
            Of the plane, in the first node's axes.
        semiaxes : three of float or str, [m]
            Along the second node's axes, positive.

        Examples
        --------
        ::

            scene.rolling_ellipsoid(
                "contact",
                "ground",
                "P",
                normal=[0, 0, 1],
                semiaxes=["R", "R", "R"],
            )
        """

    def rotational_backlash(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        lower: _Value | None = None,
        upper: _Value | None = None,
        stiffness: _Value,
        damping: _Value = 0.0,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``rotational_backlash``: play between elastic limits, with corners.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        lower : float, str or table, [rad], optional
            Angle below which it is compressed.
        upper : float, str or table, [rad], optional
            Angle above which it is stretched.
        stiffness : float, str or table, [N m/rad]
            Torque per angle.
        damping : float, str or table, [N m s/rad], default 0
            In contact; it never pulls.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.rotational_backlash(
                "K",
                "ground",
                "A",
                lower="-a",
                upper="a",
                stiffness="k",
                damping="c",
            )
        """

    def rotational_damper(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        damping: _Value,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``rotational_damper``: linear damper.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        damping : float, str or table, [N m s/rad]
            Torque per relative speed.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.rotational_damper("b", "ground", "A", damping="b")
        """

    def rotational_dry_friction(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        torque: _Value,
        breakaway: _Value | None = None,
        stribeck_speed: _Value | None = None,
        damping: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``rotational_dry_friction``: dry friction that sticks and slides.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        torque : float, str or table, [N m]
            Of dry friction, while it slides.
        breakaway : float, str or table, [N m], optional
            Largest torque at rest; `torque`.
        stribeck_speed : float, str or table, [rad/s], optional
            Speed over which the force falls from that at rest; at once where left out.
        damping : float, str or table, [N m s/rad], optional
            Of viscous friction, while it slides.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.rotational_dry_friction("F", "ground", "A", torque="F")
        """

    def rotational_friction(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        torque: _Value,
        damping: _Value = 0.0,
        transition: _Value = 0.001,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``rotational_friction``: dry friction, smooth about rest, with viscous friction.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        torque : float, str or table, [N m]
            Of dry friction.
        damping : float, str or table, [N m s/rad], default 0
            Of viscous friction.
        transition : float, str or table, [rad/s], default 0.001
            Speed below which it sets in.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.rotational_friction("F", "ground", "A", torque="F", transition="d")
        """

    def rotational_inertia(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        inertia: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``rotational_inertia``: inertia that turns about an axis.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        inertia : float, str or table, [kg m^2]
            About the axis.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.rotational_inertia("wheel", "ground", "A", inertia="J")
        """

    def rotational_lugre(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        torque: _Value,
        breakaway: _Value,
        stribeck_speed: _Value,
        stiffness: _Value,
        damping: _Value = 0.0,
        viscous: _Value = 0.0,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``rotational_lugre``: friction of bristles that bend and slip.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        torque : float, str or table, [N m]
            Of dry friction in steady sliding.
        breakaway : float, str or table, [N m]
            Torque that bristles bear at most.
        stribeck_speed : float, str or table, [rad/s]
            Speed over which one becomes the other.
        stiffness : float, str or table, [N m/rad]
            Of the bristles.
        damping : float, str or table, [N m s/rad], default 0
            Of the bristles.
        viscous : float, str or table, [N m s/rad], default 0
            Of viscous friction.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``z``.

        Examples
        --------
        ::

            scene.rotational_lugre(
                "L",
                "ground",
                "A",
                torque="F",
                breakaway="Fs",
                stribeck_speed="vs",
                stiffness="k",
                damping="c",
                viscous="d",
            )
        """

    def rotational_rigid_stop(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        lower: _Value | None = None,
        upper: _Value | None = None,
        restitution: _Value = 0.0,
        rest_speed: _Value = 0.001,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``rotational_rigid_stop``: limits that hold what runs into them.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        lower : float or str, [rad], optional
            Least angle; none where left out.
        upper : float or str, [rad], optional
            Largest angle; none where left out.
        restitution : float, str or table, default 0
            Speed after an impact over that before.
        rest_speed : float, str or table, [rad/s], default 0.001
            After an impact, below it is held.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.rotational_rigid_stop("F", "ground", "A", lower="-b", upper="b", restitution=1.0)
        """

    def rotational_spring(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        stiffness: _Value | None = None,
        free_angle: _Value = 0.0,
        torque: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``rotational_spring``: linear spring, or a spring by an expression.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        stiffness : float, str or table, [N m/rad], optional
            Torque per angle.
        free_angle : float, str or table, [rad], default 0
            Angle at rest.
        torque : float, str or table, [N m], optional
            In place of stiffness: an expression.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.rotational_spring("k1", "ground", "A", stiffness="k1", initial={"theta": 0.2})
        """

    def rotational_stop(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        lower: _Value,
        upper: _Value,
        stiffness: _Value,
        damping: _Value = 0.0,
        transition: _Value = 1e-06,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``rotational_stop``: elastic stops at either side of a gap.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        lower : float, str or table, [rad]
            Angle at which the lower stop begins.
        upper : float, str or table, [rad]
            Angle at which the upper stop begins.
        stiffness : float, str or table, [N m/rad]
            Torque per angle in contact.
        damping : float, str or table, [N m s/rad], default 0
            In contact.
        transition : float, str or table, [rad], default 1e-06
            Angle over which contact sets in.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.rotational_stop(
                "K",
                "ground",
                "A",
                lower="-a",
                upper="a",
                stiffness="k",
                damping="c",
                transition="d",
            )
        """

    def screw(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        axis: _Vector,
        pitch: _Value,
        stiffness: _Value = 0.0,
        free_angle: _Value = 0.0,
        damping: _Value = 0.0,
        torque: _Value = 0.0,
        motion: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``screw``: rotation about an axis with a translation along it in proportion.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.theta`` and so on.
        first, second : str
            Its nodes.
        axis : three of float or str
            Direction in the first node's axes.
        pitch : float or str, [m/rad]
            Translation for each radian.
        stiffness : float, str or table, [N m/rad], default 0
            Of a torsional spring in the joint.
        free_angle : float, str or table, [rad], default 0
            Angle at which that spring is at rest.
        damping : float, str or table, [N m s/rad], default 0
            Of a torsional damper in the joint.
        torque : float, str or table, [N m], default 0
            Drives the second node about the axis.
        motion : float, str or table, [rad or m], optional
            Prescribes the coordinate as a function of time.
        initial : mapping, optional
            Initial values of ``theta``, ``theta_dot``.

        Examples
        --------
        ::

            scene.screw("thread", "ground", "A", axis=[0, 0, 1], pitch="p")
        """

    def shaft(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        stiffness: _Value,
        damping: _Value,
        free_angle: _Value = 0.0,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``shaft``: elastic shaft with damping.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        stiffness : float, str or table, [N m/rad]
            Torque per angle.
        damping : float, str or table, [N m s/rad]
            Torque per relative speed.
        free_angle : float, str or table, [rad], default 0
            Angle at rest.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.shaft("S", "ground", "A", stiffness="k", damping="c", initial={"theta": "theta0"})
        """

    def sine_current(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        amplitude: _Value,
        frequency: _Value,
        phase: _Value = 0.0,
        offset: _Value = 0.0,
        delay: _Value = 0.0,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``sine_current``: sine from a delay on.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        amplitude : float, str or table, [A]
            Half of what lies between the extremes.
        frequency : float, str or table, [Hz]
            Turns per second.
        phase : float, str or table, [rad], default 0
            At the delay and before.
        offset : float, str or table, [A], default 0
            Mean value.
        delay : float, str or table, [s], default 0
            Before it nothing changes.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.sine_current("I1", "ground", "a", amplitude="I", frequency="f", delay="d")
        """

    def sine_voltage(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        amplitude: _Value,
        frequency: _Value,
        phase: _Value = 0.0,
        offset: _Value = 0.0,
        delay: _Value = 0.0,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``sine_voltage``: sine from a delay on.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        amplitude : float, str or table, [V]
            Half of what lies between the extremes.
        frequency : float, str or table, [Hz]
            Turns per second.
        phase : float, str or table, [rad], default 0
            At the delay and before.
        offset : float, str or table, [V], default 0
            Mean value.
        delay : float, str or table, [s], default 0
            Before it nothing changes.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.sine_voltage("V1", "a", "ground", amplitude="V", frequency="f")
        """

    def slot(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        axis: _Vector,
    ) -> None:
        """Add a ``slot``: holds the second node on a line through the first.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        axis : three of float or str
            Direction of the line in the first node's axes; may depend on time.

        Examples
        --------
        ::

            scene.slot("slot_x", "ground", "A", axis=[1, 0, 0])
        """

    def solenoid(
        self,
        name: str,
        /,
        *nodes: str,
        electrical: _Nodes | None = None,
        plunger: _Nodes | None = None,
        joint: str | None = None,
        line: _Nodes | None = None,
        resistance: _Value,
        inductance: _Value,
        gap: _Value,
        leakage: _Value = 0.0,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``solenoid``.

        Coil that pulls a plunger in: inductance L(s) = leakage + inductance / (1 + s/gap).

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.i`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        electrical : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        plunger : pair of str, optional
            Its nodes in the translational graph: first, second.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        resistance : float, str or table, [ohm]
            Of the coil.
        inductance : float, str or table, [H]
            Of the air gap where it is closed, s = 0.
        gap : float, str or table, [m]
            Opening at which that inductance is halved.
        leakage : float, str or table, [H], default 0
            Inductance that no motion changes.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``i``, ``f``, ``s``, ``electrical.v``, ``electrical.i``,
            ``plunger.v``, ``plunger.f``, ``plunger.s``.

        Examples
        --------
        ::

            scene.solenoid(
                "S",
                electrical=["a", "ground"],
                plunger=["ground", "x"],
                resistance="R",
                inductance="L0",
                gap="d",
                initial={"s": 0.001},
            )
        """

    def species(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        volume: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``species``: amount of a species in a well stirred volume.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.c`` and so on.
        plus, minus : str
            Its nodes.
        volume : float, str or table, [m^3]
            Of the liquid.
        initial : mapping, optional
            Initial values of ``c``, ``n``.

        Examples
        --------
        ::

            scene.species("A", "A", "ground", volume="V")
        """

    def speed_source(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        speed: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``speed_source``: given speed.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        speed : float, str or table, [rad/s]
            Second node less first.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.speed_source("drive", "ground", "D", speed="ws")
        """

    def spherical(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``spherical``: every rotation of the second node about a point that both share.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.q0`` and so on.
        first, second : str
            Its nodes.
        initial : mapping, optional
            Initial values of ``q0``, ``q1``, ``q2``, ``q3``, ``w1``, ``w2``, ``w3``,
            ``rotation``.

        Examples
        --------
        ::

            scene.spherical(
                "ball",
                "ground",
                "P",
                initial={
                    "rotation": ["alpha", 0, 0],
                    "w2": "sin(alpha)*sqrt(m*g*L/((A + m*L**2 - C)*cos(alpha)))",
                    "w3": "cos(alpha)*sqrt(m*g*L/((A + m*L**2 - C)*cos(alpha)))",
                },
            )
        """

    def spring(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        axis: _Vector | None = None,
        stiffness: _Value,
        free_length: _Value = 0.0,
        damping: _Value = 0.0,
    ) -> None:
        """Add a ``spring``: linear spring, with a damper beside it where damping is given.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        axis : three of float or str, optional
            Acts along it, fixed in the first node's axes; else along the line.
        stiffness : float, str or table, [N/m]
            Force per length.
        free_length : float, str or table, [m], default 0
            Length at rest.
        damping : float, str or table, [N s/m], default 0
            Force per rate of length.

        Examples
        --------
        ::

            scene.spring("band", "ground", "P", stiffness="k")
        """

    def switch(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        closed: _Value,
        on_resistance: _Value = 0.001,
        off_resistance: _Value = 1000000000.0,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``switch``: resistance between open and closed.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        closed : float, str or table
            Open up to 0, closed from 1 on, between them in between.
        on_resistance : float, str or table, [ohm], default 0.001
            Where it is closed.
        off_resistance : float, str or table, [ohm], default 1e+09
            Where it is open.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.switch(
                "S",
                "b",
                "c",
                closed="sign(t - 1)",
                on_resistance="r",
                off_resistance=1000000000000000.0,
            )
        """

    def tank(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        area: _Value,
        density: _Value = 1000.0,
        gravity: _Value = 9.81,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``tank``: open tank of upright walls: pressure at its bottom.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.p`` and so on.
        plus, minus : str
            Its nodes.
        area : float, str or table, [m^2]
            Of its surface.
        density : float, str or table, [kg/m^3], default 1000
            Of the liquid.
        gravity : float, str or table, [m/s^2], default 9.81
            Acceleration of free fall.
        initial : mapping, optional
            Initial values of ``p``, ``q``.

        Examples
        --------
        ::

            scene.tank("T", "n", "ground", area="A", initial={"p": "9810*h0"})
        """

    def temperature_source(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        temperature: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``temperature_source``: given temperature.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.T`` and so on.
        plus, minus : str
            Its nodes.
        temperature : float, str or table, [K]
            Plus minus minus; the ground is at 0 K.
        initial : mapping, optional
            Initial values of ``T``, ``q``.

        Examples
        --------
        ::

            scene.temperature_source("oven", "o", "ground", temperature="T0 + a*t")
        """

    def thermal_resistor(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        resistance: _Value,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``thermal_resistor``: conduction.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.T`` and so on.
        plus, minus : str
            Its nodes.
        resistance : float, str or table, [K/W]
            Temperature per heat flow.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``T``, ``q``.

        Examples
        --------
        ::

            scene.thermal_resistor("wall", "a", "b", resistance="R")
        """

    def three_terminal_capacitor(
        self,
        name: str,
        a: str,
        b: str,
        common: str,
        /,
        *,
        charge_a: _Value,
        charge_b: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``three_terminal_capacitor``.

        Two charges against a common terminal, each by both voltages.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.a.v`` and so on.
        a, b, common : str
            Its nodes.
        charge_a : float, str or table, [C]
            An expression of NAME.a.v and NAME.b.v.
        charge_b : float, str or table, [C]
            Another one.
        initial : mapping, optional
            Initial values of ``a.v``, ``a.i``, ``a.q``, ``b.v``, ``b.i``, ``b.q``.

        Examples
        --------
        ::

            scene.three_terminal_capacitor(
                "T1",
                "g",
                "d",
                "ground",
                charge_a="c*T1.a.v + m*T1.b.v",
                charge_b="c*(exp(T1.b.v) - 1)",
            )
        """

    def torque(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        torque: _Vector,
    ) -> None:
        """Add a ``torque``: given torque on the second node.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        torque : three of float or str, [N m]
            Components in the first node's axes.

        Examples
        --------
        ::

            scene.torque("motor", "A", "B", torque=[0, 0, "T"])
        """

    def torque_source(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        torque: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``torque_source``: given torque on the second node.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.w`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        torque : float, str or table, [N m]
            On the second node.
        initial : mapping, optional
            Initial values of ``w``, ``tau``, ``theta``.

        Examples
        --------
        ::

            scene.torque_source("drive", "ground", "A", torque="T*sin(om*t)")
        """

    def transformer(
        self,
        name: str,
        /,
        *nodes: str,
        primary: _Nodes | None = None,
        secondary: _Nodes | None = None,
        ratio: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``transformer``.

        Ideal transformer: voltage of the primary is ratio times that of the secondary.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.primary.v`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        primary : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        secondary : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        ratio : float, str or table
            Turns of the primary for each of the secondary.
        initial : mapping, optional
            Initial values of ``primary.v``, ``primary.i``, ``secondary.v``, ``secondary.i``.

        Examples
        --------
        ::

            scene.transformer("T1", "b", "c", ratio="n")
        """

    def translational_backlash(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        line: _Nodes | None = None,
        lower: _Value | None = None,
        upper: _Value | None = None,
        stiffness: _Value,
        damping: _Value = 0.0,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``translational_backlash``: play between elastic limits, with corners.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint or along a line.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        lower : float, str or table, [m], optional
            Length below which it is compressed.
        upper : float, str or table, [m], optional
            Length above which it is stretched.
        stiffness : float, str or table, [N/m]
            Force per length.
        damping : float, str or table, [N s/m], default 0
            In contact; it never pulls.
        initial : mapping, optional
            Initial values of ``v``, ``f``, ``s``.

        Examples
        --------
        ::

            scene.translational_backlash(
                "K",
                "ground",
                "A",
                lower="-a",
                upper="a",
                stiffness="k",
                damping="c",
            )
        """

    def translational_brake(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        line: _Nodes | None = None,
        normal_force: _Value,
        friction: _Value,
        peak: _Value | None = None,
        stribeck_speed: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``translational_brake``: brake of a mass.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint or along a line.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        normal_force : float, str or table, [N]
            That presses the faces together; none below zero.
        friction : float, str or table
            Coefficient in sliding.
        peak : float, str or table, optional
            Coefficient at rest over that in sliding; 1.
        stribeck_speed : float, str or table, [m/s], optional
            Speed over which the force falls from that at rest; at once where left out.
        initial : mapping, optional
            Initial values of ``v``, ``f``, ``s``.

        Examples
        --------
        ::

            scene.translational_brake(
                "B",
                "ground",
                "A",
                normal_force="where(t < t1, 0, N)",
                friction="mu",
            )
        """

    def translational_damper(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        line: _Nodes | None = None,
        damping: _Value,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``translational_damper``: linear damper.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint or along a line.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        damping : float, str or table, [N s/m]
            Force per relative speed.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``v``, ``f``, ``s``.

        Examples
        --------
        ::

            scene.translational_damper("c", "ground", "A", damping="c")
        """

    def translational_dry_friction(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        line: _Nodes | None = None,
        force: _Value,
        breakaway: _Value | None = None,
        stribeck_speed: _Value | None = None,
        damping: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``translational_dry_friction``: dry friction that sticks and slides.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint or along a line.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        force : float, str or table, [N]
            Of dry friction, while it slides.
        breakaway : float, str or table, [N], optional
            Largest force at rest; `force`.
        stribeck_speed : float, str or table, [m/s], optional
            Speed over which the force falls from that at rest; at once where left out.
        damping : float, str or table, [N s/m], optional
            Of viscous friction, while it slides.
        initial : mapping, optional
            Initial values of ``v``, ``f``, ``s``.

        Examples
        --------
        ::

            scene.translational_dry_friction("F", "ground", "A", force="F")
        """

    def translational_friction(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        line: _Nodes | None = None,
        force: _Value,
        damping: _Value = 0.0,
        transition: _Value = 0.001,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``translational_friction``.

        Dry friction, smooth about rest, with viscous friction.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint or along a line.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        force : float, str or table, [N]
            Of dry friction.
        damping : float, str or table, [N s/m], default 0
            Of viscous friction.
        transition : float, str or table, [m/s], default 0.001
            Speed below which it sets in.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``v``, ``f``, ``s``.

        Examples
        --------
        ::

            scene.translational_friction("F", "ground", "A", force="F", transition="d")
        """

    def translational_lugre(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        line: _Nodes | None = None,
        force: _Value,
        breakaway: _Value,
        stribeck_speed: _Value,
        stiffness: _Value,
        damping: _Value = 0.0,
        viscous: _Value = 0.0,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``translational_lugre``: friction of bristles that bend and slip.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint or along a line.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        force : float, str or table, [N]
            Of dry friction in steady sliding.
        breakaway : float, str or table, [N]
            Force that bristles bear at most.
        stribeck_speed : float, str or table, [m/s]
            Speed over which one becomes the other.
        stiffness : float, str or table, [N/m]
            Of the bristles.
        damping : float, str or table, [N s/m], default 0
            Of the bristles.
        viscous : float, str or table, [N s/m], default 0
            Of viscous friction.
        initial : mapping, optional
            Initial values of ``v``, ``f``, ``z``.

        Examples
        --------
        ::

            scene.translational_lugre(
                "L",
                "ground",
                "A",
                force="F",
                breakaway="Fs",
                stribeck_speed="vs",
                stiffness="k",
                damping="c",
                viscous="d",
            )
        """

    def translational_mass(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        line: _Nodes | None = None,
        mass: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``translational_mass``: mass that moves along a line.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint or along a line.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        mass : float, str or table, [kg]
            Of the body.
        initial : mapping, optional
            Initial values of ``v``, ``f``, ``s``.

        Examples
        --------
        ::

            scene.translational_mass("stone", "ground", "A", mass="m", initial={"v": "v0", "s": 0})
        """

    def translational_rigid_stop(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        line: _Nodes | None = None,
        lower: _Value | None = None,
        upper: _Value | None = None,
        restitution: _Value = 0.0,
        rest_speed: _Value = 0.001,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``translational_rigid_stop``: limits that hold what runs into them.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint or along a line.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        lower : float or str, [m], optional
            Least length; none where left out.
        upper : float or str, [m], optional
            Largest length; none where left out.
        restitution : float, str or table, default 0
            Speed after an impact over that before.
        rest_speed : float, str or table, [m/s], default 0.001
            After an impact, below it is held.
        initial : mapping, optional
            Initial values of ``v``, ``f``, ``s``.

        Examples
        --------
        ::

            scene.translational_rigid_stop("F", "ground", "A", upper="b", restitution="e")
        """

    def translational_spring(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        line: _Nodes | None = None,
        stiffness: _Value | None = None,
        free_length: _Value = 0.0,
        force: _Value | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``translational_spring``: linear spring, or a spring by an expression.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint or along a line.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        stiffness : float, str or table, [N/m], optional
            Force per length.
        free_length : float, str or table, [m], default 0
            Length at rest.
        force : float, str or table, [N], optional
            In place of stiffness: an expression.
        initial : mapping, optional
            Initial values of ``v``, ``f``, ``s``.

        Examples
        --------
        ::

            scene.translational_spring(
                "k",
                "ground",
                "A",
                stiffness="k",
                free_length="l",
                initial={"s": "s0"},
            )
        """

    def translational_stop(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        line: _Nodes | None = None,
        lower: _Value,
        upper: _Value,
        stiffness: _Value,
        damping: _Value = 0.0,
        transition: _Value = 1e-06,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``translational_stop``: elastic stops at either side of a gap.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint or along a line.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        lower : float, str or table, [m]
            Length at which the lower stop begins.
        upper : float, str or table, [m]
            Length at which the upper stop begins.
        stiffness : float, str or table, [N/m]
            Force per length in contact.
        damping : float, str or table, [N s/m], default 0
            In contact.
        transition : float, str or table, [m], default 1e-06
            Length over which contact sets in.
        initial : mapping, optional
            Initial values of ``v``, ``f``, ``s``.

        Examples
        --------
        ::

            scene.translational_stop(
                "K",
                "ground",
                "A",
                lower="-a",
                upper="a",
                stiffness="k",
                damping="c",
                transition="d",
            )
        """

    def universal(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        axis: _Vector,
        axis2: _Vector,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``universal``.

        Rotation about an axis of the first node, then about one that it has turned.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.theta1`` and so on.
        first, second : str
            Its nodes.
        axis : three of float or str
            Direction in the first node's axes.
        axis2 : three of float or str
            Second direction, in the axes that the first turn has moved.
        initial : mapping, optional
            Initial values of ``theta1``, ``theta1_dot``, ``theta2``, ``theta2_dot``.

        Examples
        --------
        ::

            scene.universal("cross", "A", "B", axis=[0, 0, 1], axis2=["-sin(beta)", "cos(beta)", 0])
        """

    def valve(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        area: _Value,
        opening: _Value,
        coefficient: _Value = 0.62,
        density: _Value = 1000.0,
        transition: _Value = 1.0,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``valve``: an orifice that opens and closes.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.p`` and so on.
        plus, minus : str
            Its nodes.
        area : float, str or table, [m^2]
            Of the opening, when it is open.
        opening : float, str or table
            Share of the area that is open.
        coefficient : float, str or table, default 0.62
            Of discharge.
        density : float, str or table, [kg/m^3], default 1000
            Of the liquid.
        transition : float, str or table, [Pa], default 1
            Below it the law is smoothed.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``p``, ``q``.

        Examples
        --------
        ::

            scene.valve("V", "n", "ground", area="a", opening="sin(t)**2", coefficient=0.6)
        """

    def vccs(
        self,
        name: str,
        /,
        *nodes: str,
        control: _Nodes | None = None,
        output: _Nodes | None = None,
        transconductance: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``vccs``: current in proportion to a voltage elsewhere.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.control.v`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        control : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        output : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        transconductance : float, str or table, [S]
            Current per voltage.
        initial : mapping, optional
            Initial values of ``control.v``, ``control.i``, ``output.v``, ``output.i``.

        Examples
        --------
        ::

            scene.vccs("G1", control=["b", "ground"], output=["ground", "c"], transconductance="g")
        """

    def vcvs(
        self,
        name: str,
        /,
        *nodes: str,
        control: _Nodes | None = None,
        output: _Nodes | None = None,
        gain: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``vcvs``: voltage in proportion to a voltage elsewhere.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.control.v`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        control : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        output : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        gain : float, str or table
            Voltage per voltage.
        initial : mapping, optional
            Initial values of ``control.v``, ``control.i``, ``output.v``, ``output.i``.

        Examples
        --------
        ::

            scene.vcvs("E1", "b", "c", gain="A")
        """

    def velocity_source(
        self,
        name: str,
        first: str = ...,
        second: str = ...,
        /,
        *,
        joint: str | None = None,
        velocity: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``velocity_source``: given velocity.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        first, second : str
            Its nodes; none where it acts on a joint.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        velocity : float, str or table, [m/s]
            Second node less first.
        initial : mapping, optional
            Initial values of ``v``, ``f``, ``s``.

        Examples
        --------
        ::

            scene.velocity_source("drive", "ground", "D", velocity="vs")
        """

    def voice_coil(
        self,
        name: str,
        /,
        *nodes: str,
        electrical: _Nodes | None = None,
        coil: _Nodes | None = None,
        joint: str | None = None,
        line: _Nodes | None = None,
        resistance: _Value,
        inductance: _Value | None = None,
        constant: _Value,
        heat: str | _Nodes | None = None,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``voice_coil``.

        Linear motor or generator with a constant field: a coil in the gap of a magnet.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.i`` and so on.
        *nodes : str
            In place of the entries of its ports: one node of each, the other being the ground.
        electrical : pair of str, optional
            Its nodes in the electrical graph: plus, minus.
        coil : pair of str, optional
            Its nodes in the translational graph: first, second.
        joint : str, optional
            Joint that it acts on in place of two nodes, or its coordinate: h or h.theta.
        line : pair of str, optional
            Two nodes of the multibody system; it acts along their line.
        resistance : float, str or table, [ohm]
            Of the winding.
        inductance : float, str or table, [H], optional
            Of the winding; none where absent.
        constant : float, str or table, [N/A]
            Force per current, and voltage per velocity.
        heat : str or pair of str, optional
            Thermal node that takes up its loss, or two.
        initial : mapping, optional
            Initial values of ``i``, ``f``, ``s``, ``electrical.v``, ``electrical.i``,
            ``coil.v``, ``coil.f``, ``coil.s``.

        Examples
        --------
        ::

            scene.voice_coil(
                "M",
                electrical=["a", "ground"],
                joint="rail",
                resistance=2.5,
                inductance=1.0,
                constant=1.0,
            )
        """

    def voltage_source(
        self,
        name: str,
        plus: str,
        minus: str,
        /,
        *,
        voltage: _Value,
        initial: _Initial | None = None,
    ) -> None:
        """Add a ``voltage_source``: given voltage.

        Parameters
        ----------
        name : str
            Name of the edge; its variables are called ``name.v`` and so on.
        plus, minus : str
            Its nodes.
        voltage : float, str or table, [V]
            Plus minus minus.
        initial : mapping, optional
            Initial values of ``v``, ``i``.

        Examples
        --------
        ::

            scene.voltage_source("V1", "a", "ground", voltage="k*t")
        """

    def weld(
        self,
        name: str,
        first: str,
        second: str,
        /,
        *,
        rotation: _Rotation | None = None,
    ) -> None:
        """Add a ``weld``: holds the second node to the first.

        Parameters
        ----------
        name : str
            Name of the edge.
        first, second : str
            Its nodes.
        rotation : three angles, or a matrix, [rad], optional
            Of the second node: roll, pitch and yaw about the first node's axes, or a matrix.

        Examples
        --------
        ::

            scene.weld("slope", "ground", "I", rotation=[0, 0, "-alpha"])
        """
