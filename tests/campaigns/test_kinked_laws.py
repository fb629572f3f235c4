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
    "number", [pytest.param(number, id=_name(number)) for number in range(len(CASES))]
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
