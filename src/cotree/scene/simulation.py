"""Default settings of a run, and the point at which it begins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cotree.errors import SceneError, check_known
from cotree.naming import check_path, check_text
from cotree.scene.expressions import Expression, check_number, parse
from cotree.tolerances import rtol_fault

#: Starts of a run: the initial values of its states, or the point at which nothing moves.
INITIAL, OPERATING_POINT = "initial values", "operating point"

_POSITIVE = ("t_end", "rtol", "atol")


@dataclass(frozen=True)
class Simulation:
    """Default settings of a run.

    Attributes
    ----------
    t_end, rtol, atol, method
        End time, [s], tolerances and method.
    start : {"initial values", "operating point"}
        The state in which it begins. At its operating point an electrical network rests with what
        its sources give at the start: no current flows into capacitors, no voltage is across
        inductors.
    held : tuple of (str, Expression)
        Nodes whose voltages are held during the search for the operating point, then released.
    """

    t_end: float = 10.0
    rtol: float = 1e-8
    atol: float = 1e-10
    method: str = "auto"
    start: str = INITIAL
    held: tuple[tuple[str, Expression], ...] = ()


def with_settings(old: Simulation, settings: Mapping[str, Any]) -> Simulation:
    """Change some settings.

    Parameters
    ----------
    old : Simulation
        The settings so far.
    settings : mapping of str to object
        Those to change, by name.

    Raises
    ------
    SceneError, ExpressionError
        If a setting is unknown or has no sensible value.
    """
    known = Simulation.__dataclass_fields__
    # The settings are frozen; a changed copy leaves those that others hold.
    changed = dict(vars(old))
    check_known(settings, known, "simulation has no setting")
    for key, value in settings.items():
        what = f"{key} of the simulation"
        if key in _POSITIVE:
            value = check_number(value, what)
            if value <= 0.0:
                raise SceneError(f"{what} is {value}: it must be positive")
        if key == "rtol" and rtol_fault(value):
            raise SceneError(f"of the simulation {rtol_fault(value)}")
        if key in ("method", "start"):
            value = check_text(value, what)
        if key == "start" and value not in (INITIAL, OPERATING_POINT):
            raise SceneError(f"{what} is '{value}': give '{INITIAL}' or '{OPERATING_POINT}'")
        changed[key] = _held(value, what) if key == "held" else value
    made = Simulation(**changed)
    # Nodes are held during the search for an operating point, which initial values do without.
    if made.held and made.start != OPERATING_POINT:
        raise SceneError(f"held of the simulation needs start = '{OPERATING_POINT}'")
    return made


def _held(value: object, what: str) -> tuple[tuple[str, Expression], ...]:
    if not isinstance(value, Mapping):
        raise SceneError(f"{what} must be a table of nodes and voltages")
    return tuple(
        (check_path("node", node), parse(item, f"voltage of node '{node}'"))
        for node, item in value.items()
    )
