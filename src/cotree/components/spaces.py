"""Motion spaces of bodies in the tree: absolute coordinates."""

from __future__ import annotations

from cotree.components.component import Freedom, FreeRotation, MotionStep

#: The axes that follow each normal cyclically.
PLANE_AXES = {"z": ("x", "y"), "x": ("y", "z"), "y": ("z", "x")}


def body_space(plane: str, is_particle: bool, line: str = "") -> tuple[MotionStep, ...]:
    """Give the motion space of a body in the tree: along a line, in a plane, or free.

    Parameters
    ----------
    plane : {'', 'x', 'y', 'z'}
        Normal of the plane that it moves in; empty where it moves in space.
    is_particle : bool
        Whether it has no inertia to rotation, so that its orientation does not matter.
    line : {'', 'x', 'y', 'z'}
        Direction of the line that it moves along; empty where there is none.

    Returns
    -------
    tuple of MotionStep
        Translations first, then the rotation.
    """
    # The order of translations and rotation is the order of the coordinates among the states.
    if line:
        return (Freedom(line, "m", rotates=False, axis=line),)
    if plane:
        # Coordinates are called x and y in every plane; only their axes depend on the normal.
        sliding = tuple(
            Freedom(name, "m", rotates=False, axis=axis)
            for name, axis in zip("xy", PLANE_AXES[plane], strict=True)
        )
        return sliding if is_particle else (*sliding, Freedom("theta", "rad", True, plane))
    sliding = tuple(Freedom(name, "m", False, name, rate=f"v{name}") for name in "xyz")
    return sliding if is_particle else (*sliding, FreeRotation())
