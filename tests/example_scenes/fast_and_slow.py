"""Cases of a parametrized test of which some run with ``--slow`` only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterable


def cases(fast: Iterable[Any], slow: Iterable[Any]) -> list[Any]:
    """Return all cases, the second ones marked as slow."""
    return [*fast, *(pytest.param(case, marks=pytest.mark.slow) for case in slow)]


def seeds(n_fast: int, n: int) -> list[Any]:
    """Return the first n whole numbers, those from ``n_fast`` on marked as slow."""
    return cases(range(n_fast), range(n_fast, n))
