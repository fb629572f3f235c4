"""Picture of a run: coordinates, and sensitivities with finite differences as an overlay."""

from __future__ import annotations

import io
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.check import Array, RepeatedRun
from cotree.errors import Error
from cotree.files import atomic_write
from cotree.plot import choose_curves, plot_result, save_figure, svg_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cotree.api import Model
    from cotree.plot import Curves
    from cotree.results import Result

_CIRCLES = 40
# Relative step of finite differences, and tolerances of their runs. Truncation and integration
# errors remain below 1e-5 of the curve, less than a line width.
_STEP, _RTOL, _ATOL = 1e-4, 1e-10, 1e-12


def draw_run(
    model: Model, result: Result, path: Path, settings: Mapping[str, Any], names: Sequence[str] = ()
) -> None:
    """Draw curves of a result, with finite differences, and save the figure."""
    chosen = check_names(model, names)
    overlay: dict[tuple[str, str], tuple[Array, Array]] = {}
    # If the run failed, the runs for finite differences would also fail.
    if result.success:
        overlay = _finite_differences(model, result, chosen.sensitivities, settings)
    save_figure(
        plot_result(result.smooth(), [*chosen.values, *chosen.sensitivities], overlay), path
    )


def draw_curves(result: Result, path: Path, names: Sequence[str] = ()) -> None:
    """Save the curves of a run as ``.html`` or ``.gif``, for scenes without moving bodies."""
    figure = plot_result(result.smooth(), names or None)
    with atomic_write(path, "the picture") as draft:
        if path.suffix.lower() == ".html":
            head = '<!DOCTYPE html>\n<meta charset="utf-8">\n<title>cotree</title>\n'
            draft.write_text(head + svg_text(figure), encoding="utf-8")
            return
        from PIL import Image

        png = io.BytesIO()
        figure.savefig(png, format="png", dpi=100)
        Image.open(png).convert("P", palette=Image.Palette.ADAPTIVE).save(draft, format="GIF")


def check_names(model: Model, names: Sequence[str]) -> Curves:
    """Return the named curves of a model, or all coordinates if no curve is named."""
    followers = (*(row.name for row in model.kernels.layout.positions), *model.outputs)
    known = (model.states, followers, model.inputs, model.sensitivities)
    return choose_curves(names or None, *known)


def _finite_differences(
    model: Model, result: Result, pairs: Sequence[tuple[str, str]], settings: Mapping[str, Any]
) -> dict[tuple[str, str], tuple[Array, Array]]:
    """Compute finite differences for pairs of quantity and parameter, without those that fail."""
    times = np.linspace(result.t[0], result.t[-1], _CIRCLES)
    # Use the method of the result, because "auto" could choose another one.
    tight = {"method": result.statistics.method, "rtol": _RTOL, "atol": _ATOL}
    experiment = RepeatedRun(model, times, {**settings, **tight})
    overlay: dict[tuple[str, str], tuple[Array, Array]] = {}
    # Two runs per parameter provide the differences of all quantities.
    for parameter in dict.fromkeys(parameter for _, parameter in pairs):
        try:
            values = experiment.central_difference(
                parameter, _STEP * experiment.size(parameter, result)
            )
        except Error as error:
            warnings.warn(
                f"no finite differences of '{parameter}' are drawn: {error}",
                RuntimeWarning,
                stacklevel=2,
            )
            continue
        rows = dict(zip(experiment.quantities, values, strict=True))
        overlay |= {(name, to): (times, rows[name]) for name, to in pairs if to == parameter}
    return overlay
