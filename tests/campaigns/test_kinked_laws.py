"""Continuous piecewise laws cross, start, rest, decay and touch, however they are written."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from kinked_laws import LAWS, METHODS, SITUATIONS, faults

from cotree.components import COMPONENTS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

pytestmark = pytest.mark.compiler

CASES = [
    (name, situation, is_registered)
    for name, law in LAWS.items()
    for situation in SITUATIONS
    for is_registered in (False, True)
    if law.is_registered or not is_registered
]


_IMPLICIT = ("rodas4", "rodas5", "cvode", "ida")

#: Methods that still fail without and with sensitivities, of an expression and of a registered law,
#: where the motion begins on the corner: the slope there is infinite on both sides.
ON_CORNER = {
    "orifice": ((_IMPLICIT, _IMPLICIT), (_IMPLICIT, _IMPLICIT)),
    "orifice_where": ((_IMPLICIT, METHODS), (_IMPLICIT, METHODS)),
}
#: The same where it comes to rest at an infinite slope, of both: they stop, or take more than
#: 20,000 steps.
COMES_TO_REST = {
    "orifice": (("dopri5", "dop853", "cvode", "ida"),) * 2,
    "orifice_where": (("dop853", "cvode", "ida"), ("dop853", "rodas4", "cvode", "ida")),
}


def _marks(number: int, methods: Sequence[str], *, has_sensitivities: bool) -> list[object]:
    name, situation, is_registered = CASES[number]
    if situation in ("start", "rest"):
        failing = ON_CORNER.get(name, (((), ()),) * 2)[is_registered][has_sensitivities]
        reason = "the slope at the corner is infinite on both sides"
    else:
        own = COMES_TO_REST if situation == "decay" else {}
        failing = own.get(name, ((), ()))[has_sensitivities]
        reason = "it rests at an infinite slope"
    if set(failing).isdisjoint(methods):
        return []
    # Numbers of steps at an infinite slope hang on the last digits.
    return [pytest.mark.xfail(reason=reason, strict=situation != "decay")]


def _single(number: int) -> tuple[str, bool]:
    """Return the method of a case, and whether it has sensitivities."""
    return METHODS[number % len(METHODS)], bool(number // 2 % 2)


def _name(number: int) -> str:
    return "-".join(map(str, CASES[number]))


@pytest.fixture(autouse=True)
def registry() -> Iterator[None]:
    before = dict(COMPONENTS)
    yield
    COMPONENTS.clear()
    COMPONENTS.update(before)


@pytest.mark.sampled(8)
@pytest.mark.parametrize(
    "number",
    [
        pytest.param(
            number,
            id=_name(number),
            marks=_marks(number, [_single(number)[0]], has_sensitivities=_single(number)[1]),
        )
        for number in range(len(CASES))
    ],
)
def test_a_law_in_a_situation(number: int) -> None:
    """One method for each case, with sensitivities in every other."""
    name, situation, is_registered = CASES[number]
    method, has_sensitivities = _single(number)
    found = faults(
        name,
        situation,
        is_registered=is_registered,
        parameters=["k", "c"] if has_sensitivities else [],
        methods=[method],
    )
    assert not found


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("number", "parameters"),
    [
        pytest.param(
            number,
            parameters,
            id=f"{_name(number)}-{'sensitivities' if parameters else 'plain'}",
            marks=_marks(number, METHODS, has_sensitivities=bool(parameters)),
        )
        for parameters in ([], ["k", "c"])
        for number in range(len(CASES))
    ],
)
def test_every_method(number: int, parameters: list[str]) -> None:
    name, situation, is_registered = CASES[number]
    assert not faults(
        name, situation, is_registered=is_registered, parameters=parameters, methods=list(METHODS)
    )
