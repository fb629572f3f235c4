"""Time that a call of ``simulate`` spends outside its C code, for small models.

``python benchmarks/calls.py [--rounds 200]`` runs each model alternately with each method, once
with equal values and once with a different value of a parameter at each call. It prints medians of
the elapsed time, of the time of the integration in C (``result.statistics.seconds``) and of the
difference, which is spent in Python. Then it prints the times of kernels at 101 points, evaluated
one at a time and in one call.
"""

from __future__ import annotations

import argparse
import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from timing import heading, line

import cotree

if TYPE_CHECKING:
    from collections.abc import Callable


class Case(NamedTuple):
    """A model, the time span of its runs, and the methods to measure."""

    label: str
    model: cotree.Model
    end: float
    methods: tuple[str, ...]


def cases() -> list[Case]:
    """Compile the models."""
    slider, usual, stiff = cotree.load("slider-pendulum"), ("dop853", "auto"), ("rodas5", "auto")
    plain = slider.compile()
    return [
        Case("slider-pendulum", plain, 10.0, usual),
        Case("slider-pendulum, L", slider.compile(["L"]), 10.0, usual),
        Case("slider-pendulum, all 8", slider.compile(list(plain.parameters)), 10.0, usual),
        Case("spring-mass-damper", cotree.load("spring-mass-damper").compile(), 10.0, usual),
        Case("bouncing-ball", cotree.load("bouncing-ball").compile(), 3.0, usual),
        Case("bridge-rectifier", cotree.load("bridge-rectifier").compile(), 0.05, stiff),
        Case("motor-linkage", cotree.load("motor-linkage").compile(), 1.0, usual),
    ]


def calls_of(case: Case, method: str) -> dict[str, Callable[[int], cotree.Result]]:
    """Return functions that call a model; their argument is the number of the call."""
    model, times = case.model, np.linspace(0.0, case.end, 101)
    name, value = model.parameters[0], float(model.default_parameters[0])

    def simulate(parameters: dict[str, float]) -> cotree.Result:
        span = (0.0, case.end)
        return model.simulate(span, times, method, 1e-8, parameters=parameters)

    return {
        "the same": lambda k: simulate({}),
        "others": lambda k: simulate({name: value * (1.0 + 1e-7 * k)}),
    }


def measure(call: Callable[[int], cotree.Result], rounds: int) -> list[float]:
    """Return the medians of elapsed time, time in C and their difference, [us]."""
    found = []
    for k in range(rounds + 2):
        begin = time.perf_counter()
        result = call(k)
        clock = time.perf_counter() - begin
        if k > 1:  # the first ones compile, and prepare
            inside = result.statistics.seconds
            found.append((clock, inside, clock - inside))
    return [1e6 * float(value) for value in np.median(found, axis=0)]


def points(rounds: int) -> list[list[str]]:
    """Measure kernels at many points, one at a time and in one call."""
    model = cotree.load("slider-pendulum").compile(["L"])
    result = model.simulate((0.0, 10.0), np.linspace(0.0, 10.0, 101))
    t, y, s, rows = result.t, result.y, result.s, []
    ways = {
        "rhs": (lambda: [model.rhs(t[j], y[:, j]) for j in range(101)], lambda: model.rhs(t, y)),
        "jacobian": (
            lambda: [model.jacobian(t[j], y[:, j]) for j in range(101)],
            lambda: model.jacobian(t, y),
        ),
        "sensitivity_rhs": (
            lambda: [model.sensitivity_rhs(t[j], y[:, j], s[..., j]) for j in range(101)],
            lambda: model.sensitivity_rhs(t, y, s),
        ),
    }
    for name, both in ways.items():
        medians = []
        for way in both:
            took = []
            for _ in range(rounds + 1):
                begin = time.perf_counter()
                way()
                took.append(time.perf_counter() - begin)
            medians.append(1e6 * float(np.median(took[1:])))
        rows.append([name, *(f"{value:.0f}" for value in medians)])
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=200)
    rounds = parser.parse_args().rounds
    print(heading(["model", "method", "values", "clock [us]", "C [us]", "Python [us]"]))
    for case in cases():
        for method in case.methods:
            for values, call in calls_of(case, method).items():
                numbers = [f"{value:.0f}" for value in measure(call, rounds)]
                print(line([case.label, method, values, *numbers]), flush=True)
    print()
    print(heading(["kernel at 101 points", "one by one [us]", "together [us]"]))
    for row in points(rounds):
        print(line(row))


if __name__ == "__main__":
    main()
