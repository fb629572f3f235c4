"""Methods with which scenes add parts and lookup tables."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any, cast

from cotree.errors import SceneError, brief
from cotree.files import read_text
from cotree.scene.description import SceneDescription
from cotree.scene.toml_file import load_part

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path


class PartMethods:
    """Method with which a scene adds a part."""

    def add(
        self,
        name: str,
        part: SceneDescription | str | Path,
        /,
        *,
        count: int | Sequence[int] | None = None,
        index: str | Sequence[str] | None = None,
        nodes: Mapping[str, str] | None = None,
        parameters: Mapping[str, Any] | None = None,
        inputs: Mapping[str, Any] | None = None,
        set: Mapping[str, Any] | None = None,
        **bindings: Any,
    ) -> None:
        """Add a part: a scene whose declarations get names within this scene.

        Parameters
        ----------
        name : str
            Its name, which precedes the names of its declarations, as in ``name.edge.variable``.
        part : Scene, str or Path
            A scene, which is copied, the name of a shipped part, or the path of a TOML file.
        count : int or sequence of int, optional
            Number of parts in an array: ``name1``, ``name2``, ...; for two numbers ``name1_1``, ...
        index : str or sequence of str, optional
            Names of a part's indices in bindings; by default ``i``, ``j`` and ``k``. Node names
            contain indices in braces: ``left="n{i - 1}"``.
        nodes : mapping of str to str, optional
            For each node of the part to connect, the node of this scene. All scenes share the
            ground.
        parameters, inputs : mapping of str to float, str, or table of value and unit, optional
            Values of the part's parameters and inputs: numbers, or expressions with names of this
            scene; inputs may also be tables (times, values). Parameters and inputs that are not
            listed keep their values.
        set : mapping of str to float or str, optional
            Values for individual parts of an array by their full names, ``{"cell3.R": 0.05}``.
        **bindings
            Nodes, parameters and inputs by name, as in the three mappings above.

        Raises
        ------
        ModelError
            If a name is unknown or taken, a port is not connected, or a value is invalid.

        Examples
        --------
        >>> import cotree
        >>> cell = cotree.Scene("cell")
        >>> cell.parameter("R", 1.0)
        >>> cell.edge("series", "resistor", "left", "right", resistance="R")
        >>> cell.edge("shunt", "capacitor", "right", "ground", capacitance=1.0)
        >>> ladder = cotree.Scene("ladder")
        >>> ladder.add("cell", cell, count=3, left="n{i - 1}", right="n{i}", R="0.5*i")
        >>> ladder.edge("source", "voltage_source", "n0", "ground", voltage=1.0)
        >>> ladder.compile().states
        ('cell1.shunt.v', 'cell2.shunt.v', 'cell3.shunt.v')
        """
        from cotree.scene.part_adding import add_part

        if isinstance(part, SceneDescription):
            scene, source = template_of(part), ""
        elif isinstance(part, (str, PathLike)):
            scene, source = load_part(part)
        else:
            raise SceneError(
                f"part '{brief(name)}' is made of {brief(repr(part))}: give a scene, a file, or "
                "the name of a shipped part"
            )
        own = {"count": count, "index": index, "nodes": nodes, "parameters": parameters}
        own |= {"inputs": inputs, "set": set}
        given = {key: value for key, value in own.items() if value is not None}
        add_part(cast("SceneDescription", self), name, scene, {**given, **bindings}, source)


def template_of(scene: SceneDescription) -> SceneDescription:
    """Return an independent copy of a scene that serves as a template of parts."""
    made = SceneDescription(scene.name)
    # The copy is a plain description: equality must not depend on the class of the user's scene.
    made.__dict__.update(scene.copied().__dict__)
    return made


class TableMethods:
    """Method with which a scene adds a lookup table."""

    def table(
        self,
        name: str,
        x: Sequence[float] | None = None,
        y: Sequence[float | str] | None = None,
        values: Sequence[Any] | None = None,
        *,
        file: str | PathLike[str] | None = None,
        interpolation: str = "linear",
        beyond: str = "hold",
        doc: str = "",
    ) -> None:
        """Declare a lookup table, which subsequent expressions may call as a function.

        Parameters
        ----------
        name : str
            Its name in expressions: ``torque(j.omega)``, or ``map(speed, throttle)`` for two
            arguments.
        x : sequence of float, optional
            Values of the first argument, in SI, ascending.
        y : sequence, optional
            For one argument, the values at ``x``: numbers or expressions of parameters. For two
            arguments, values of the second argument, ascending.
        values : sequence, optional
            For two arguments, the values: one row per ``x`` with one number per ``y``. For one
            argument, the values, instead of ``y``.
        file : path, optional
            A CSV file with these data: columns of arguments and values; for two arguments, values
            of the second one in the first line, and of the first one in the first column.
        interpolation : str
            ``linear`` (bilinear for two arguments), or ``monotone`` for one argument: cubic, with a
            continuous slope and without overshoot (Fritsch and Butland).
        beyond : str
            Extrapolation beyond the first and last points: ``hold`` keeps the value at that point;
            ``extend`` keeps the slope or, for two arguments, the outermost bilinear piece.
        doc : str
            Its meaning as text.

        Raises
        ------
        SceneError, ExpressionError
            If the name is invalid or taken, arguments are not ascending, or a value is not finite.

        Examples
        --------
        >>> import cotree
        >>> scene = cotree.Scene("motor")
        >>> scene.table("torque", x=[0, 50, 100], y=[2.0, 2.5, 0.0], interpolation="monotone")
        >>> scene.edge("rotor", "rotational_inertia", "ground", "shaft", inertia=0.1)
        >>> scene.edge("drive", "torque_source", "ground", "shaft", torque="torque(rotor.w)")
        """
        from cotree.scene.tables import LARGEST_POINTS, add_table

        given = {"x": x, "y": y, "values": values, "file": file}
        rest = {"interpolation": interpolation, "beyond": beyond, "doc": doc}
        stated = {key: value for key, value in given.items() if value is not None}
        scene = cast("SceneDescription", self)
        add_table(scene, name, {**stated, **rest}, lambda path: read_text(path, LARGEST_POINTS))
