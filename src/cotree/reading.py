"""Readers of other tools' files, as users call them."""

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

    Links become nodes, joints edges of the same name; torques and forces of joints are inputs
    ``JOINT_torque`` and ``JOINT_force``; masses, centres of mass, moments of inertia, damping,
    friction and gravity are parameters. What was not read, and names that had to change, stand in
    ``scene.origin``.

    Parameters
    ----------
    path : str or Path
        The file.
    base : {"fixed", "free"}
        Whether the root link is welded to the ground, or moves freely as edge ``base``.
    mimic : bool
        Whether joints that mimic others follow them; else they are joints of their own.
    snap : float
        Angles of frames this close, [rad], to a multiple of a quarter turn are taken as that. Files
        often write quarter turns with few digits; exact ones save many operations. Zero, the
        default, takes them as they are written.

    Returns
    -------
    Scene
        The robot at rest, all coordinates zero; gravity of 9.81 m/s^2 along -z.

    Raises
    ------
    SceneError
        If the file cannot be read, or is not a robot; the message begins with file and line.
    """
    return read_urdf_scene(path, Scene, UrdfOptions(base, mimic, snap))


def read_spice(path: str | Path) -> Scene:
    """Read a circuit from a SPICE netlist.

    Nodes and elements keep their names where a scene can have them; values of elements are
    parameters of the same name, those of models ``MODEL_parameter``. Runs begin at the operating
    point, or with ``uic`` at initial values, and end where ``.tran`` says. What was not read, and
    names that had to change, stand in ``scene.origin``; docs/spice.md lists what is known.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    Scene
        The circuit.

    Raises
    ------
    SceneError
        If the file cannot be read, or holds what is not known; the message begins with file and
        line.
    """
    return read_spice_scene(path, Scene)


def read_sbml(path: str | Path) -> Scene:
    """Read a model of reactions from an SBML file, Level 2 or 3.

    Species become edges of the chemical domain, whose states are concentrations or amounts;
    parameters, sizes of compartments and initial values (``A_0`` of a species ``A``) are
    parameters. What changes has an output of its identifier, with the value that formulas of the
    model mean by it; so have rates of reactions. Names that had to change, and what was not read,
    stand in ``scene.origin``; docs/sbml.md lists what is known. Needs python-libsbml, which
    ``pip install cotree[sbml]`` brings.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    Scene
        The model, in the units of the file.

    Raises
    ------
    Error
        If python-libsbml is not installed.
    SceneError
        If the file cannot be read, or holds what is not known; the message begins with file and
        line.
    """
    return read_sbml_scene(path, Scene)
