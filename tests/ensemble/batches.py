"""Rows of members, and comparisons of blocks."""

import numpy as np


def rows_of(model, n, names):
    """Draw values within a tenth of the scene's, or near zero for initial values of zero."""
    rng = np.random.default_rng(1)
    values = dict(zip(model.parameters, model.default_parameters, strict=True))
    values |= dict(zip(model.states, model.initial_state, strict=True))
    middle = np.array([values[name] for name in names])
    return middle + 0.1 * np.where(middle, middle, 1.0) * rng.uniform(-1, 1, (n, len(names)))


def assert_same(block, other):
    """Compare all but the time that members took, to the last bit."""
    for name in ("z", "outputs", "output_sensitivities", "status", "steps", "events"):
        np.testing.assert_array_equal(getattr(block, name), getattr(other, name), name)
    assert block.messages == other.messages
