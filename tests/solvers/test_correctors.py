"""CVODES and IDAS: sensitivities as vectors of their own, on compiled models."""

from __future__ import annotations

import sys

import _cffi_backend
import cffi
import circuits
import numpy as np
import pytest
from domain_scenes import scene_of_domain
from hand_made import Made, model_of
from ivp_cases import oscillator
from loop_with_network import four_bar, with_a_network
from reference_scenes import read_reference
from sundials_cases import counted_contexts, follows_a_long_ladder, follows_an_oscillator

from cotree import Scene, bench, load
from cotree.build import find_toolchain
from cotree.errors import SolveError
from cotree.methods import METHODS as ROWS
from cotree.pipeline import formulate
from cotree.solvers import engine, integrate, job
from cotree.solvers import sundials as sundials_library
from cotree.solvers.engine import load_engine
from cotree.solvers.native import check_available, is_available
from cotree.solvers.problem import Tolerances
from cotree.solvers.sundials import library_path, version_of

METHODS = tuple(name for name, row in ROWS.items() if row.family == "correctors")

pytestmark = pytest.mark.compiler


@pytest.fixture
def there():
    """Skip where there is no library to run."""
    for method in METHODS:
        try:
            check_available(method)
        except SolveError as error:
            pytest.skip(str(error))


@pytest.fixture
def nowhere(monkeypatch):
    """Neither a named library nor an installed one."""
    monkeypatch.delenv("COTREE_SUNDIALS", raising=False)
    monkeypatch.setattr(sundials_library.importlib.util, "find_spec", lambda name: None)


@pytest.fixture(scope="module")
def slider():
    return load("slider-pendulum").compile(["L", "k"])


@pytest.mark.parametrize("method", METHODS)
def test_no_library_names_what_to_do(method, nowhere, monkeypatch):
    monkeypatch.setattr(sys, "version_info", (3, 11, 9))
    with pytest.raises(SolveError) as caught:
        check_available(method)
    words = (f"'{method}'", "take Python 3.12 or later, here it is 3.11", "COTREE_SUNDIALS")
    words += ("pip install sundials4py", "cotree[sundials]", f"use '{ROWS[method].instead}'")
    for word in words:
        assert word in str(caught.value)
    monkeypatch.setattr(sys, "version_info", (3, 13, 0))
    with pytest.raises(SolveError) as caught:
        check_available(method)
    assert "take Python" not in str(caught.value)
    assert "pip install sundials4py" in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("content", [None, b"no library"])
def test_a_wrong_file_is_named(content, tmp_path, monkeypatch):
    path = tmp_path / "libsundials.so"
    if content is not None:
        path.write_bytes(content)
    monkeypatch.setenv("COTREE_SUNDIALS", str(path))
    words = "there is no such file" if content is None else "functions cannot be found"
    if content is not None and find_toolchain() is None:
        words = "no compiler can build its engine"
    for method in METHODS:
        with pytest.raises(SolveError, match=words):
            check_available(method)
        assert not is_available(method)


def test_a_named_library_serves_cvode_too(tmp_path, monkeypatch):
    monkeypatch.setenv("COTREE_SUNDIALS", str(tmp_path / "nothing.so"))
    result = load("spring-mass-damper").compile().simulate((0.0, 0.1), [0.1], "cvode")
    assert "BDF was used instead of cvode" in result.message
    assert "there is no such file" in result.message


@pytest.mark.parametrize(
    ("folder", "version"),
    [("sundials4py-7.9.0.dist-info", (7, 9)), ("sundials4py-8.10.2.dist-info", (8, 10)), ("", ())],
)
def test_the_version_of_a_library_that_does_not_tell_it(folder, version, tmp_path):
    """As in sundials4py: the package's own, beside the file."""
    if folder:
        (tmp_path / folder).mkdir()
    path = tmp_path / "sundials4py.abi3.so"
    assert version_of(_cffi_backend.FFI(), object(), str(path)) == version


@pytest.mark.slow
def test_bench_leaves_out_what_is_not_there(nowhere):
    report = bench("spring-mass-damper", tolerances=[1e-4], repeats=1, t_end=0.1)
    assert not {row.method for row in report.rows} & set(METHODS)


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("library", ["cvodes", "idas"])
def test_the_structures_are_those_of_the_library(library):
    """SUNDIALS' own iteration has its functions, and its vectors others, where C looks for them."""
    load_engine(library)
    ffi = cffi.FFI()
    names = {0: "GetType", 3: "Solve", 5: "SetSysFn", 14: "SetMaxIters", 16: "GetCurIter"}
    functions = {place: f"SUNNonlinSol{name}_Newton" for place, name in names.items()}
    ffi.cdef(
        "int SUNContext_Create(int, void **); int SUNContext_Free(void **);"
        "void *N_VNew_Serial(int64_t, void *); void N_VDestroy(void *);"
        "void *N_VNew_SensWrapper(int, void *); void N_VConst(double, void *);"
        "double *N_VGetArrayPointer(void *);"
        "void *SUNNonlinSol_Newton(void *, void *); int SUNNonlinSolFree(void *);"
        + "".join(f"void {name}(void);" for name in functions.values())
    )
    there = ffi.dlopen(library_path(library).path, ffi.RTLD_LAZY)
    context = ffi.new("void **")
    assert there.SUNContext_Create(0, context) == 0
    vector = there.N_VNew_Serial(2, context[0])
    solver = there.SUNNonlinSol_Newton(vector, context[0])
    fields = ffi.cast("void **", solver)
    operations = ffi.cast("void **", fields[2])  # after content and python
    assert fields[3] == context[0]
    for place, name in functions.items():
        assert operations[place] == ffi.cast("void *", ffi.addressof(there, name))
    several = there.N_VNew_SensWrapper(3, vector)
    content = ffi.cast("void **", ffi.cast("void **", several)[0])
    assert ffi.cast("void **", several)[2] == context[0]
    assert ffi.cast("int *", content + 1)[0] == 3
    vectors = ffi.cast("void **", content[0])
    there.N_VConst(7.0, several)
    assert [list(there.N_VGetArrayPointer(vectors[i])[0:2]) for i in range(3)] == [[7.0, 7.0]] * 3
    there.N_VDestroy(several)
    there.SUNNonlinSolFree(solver)
    there.N_VDestroy(vector)
    there.SUNContext_Free(context)


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
def test_another_version_is_refused(method, monkeypatch):
    monkeypatch.setattr(sundials_library, "SUNDIALS_VERSION", (6, 0))
    engine._opened.cache_clear()
    try:
        with pytest.raises(SolveError, match=r"SUNDIALS is of version 7\.9, not 6\.0"):
            check_available(method)
    finally:
        engine._opened.cache_clear()


@pytest.mark.usefixtures("there")
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
    # A matrix a step at most, and two evaluations; a tenth more for steps that are refused.
    assert result.statistics.nlu < 1.1 * result.statistics.n_steps
    assert result.statistics.nfev < 2.2 * result.statistics.n_steps


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
def test_sensitivities_are_in_the_error_test_or_not(slider, method, monkeypatch):
    """Without states in the error test, that of the sensitivities controls the steps."""

    class Loose(Tolerances):
        def of(self, problem):
            atol = super().of(problem)
            atol[: problem.n_states] = 1e3
            return atol

    monkeypatch.setattr(job, "Tolerances", Loose)
    settings = {"method": method, "rtol": 1e-9, "atol": 1e-9}
    with_test = slider.simulate((0.0, 10.0), [10.0], **settings)
    without = slider.simulate((0.0, 10.0), [10.0], error_test_sensitivities=False, **settings)
    assert with_test.statistics.n_steps > 500
    assert without.statistics.n_steps < 100


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
def test_without_sensitivities_it_is_the_method_without_them(method):
    model, other = load("slider-pendulum").compile(), ROWS[method].instead
    there = model.simulate((0.0, 10.0), None, method)
    here = model.simulate((0.0, 10.0), None, other)
    assert there.statistics.n_steps == here.statistics.n_steps
    # Two builds of the same text may round differently, and the motion stretches that.
    np.testing.assert_allclose(there.y, here.y, atol=3e-6)


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize(("name", "span"), [("chem_hires", 321.8122), ("chem_robertson", 1e5)])
@pytest.mark.parametrize("tested", [True, False])
@pytest.mark.parametrize("method", METHODS)
def test_stiff_reactions(name, span, tested, method):
    scene = scene_of_domain(name)
    model = scene.compile(list(scene.compile().parameters)[:3])
    times = np.geomspace(1e-3, span, 40)
    reference = model.simulate((0.0, span), times, "rodas5", 1e-12, 1e-17, throw=True)
    settings = {"error_test_sensitivities": tested, "throw": True}
    result = model.simulate((0.0, span), times, method, 1e-8, 1e-13, **settings)
    scale_y = np.abs(reference.y).max(axis=1, keepdims=True)
    scale_s = np.abs(reference.s).max(axis=2, keepdims=True)
    # Some thousand steps of 1e-8. Sensitivities outside the error test only follow the states.
    assert np.max(np.abs(result.y - reference.y) / scale_y) < 1e-6
    assert np.max(np.abs(result.s - reference.s) / scale_s) < (1e-6 if tested else 1e-4)


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
def test_sensitivities_against_a_closed_form(method):
    follows_an_oscillator(method)


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
def test_backwards(method):
    scene = Scene("discharge")
    scene.parameter("R", 1.0)
    scene.edge("C1", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.edge("R1", "resistor", "a", "ground", resistance="R")
    result = scene.compile(["R"]).simulate((1.0, 0.0), [0.5, 0.0], method, 1e-10, 1e-12)
    # v = exp((1 - t)/R), dv/dR = (t - 1) v at R = 1. A hundred steps of 1e-10.
    np.testing.assert_allclose(result["C1.v"], np.exp([0.5, 1.0]), rtol=1e-8)
    expected = [-0.5 * np.exp(0.5), -np.exp(1.0)]
    np.testing.assert_allclose(result.sensitivity("C1.v", "R"), expected, rtol=1e-8)


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
def test_jumps_of_an_input_are_corners(method):
    scene = Scene("forced")
    scene.input("u", 0.0)
    scene.parameter("m", 2.0)
    scene.edge("m", "translational_mass", "ground", "a", mass="m")
    scene.edge("f", "force_source", "ground", "a", force="u")
    scene.output("v", "m.v")
    pulse = ([0.0, 1.0, 1.001, 1.002, 1.003], [0.0, 0.0, 2000.0, 2000.0, 0.0])
    times = [0.5, 1.0, 5.0]
    model = scene.compile(["m"])
    result = model.simulate((0.0, 5.0), times, method, 1e-9, 1e-12, inputs={"u": pulse})
    # The pulse's area is 4 N s: 2 m/s for 2 kg, and -4/m^2 = -1 m/s/kg.
    np.testing.assert_allclose(result["v"], [0.0, 0.0, 2.0], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(result.sensitivity("v", "m"), [0.0, 0.0, -1.0], atol=1e-8)


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
def test_sensitivities_of_a_long_ladder(method):
    follows_a_long_ladder(method)


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("name", "parameters"), [("spice_rectifier", 0), ("ivp_transistor_amplifier", 3)]
)
def test_references_of_index_1(name, parameters, method):
    """Outputs and sensitivities of the files, at 1e-8."""
    data = read_reference(name)
    wanted = list(data.get("sensitivities", {}).get("values", {}))[:parameters]
    times = [row["t"] for row in data["reference"]]
    model = circuits.circuit(name).compile(wanted)
    result = model.simulate((0.0, data["t_end"]), times, method, 1e-8, 1e-10, throw=True)
    # Were algebraic unknowns in IDA's error test, it would take a hundred times as many.
    assert result.statistics.n_steps < 9000
    tables = {"": data["reference"]} | {p: data["sensitivities"]["values"][p] for p in wanted}
    for parameter, rows in tables.items():
        largest = max(abs(value) for row in rows for value in row["values"].values())
        for key in rows[0]["values"]:
            expected = np.array([row["values"][key] for row in rows])
            output = circuits.output_of(key)
            found = result.sensitivity(output, parameter) if parameter else result[output]
            # Errors of 1e-8 a step, through some thousand steps that forget most of them.
            assert np.max(np.abs(found - expected)) < 1e-5 * largest, (key, parameter)
    # Solved for wherever a point is kept: to rounding, of mA and tens of volts.
    assert result.drift.worst < 1e-12


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("tested", [True, False])
def test_constrained_motions_stay_on_their_constraints(method, tested):
    model = load("slider-pendulum").compile(["L"], tree=["m5", "m6", "r3", "r4"])
    times = np.linspace(0.0, 10.0, 41)
    settings = {"error_test_sensitivities": tested, "throw": True}
    result = model.simulate((0.0, 10.0), times, method, 1e-9, 1e-10, **settings)
    expected = model.simulate((0.0, 10.0), times, "dop853", 1e-12, 1e-13, throw=True)
    # Rounding of lengths and speeds of some metres.
    assert result.drift.worst < 1e-13
    # A step's own error at most, which is what a projection takes back.
    assert 0.0 < result.drift.correction < 1e-6
    # 1e-9 a step through a thousand steps of a motion that stretches errors.
    assert np.abs(result.y - expected.y).max() < 1e-5
    assert np.abs(result.s - expected.s).max() < 1e-4


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
def test_constraints_and_algebraic_unknowns_live_together(method):
    alone = four_bar().compile(["a"])
    model = model_of(with_a_network(formulate(four_bar(), ["a"], None)[1]))
    times, n = np.linspace(0.0, 1.0, 6), len(alone.states)
    result = model.simulate((0.0, 1.0), times, method, 1e-9, 1e-11, throw=True)
    expected = alone.simulate((0.0, 1.0), times, "dop853", 1e-12, 1e-13, throw=True)
    # Some hundred steps at 1e-9, enlarged some ten times by the motion.
    np.testing.assert_allclose(result.y[:n], expected.y, atol=1e-6)
    np.testing.assert_allclose(result.s[:n], expected.s, atol=1e-5)


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
def test_what_cannot_be_taken_names_the_method_that_can(method):
    other = ROWS[method].instead
    with pytest.raises(SolveError, match=f"are Python functions. Use '{other}'"):
        integrate(oscillator(), method)
    fixed = Scene("fixed")
    fixed.edge("V1", "voltage_source", "a", "ground", voltage="sin(t)")
    fixed.edge("R1", "resistor", "a", "ground", resistance=1.0)
    fixed.edge("D1", "diode", "a", "b", saturation_current=1e-9)
    fixed.edge("R2", "resistor", "b", "ground", resistance=1.0)
    with pytest.raises(SolveError, match=f"there are no states. Use '{other}'"):
        fixed.compile().simulate((0.0, 1.0), [1.0], method)


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
def test_failures_are_results_with_their_reason(method):
    """x' = -1, 0 = z^2 - x: no solution is left beyond t = 1."""
    made = Made(
        "fold", {"x": 1.0}, {"z": 1.0}, {}, lambda v: [-1.0 + 0.0 * v["z"], v["z"] ** 2 - v["x"]]
    )
    with pytest.warns(RuntimeWarning, match=f"{method} stopped at"):
        result = made.model().simulate((0.0, 2.0), [0.75, 1.5], method, 1e-8, 1e-10)
    assert result.status == -1
    np.testing.assert_allclose(result["z"][0], 0.5, rtol=1e-8)


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("current", "end"), [("C1.v**2*k", 1.0), ("k*sqrt(0.5 - t)", 0.5)])
def test_failures_are_reported_where_they_happen(current, end, method):
    scene = Scene("explosion")
    scene.parameter("k", 1.0)
    scene.edge("C1", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.edge("I1", "current_source", "ground", "a", current=current)
    with pytest.warns(RuntimeWarning, match=f"{method} stopped at t = "):
        result = scene.compile(["k"]).simulate((0.0, 2.0), [0.25, 1.5], method, 1e-6, 1e-8)
    assert result.status == -1
    # v' = v^2 with v(0) = 1 has its pole at 1, which 1e-6 places within 1e-4.
    assert result.t.tolist() == [0.25, pytest.approx(end, abs=1e-4)]
    assert np.all(np.isfinite(result.y))


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
def test_budgets(slider, method):
    with pytest.warns(RuntimeWarning, match="the limit of 7 steps is reached"):
        result = slider.simulate((0.0, 10.0), None, method, max_steps=7)
    assert result.status == -2
    assert len(result.t) == 8
    result = slider.simulate((0.0, 1.0), None, method, max_step=1e-3)
    assert np.diff(result.t).max() <= 1e-3 * (1 + 1e-9)


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("method", METHODS)
def test_memory_is_freed_after_an_interruption(slider, method, monkeypatch):
    run = job.Job.run

    def interrupted(self, most_steps):
        run(self, 5)
        raise KeyboardInterrupt

    monkeypatch.setattr(job.Job, "run", interrupted)
    loaded = load_engine(ROWS[method].stepper)
    with counted_contexts(loaded) as counts, pytest.raises(KeyboardInterrupt):
        slider.simulate((0.0, 10.0), [10.0], method)
    assert counts["SUNContext_Create"] == counts["SUNContext_Free"] == 1
    assert counts["N_VMake_Serial"] == counts["N_VDestroy"] > 0
    assert counts["SUNNonlinSolNewEmpty"] == counts["SUNNonlinSolFreeEmpty"] > 0
