"""Time that a call of ``simulate`` spends outside its C code, for small models.

``python benchmarks/calls.py [--rounds 200]`` runs each model alternately with each method, once
with equal values and once with a different value of a parameter at each call. It prints medians of
the elapsed time, of the time of the integration in C (``result.statistics.seconds``) and of the
difference, which is spent in Python. Then it prints the times of kernels at 101 points, evaluated
one at a time and in one call. The last table compares calls with calls without two mechanisms:
``cotree.records``, which copies records faster than ``dataclasses.replace``, and
``cotree.sharing.RecentCache``, which keeps what runs with equal settings share.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest.mock import patch

import numpy as np
from timing import heading, line

import cotree
from cotree import records
from cotree.sharing import RecentCache

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping


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


def constructed(kind: type[Any], values: Mapping[str, Any]) -> Any:
    """Make a record by its constructor; fields that are computed later are None."""
    if set(values) <= set(kind.__dataclass_fields__):
        return kind(**values)
    return kind(**{name: values.get(name) for name in kind.__dataclass_fields__})


@contextmanager
def by_constructors() -> Iterator[None]:
    """Replace the functions of ``cotree.records`` by constructors and ``dataclasses.replace``."""
    plain = {records.filled: constructed, records.changed: dataclasses.replace}
    with ExitStack() as stack:
        for module in [row for name, row in sys.modules.items() if name.startswith("cotree.")]:
            for name in ("filled", "changed"):
                function = getattr(records, name)
                if getattr(module, name, None) is function:
                    stack.enter_context(patch.object(module, name, plain[function]))
        yield


def prepared_anew() -> Any:
    """Replace the cache by one that stores nothing."""
    return patch.object(RecentCache, "of", lambda self, key, make: make())


def mechanisms(rounds: int) -> list[list[str]]:
    """Measure calls with and without each mechanism, in turn."""
    ways = {"records": by_constructors, "RecentCache": prepared_anew}
    rows = []
    for case in cases()[:3]:
        call = calls_of(case, "dop853")["others"]
        for name, without in ways.items():
            pairs = []
            for _ in range(9):
                usual = measure(call, rounds)[0]
                with without():
                    pairs.append((usual, measure(call, rounds)[0]))
            clocks = [f"{value:.0f}" for value in np.median(pairs, axis=0)]
            ratio = np.median([other / usual for usual, other in pairs])
            rows.append([case.label, name, *clocks, f"{ratio:.2f}"])
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
    print()
    print(heading(["model", "mechanism", "with [us]", "without [us]", "ratio"]))
    for row in mechanisms(rounds):
        print(line(row))


if __name__ == "__main__":
    main()
