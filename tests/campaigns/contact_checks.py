"""Checks of runs with contact: energy, gaps and forces; sensitivities against differences."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

TIGHT = {"rtol": 1e-10, "atol": 1e-12, "time_limit": 60}

#: Impacts that occur ever faster, or coincide, have no sensitivities.
ENDS = ("grazes", "ever faster", "coincides")


def sequence(result):
    """List the events of a run by name, in the order of their times."""
    return [name for _, name in sorted((t, k) for k, row in result.events.items() for t in row.t)]


def check_contacts(result, places, friction):
    """Check the outputs ``energy`` and, at each place, ``gap_``, ``N_`` and ``T_`` of a run."""
    energy = result["energy"]
    # Errors of some hundred steps, each a tolerance of 1e-9.
    assert np.max(np.diff(energy), initial=0.0) <= 1e-6 * (1 + abs(energy[0]))
    for place in places:
        normal, along = result[f"N_{place}"], result[f"T_{place}"]
        # A contact that holds is left by what the tolerance allows.
        assert np.min(result[f"gap_{place}"]) >= -1e-6, place
        assert np.min(normal) >= -1e-6, place
        assert np.max(np.abs(along) - friction * normal) <= 1e-6, place


def check_sensitivities(model, values, end, states):
    """Compare all sensitivities of some states at the end with differences of fourth order."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of runs that end early
        result = model.simulate((0, end), parameters=values, **TIGHT)
        if not result.success:
            assert any(end in result.message for end in ENDS), result.message
            pytest.skip("no sensitivities exist there")
        for name in model.sensitivities:
            slopes = []
            for h in (1e-5, 2.5e-6):
                sides = [
                    model.simulate((0, end), parameters={**values, name: values[name] + d}, **TIGHT)
                    for d in (h, -h)
                ]
                if any(sequence(side) != sequence(result) for side in sides):
                    pytest.skip("the sequence of events changes")
                ends = [np.array([side[state][-1] for state in states]) for side in sides]
                slopes.append((ends[0] - ends[1]) / (2 * h))
            slope = slopes[1] + (slopes[1] - slopes[0]) / 15
            found = [result.sensitivity(state, name)[-1] for state in states]
            # Errors of runs at 1e-10 over the step, and what is left of the differences' own.
            allowed = 1e-4 * (1 + np.abs(slope).max()) + 3 * np.abs(slopes[1] - slopes[0]).max()
            np.testing.assert_allclose(found, slope, rtol=0.0, atol=allowed, err_msg=name)
