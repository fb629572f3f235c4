"""Report that a run prints: the model, the time spent, and the last point."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.plot.result import quotient

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.api import Model, Scene
    from cotree.results import Result


def run_report(
    scene: Scene, model: Model, result: Result, parameters: Mapping[str, float] | None = None
) -> str:
    """Describe a run and its last point.

    Parameters
    ----------
    scene, model : Scene, Model
        The scene and the model that ran.
    result : Result
        Result of the run; its last point is the end, or the last good point.
    parameters : mapping of str to float, optional
        Parameters of the run in place of the scene's.

    Returns
    -------
    str
        Some lines; numbers have 10 significant digits.
    """
    work = result.statistics
    times = ", ".join(f"{stage} {seconds:.3f} s" for stage, seconds in result.times.items())
    lines = [
        f"{scene.headline}; {len(model.states)} states, kernels in {model.kernels.backend}",
        f"times: {times}{' (library from the cache)' if model.kernels.cached else ''}",
        f"{work.method}: {work.n_steps} steps, {work.nfev} evaluations, {work.njev} Jacobians",
    ]
    # A failure has been told already, as a warning on standard error.
    if result.success:
        lines.append(result.message)
    # The run failed at its first point.
    if not result.t.size:
        return "\n".join(lines)
    lines += ["", f"{'end' if result.success else 'last good point'}: t = {result.t[-1]:.10g} s"]
    lines += _aligned((name, result[name][-1], result.unit(name)) for name in result.states)
    for title, names in (("outputs", result.outputs), ("inputs", result.inputs)):
        if names:
            lines += [title, *_aligned((n, result[n][-1], result.unit(n)) for n in names)]
    lines += derived_lines(model, parameters)
    for parameter in result.parameters_of_sensitivity:
        lines.append(f"sensitivities to {parameter}")
        lines += _aligned(
            (
                f"d({name})/d({parameter})",
                result.sensitivity(name, parameter)[-1],
                quotient(result.unit(name), result.unit(parameter)),
            )
            for name in (*result.states, *result.outputs)
        )
    return "\n".join(lines)


def derived_lines(model: Model, parameters: Mapping[str, float] | None) -> list[str]:
    """Write the parameters that follow from others: name, expression, value and unit."""
    values = model.derived(parameters)
    if not values:
        return []
    rows = ((f"{r.name} = {r.text}", values[r.name], r.unit) for r in model.layout.derived)
    return ["derived parameters", *_aligned(rows)]


def _aligned(rows: Iterable[tuple[str, float, str]]) -> list[str]:
    """Write ``name = value unit`` for each row, in columns."""
    # Ten digits show more than usual tolerances determine, and no rounding noise.
    table = [(name, f"{value:.10g}", unit) for name, value, unit in rows]
    width = max((len(name) for name, _, _ in table), default=0)
    # A space holds the place of a minus sign.
    return [
        f"  {name:<{width}} = {number if number.startswith('-') else ' ' + number} {unit}".rstrip()
        for name, number, unit in table
    ]
