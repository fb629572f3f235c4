"""Settings of runs: their types, units, defaults and checks.

To add a setting, add a line to ``Settings`` and, for editors, its type to ``SettingsDict``.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple, TypedDict, TypeVar

import numpy as np
import numpy.typing as npt

from cotree.arguments import by_name, check_mapping, doubles
from cotree.errors import ParameterError, SceneError, SolveError, brief, check_known, nearest
from cotree.methods import METHODS, names_of
from cotree.naming import check_path, check_text
from cotree.scene.expressions import Expression, check_number, parse
from cotree.tolerances import rtol_fault

FloatArray = npt.NDArray[np.float64]

_F = TypeVar("_F", bound=Callable[..., Any])


#: Default limits of the numbers of steps and events in a run.
MOST_STEPS, MOST_EVENTS = 1_000_000, 100_000

#: Maximum number of steps of a run in an estimation: runs of models that become stiff fail early.
STEPS_OF_FIT = 100_000


class OtherSettings(TypedDict, total=False):
    """Settings of ``simulate`` in addition to its named arguments; see :class:`Settings`."""

    error_test_sensitivities: bool
    scales: Mapping[str, float] | None
    max_step: float | None
    max_steps: float | None
    max_events: float | None
    time_limit: float | None
    project: bool


class SettingsDict(OtherSettings, total=False):
    """Settings of studies that consist of many runs; see :class:`Settings`."""

    rtol: float | None
    atol: float | None


class SettingRow(NamedTuple):
    """Documentation, check and command-line option of a setting."""

    doc: str  # documentation of the setting
    #: Function ``check(value, name)``, which returns the value to be stored or raises an error.
    check: Callable[[Any, str], Any]
    #: Help text of the command-line option, in which ``{}`` is the default; "" for no option.
    option: str = ""
    metavar: str | None = None  # placeholder for the value in the help text
    flag: str = ""  # name of the option; "" for the name of the setting
    in_scenes: bool = True  # whether scene files may contain the setting


def _setting(default: Any, doc: str, check: Callable[[Any, str], Any], **more: Any) -> Any:
    about = {"row": SettingRow(doc, check, **more)}
    if isinstance(default, dict):
        return field(default_factory=dict, metadata=about)
    return field(default=default, metadata=about)


def _quoted(family: str) -> str:
    return f"``{names_of(family).replace(', ', '``, ``')}``"


def _values(value: Any, name: str) -> Any:
    return by_name(value)  # the model checks names and shape


# Maximum number of output times in a run; it guards against typing errors.
_MOST_POINTS = 10_000_000


def _span(value: Any, name: str) -> tuple[float, float]:
    try:
        start, end = value
    except (TypeError, ValueError):
        raise SolveError(f"{name} must be a pair (start, end)") from None
    start, end = check_number(start, f"start of {name}"), check_number(end, f"end of {name}")
    if start == end:
        raise SolveError(f"The time span is empty: it starts and ends at t = {start:g}.")
    return start, end


def _times(value: Any, name: str) -> FloatArray | int | None:
    if value is None:
        return None
    if isinstance(value, int) and not isinstance(value, bool):
        if not 2 <= value <= _MOST_POINTS:
            raise SolveError(
                f"{name} is {brief(value)}: give at least 2 points and at most {_MOST_POINTS} "
                "points, or times"
            )
        return value
    if np.ndim(value) == 0:
        raise SolveError(f"{name} is {brief(repr(value))}: give a whole number of points, or times")
    times = doubles(value)
    if times is None:
        raise SolveError(f"{name} must be a sequence of numbers")
    if times.ndim != 1 or times.size == 0:
        raise SolveError(f"{name} must be a sequence of at least one time, or None.")
    if not np.all(np.isfinite(times)):
        raise SolveError(f"{name} holds a time that is not finite.")
    return times


def _method(value: Any, name: str) -> str:
    if not isinstance(value, str):
        raise SolveError(f"{name} is {brief(repr(value))}: give a name in quotes")
    return value


def _rtol(value: Any, name: str) -> float:
    number = check_number(value, name)
    if fault := rtol_fault(number):
        raise SolveError(f"{fault}.")
    return number


def _positive(value: Any, name: str, what: str = "a positive finite number") -> float:
    number = check_number(value, name)
    if not number > 0.0:
        raise SolveError(f"{name} is {number}; give {what}.")
    return number


def _flag(value: Any, name: str) -> bool:
    if not isinstance(value, bool):
        raise ParameterError(f"{name} is {brief(repr(value))}: give True or False")
    return value


def _wanted(value: Any, name: str) -> bool:
    if not isinstance(value, bool):
        raise ParameterError(
            f"{name} is {brief(repr(value))}: give True or False; parameters of sensitivity are "
            "chosen when a scene is compiled"
        )
    return value


def _longest_step(value: Any, name: str) -> float | None:
    if value is None or value == math.inf:
        return None if value is None else math.inf
    return _positive(value, name, "positive seconds, or inf for none")


def _seconds(value: Any, name: str) -> float | None:
    if value is None or value == math.inf:
        return None
    return _positive(value, name, "positive seconds or None")


def _count(value: Any, name: str) -> int | None:
    if value is None or value == math.inf:
        return None
    number = check_number(value, name)
    if not number > 0.0:
        raise SolveError(f"{name} is {value}; give a positive number or None.")
    if not number.is_integer():
        raise ParameterError(f"{name} is {value}: give a whole number")
    return int(number)


@dataclass(frozen=True)
class Settings:
    """The settings of a run.

    Values are checked when an object is created, and NumPy scalars become Python numbers.
    ``model.simulate(t_span, **settings)``, ``ensemble``, ``fit``, ``optimise`` and others accept
    method, tolerances, budgets and other settings as keyword arguments.

    Attributes
    ----------
    **settings
        The settings.
    """

    t_span: tuple[float, float] = _setting(
        (0.0, 10.0), "Start and end, [s]; by default from zero to the scene's ``t_end``.", _span
    )
    t_eval: Any = _setting(  # noqa: RUF009 - a field
        None,
        "Output times, shape (n_t,), [s], or their number, evenly spaced over the span. By "
        "default the solver's steps; only every second, fourth, ... one is stored if all "
        "of them would take more than 256 MiB.",
        _times,
    )
    method: str = _setting(
        "auto",
        f"{_quoted('cotree')} (in C), {_quoted('scipy')} (SciPy, for models without events, "
        f"kinks, constraints and algebraic unknowns), {_quoted('sundials')}, and as an extra "
        f"{_quoted('correctors')} (SUNDIALS), or ``auto``; by default the scene's.",
        _method,
        option=f"Integration method: {', '.join(METHODS)} or auto.",
    )
    rtol: float = _setting(
        1e-8,
        "Relative tolerance; by default the scene's.",
        _rtol,
        option="Relative tolerance.",
    )
    atol: float = _setting(
        1e-10,
        "Absolute tolerance; by default the scene's.",
        _positive,
        option="Absolute tolerance.",
    )
    parameters: Any = _setting(  # noqa: RUF009 - a field
        None,
        "Values that replace the scene's, by name or as an array of shape (n_parameters,).",
        _values,
        option="Value of a parameter; may be repeated.",
        metavar="NAME=NUMBER",
        flag="--set",
        in_scenes=False,
    )
    initial: Mapping[str, float] = _setting(
        {},
        "Initial values of states that replace the scene's. They depend on no parameter unless "
        'their sensitivities are given, too, as ``"d(STATE)/d(PARAMETER)"``, so that a run can '
        "continue from the end of another one.",
        check_mapping,
        option="Initial value of a state; may be repeated.",
        metavar="STATE=NUMBER",
        in_scenes=False,
    )
    inputs: Mapping[str, Any] = _setting(
        {},
        "Inputs that replace the scene's: a number, (times, values), a Python function of t, or an "
        "expression of t, parameters, states, outputs and other variables that fields may name. "
        "Expressions are compiled into the model at their first use. New parameters in them, "
        "such as gains, get their values by ``parameters``; for sensitivities to them compile "
        "``scene.with_inputs(...)``.",
        check_mapping,
        option="Replace an input by a number or by an expression of t, parameters, states and "
        "outputs; may be repeated. --set assigns values to new names in the expression.",
        metavar="NAME=VALUE",
        flag="--input",
        in_scenes=False,
    )
    sensitivities: bool = _setting(
        True,
        "Whether the sensitivities that the model was compiled with are integrated. If not, the "
        "result has none, and the run takes as long as that of a model without them.",
        _wanted,
        in_scenes=False,
    )
    throw: bool = _setting(
        False,
        "Raise SolveError if the integration fails; by default it warns, and "
        "``result.status`` is negative.",
        _flag,
        in_scenes=False,
    )
    error_test_sensitivities: bool = _setting(
        True, "Whether sensitivities take part in the error test.", _flag
    )
    scales: Mapping[str, float] = _setting(
        {},
        "Scales of parameters: ``atol`` divided by the scale is the absolute tolerance of the "
        "sensitivities to a parameter. By default the magnitude of its value, and one for "
        "parameters of value zero and for initial values.",
        check_mapping,
        in_scenes=False,
    )
    max_step: float | None = _setting(
        None,
        "Longest step, [s]; infinity for no limit. The default is a 32nd of the shortest period if "
        "sines of time drive elements that act during a part of it, as diodes do; otherwise none.",
        _longest_step,
    )
    max_steps: int | None = _setting(
        MOST_STEPS,
        "Budget of steps; None or infinity for no limit. A run that exceeds a budget stops with "
        "its results so far; the message names a state that grows without bound, if there is one.",
        _count,
        option="Maximum number of steps of a run, or inf. Default: {}.",
        metavar="N",
    )
    max_events: int | None = _setting(
        MOST_EVENTS,
        "Budget of events; None or infinity for no limit.",
        _count,
        option="Maximum number of events of a run, or inf. Default: {}.",
        metavar="N",
    )
    time_limit: float | None = _setting(
        3600.0,
        "Budget of computing time, [s]; None or infinity for no limit.",
        _seconds,
        option="Maximum computing time of a run in s, or inf. Default: {:g}.",
        metavar="S",
    )
    project: bool = _setting(
        True,
        "Project states and sensitivities onto the constraints. Otherwise drift is limited by the "
        "tolerances, or by ``baumgarte``.",
        _flag,
    )

    def __post_init__(self) -> None:
        for name, row in ROWS.items():
            object.__setattr__(self, name, row.check(in_python(getattr(self, name)), name))
        if isinstance(self.t_eval, int):
            object.__setattr__(self, "t_eval", np.linspace(*self.t_span, self.t_eval))
        _check_order(self.t_span, self.t_eval)

    def keys(self) -> tuple[str, ...]:
        """Return the names of the settings that ``**settings`` passes."""
        return SHARED

    def __getitem__(self, name: str) -> Any:
        if name not in ROWS:
            raise KeyError(name)
        return getattr(self, name)


def _check_order(t_span: tuple[float, float], times: FloatArray | None) -> None:
    """Raise if times are outside the time span or do not follow its direction."""
    if times is None:
        return
    start, end = t_span
    outside = times[(times < min(start, end)) | (times > max(start, end))]
    if outside.size:
        raise SolveError(
            f"t_eval holds t = {outside[0]:g}, outside the time span ({start:g}, {end:g})."
        )
    # Outputs are stored in the order of the steps, so times must have the direction of the run.
    direction = math.copysign(1.0, end - start)
    if np.any(direction * np.diff(times) <= 0):
        order = "increase" if direction > 0 else "decrease"
        raise SolveError(f"t_eval must strictly {order}, as the time span does.")


#: Documentation, check and option of each setting, by its name.
ROWS: Mapping[str, SettingRow] = {item.name: item.metadata["row"] for item in fields(Settings)}

#: Settings that all studies accept: method, tolerances, budgets and others.
SHARED = ("method", "rtol", "atol", *OtherSettings.__annotations__)

# Settings for which None is a value; for all others, None selects the default.
_OPTIONAL = {item.name for item in fields(Settings) if "None" in str(item.type)}


def in_python(value: Any) -> Any:
    """Return a NumPy scalar, or an array without axes, as a Python number."""
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and not value.ndim):
        return value.item()
    return value


def documented(kind: _F) -> _F:
    """Replace the entry ``**settings`` in a docstring by the documentation of all settings."""

    def rows(entry: re.Match[str]) -> str:
        margin, lines = entry[1], []
        for item in fields(Settings):
            text = textwrap.wrap(ROWS[item.name].doc, 100 - len(margin) - 4)
            lines += [f"{margin}{item.name} : {item.type}", *(f"{margin}    {row}" for row in text)]
        return "\n".join([*lines, ""])

    if kind.__doc__:  # under -OO there are no docstrings
        kind.__doc__ = _ENTRY.sub(rows, kind.__doc__)
    return kind


_ENTRY = re.compile(r"^( *)(?:\S[^\n]*)?\*\*settings\n(?:\1 +[^\n]*\n)*", re.MULTILINE)
documented(Settings)


def settings_from(defaults: Simulation, given: Mapping[str, Any]) -> Settings:
    """Return the settings of a call; settings that it omits have the scene's defaults."""
    if not given.keys() <= ROWS.keys():
        name = next(name for name in given if name not in ROWS)
        raise TypeError(f"there is no setting '{name}'{nearest(name, ROWS)}")
    own = {name: v for name, v in given.items() if v is not None or name in _OPTIONAL}
    return Settings(**{name: getattr(defaults, name) for name in ROWS} | own)


#: Kinds of starts: initial values of the states, or the operating point, where rates are zero.
INITIAL, OPERATING_POINT = "initial values", "operating point"


@dataclass(frozen=True)
class Simulation(Settings):
    """The defaults of a scene's runs, and the state in which they begin."""

    #: Kind of the start. At the operating point, an electrical network is at rest with the initial
    #: values of its sources: capacitors have no current, and inductors have no voltage.
    start: str = INITIAL
    #: Nodes and their voltages, which are prescribed only while the operating point is computed.
    held: tuple[tuple[str, Expression], ...] = ()

    @property
    def t_end(self) -> float:
        """The end time, [s]."""
        return self.t_span[1]


#: Settings that scenes may contain.
OF_SCENES = ("t_end", *(name for name in SHARED if ROWS[name].in_scenes), "start", "held")


def with_settings(old: Simulation, settings: Mapping[str, Any]) -> Simulation:
    """Return changed settings; raise SceneError or ExpressionError for invalid names or values."""
    check_known(settings, OF_SCENES, "simulation has no setting")
    changed = dict(settings)
    if "t_end" in changed:
        what = "t_end of the simulation"
        end = check_number(changed.pop("t_end"), what)
        if end <= 0.0:
            raise SceneError(f"{what} is {end}: it must be positive")
        changed["t_span"] = (0.0, end)
    if "start" in changed:
        what = "start of the simulation"
        start = check_text(changed["start"], what)
        if start not in (INITIAL, OPERATING_POINT):
            raise SceneError(f"{what} is '{start}': give '{INITIAL}' or '{OPERATING_POINT}'")
    if "held" in changed:
        changed["held"] = _held(changed["held"])
    try:
        # Settings are immutable and may be shared, so the change is made in a copy.
        made = replace(old, **changed)
    except (ParameterError, SolveError) as error:
        raise SceneError(f"of the simulation {str(error).rstrip('.')}") from None
    # Node voltages can be prescribed only while an operating point is computed.
    if made.held and made.start != OPERATING_POINT:
        raise SceneError(f"held of the simulation needs start = '{OPERATING_POINT}'")
    return made


def _held(value: object) -> tuple[tuple[str, Expression], ...]:
    if not isinstance(value, Mapping):
        raise SceneError("held of the simulation must be a table of nodes and voltages")
    return tuple(
        (check_path("node", node), parse(item, f"voltage of node '{node}'"))
        for node, item in value.items()
    )
