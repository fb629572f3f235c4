"""CVODE and IDA driven from C, on compiled models."""

from __future__ import annotations

import importlib
import sys

import cffi
import circuits
import numpy as np
import pytest
from domain_scenes import scene_of_domain
from hand_made import Made, model_of
from loop_with_network import four_bar, with_a_network
from network_scenes import rc_grid, rc_ladder
from reference_scenes import read_reference
from sundials_cases import counted_contexts, follows_a_long_ladder, follows_an_oscillator

from cotree import Scene, load
from cotree.codegen.c_files import sundials_functions
from cotree.errors import SolveError
from cotree.pipeline import formulate
from cotree.solvers import engine, problem
from cotree.solvers import sundials as sundials_library
from cotree.solvers.engine import load_engine
from cotree.solvers.job import Job

pytest.importorskip("sksundae")
pytestmark = pytest.mark.compiler

METHODS = ("cvode", "ida")


@pytest.fixture(autouse=True)
def _in_c():
    for method in METHODS:
        loaded = load_engine(method)
        if isinstance(loaded, str):
            pytest.skip(loaded)


@pytest.fixture(scope="module")
def slider():
    return load("slider-pendulum").compile(["L", "k"])


@pytest.mark.parametrize("method", METHODS)
def test_the_structures_are_those_of_the_library(method):
    """SUNDIALS' own Newton iteration has its functions where C puts others."""
    load_engine(method)
    ffi = cffi.FFI()
    names = {0: "GetType", 3: "Solve", 5: "SetSysFn", 14: "SetMaxIters", 16: "GetCurIter"}
    functions = {place: f"SUNNonlinSol{name}_Newton" for place, name in names.items()}
    ffi.cdef(
        "int SUNContext_Create(int, void **); int SUNContext_Free(void **);"
        "void *N_VNew_Serial(int64_t, void *); void N_VDestroy(void *);"
        "void *SUNNonlinSol_Newton(void *, void *); int SUNNonlinSolFree(void *);"
        + "".join(f"void {name}(void);" for name in functions.values())
    )
    path = importlib.import_module(f"sksundae._cy_{method}").__file__
    library, context = ffi.dlopen(path), ffi.new("void **")
    assert library.SUNContext_Create(0, context) == 0
    vector = library.N_VNew_Serial(2, context[0])
    solver = library.SUNNonlinSol_Newton(vector, context[0])
    fields = ffi.cast("void **", solver)
    operations = ffi.cast("void **", fields[2])  # after content and python
    assert fields[3] == context[0]
    for place, name in functions.items():
        assert operations[place] == ffi.cast("void *", ffi.addressof(library, name))
    library.SUNNonlinSolFree(solver)
    library.N_VDestroy(vector)
    library.SUNContext_Free(context)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("tested", [True, False])
def test_agrees_with_a_tight_solution(slider, tested, method):
    times = np.linspace(0.0, 10.0, 101)
    reference = slider.simulate((0.0, 10.0), times, "dop853", 1e-12, 1e-13)
    settings = {"error_test_sensitivities": tested, "throw": True}
    result = slider.simulate((0.0, 10.0), times, method, 1e-9, 1e-10, **settings)
    assert result.message == f"{method} reached t = 10."
    assert result.statistics.method == method
    # 1e-9 a step through a thousand steps of a motion that stretches errors.
    assert np.abs(result.y - reference.y).max() < 1e-6
    assert np.abs(result.s - reference.s).max() < 1e-5
    assert np.array_equal(result.t, times)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("name", "span"), [("chem_hires", 321.8122), ("chem_robertson", 1e5)])
@pytest.mark.parametrize("tested", [True, False])
@pytest.mark.parametrize("method", METHODS)
def test_stiff_reactions_agree_with_a_tight_solution(name, span, tested, method):
    scene = scene_of_domain(name)
    model = scene.compile(list(scene.compile().parameters)[:3])
    times = np.geomspace(1e-3, span, 40)
    settings = {"method": method, "rtol": 1e-8, "atol": 1e-13, "throw": True}
    tight = settings | {"rtol": 1e-11, "atol": 1e-16, "method": "rodas5"}
    reference = model.simulate((0.0, span), times, **tight)
    result = model.simulate((0.0, span), times, error_test_sensitivities=tested, **settings)
    assert result.statistics.method == method
    scale_y = np.abs(reference.y).max(axis=1, keepdims=True)
    scale_s = np.abs(reference.s).max(axis=2, keepdims=True)

    def errors(found):
        return (
            np.max(np.abs(found.y - reference.y) / scale_y),
            np.max(np.abs(found.s - reference.s) / scale_s),
        )

    # Some thousand steps of 1e-8. Sensitivities outside the error test only follow the states.
    y, s = errors(result)
    assert y < 1e-6
    assert s < (1e-6 if tested else 1e-4)
    # One factorisation for the states of a step and one for all their sensitivities, with one
    # evaluation each; half as many again for steps that are refused or iterated on.
    assert result.statistics.nlu < 2.5 * result.statistics.n_steps
    assert result.statistics.nfev < 2.5 * result.statistics.n_steps


@pytest.mark.parametrize("method", METHODS)
def test_sensitivities_against_a_closed_form(method):
    follows_an_oscillator(method)


@pytest.mark.parametrize("method", METHODS)
def test_backwards(method):
    scene = Scene("discharge")
    scene.edge("C1", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.edge("R1", "resistor", "a", "ground", resistance=1.0)
    result = scene.compile().simulate((1.0, 0.0), [0.5, 0.0], method, 1e-10, 1e-12)
    # A hundred steps of 1e-10.
    np.testing.assert_allclose(result["C1.v"], np.exp([0.5, 1.0]), rtol=1e-8)


@pytest.mark.parametrize("method", METHODS)
def test_jumps_of_an_input_are_corners(method):
    scene = Scene("forced")
    scene.input("u", 0.0)
    scene.edge("m", "translational_mass", "ground", "a", mass=2.0)
    scene.edge("f", "force_source", "ground", "a", force="u")
    scene.output("v", "m.v")
    pulse = ([0.0, 1.0, 1.001, 1.002, 1.003], [0.0, 0.0, 2000.0, 2000.0, 0.0])
    result = scene.compile().simulate(
        (0.0, 5.0), [0.5, 1.0, 5.0], method, 1e-9, 1e-12, inputs={"u": pulse}
    )
    # The pulse's area is 4 N s: 2 m/s for 2 kg.
    np.testing.assert_allclose(result["v"], [0.0, 0.0, 2.0], rtol=1e-8, atol=1e-10)
    assert result.statistics.method == method


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("make", "size"), [(rc_ladder, 200), (rc_grid, 15)])
def test_narrow_and_wide_bands(make, size, method):
    """Networks of hundreds of states: a band of a few entries, and one of tens."""
    model = make(size).compile()
    settings = {"method": method, "rtol": 1e-7, "atol": 1e-10, "throw": True}
    result = model.simulate((0.0, 50.0), [1.0, 50.0], **settings)
    assert result.statistics.method == method
    # SciPy's, whose factors are sparse; each follows with an error of some hundred tolerances.
    other = model.simulate((0.0, 50.0), [1.0, 50.0], **settings | {"method": "BDF", "rtol": 1e-9})
    np.testing.assert_allclose(result.y, other.y, rtol=1e-5, atol=1e-8)


_BAND_TEST = """
#include "cotree_lu.h"

#include <stdlib.h>

/* Entries column by column; each array has exactly its size. Returns whether it is singular. */
%s int solve(int n, int lower, int upper, const double *entries, double *b)
{
    const size_t size = cotree_lu_doubles(n, lower, upper);
    double *const memory = (double *)calloc(size, sizeof(double));
    int *const pivots = (int *)calloc((size_t)n, sizeof(int));
    const cotree_lu a = cotree_lu_of(n, lower, upper, memory, pivots);
    int i, j, status;
    for (j = 0; j < n; ++j) {
        for (i = 0; i < n; ++i) {
            if (i - j <= lower && j - i <= upper) a.first[i + j * a.stride] = entries[i + j * n];
        }
    }
    status = cotree_lu_factorise(&a);
    if (status == 0) cotree_lu_solve(&a, b);
    free(memory);
    free(pivots);
    return status;
}
"""


def test_bands_against_another_factorisation():
    """Random matrices without large diagonals, so that rows are exchanged; and singular ones."""
    from cotree.build import BuildOptions, build_library, find_toolchain
    from cotree.codegen.render import with_runtime

    export = "__declspec(dllexport)" if sys.platform == "win32" else ""
    built = build_library(
        with_runtime({"band.c": _BAND_TEST % export}),
        abi_version=0,
        n_operations=1,
        options=BuildOptions("-O1"),
        toolchain=find_toolchain(),
    )
    ffi = cffi.FFI()
    ffi.cdef("int solve(int, int, int, const double *, double *);")
    library = ffi.dlopen(str(built.path))
    rng = np.random.default_rng(3)

    def solve(matrix, lower, upper, b):
        entries = np.asfortranarray(matrix).ravel(order="F").copy()
        x = b.copy()
        pointers = (ffi.from_buffer("double[]", array) for array in (entries, x))
        return library.solve(len(b), lower, upper, *pointers), x

    for n, lower, upper in [(1, 0, 0), (7, 6, 6), (9, 0, 2), (12, 1, 1), (30, 3, 1), (30, 2, 7)]:
        i, j = np.indices((n, n))
        matrix = np.where((i - j <= lower) & (j - i <= upper), rng.normal(size=(n, n)), 0.0)
        b = rng.normal(size=n)
        status, x = solve(matrix, lower, upper, b)
        assert status == 0
        # Rounding, times the condition of the matrix.
        accuracy = 1e-14 * n * np.linalg.cond(matrix)
        np.testing.assert_allclose(x, np.linalg.solve(matrix, b), rtol=accuracy, atol=accuracy)
        matrix[:, n // 2] = 0.0
        assert solve(matrix, lower, upper, b)[0] == 1


def test_too_wide_a_band_is_left_to_sparse_matrices(monkeypatch):
    monkeypatch.setattr(sundials_library, "_MOST_MULTIPLICATIONS", 1e3)
    model = rc_grid(15).compile()
    result = model.simulate((0.0, 1.0), [1.0], "cvode")
    assert "BDF was used instead of cvode: the Jacobian's band is wide." in result.message


def test_too_wide_a_band_with_events_is_factorised_all_the_same(monkeypatch):
    scene = rc_grid(15)
    scene.event("late", "t - 0.5", direction=1, stop=True)
    model = scene.compile()
    first = model.simulate((0.0, 1.0), [0.5], "cvode")
    monkeypatch.setattr(sundials_library, "_MOST_MULTIPLICATIONS", 1e3)
    result = model.simulate((0.0, 1.0), [0.5], "cvode")
    assert result.statistics.method == "cvode"
    np.testing.assert_array_equal(result.y, first.y)


def test_many_states_beside_algebraic_unknowns_are_refused(monkeypatch):
    monkeypatch.setattr(problem, "_MOST_REDUCED", 2)
    model = load("bridge-rectifier").compile()
    with pytest.raises(SolveError, match="algebraic unknowns and more than 2 states"):
        model.simulate((0.0, 1e-3), [1e-3], "cvode", 1e-6, 1e-8)
    result = model.simulate((0.0, 1e-3), [1e-3], "ida", 1e-6, 1e-8)
    assert result.statistics.method == "ida"


@pytest.mark.parametrize("method", METHODS)
def test_sensitivities_of_a_long_ladder(method):
    assert follows_a_long_ladder(method).statistics.method == method


@pytest.mark.parametrize(
    ("current", "end", "words"),
    [
        ("C1.v**2", 1.0, ""),
        ("sqrt(0.5 - t)", 0.5, "the derivative of 'C1.v' is not finite within"),
    ],
)
@pytest.mark.parametrize("method", METHODS)
def test_failures_are_reported_where_they_happen(current, end, words, method):
    scene = Scene("explosion")
    scene.edge("C1", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.edge("I1", "current_source", "ground", "a", current=current)
    model = scene.compile()
    with pytest.warns(RuntimeWarning, match=f"{method} stopped at t = "):
        result = model.simulate((0.0, 2.0), [0.25, 1.5], method, 1e-6, 1e-8)
    assert result.status == -1
    assert words in result.message
    # v' = v^2 with v(0) = 1 has its pole at 1, which 1e-6 places within 1e-4.
    assert result.t.tolist() == [0.25, pytest.approx(end, abs=1e-4)]
    assert np.all(np.isfinite(result.y))


@pytest.mark.parametrize("method", METHODS)
def test_budgets(slider, method):
    with pytest.warns(RuntimeWarning, match="the limit of 7 steps is reached"):
        result = slider.simulate((0.0, 10.0), None, method, max_steps=7)
    assert result.status == -2
    assert len(result.t) == 8
    with pytest.warns(RuntimeWarning, match=r"time limit of 0\.0001 s is spent"):
        result = slider.simulate((0.0, 1e9), [1e9], method, time_limit=1e-4)
    assert result.status == -2
    assert 0.0 < result.t[-1] < 1e9


@pytest.mark.parametrize("method", METHODS)
def test_the_longest_step_is_kept(slider, method):
    result = slider.simulate((0.0, 1.0), None, method, max_step=1e-3)
    assert result.statistics.n_steps >= 1000
    assert np.diff(result.t).max() <= 1e-3 * (1 + 1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_memory_is_freed_after_an_interruption(slider, method, monkeypatch):
    run = Job.run

    def interrupted(self, most_steps):
        run(self, 5)
        raise KeyboardInterrupt

    monkeypatch.setattr(Job, "run", interrupted)
    with (
        counted_contexts(load_engine(method, has_events=False)) as counts,
        pytest.raises(KeyboardInterrupt),
    ):
        slider.simulate((0.0, 10.0), [10.0], method)
    assert counts["SUNContext_Create"] == counts["SUNContext_Free"] == 1
    assert counts["N_VMake_Serial"] == counts["N_VDestroy"] > 0


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("missing", ["symbols", "version", "compiler"])
def test_what_is_missing_is_said(slider, monkeypatch, missing, method):
    if missing == "symbols":
        monkeypatch.setitem(sundials_functions(method), "CVodeFlyAway", ("int", "void"))
    elif missing == "version":
        monkeypatch.setattr(sundials_library, "SUNDIALS_VERSION", (6, 0))
    else:
        monkeypatch.setattr(engine, "build_engine", lambda *_: None)
    engine._opened.cache_clear()
    try:
        result = slider.simulate((0.0, 0.1), [0.1], method)
    finally:
        engine._opened.cache_clear()
    why = {
        "symbols": "SUNDIALS' functions cannot be found",
        "version": "SUNDIALS is of version 7.9, not 6.0",
        "compiler": "no compiler can build its engine",
    }[missing]
    assert f"BDF was used instead of {method}: {why}" in result.message
    exact = slider.simulate((0.0, 0.1), [0.1], "DOP853", 1e-11, 1e-12)
    np.testing.assert_allclose(result.y, exact.y, atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("name", "parameters", "steps"),
    [("spice_rectifier", 0, 1000), ("ivp_transistor_amplifier", 3, 9000)],
)
def test_references_of_index_1(name, parameters, steps, method):
    """Outputs and sensitivities of the files, at 1e-8."""
    data = read_reference(name)
    wanted = list(data.get("sensitivities", {}).get("values", {}))[:parameters]
    times = [row["t"] for row in data["reference"]]
    model = circuits.circuit(name).compile(wanted)
    result = model.simulate((0.0, data["t_end"]), times, method, 1e-8, 1e-10, throw=True)
    assert result.statistics.method == method
    # Were algebraic unknowns in IDA's error test, it would take a hundred times as many.
    assert result.statistics.n_steps < steps
    tables = {"": data["reference"]} | {p: data["sensitivities"]["values"][p] for p in wanted}
    for parameter, rows in tables.items():
        largest = max(abs(value) for row in rows for value in row["values"].values())
        for key in rows[0]["values"]:
            expected = np.array([row["values"][key] for row in rows])
            output = circuits.output_of(key)
            found = result.sensitivity(output, parameter) if parameter else result[output]
            # Errors of 1e-8 a step, through some thousand steps that forget most of them.
            assert np.max(np.abs(found - expected)) < 1e-5 * largest, (key, parameter)
    # Algebraic unknowns are solved for wherever a point is kept: to rounding of their equations,
    # which have currents of mA and voltages of tens of volts.
    assert result.drift.worst < 1e-12


@pytest.mark.parametrize("method", METHODS)
def test_stored_points_of_index_1_are_solutions_with_their_sensitivities(method):
    """C v' = -i with R i + Vt log(1 + i/Is) = v: i(v) and its derivative are known."""
    resistance, saturation, thermal = 10.0, 1e-9, 0.025
    scene = Scene("discharge")
    scene.parameter("R", resistance)
    scene.edge("C1", "capacitor", "a", "ground", capacitance=1e-3, initial={"v": 1.0})
    scene.edge("R1", "resistor", "a", "b", resistance="R")
    diode = {"saturation_current": saturation, "thermal_voltage": thermal}
    scene.edge("D1", "diode", "b", "ground", **diode)
    result = scene.compile(["R"]).simulate((0.0, 0.05), None, method, 1e-8, 1e-10)
    assert result.statistics.method == method
    v, vd = result["C1.v"], result["D1.v"]
    current = saturation * np.expm1(vd / thermal)
    # The exponential enlarges the rounding of a volt forty times; currents of 50 mA.
    np.testing.assert_allclose(resistance * current + vd, v, rtol=1e-13, atol=1e-14)
    # R i' vd_R + vd_R = v_R - i, where i' = (i + Is) / Vt.
    slope = (current + saturation) / thermal
    along = (result.sensitivity("C1.v", "R") - current) / (1.0 + resistance * slope)
    np.testing.assert_allclose(result.sensitivity("D1.v", "R"), along, rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("method", METHODS)
def test_algebraic_unknowns_jump_with_an_input(method):
    """At a corner they begin anew: R v' C = u - v through two diodes in opposite directions."""
    scene = Scene("clamped")
    scene.input("u", 0.0)
    scene.edge("V1", "voltage_source", "s", "ground", voltage="u")
    scene.edge("R1", "resistor", "s", "a", resistance=100.0)
    for name, ends in {"D1": ("a", "b"), "D2": ("b", "a")}.items():
        scene.edge(name, "diode", *ends, saturation_current=1e-9)
    scene.edge("C1", "capacitor", "b", "ground", capacitance=1e-5)
    model = scene.compile()
    steps = ([0.0, 1e-3, 1e-3 + 1e-9, 4e-3, 4e-3 + 1e-9, 6e-3], [5.0, 5.0, -5.0, -5.0, 3.0, 3.0])
    times = np.linspace(0.0, 6e-3, 31)
    settings = {"inputs": {"u": steps}, "throw": True}
    result = model.simulate((0.0, 6e-3), times, method, 1e-8, 1e-10, **settings)
    expected = model.simulate((0.0, 6e-3), times, "dop853", 1e-11, 1e-13, **settings)
    assert result.statistics.method == method
    # Some hundred steps of 1e-8 on each of three pieces.
    np.testing.assert_allclose(result["C1.v"], expected["C1.v"], atol=1e-6)
    assert result.drift.worst < 1e-12


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("tested", [True, False])
def test_constrained_motions_stay_on_their_constraints(method, tested):
    model = load("slider-pendulum").compile(["L"], tree=["m5", "m6", "r3", "r4"])
    times = np.linspace(0.0, 10.0, 41)
    settings = {"error_test_sensitivities": tested, "throw": True}
    result = model.simulate((0.0, 10.0), times, method, 1e-9, 1e-10, **settings)
    expected = model.simulate((0.0, 10.0), times, "dop853", 1e-12, 1e-13, throw=True)
    assert result.statistics.method == method
    assert model.kernels.layout.constraints
    # Rounding of lengths and speeds of some metres.
    assert result.drift.worst < 1e-13
    # A step's own error at most, which is what a projection takes back.
    assert 0.0 < result.drift.correction < 1e-6
    # 1e-9 a step through a thousand steps of a motion that stretches errors.
    assert np.abs(result.y - expected.y).max() < 1e-5
    assert np.abs(result.s - expected.s).max() < 1e-4


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", METHODS)
def test_constraints_beside_algebraic_unknowns_are_held_in_c(method):
    model = model_of(with_a_network(formulate(four_bar(), ["a"], None)[1]))
    times = np.linspace(0.0, 1.0, 6)
    result = model.simulate((0.0, 1.0), times, method, 1e-9, 1e-11, throw=True)
    expected = model.simulate((0.0, 1.0), times, "dop853", 1e-12, 1e-13, throw=True)
    assert result.statistics.method == method
    # Some hundred steps at 1e-9, enlarged some ten times by the motion.
    np.testing.assert_allclose(result.y, expected.y, atol=1e-6)
    np.testing.assert_allclose(result.s, expected.s, atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_unheld_constraints_drift(method):
    model = load("slider-pendulum").compile(tree=["m5", "m6", "r3", "r4"])
    result = model.simulate((0.0, 10.0), [10.0], method, 1e-6, 1e-8, project=False)
    assert result.statistics.method == method
    assert result.drift is None


@pytest.mark.parametrize("method", METHODS)
def test_the_last_good_point_of_a_spent_budget(method):
    model = load("bridge-rectifier").compile(["RL"])
    with pytest.warns(RuntimeWarning, match="the limit of 40 steps"):
        at_steps = model.simulate((0.0, 0.1), None, method, max_steps=40)
    with pytest.warns(RuntimeWarning, match="the limit of 40 steps"):
        wanted = model.simulate((0.0, 0.1), [0.1], method, max_steps=40)
    assert wanted.t[-1] == at_steps.t[-1]
    # Solved for once more: to rounding, enlarged by exponentials.
    np.testing.assert_allclose(wanted.y[:, -1], at_steps.y[:, -1], rtol=1e-9, atol=1e-12)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", METHODS)
def test_a_fold_is_named(method):
    """x' = -1, 0 = z^2 - x: no solution is left beyond t = 1."""
    made = Made(
        "fold", {"x": 1.0}, {"z": 1.0}, {}, lambda v: [-1.0 + 0.0 * v["z"], v["z"] ** 2 - v["x"]]
    )
    with pytest.warns(RuntimeWarning, match=f"{method} stopped at"):
        result = made.model().simulate((0.0, 2.0), [0.75, 1.5], method, 1e-8, 1e-10)
    assert result.status == -1
    assert "algebraic" in result.message
    np.testing.assert_allclose(result["z"][0], 0.5, rtol=1e-8)
