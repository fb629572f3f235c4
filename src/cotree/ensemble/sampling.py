"""Sampling of members from distributions, randomly or by low-discrepancy sequences."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.arguments import check_choice, check_whole
from cotree.errors import ParameterError, brief, check_known, nearest
from cotree.model.model import CompiledModel
from cotree.model.start import scene_start
from cotree.report import frame
from cotree.scene.description import SceneDescription
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from cotree.solvers.result import FloatArray


#: Argument names of each distribution, for messages.
KINDS: Mapping[str, tuple[str, ...]] = {
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
    "triangular": ("low", "mode", "high"),
    "normal": ("mean", "deviation"),
    "truncated": ("mean", "deviation", "low", "high"),
    "lognormal": ("median", "factor"),
    "relative": ("share",),
}


def read_distribution(
    given: Any, name: str, own: Callable[[], float]
) -> tuple[Callable[[Any], Any], list[Any]]:
    """Return the quantile function of a distribution and its description as JSON values."""
    if not isinstance(name, str):
        raise ParameterError(f"sample has the name {brief(repr(name))}: give it as text")
    what = f"the distribution of '{brief(name)}'"
    quantiles = getattr(given, "ppf", None) or getattr(given, "icdf", None)
    if quantiles is not None and hasattr(given, "mean") and not hasattr(given, "shapes"):
        return quantiles, [_described(given)]
    is_row = isinstance(given, Sequence) and not isinstance(given, str) and len(given) > 0
    if not is_row or not isinstance(given[0], str):
        raise ParameterError(
            f'{what} is {brief(repr(given))}: give a tuple such as ("uniform", 0.9, 1.1), or a '
            "frozen distribution of scipy.stats"
        )
    kind, *rest = given
    check_known([kind], KINDS, f"{what} is of the unknown kind", error=ParameterError)
    wanted = KINDS[kind]
    if len(rest) != len(wanted):
        raise ParameterError(
            f'{what} is {brief(repr(given))}: give ("{kind}", {", ".join(wanted)})'
        )
    numbers = [
        check_number(value, f"{label} of {what}") for label, value in zip(wanted, rest, strict=True)
    ]
    return _frozen(kind, numbers, what, own).ppf, [kind, *numbers]


def _frozen(kind: str, numbers: Sequence[float], what: str, own: Callable[[], float]) -> Any:
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


def _described(given: Any) -> str:
    """Describe a frozen distribution by its name and arguments."""
    kind = getattr(getattr(given, "dist", None), "name", None)
    if kind is None:
        return brief(repr(given), 200)
    return f"{kind}{(*given.args, *given.kwds.items())}"


#: Methods of drawing points from the unit cube.
METHODS = ("sobol", "latin", "halton", "random")

# Maximum number of points of scipy's Sobol sequence.
_MOST = 2**30


@dataclass(frozen=True, eq=False)
class Samples(Mapping[str, "FloatArray"]):
    """Sampled members, a mapping of names to arrays of shape (n,)."""

    columns: Mapping[str, FloatArray]  # sampled values by name
    #: Method, seed and distributions of the sample; stored in the results.
    origin: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> FloatArray:
        return self.columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(self.columns)

    def __repr__(self) -> str:
        n = len(next(iter(self.columns.values())))
        how = f"{self.origin['method']}, seed {self.origin['seed']}"
        return f"<Samples of {n} members, {how}: {', '.join(self.columns)}>"

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with a row for each member."""
        return frame(dict(self.columns))


def sample(
    source: Any,
    distributions: Mapping[str, Any],
    n: int,
    *,
    method: str = "sobol",
    seed: int | None = None,
) -> Samples:
    """Draw ``n`` members from independent distributions.

    Parameters
    ----------
    source : Model or Scene
        Model or scene, to whose values ``relative`` distributions refer.
    distributions : mapping of str to tuple, or distribution of scipy.stats
        For parameters, and initial values of states: ``("uniform", low, high)``,
        ``("loguniform", low, high)``, ``("triangular", low, mode, high)``,
        ``("normal", mean, deviation)``, ``("truncated", mean, deviation, low, high)``,
        ``("lognormal", median, factor)``, whose logarithm has the deviation log(factor),
        ``("relative", share)``, uniform within this fraction of the model's value, or any frozen
        distribution, such as ``scipy.stats.weibull_min(2.0)``.
    method : {"sobol", "latin", "halton", "random"}
        Scrambled Sobol or Halton points, a Latin hypercube, or independent points. The first
        three cover the space more evenly, so that means converge faster. Use a power of 2 for
        Sobol points.
    seed : int, optional
        Equal seeds yield equal members. By default a seed is drawn; it is stored in ``origin``.

    Returns
    -------
    Samples
        For ``members`` of :meth:`cotree.Model.ensemble`.

    Raises
    ------
    ParameterError
        If a distribution, the number or the method is invalid.

    Examples
    --------
    >>> import cotree
    >>> model = cotree.load("slider-pendulum").compile()
    >>> drawn = cotree.sample(model, {"L": ("relative", 0.1), "k": ("normal", 50, 5)}, 8, seed=1)
    >>> bool(((drawn["L"] >= 0.9) & (drawn["L"] <= 1.1)).all())
    True
    """
    source = getattr(source, "kernels", source)
    if not isinstance(source, (CompiledModel, SceneDescription)):
        raise ParameterError(f"sample takes a model or a scene first, not {brief(repr(source))}")
    if not isinstance(distributions, Mapping) or not distributions:
        raise ParameterError(
            'sample takes a mapping of names to distributions: {"L": ("uniform", 0.9, 1.1)}'
        )
    if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or not 1 <= n <= _MOST:
        raise ParameterError(
            f"the number of members is {brief(repr(n))}: give a whole number of at least 1"
        )
    check_choice(method, "the method of drawing", METHODS)
    if seed is None:  # choose a seed, so that the sample can be repeated
        seed = int(np.random.SeedSequence().generate_state(1)[0])
    seed = check_whole(seed, "the seed")
    read = {
        name: read_distribution(given, name, partial(own_value, source, name))
        for name, given in distributions.items()
    }
    points = unit_points(method, int(n), len(read), seed)
    columns = {
        name: _finite(quantiles(points[:, j]), name)
        for j, (name, (quantiles, _)) in enumerate(read.items())
    }
    described = {name: description for name, (_, description) in read.items()}
    origin = {"method": method, "seed": seed, "n": int(n), "distributions": described}
    return Samples(columns, origin)


def own_value(source: CompiledModel | SceneDescription, name: str) -> float:
    """Return the value of a parameter, or the initial value of a state, in a model or scene."""
    if isinstance(source, SceneDescription):
        row = source.parameters.get(name)
        if row is not None and not row.is_derived:
            return row.number
        hint = nearest(name, source.parameters)
        compiled = "; initial values of states need a compiled model" if "." in name else ""
        raise ParameterError(f"the scene has no value of '{brief(name)}'{compiled or hint}")
    if name in source.parameters:
        return float(source.default_parameters[source.parameters.index(name)])
    if name in source.states:
        return float(scene_start(source).y[source.states.index(name)])
    known = (*source.parameters, *source.states)
    raise ParameterError(
        f"the model has no tunable parameter or state '{brief(name)}'{nearest(name, known)}"
    )


def unit_points(method: str, n: int, n_columns: int, seed: int | None) -> FloatArray:
    """Draw points from the open unit cube, shape (n, n_columns)."""
    from scipy.stats import qmc

    generator = np.random.default_rng(seed)
    if method == "random":
        points = generator.random((n, n_columns))
    elif method == "sobol":
        # SciPy warns unless the number is a power of 2; surplus points are dropped.
        drawn = qmc.Sobol(n_columns, seed=generator).random_base2(max(0, int(n - 1).bit_length()))
        points = drawn[:n]
    else:
        kind = {"latin": qmc.LatinHypercube, "halton": qmc.Halton}[method]
        points = kind(n_columns, seed=generator).random(n)
    # On the faces of the cube, quantiles of unbounded distributions are infinite.
    return np.clip(points, 2.0**-53, 1.0 - 2.0**-53)


def _finite(values: Any, name: str) -> FloatArray:
    found = np.asarray(values, dtype=float)
    if not np.isfinite(found).all():
        raise ParameterError(
            f"the distribution of '{brief(name)}' gives values that are not finite: check its "
            "parameters"
        )
    return found
