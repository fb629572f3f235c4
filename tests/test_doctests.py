"""Every example in a docstring runs."""

from __future__ import annotations

import doctest
import importlib
import pkgutil

import pytest

import cotree

MODULES = [
    info.name
    for info in pkgutil.walk_packages(cotree.__path__, "cotree.")
    if not info.name.endswith("__main__")  # importing it runs the command line
]


@pytest.mark.sampled(40)
@pytest.mark.parametrize("name", MODULES)
def test_examples_of_module(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0
