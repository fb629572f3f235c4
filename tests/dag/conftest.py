from __future__ import annotations

import pytest

from cotree.dag.nodes import Dag


@pytest.fixture
def dag() -> Dag:
    return Dag()


@pytest.fixture
def x(dag):
    return dag.symbol("x", 0)


@pytest.fixture
def y(dag):
    return dag.symbol("x", 1)
