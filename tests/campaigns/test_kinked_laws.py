"""Continuous piecewise laws cross, start, rest, decay and touch, however they are written."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from kinked_laws import LAWS, METHODS, SITUATIONS, faults

from cotree.components import COMPONENTS

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.compiler

CASES = [
    (name, situation, is_registered)
    for name, law in LAWS.items()
    for situation in SITUATIONS
    for is_registered in (False, True)
    if law.is_registered or not is_registered
]


def _marked(number: int) -> object:
    """Roots and powers whose first or second slope is infinite at the corner still stop there."""
    name = CASES[number][0]
    is_singular = LAWS[name].is_steep or name.startswith("hertz")
    reason = "an infinite slope at the corner, which implicit methods and sensitivities need"
    marks = [pytest.mark.xfail(reason=reason, strict=False)] if is_singular else []
    return pytest.param(number, id="-".join(map(str, CASES[number])), marks=marks)


@pytest.fixture(autouse=True)
def registry() -> Iterator[None]:
    before = dict(COMPONENTS)
    yield
    COMPONENTS.clear()
    COMPONENTS.update(before)


@pytest.mark.sampled(8)
@pytest.mark.parametrize("number", [*map(_marked, range(len(CASES)))])
def test_a_law_in_a_situation(number: int) -> None:
    """One method for each case, with sensitivities in every other."""
    name, situation, is_registered = CASES[number]
    found = faults(
        name,
        situation,
        is_registered=is_registered,
        parameters=["k", "c"] if number // 2 % 2 else [],
        methods=[METHODS[number % len(METHODS)]],
    )
    assert not found


@pytest.mark.campaign
@pytest.mark.parametrize("parameters", [[], ["k", "c"]], ids=["plain", "sensitivities"])
@pytest.mark.parametrize("number", [*map(_marked, range(len(CASES)))])
def test_every_method(number: int, parameters: list[str]) -> None:
    name, situation, is_registered = CASES[number]
    assert not faults(
        name, situation, is_registered=is_registered, parameters=parameters, methods=list(METHODS)
    )
