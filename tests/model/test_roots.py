"""Roots of equations whose laws lose digits inside."""

import numpy as np
import pytest

from cotree.model.roots import Equation, find_root


@pytest.mark.parametrize("volts", [5.0, 1e3])
@pytest.mark.parametrize("root", [6e-10, 1e-13, 0.0])
def test_a_difference_of_squares_has_a_root_as_good_as_its_digits(volts, root):
    """((V + z)^2 - V^2)/(2 V) = r: what is small is the difference of what is large."""

    def value(z):
        return ((volts + z) ** 2 - volts**2) / (2 * volts) - root * (1 + root / (2 * volts))

    found = find_root(
        Equation(value, lambda z: np.diag(1 + z / volts), np.zeros(0)), np.ones(1), lambda: None
    )
    assert found.is_found
    # A few roundings of V^2 by 2 V.
    assert found.z[0] == pytest.approx(root, abs=4 * np.finfo(float).eps * volts)


def test_what_has_no_root_is_told():
    found = find_root(
        Equation(lambda z: z**2 + 1e-12, lambda z: np.diag(2 * z), np.zeros(0)),
        np.ones(1),
        lambda: None,
    )
    assert not found.is_found
