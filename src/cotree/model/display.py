"""A model and its linearisations as people see them, at a prompt and in a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cotree.build import find_toolchain
from cotree.errors import BuildError
from cotree.markup import block, labelled, matrix, names, paragraph, table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy as np
    import numpy.typing as npt

    from cotree.equations.equations import Quantity
    from cotree.model.linearization import Linearization
    from cotree.model.model import CompiledModel

#: What users call, in the order of a session.
_CALLS = (
    "simulate",
    "trim",
    "linearize",
    "start",
    "rhs",
    "jacobian",
    "output_values",
    "write",
    "summary",
)


def model_text(model: Any, methods: Sequence[str]) -> str:
    """Describe a model in a few lines."""
    return labelled(f"{type(model).__name__} {model.layout.name}", _lines(model, methods))


def model_html(model: Any, methods: Sequence[str]) -> str:
    """Describe a model in tables; see :func:`model_text`."""
    layout = model.layout
    lines = _lines(model, methods)
    rows = [(label, text) for label, text in lines if text and label != "parameters"]
    values = (
        (row.name, value, row.unit, row.doc)
        for row, value in zip(layout.parameters, layout.parameter_values, strict=True)
    )
    return block(
        f"{type(model).__name__} {layout.name}",
        table("", ["", ""], rows, n_rows=len(rows)),
        table(
            "parameters",
            ["name", "value", "unit", "meaning"],
            values,
            n_rows=len(layout.parameters),
        ),
    )


def _lines(model: Any, methods: Sequence[str]) -> list[tuple[str, str]]:
    layout = model.layout
    calls = [f"{name}()" for name in _CALLS if hasattr(model, name)]
    return [
        ("states", _quantities(layout.states)),
        ("parameters", names(model.parameters)),
        ("inputs", _quantities(layout.inputs)),
        ("outputs", _quantities(layout.outputs)),
        ("sensitivities", f"to {names(model.sensitivities)}" if model.sensitivities else "none"),
        ("constraints", names(model.constraints) if model.constraints else ""),
        ("calls", " ".join(calls)),
        ("methods", " ".join(methods)),
        ("compiler", _compiler(model.kernels)),
    ]


def _quantities(rows: Iterable[Quantity]) -> str:
    return names([f"{row.name} [{row.unit}]" if row.unit else row.name for row in rows], 6)


def _compiler(model: CompiledModel) -> str:
    """Name the compiler; "none" where there was none."""
    if model.backend != "C":
        return "none: nothing is evaluated"
    try:
        found = find_toolchain()
    except BuildError:
        # The environment names another one since, which is no fault of this model.
        found = None
    return found.version if found else "C"


def linear_text(linear: Linearization) -> str:
    """Describe a linearisation in a few lines."""
    return labelled(
        f"Linearization of {len(linear.states)} states",
        [
            ("about", linear.summary().partition("about ")[2]),
            *([("modes", linear.in_modes)] if linear.modes else []),
            ("z", names(linear.states)),
            ("u", names(linear.inputs)),
            ("y", names(linear.outputs)),
            ("eigenvalues of A", _eigenvalues(linear.eigenvalues)),
        ],
    )


def linear_html(linear: Linearization) -> str:
    """Show the matrices of a linearisation as tables with names."""
    z, u, y = linear.states, linear.inputs, linear.outputs
    rates = [f"{name}′" for name in z]
    return block(
        f"Linearization of {len(z)} states",
        paragraph(f"about {linear.summary().partition('about ')[2]}"),
        *([paragraph(f"modes: {linear.in_modes}")] if linear.modes else []),
        matrix("A", rates, z, linear.A),
        matrix("B", rates, u, linear.B),
        matrix("C", y, z, linear.C),
        matrix("D", y, u, linear.D),
        paragraph(f"eigenvalues of A: {_eigenvalues(linear.eigenvalues)}"),
    )


def _eigenvalues(values: npt.NDArray[np.complex128], most: int = 12) -> str:
    """Write eigenvalues, a pair of conjugate ones as one."""
    parts = [
        f"{x.real:.4g}" if x.imag == 0.0 else f"{x.real:.4g} ± {x.imag:.4g}i"
        for x in values
        if x.imag >= 0.0
    ]
    hidden = len(parts) - most
    return ", ".join(parts[:most]) + (f" and {hidden} more" if hidden > 0 else "") or "none"
