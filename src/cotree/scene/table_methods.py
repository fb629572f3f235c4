"""The method by which scenes get lookup tables, and its counterpart for scene files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

from cotree.files import read_text
from cotree.scene.tables import LARGEST_POINTS, add_table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

    from cotree.scene.description import SceneDescription


class TableMethods:
    """Lookup tables of a scene."""

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
        """Declare a lookup table, which expressions that are stated later call as a function.

        Parameters
        ----------
        name : str
            Its name in expressions: ``torque(j.omega)``, or ``map(speed, throttle)`` of two
            arguments.
        x : sequence of float
            Ascending arguments, in SI.
        y : sequence of float or str
            Of a table of one argument its values, numbers or expressions of parameters; of a table
            of two arguments the second ones, ascending.
        values : sequence, optional
            Of a table of two arguments its values, a row for each ``x`` with one number for each
            ``y``. Of one argument its values, in place of ``y``.
        file : path, optional
            A CSV file that has all of these: two columns, arguments and values; or, of two
            arguments, the second ones in the first line and the first ones in the first column.
        interpolation : str
            ``linear``, bilinear for two arguments; or ``monotone``, for one argument: cubic, with a
            continuous slope, and without overshoot (Fritsch and Butland).
        beyond : str
            What it is beyond its first and last points: ``hold`` keeps the value there; ``extend``
            goes on with the slope there, of two arguments with the outermost bilinear piece.
        doc : str
            Its meaning, for people.

        Raises
        ------
        SceneError, ExpressionError
            If the name is not allowed or taken, arguments do not ascend, or a value is not finite.

        Examples
        --------
        >>> import cotree
        >>> scene = cotree.Scene("motor")
        >>> scene.table("torque", x=[0, 50, 100], y=[2.0, 2.5, 0.0], interpolation="monotone")
        >>> scene.edge("rotor", "rotational_inertia", "ground", "shaft", inertia=0.1)
        >>> scene.edge("drive", "torque_source", "ground", "shaft", torque="torque(rotor.w)")
        """
        given = {"x": x, "y": y, "values": values, "file": file}
        rest = {"interpolation": interpolation, "beyond": beyond, "doc": doc}
        stated = {key: value for key, value in given.items() if value is not None}
        scene = cast("SceneDescription", self)
        add_table(scene, name, {**stated, **rest}, lambda path: read_text(path, LARGEST_POINTS))
