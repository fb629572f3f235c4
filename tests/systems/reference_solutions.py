"""Reference solutions: published or closed form, from tests/references."""

from __future__ import annotations

import json
from pathlib import Path

import mpmath
import numpy as np

_FOLDER = Path(__file__).resolve().parents[1] / "references"

#: State of a shipped scene, by the name that a reference gives it.
STATES = {
    "slider-pendulum": {
        "s": "j1.s",
        "theta": "h2.theta",
        "sdot": "j1.s_dot",
        "thetadot": "h2.theta_dot",
    },
    "spring-mass-damper": {"x": "s.s", "v": "s.s_dot"},
}


def reference(name):
    """Return times, {state: values} and {(state, parameter): values} of a shipped scene."""
    data = json.loads((_FOLDER / f"{name.replace('-', '_')}.json").read_text())
    rows = data["reference"]
    states = {
        state: np.array([row["values"][key] for row in rows]) for key, state in STATES[name].items()
    }
    sensitivities = {
        (state, parameter): np.array([row["values"][key] for row in along])
        for parameter, along in data["sensitivities"]["values"].items()
        for key, state in STATES[name].items()
    }
    return np.array([row["t"] for row in rows]), states, sensitivities


def oscillator(t, m, k, c, l0, F0, w, x0, v0):
    """Return position and velocity of m x'' + c x' + k (x - l0) = F0 sin(w t), weakly damped."""
    stiff, loss = k - m * w**2, c * w
    size = F0 / (stiff**2 + loss**2)
    forced = size * (stiff * mpmath.sin(w * t) - loss * mpmath.cos(w * t))
    forced_rate = size * w * (stiff * mpmath.cos(w * t) + loss * mpmath.sin(w * t))
    delta = c / (2 * m)
    omega = mpmath.sqrt(k / m - delta**2)
    a = x0 - l0 + size * loss
    b = (v0 - size * w * stiff + delta * a) / omega
    decay, cos, sin = mpmath.exp(-delta * t), mpmath.cos(omega * t), mpmath.sin(omega * t)
    free = decay * (a * cos + b * sin)
    free_rate = decay * omega * (b * cos - a * sin) - delta * free
    return l0 + forced + free, forced_rate + free_rate


def oscillator_values(times, parameters):
    """Evaluate :func:`oscillator` and its derivatives by every parameter, in 40 digits.

    Gives arrays of shape (2, n_t) and (2, n_parameters, n_t).
    """
    with mpmath.workdps(40):
        exact = {name: mpmath.mpf(value) for name, value in parameters.items()}

        def derivative(t, name, row):
            def moved(value):
                return oscillator(mpmath.mpf(t), **{**exact, name: value})[row]

            return float(mpmath.diff(moved, exact[name]))

        values = [[float(oscillator(mpmath.mpf(t), **exact)[i]) for t in times] for i in (0, 1)]
        along = [[[derivative(t, name, i) for t in times] for name in exact] for i in (0, 1)]
    return np.array(values), np.array(along)
