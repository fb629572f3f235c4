"""Methods with steps of one length, for real time: what their template is told."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FixedStep:
    """A method whose steps all have the length that the caller chose.

    Attributes
    ----------
    name : str
        In C, after ``cotree_``.
    title : str
        A description, as a part of a sentence.
    source : str
        Reference.
    order : int
        Of the error at the end.
    n_stages : int
        Evaluations of the rates in a step.
    is_implicit : bool
        Whether it solves linear systems.
    """

    name: str
    title: str
    source: str
    order: int
    n_stages: int
    is_implicit: bool


_RK4 = FixedStep(
    name="rk4",
    title="the classical Runge-Kutta method of order 4, with steps of one length",
    source="E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, second "
    "edition, section II.1",
    order=4,
    n_stages=4,
    is_implicit=False,
)

_EULER = FixedStep(
    name="euler",
    title="the linearly implicit Euler method, with steps of one length",
    source="E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, second edition, "
    "sections IV.7 and VI.4",
    order=1,
    n_stages=1,
    is_implicit=True,
)

#: Every method with steps of one length, by name.
FIXED: dict[str, FixedStep] = {row.name: row for row in (_RK4, _EULER)}
