"""One model in several threads: every number is that of one thread, to the last bit."""

from __future__ import annotations

import functools
import gc
import io
import math
import os
import random
import signal
import sys
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import cotree
from cotree.ensemble.store import read_array, write_arrays
from cotree.quiet import without_warnings
from cotree.sharing import locked_cache, locked_cached_property
from cotree.solvers import engine
from cotree.solvers.budgets import is_watched

pytestmark = pytest.mark.compiler

N_THREADS = 4
#: Calls of the slow test. 1,000,000 take about half an hour.
N_CALLS = int(os.environ.get("COTREE_CASES", "4000"))
#: As many sets of parameters, each with its own result.
N_SETS = 8

C_METHODS = ("dopri5", "rkf45", "dop853", "rodas4", "rodas5", "cvode", "ida", "auto")
SCIPY_METHODS = ("DOP853", "Radau", "LSODA")
#: Sensitivities, the span of a run, and whether the scene has what a loop of joints needs.
SCENES = {
    "slider-pendulum": (("L",), 0.2),
    "bridge-rectifier": (("C",), 2e-4),
    "motor-linkage": ((), 0.01),
    "bouncing-ball": ((), 0.8),
}


@pytest.fixture(autouse=True)
def _hasty():
    """Switch threads as often as Python can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@functools.cache
def compiled(name):
    return cotree.load(name).compile(list(SCENES[name][0]))


def scipy_methods(name):
    """They take neither events and constraints nor algebraic unknowns."""
    return SCIPY_METHODS if name == "slider-pendulum" else ()


@functools.cache
def parameters(name):
    """Return parameters near the scene's own."""
    rng, own = np.random.default_rng(len(name)), compiled(name).default_parameters
    return [own * rng.uniform(0.98, 1.02, len(own)) for _ in range(N_SETS)]


def calls(name, methods):
    """Return functions of a number of a set of parameters to arrays, by name."""
    model, sets, span = compiled(name), parameters(name), SCENES[name][1]
    given = [dict(zip(model.parameters, p.tolist(), strict=True)) for p in sets]
    starts = [model.start(0.0, p) for p in sets]

    def run(method, j):
        result = model.simulate((0.0, span), method=method, parameters=given[j], rtol=1e-6)
        assert result.success
        happened = [times.t for times in result.events.values()]
        return (result.t, result.y, result.s, result.output_values, *happened)

    def start(j):
        found = model.start(0.0, sets[j])
        return found.y, found.s

    def linearize(j):
        found = model.linearize(0.0, starts[j].y, sets[j])
        return found.A, found.B, found.C, found.D

    at = [(0.1 * span, starts[j].y, sets[j]) for j in range(N_SETS)]
    found = {
        "rhs": lambda j: (model.rhs(*at[j]),),
        "jacobian": lambda j: (model.jacobian(*at[j]),),
        "outputs": lambda j: (model.output_values(*at[j]),),
        "start": start,
        "linearize": linearize,
    }
    if model.sensitivities:
        found["sensitivities"] = lambda j: (
            model.sensitivity_rhs(at[j][0], at[j][1], starts[j].s, sets[j]),
        )
    return found | {method: functools.partial(run, method) for method in methods}


def in_threads(work, n=N_THREADS):
    """Call a function with 0, 1, ... in as many threads, which begin together."""
    gate = threading.Barrier(n)

    def begin(i):
        gate.wait()
        return work(i)

    with ThreadPoolExecutor(n) as pool:
        return list(pool.map(begin, range(n)))


def check(name, methods, shares):
    """Call a model in four threads, ``shares`` calls of each kind, and compare bits."""
    made = calls(name, methods)
    expected = {key: [call(j) for j in range(N_SETS)] for key, call in made.items()}

    def work(i):
        order = [key for key in made for _ in range(shares(key))]
        random.Random(i).shuffle(order)
        wrong = []
        for j, key in enumerate(order):
            found = made[key]((i + j) % N_SETS)
            known = expected[key][(i + j) % N_SETS]
            if not all(np.array_equal(a, b) for a, b in zip(found, known, strict=True)):
                wrong.append(key)
        return wrong

    assert [sorted(set(wrong)) for wrong in in_threads(work)] == [[]] * N_THREADS


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ["slider-pendulum", "bridge-rectifier"])
def test_calls_of_four_threads(name):
    check(
        name,
        ("dopri5", "rodas5", "cvode", *scipy_methods(name)[:1]),
        lambda key: 40 if key == "rhs" else 8,
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_many_calls_of_four_threads(name):
    """A run takes a thousand times as long as an evaluation: of a hundred calls three are runs."""
    total = N_CALLS / len(SCENES) / N_THREADS
    methods = (*C_METHODS, *scipy_methods(name))
    quick = {"rhs": 0.45, "jacobian": 0.36, "outputs": 0.12, "start": 0.02, "linearize": 0.02}
    check(name, methods, lambda key: math.ceil(total * quick.get(key, 0.03 / len(methods))))


def test_what_is_formed_or_built_at_the_first_use():
    """Four threads want the same derivatives, Newton matrix and operating point for the first time.

    All of them are formed in the arena that the model was made in, where numbers of nodes that are
    handed out twice would mix values up.
    """
    known = compiled("bridge-rectifier")
    y = known.start().y
    expected = known.linearize(0.0, y), known.simulate((0.0, 2e-4), method="rodas5")
    model = cotree.load("bridge-rectifier").compile(["C"])
    formed = in_threads(
        lambda i: (
            model.simulate((0.0, 2e-4), method="rodas5") if i % 2 else model.linearize(0.0, y),
            model.kernels.junctions,
            model._linearizer,
        )
    )
    for i, (found, junctions, linearizer) in enumerate(formed):
        assert junctions is model.kernels.junctions
        assert linearizer is model._linearizer
        if i % 2:
            assert np.array_equal(found.y, expected[1].y)
            assert np.array_equal(found.s, expected[1].s)
        else:
            assert np.array_equal(found.A, expected[0].A)
            assert np.array_equal(found.B, expected[0].B)
    nodes = model.kernels.program.dag.nodes
    assert [node.index for node in nodes] == list(range(len(nodes)))


def test_compiling_in_four_threads():
    known, scene = compiled("slider-pendulum"), cotree.load("slider-pendulum")
    models = in_threads(lambda i: scene.compile(["L"]))
    y = known.initial_state
    for model in models:
        assert model.kernels.source == known.kernels.source
        assert np.array_equal(model.rhs(0.1, y), known.rhs(0.1, y))


def test_threads_parse_while_the_collector_calls_python(tmp_path):
    """Python before 3.11.8 fails here without a lock (python/cpython#106905)."""
    archive = tmp_path / "block.npz"
    write_arrays(archive, {"x": np.arange(4.0)})

    def parse(i):
        for k in range(60):
            scene = cotree.Scene("parsed")
            scene.parameter("a", f"(({k} + 1)*({i} + 2))*((1 + 2) + {k}*(3 + 4))")
            with np.load(archive) as opened:
                assert read_array(opened, "x")[3] == 3.0
        return scene

    def callback(*_):
        sum(range(50))

    before = gc.get_threshold()
    gc.callbacks.append(callback)
    gc.set_threshold(50, 2, 2)
    try:
        in_threads(parse)
    finally:
        gc.set_threshold(*before)
        gc.callbacks.remove(callback)


def test_one_thread_makes_and_the_others_wait():
    made = []

    @locked_cache
    def make(name):
        time.sleep(0.01)
        made.append(name)
        return object()

    assert len(set(in_threads(lambda i: make("a")))) == 1
    assert make("b") is not make("a")
    assert made == ["a", "b"]
    make.cache_clear()
    make("a")
    assert made == ["a", "b", "a"]

    class Owner:
        @locked_cached_property
        def value(self):
            """Return a new object."""
            time.sleep(0.01)
            return object()

    owner = Owner()
    assert len(set(in_threads(lambda i: owner.value))) == 1
    assert Owner.value.__doc__ == "Return a new object."


def test_an_engine_is_built_once(monkeypatch):
    built = []

    def build(code):
        time.sleep(0.01)
        built.append(object())
        return built[-1]

    monkeypatch.setattr(engine, "build_engine", build)
    engine._opened.cache_clear()
    try:
        assert in_threads(lambda i: engine.load_engine("rkf45").library) == built * N_THREADS
    finally:
        engine._opened.cache_clear()
    assert len(built) == 1


def test_an_input_may_call_the_model_itself():
    """A function of time evaluates the model at other parameters in the middle of a run."""
    scene = cotree.Scene("driven")
    scene.parameter("R", 2.0)
    scene.input("f", 1.0)
    scene.edge("S", "voltage_source", "a", "ground", voltage="f")
    scene.edge("R1", "resistor", "a", "b", resistance="R")
    scene.edge("C1", "capacitor", "b", "ground", capacitance=1.0)
    model = scene.compile()

    def calls(t):
        model.rhs(t, [0.3], model.kernels.parameter_array({"R": 5.0 + t}))
        return 1.0 + t

    for method in ("DOP853", "Radau", "LSODA"):
        found = model.simulate((0.0, 1.0), inputs={"f": calls}, method=method)
        known = model.simulate((0.0, 1.0), inputs={"f": lambda t: 1.0 + t}, method=method)
        assert np.array_equal(found.y, known.y)


@pytest.fixture
def interruptible():
    """Install the SIGINT handler of interactive runs, which background processes do not inherit."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_reaches_the_main_thread_alone():
    model = compiled("slider-pendulum")
    known = model.simulate((0.0, 1.0), method="dopri5")

    def interrupted():
        threading.Timer(0.2, signal.raise_signal, [signal.SIGINT]).start()
        # More steps than any machine takes before the signal, and only two points are kept: where
        # the signal is lost, the test fails by the limit of steps and not by the memory.
        model.simulate((0.0, 1e9), [0.0, 1e9], method="dopri5", rtol=1e-10, max_steps=10**8)

    def others():
        deadline = time.perf_counter() + 0.5
        while time.perf_counter() < deadline:
            found = model.simulate((0.0, 1.0), method="dopri5")
            assert np.array_equal(found.y, known.y)

    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(others)
        with pytest.raises(KeyboardInterrupt):
            interrupted()
        running.result()
    assert np.array_equal(model.simulate((0.0, 1.0), method="dopri5").y, known.y)


def test_silence_ends_with_the_last_who_asked():
    filters = list(warnings.filters)
    first, second = threading.Event(), threading.Event()

    def long():
        with without_warnings("never said"):
            first.set()
            second.wait()

    def overlapping(_):
        first.wait()
        with without_warnings("never said"):
            pass
        assert len(warnings.filters) == len(filters) + 1  # the other thread still asks for it
        second.set()

    with ThreadPoolExecutor(2) as pool:
        waiting = pool.submit(long)
        pool.submit(overlapping, 0).result()
        waiting.result()
    assert list(warnings.filters) == filters


def test_silence_leaves_other_filters_alone():
    with warnings.catch_warnings():
        with without_warnings("never said", UserWarning):
            warnings.simplefilter("error", DeprecationWarning)
            added = warnings.filters[0]
            warnings.warn("never said", UserWarning, stacklevel=1)
        assert warnings.filters[0] == added
        with pytest.warns(UserWarning, match="never said"):
            warnings.warn("never said", UserWarning, stacklevel=1)


def test_bars_are_of_the_main_thread(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    with ThreadPoolExecutor(1) as pool:
        assert not pool.submit(is_watched).result()
    assert is_watched()


class Terminal(io.StringIO):
    def isatty(self):
        return True
