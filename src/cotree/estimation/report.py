"""Reports of a fit: text, HTML, data frames and plain dictionaries."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree import markup
from cotree.errors import Error

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.estimation.result import FitResult

_WIDTH = 96

# Smallest correlation that is listed, and the largest number of them.
_CORRELATED, _MOST_CORRELATED = 0.5, 8

_HEAD = ("parameter", "estimate", "std. error", "relative", "lower", "upper", "unit", "")


def estimate_rows(result: FitResult, level: float = 0.95) -> list[dict[str, Any]]:
    """Return a row for each parameter: estimate, standard error, interval, bounds and remark."""
    errors, intervals = result.standard_errors, result.intervals(level)
    is_open = result.uncertainty.split.is_open
    rows = []
    for i, row in enumerate(result.problem.estimated):
        value, error = result.parameters[row.name], errors[row.name]
        side = result.at_bounds.get(row.name, "")
        remark = f"at its {side} bound" if side else ""
        rows.append(
            {
                "parameter": row.name,
                "estimate": value,
                "error": error,
                "relative": abs(error / value) if value else math.inf,
                "lower": intervals[row.name][0],
                "upper": intervals[row.name][1],
                "unit": result.units[row.name],
                "scale": row.scale,
                "bounds": (row.lower, row.upper),
                "remark": "not determined" if is_open[i] else remark,
            }
        )
    return rows


def quality(result: FitResult) -> dict[str, Any]:
    """Return the goodness-of-fit statistics by name."""
    return {
        "values": len(result.problem.measured),
        "conditions": len(result.problem.conditions),
        "estimated": len(result.problem.estimated),
        "degrees of freedom": result.degrees_of_freedom,
        "chi2": result.chi2,
        "reduced chi2": result.reduced_chi2,
        "log-likelihood": result.log_likelihood,
        "AIC": result.aic,
        "BIC": result.bic,
        "starts": len(result.starts),
        "converged": sum(row.is_converged for row in result.starts),
        "evaluations": sum(row.n_evaluations for row in result.starts),
    }


def as_text(result: FitResult) -> str:
    """Format a summary as plain text."""
    numbers = quality(result)
    title = "Fit of " + _counted(numbers["estimated"], "parameter")
    title += " to " + _counted(numbers["values"], "value")
    title += " of " + _counted(numbers["conditions"], "experiment")
    keys = [k for k in numbers if k not in ("values", "conditions", "estimated")]
    pairs = [f"{key + ':':<20}{_short(numbers[key]):>12}" for key in keys]
    half = -(-len(pairs) // 2)
    pairs += [""] * (2 * half - len(pairs))
    lines = [title, "=" * len(title)]
    lines += [f"{a}    {b}".rstrip() for a, b in zip(pairs[:half], pairs[half:], strict=True)]
    lines += ["", *columns(_HEAD, _cells(result), (0, 6, 7)), ""]
    lines += _lines(_how(result))
    pairs = _correlations(result)
    if pairs:
        lines += ["Correlations: " + ", ".join(pairs)]
    if result.findings:
        lines += ["", *_wrapped(result.findings)]
    return "\n".join(lines)


def as_html(result: FitResult) -> str:
    """Format the summary as HTML for a notebook."""
    numbers = [(key, _short(value)) for key, value in quality(result).items()]
    findings = [markup.paragraph(sentence) for sentence in result.findings]
    return markup.block(
        "Fit",
        markup.table("Estimates", _HEAD, _cells(result), n_rows=len(result.problem.estimated)),
        markup.paragraph(_how(result), muted=True),
        *findings,
        markup.table("Agreement", ("", ""), numbers, n_rows=len(numbers)),
        markup.matrix(
            "Correlation", result.names, result.names, np.round(result.correlation, 3)
        ),
    )  # fmt: skip


def as_dict(result: FitResult) -> dict[str, Any]:
    """Return everything as JSON-compatible values; numbers that are not finite become None."""
    found: dict[str, Any] = _plain(
        {
            "parameters": estimate_rows(result),
            "agreement": quality(result),
            "names": list(result.names),
            "scales": [row.scale for row in result.problem.estimated],
            "theta": result.theta,
            "covariance": result.covariance,
            "correlation": result.correlation,
            "fisher": result.fisher,
            "eigenvalues": result.eigenvalues,
            "starts": starts_rows(result),
            "findings": list(result.findings),
        }
    )
    return found


def starts_rows(result: FitResult) -> list[dict[str, Any]]:
    """Return a row for each start, the best one first.

    The distance from the best end point is the Mahalanobis distance, in standard errors;
    undetermined directions do not contribute.
    """
    best, rows = result.starts[0], []
    values = result.problem.scaled.values
    for rank, start in enumerate(result.starts):
        apart = start.theta - best.theta
        distance = math.sqrt(max(float(apart @ result.fisher @ apart), 0.0))
        rows.append(
            {
                "rank": rank,
                "objective": start.objective,
                "above": start.objective - best.objective if rank else 0.0,
                "distance": distance,
                "evaluations": start.n_evaluations,
                "converged": start.is_converged,
                "message": start.message,
                **dict(zip(result.names, values(start.theta).tolist(), strict=True)),
            }
        )
    return rows


def frame(rows: Sequence[Mapping[str, Any]], index: str | None = None) -> Any:
    """Make a pandas DataFrame."""
    try:
        import pandas as pd
    except ImportError as error:
        raise Error("tables need pandas: run `pip install cotree[ensembles]`") from error
    table = pd.DataFrame(list(rows))
    return table.set_index(index) if index and len(table) else table


def _cells(result: FitResult) -> list[list[str]]:
    return [
        [
            row["parameter"],
            _short(row["estimate"]),
            _short(row["error"], 3),
            f"{100 * row['relative']:.2g} %" if math.isfinite(row["relative"]) else "",
            _short(row["lower"]),
            _short(row["upper"]),
            row["unit"],
            row["remark"],
        ]
        for row in estimate_rows(result)
    ]


def columns(head: Sequence[str], rows: Sequence[Sequence[str]], texts: Sequence[int]) -> list[str]:
    """Align rows as a table: numbers to the right, the columns listed in ``texts`` to the left."""
    widths = [max(len(cell) for cell in column) for column in zip(head, *rows, strict=True)]
    lines = []
    for row in (head, ["-" * w for w in widths], *rows):
        cells = [
            cell.ljust(w) if j in texts else cell.rjust(w)
            for j, (cell, w) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return lines


def _how(result: FitResult) -> str:
    freedom = result.uncertainty.freedom
    law = (
        "normal quantiles, because the noise is given"
        if math.isinf(freedom)
        else f"Student's t with {freedom:g} degrees of freedom, because the noise is estimated"
    )
    logs = any(row.scale != "lin" for row in result.problem.estimated)
    on_scale = "; those of logarithmic parameters are formed on that scale" if logs else ""
    return f"The 95 % intervals use {law}{on_scale}."


def _correlations(result: FitResult) -> list[str]:
    found = [
        (abs(c), f"{result.names[i]} with {result.names[j]} {c:+.2f}")
        for i in range(len(result.names))
        for j in range(i)
        if math.isfinite(c := float(result.correlation[i, j])) and abs(c) >= _CORRELATED
    ]
    return [text for _, text in sorted(found, reverse=True)[:_MOST_CORRELATED]]


def _wrapped(sentences: Sequence[str]) -> list[str]:
    return [line for sentence in sentences for line in _lines(sentence, "! ", "  ")]


def _lines(text: str, first: str = "", later: str = "") -> list[str]:
    import textwrap

    return textwrap.wrap(text, _WIDTH, initial_indent=first, subsequent_indent=later)


def _short(value: Any, digits: int = 6) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.{digits}g}"
    return str(value)


def _counted(n: int, what: str) -> str:
    return f"{n} {what}{'s' if n != 1 else ''}"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value
