"""Functions that read files of other tools."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.api import Scene
from cotree.readers.sbml.scene import read_sbml_scene
from cotree.readers.spice.scene import read_spice_scene
from cotree.readers.urdf.scene import UrdfOptions, read_urdf_scene

if TYPE_CHECKING:
    from pathlib import Path


def read_urdf(
    path: str | Path, base: str = "fixed", mimic: bool = True, *, snap: float = 0.0
) -> Scene:
    """Read a robot from a URDF file.

    Links become nodes, and joints become edges of the same name. Torques and forces of joints are
    inputs ``JOINT_torque`` and ``JOINT_force``. Masses, centres of mass, moments of inertia,
    damping, friction and gravity, 9.81 m/s^2 along -z, are parameters. All coordinates start at
    zero. ``scene.origin`` lists ignored elements and changed names.

    Parameters
    ----------
    base : {"fixed", "free"}
        Whether the root link is welded to the ground, or has a free joint named ``base``.
    mimic : bool
        Whether joints that mimic others follow them; otherwise they are independent.
    snap : float
        Angles of frames closer than this, [rad], to a multiple of a quarter turn are rounded to it.
        Files often have quarter turns with few digits; exact ones save many operations. By default,
        zero, angles are not rounded.

    Raises
    ------
    SceneError
        If the file cannot be read or does not describe a robot; the message begins with file and
        line.
    """
    return read_urdf_scene(path, Scene, UrdfOptions(base, mimic, snap))


def read_spice(path: str | Path) -> Scene:
    """Read a circuit from a SPICE netlist.

    Nodes and elements keep their names if these are valid in scenes. Values of elements are
    parameters of the same name, those of models ``MODEL_parameter``. Runs begin at the operating
    point, or with ``uic`` at the initial values, and end at the time of ``.tran``. ``scene.origin``
    lists ignored statements and changed names; docs/spice.md lists the supported ones.

    Raises SceneError, beginning with file and line, if the file cannot be read or has unsupported
    contents.
    """
    return read_spice_scene(path, Scene)


def read_sbml(path: str | Path) -> Scene:
    """Read a reaction model from an SBML file, Level 2 or 3.

    Species become edges of the chemical domain, whose states are concentrations or amounts.
    Parameters, sizes of compartments and initial values (``A_0`` of a species ``A``) are
    parameters. Variables and rates of reactions are outputs under their identifiers, with the
    values that they have in formulas of the model. ``scene.origin`` lists ignored elements and
    changed names; docs/sbml.md lists the supported elements. The scene has the units of the file.

    Raises SceneError, beginning with file and line, if the file cannot be read or has unsupported
    contents, and Error without python-libsbml, which ``pip install cotree[sbml]`` installs.
    """
    return read_sbml_scene(path, Scene)
