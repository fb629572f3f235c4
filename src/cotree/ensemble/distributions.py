"""Distributions of members by short names, or as frozen distributions of scipy.stats."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.errors import ParameterError, brief, nearest
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

#: Names of distributions with their numbers, for messages.
KINDS: Mapping[str, tuple[str, ...]] = {
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
    "triangular": ("low", "mode", "high"),
    "normal": ("mean", "deviation"),
    "truncated": ("mean", "deviation", "low", "high"),
    "lognormal": ("median", "factor"),
    "relative": ("share",),
}


@dataclass(frozen=True, eq=False)
class Distribution:
    """A distribution of one column.

    Attributes
    ----------
    quantiles : callable
        From probabilities to values.
    told : list of object
        Its kind and numbers, as JSON takes them.
    """

    quantiles: Callable[[Any], Any]
    told: list[Any]


def read_distribution(given: Any, name: str, own: Callable[[], float]) -> Distribution:
    """Read a distribution.

    Parameters
    ----------
    given : sequence or distribution of scipy.stats
        Its kind and numbers, or a frozen distribution.
    name : str
        What is distributed, for messages.
    own : callable
        Gives the value that the model has.

    Raises
    ------
    ParameterError
        If there is no such distribution, or its numbers make no sense.
    """
    if not isinstance(name, str):
        raise ParameterError(f"sample has the name {brief(repr(name))}: give it as text")
    what = f"the distribution of '{brief(name)}'"
    quantiles = getattr(given, "ppf", None) or getattr(given, "icdf", None)
    if quantiles is not None and hasattr(given, "mean") and not hasattr(given, "shapes"):
        return Distribution(quantiles, [_told(given)])
    is_row = isinstance(given, Sequence) and not isinstance(given, str) and len(given) > 0
    if not is_row or not isinstance(given[0], str):
        raise ParameterError(
            f'{what} is {brief(repr(given))}: give a tuple such as ("uniform", 0.9, 1.1), or a '
            "frozen distribution of scipy.stats"
        )
    kind, *rest = given
    if kind not in KINDS:
        raise ParameterError(f"{what} is of the unknown kind '{brief(kind)}'{nearest(kind, KINDS)}")
    wanted = KINDS[kind]
    if len(rest) != len(wanted):
        raise ParameterError(
            f'{what} is {brief(repr(given))}: give ("{kind}", {", ".join(wanted)})'
        )
    numbers = [
        check_number(value, f"{label} of {what}") for label, value in zip(wanted, rest, strict=True)
    ]
    return Distribution(_frozen(kind, numbers, what, own).ppf, [kind, *numbers])


def _frozen(kind: str, numbers: Sequence[float], what: str, own: Callable[[], float]) -> Any:
    """Give the frozen distribution of scipy.stats of a kind."""
    from scipy import stats

    if kind == "relative":
        (share,), centre = numbers, own()
        if not share > 0.0 or centre == 0.0:
            raise ParameterError(
                f"{what} is relative by {share:g} to the model's value {centre:g}: "
                "both must differ from zero, and the share must be positive"
            )
        half = share * abs(centre)
        return stats.uniform(centre - half, 2.0 * half)
    if kind in ("normal", "truncated") and not numbers[1] > 0.0:
        raise ParameterError(f"{what} has the deviation {numbers[1]:g}: it must be positive")
    if kind == "normal":
        return stats.norm(*numbers)
    if kind == "lognormal":
        median, factor = numbers
        if not (median > 0.0 and factor > 1.0):
            raise ParameterError(
                f"{what} has the median {median:g} and the factor {factor:g}: give a positive "
                "median, and a factor above 1"
            )
        return stats.lognorm(math.log(factor), scale=median)
    low, high = (numbers[0] if kind != "truncated" else numbers[2]), numbers[-1]
    if not low < high:
        raise ParameterError(f"{what} goes from {low:g} to {high:g}: give the smaller number first")
    if kind == "uniform":
        return stats.uniform(low, high - low)
    if kind == "loguniform":
        if not low > 0.0:
            raise ParameterError(f"{what} begins at {low:g}: its bounds must be positive")
        return stats.loguniform(low, high)
    if kind == "triangular":
        mode = numbers[1]
        if not low <= mode <= high:
            raise ParameterError(f"{what} has its mode {mode:g} outside {low:g} to {high:g}")
        return stats.triang((mode - low) / (high - low), low, high - low)
    mean, deviation = numbers[:2]
    return stats.truncnorm((low - mean) / deviation, (high - mean) / deviation, mean, deviation)


def _told(given: Any) -> str:
    """Name a frozen distribution with its arguments."""
    kind = getattr(getattr(given, "dist", None), "name", None)
    if kind is None:
        return brief(repr(given), 200)
    return f"{kind}{(*given.args, *given.kwds.items())}"
