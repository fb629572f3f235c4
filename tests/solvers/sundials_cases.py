"""Cases that every method of SUNDIALS must solve, with sensitivities."""

from __future__ import annotations

import contextlib
from collections import Counter

import numpy as np
from network_scenes import rc_ladder, rc_ladder_matrix

from cotree import Scene


def follows_an_oscillator(method):
    """A closed form, at every step."""
    scene = Scene("oscillator")
    scene.parameter("c", 1.0)
    scene.edge("L1", "inductor", "a", "ground", inductance=1.0, initial={"i": 0.0})
    scene.edge("C1", "capacitor", "a", "ground", capacitance="c", initial={"v": 1.0})
    result = scene.compile(["c"]).simulate((0.0, 5.0), None, method, 1e-10, 1e-12)
    # v = cos(t / sqrt(c)), dv/dc = t sin(t) / 2 at c = 1. Some thousand steps of 1e-10.
    np.testing.assert_allclose(result["C1.v"], np.cos(result.t), atol=1e-7)
    found = result.sensitivity("C1.v", "c")
    np.testing.assert_allclose(found, 0.5 * result.t * np.sin(result.t), atol=5e-7)
    assert len(result.t) == result.statistics.n_steps + 1


def follows_a_long_ladder(method):
    """A band, with places of its own for the states; give the result."""
    model, end = rc_ladder(150).compile(["R"]), 10.0
    result = model.simulate((0.0, end), [end], method, 1e-9, 1e-12, throw=True)
    # All voltages depend on t / R, so that dv/dR = -t v' at R = 1; v' = A v + e_1.
    rates = rc_ladder_matrix(150) @ result.y[:, -1] + np.eye(150)[0]
    # Some hundred steps of 1e-9, times t.
    np.testing.assert_allclose(result.s[:, 0, -1], -end * rates, atol=1e-6)
    return result


@contextlib.contextmanager
def counted_contexts(sundials):
    """Count the calls of functions that make and free what SUNDIALS holds."""
    counts, functions, kept = Counter(), sundials.functions, {}

    def count(name):
        own = kept[name] = getattr(functions, name)

        def call(*arguments):
            counts[name] += 1
            return own(*arguments)

        return sundials.library.ffi.callback(sundials.library.ffi.typeof(own), call)

    names = ("SUNContext_Create", "SUNContext_Free", "N_VMake_Serial", "N_VDestroy")
    names += ("SUNNonlinSolNewEmpty", "SUNNonlinSolFreeEmpty")
    callbacks = {name: count(name) for name in names}
    for name, callback in callbacks.items():
        setattr(functions, name, callback)
    try:
        yield counts
    finally:
        for name, own in kept.items():
            setattr(functions, name, own)
