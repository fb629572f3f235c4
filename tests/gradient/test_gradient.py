"""Gradients in reverse mode against forward sensitivities of the same steps and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rod_chain import rod_chain

import cotree
from cotree.program.adjoint import form_adjoints

pytestmark = pytest.mark.compiler

#: Settings with which every step, also with sensitivities, has the largest permitted length.
FIXED = {"rtol": 1e-2, "atol": 1e3}
#: Both modes differentiate the same steps, so they differ only by rounding.
ROUNDING = 1e-11


def ladder(n: int) -> cotree.Scene:
    """Form an RC ladder, whose source depends on time and a parameter."""
    scene = cotree.Scene("ladder")
    scene.parameter("w", 1.3)
    for i in range(1, n + 1):
        scene.parameter(f"R{i}", 1.0 + 0.01 * i)
        scene.parameter(f"C{i}", 0.5 + 0.02 * i)
    scene.edge("V", "voltage_source", "n0", "ground", voltage="sin(w*t)")
    for i in range(1, n + 1):
        scene.edge(f"r{i}", "resistor", f"n{i - 1}", f"n{i}", resistance=f"R{i}")
        start = {"v": 0.3}
        scene.edge(f"c{i}", "capacitor", f"n{i}", "ground", capacitance=f"C{i}", initial=start)
    scene.output("v", f"c{n}.v")
    return scene


def predators() -> cotree.Scene:
    """Form the equations of Lotka and Volterra as circuits of two capacitors."""
    scene = cotree.Scene("predators")
    for name, value in {"a": 1.1, "b": 0.4, "c": 0.4, "d": 0.1}.items():
        scene.parameter(name, value)
    for name, rate, start in (("x", "a*x.v - b*x.v*y.v", 10.0), ("y", "d*x.v*y.v - c*y.v", 5.0)):
        scene.edge(name, "capacitor", name, "ground", capacitance=1.0, initial={"v": start})
        scene.edge(f"{name}i", "current_source", "ground", name, current=rate)
    scene.output("prey", "x.v")
    return scene


def pendulum() -> cotree.Scene:
    scene = cotree.load("slider-pendulum")
    scene.output("tip", "L*sin(h2.theta) + j1.s")
    return scene


def chain() -> cotree.Scene:
    scene, _ = rod_chain(4)
    joint = next(name for name, edge in scene.edges.items() if edge.statement["type"] == "revolute")
    scene.output("angle", f"sin({joint}.theta)")
    return scene


SCENES = {
    "ladder": (lambda: ladder(6), "v", 2.0, 0.05),
    "predators": (predators, "prey", 2.0, 0.05),
    "pendulum": (pendulum, "tip", 1.0, 0.02),
    "chain": (chain, "angle", 0.5, 0.01),
}


@pytest.mark.filterwarnings("ignore:no state was ever larger")
@pytest.mark.parametrize("method", ["dopri5", "rkf45", "dop853"])
@pytest.mark.parametrize("name", SCENES)
def test_the_gradient_is_the_derivative_of_the_same_steps(name, method):
    form, output, end, step = SCENES[name]
    scene = form()
    model = scene.compile()
    by = [*model.parameters, *model.states]
    settings = {**FIXED, "max_step": step, "method": method}
    found = model.gradient(f"end({output})**2", (0.0, end), by, **settings)
    result = scene.compile(by).simulate((0.0, end), **settings)
    assert found.n_steps == result.statistics.n_steps
    value, slopes = result.output_values, result.output_sensitivities
    i = result.outputs.index(output)
    assert found.value == pytest.approx(value[i, -1] ** 2, rel=ROUNDING)
    expected = 2.0 * value[i, -1] * slopes[i, :, -1]
    largest = np.abs(expected).max()
    np.testing.assert_allclose(found.gradient, expected, ROUNDING, ROUNDING * largest)


@pytest.mark.parametrize("method", ["dopri5", "rkf45", "dop853"])
@pytest.mark.parametrize("name", SCENES)
def test_misfits_within_steps_agree_with_forward_sensitivities(name, method):
    form, output, end, _ = SCENES[name]
    scene = form()
    model = scene.compile()
    by = [*model.parameters, *model.states]
    settings = {"rtol": 1e-11, "atol": 1e-13, "method": method}
    times = np.linspace(0.0, end, 17)
    data, spread = np.cos(times), 0.5 + times
    found = model.gradient({output: (times, data, spread)}, (0.0, end), by, **settings)
    result = scene.compile(by).simulate((0.0, end), times, **settings)
    i = result.outputs.index(output)
    deviations = (result.output_values[i] - data) / spread
    expected = 2.0 * result.output_sensitivities[i] @ (deviations / spread)
    assert found.value == pytest.approx(deviations @ deviations, rel=1e-9)
    # The step sizes differ, since forward runs also control the errors of sensitivities.
    np.testing.assert_allclose(found.gradient, expected, 1e-9, 1e-9 * np.abs(expected).max())


@pytest.mark.filterwarnings("ignore:no state was ever larger")
@pytest.mark.parametrize("rtol", [1e-3, 1e-7])
def test_interpolation_is_transposed_exactly(rtol):
    """Differences of the computed objective at equal steps; loose runs take steps to readings."""
    scene = ladder(4)
    model = scene.compile()
    times = np.linspace(0.0, 2.0, 29)
    data = {"v": (times, 0.3 * np.cos(times))}
    # With the largest step, changes of a parameter do not change the steps.
    settings = {"rtol": rtol, "atol": 1e3, "max_step": 0.21, "method": "dopri5"}
    found = model.gradient(data, (0.0, 2.0), ["R2", "w"], **settings)
    for name in ("R2", "w"):
        p = dict(zip(model.parameters, model.default_parameters, strict=True))[name]
        h = 1e-4 * p
        sides = [
            model.gradient(data, (0.0, 2.0), [], parameters={name: p + k * h}, **settings).value
            for k in (-2, -1, 1, 2)
        ]
        slope = (sides[0] - 8.0 * sides[1] + 8.0 * sides[2] - sides[3]) / (12.0 * h)
        # Rounding errors of the values, divided by the difference of the parameters.
        assert found[name] == pytest.approx(slope, rel=1e-9, abs=1e-11 / h * found.value)


def test_integrals_means_and_values_at_times():
    """The current of a capacitor that discharges has closed forms."""
    scene = cotree.Scene("discharge")
    scene.parameter("R", 2.0)
    scene.parameter("C", 0.5)
    scene.parameter("V", 3.0)
    scene.edge("c", "capacitor", "n", "ground", capacitance="C", initial={"v": "V"})
    scene.edge("r", "resistor", "n", "ground", resistance="R")
    model, tau, end = scene.compile(), 1.0, 1.5
    tight = {"rtol": 1e-12, "atol": 1e-14}
    found = model.gradient("R*integral(r.i**2)", (0.0, end), **tight)
    # The energy is C V^2 (1 - exp(-2 T / (R C))) / 2.
    share = math.exp(-2.0 * end / tau)
    energy = 0.25 * 9.0 * (1.0 - share)
    by_tau = -0.25 * 9.0 * share * 2.0 * end / tau**2
    assert found.value == pytest.approx(energy, rel=1e-11)
    assert found["V"] == pytest.approx(2.0 * energy / 3.0, rel=1e-11)
    assert found["R"] == pytest.approx(by_tau * 0.5, rel=1e-10)
    assert found["C"] == pytest.approx(energy / 0.5 + by_tau * 2.0, rel=1e-10)
    other = model.gradient("mean(c.v) + V*at(0.5, c.v) - start(c.v)", (0.0, end), ["V"], **tight)
    mean = (1.0 - math.exp(-end)) / end
    assert other["V"] == pytest.approx(mean + 6.0 * math.exp(-0.5) - 1.0, rel=1e-11)


def test_the_initial_value_of_a_run_depends_on_no_parameter():
    scene = cotree.Scene("discharge")
    scene.parameter("V", 3.0)
    scene.edge("c", "capacitor", "n", "ground", capacitance=1.0, initial={"v": "V"})
    scene.edge("r", "resistor", "n", "ground", resistance=1.0)
    model = scene.compile()
    by = ["V", "c.v"]
    assert model.gradient("c.v", (0.0, 1.0), by)["V"] == pytest.approx(math.exp(-1.0), rel=1e-7)
    found = model.gradient("c.v", (0.0, 1.0), by, initial={"c.v": 2.0})
    assert found["V"] == 0.0
    assert found["c.v"] == pytest.approx(math.exp(-1.0), rel=1e-7)


def test_jumps_of_inputs_divide_the_run():
    """No step evaluates the source on both sides of its jumps; the last one is no reading."""
    scene = cotree.Scene("pulses")
    scene.parameter("R", 0.7)
    scene.parameter("A", 2.0)
    scene.edge(
        "V",
        "voltage_source",
        "a",
        "ground",
        voltage="A*where(t > 0.4, 1, 0) - where(t > 1.1, 1, 0)",
    )
    scene.edge("r", "resistor", "a", "n", resistance="R")
    scene.edge("c", "capacitor", "n", "ground", capacitance=1.0)
    scene.output("v", "c.v")
    times = np.array([0.2, 0.4, 0.41, 0.75, 1.1, 1.3, 2.0])
    tight = {"rtol": 1e-11, "atol": 1e-13}
    found = scene.compile().gradient({"v": (times, 0.0 * times)}, (0.0, 2.0), **tight)
    result = scene.compile(["R", "A"]).simulate((0.0, 2.0), times, **tight)
    expected = 2.0 * result.output_sensitivities[0] @ result.output_values[0]
    np.testing.assert_allclose(found.gradient, expected, 1e-9)


def test_replaced_inputs_and_runs_backwards():
    scene = ladder(3)
    scene.input("F", "w*t")
    scene.edge("i", "current_source", "ground", "n2", current="F")
    model = scene.compile()
    by = ["R1", "w"]
    tight = {"rtol": 1e-11, "atol": 1e-13}
    table = ([0.0, 0.5, 2.0], [0.0, 1.0, -1.0])
    for span, inputs in (((0.0, 1.0), {}), ((1.0, 0.0), {}), ((0.0, 1.0), {"F": "sin(w*t)"})):
        found = model.gradient("v**2", span, by, inputs=inputs, **tight)
        other = scene.with_inputs(inputs) if inputs else scene
        result = other.compile(by).simulate(span, **tight)
        expected = 2.0 * result["v"][-1] * result.output_sensitivities[0, :, -1]
        np.testing.assert_allclose(found.gradient, expected, 1e-9)
    found = model.gradient("v**2", (0.0, 1.0), by, inputs={"F": table}, **tight)
    sides = []
    for sign in (-1, 1):
        parameters = {"w": 1.3 + sign * 1e-4}
        run = model.simulate(
            (0.0, 1.0), inputs={"F": table}, parameters=parameters, sensitivities=False, **tight
        )
        sides.append(run["v"][-1] ** 2)
    # Truncation error of central differences.
    assert found["w"] == pytest.approx((sides[1] - sides[0]) / 2e-4, rel=1e-6)


def test_a_model_with_sensitivities_has_the_same_gradient():
    scene = ladder(3)
    plain, other = scene.compile(), scene.compile(["R1", "c2.v"])
    by = ["R1", "C3", "c2.v"]
    first, second = (model.gradient("v", (0.0, 1.0), by) for model in (plain, other))
    assert first.gradient.tolist() == second.gradient.tolist()


@pytest.mark.parametrize("name", ["slider-pendulum", "robot-arm", "cart-pole", "crane"])
def test_the_adjoint_has_at_most_five_times_the_operations_of_the_rates(name):
    program = cotree.load(name).compile().kernels.program
    names = [row.name for row in program.layout.parameters]
    of_rates = form_adjoints(program, names).kernels[0]
    assert of_rates.operations.total <= 5 * program.kernels["rhs"].operations.total


def test_a_run_whose_steps_exceed_the_memory_is_refused(monkeypatch):
    monkeypatch.setattr("cotree.solvers.budgets.MOST_STORED", 1024)
    model = ladder(2).compile()
    with pytest.raises(cotree.SolveError, match="steps, whose states exceed 256 MiB"):
        model.gradient("v", (0.0, 100.0), ["R1"])


def test_a_gradient_has_names_and_a_report():
    found = ladder(2).compile().gradient("v", (0.0, 1.0), ["C1", "R2"])
    assert found.names == ("C1", "R2")
    assert found["R2"] == found.gradient[1]
    assert "C1" in str(found)
    assert "value" in repr(found)
    with pytest.raises(cotree.ParameterError, match="no entry 'C3'"):
        found["C3"]


@pytest.mark.parametrize(
    ("name", "reason"),
    [("bouncing-ball", "events"), ("bridge-rectifier", "algebraic unknowns|kinks")],
)
def test_models_beyond_the_sweep_are_refused(name, reason):
    model = cotree.load(name).compile()
    with pytest.raises(cotree.ParameterError, match=f"{reason}.*use forward sensitivities"):
        model.gradient(f"{model.states[0]}**2", (0.0, 0.1))


def test_arguments_are_checked():
    scene = ladder(2)
    scene.input("F", 0.0)
    scene.edge("i", "current_source", "ground", "n2", current="F*sign(t - R1)")
    model = scene.compile()
    run = ("v", (0.0, 1.0))
    with pytest.raises(cotree.ParameterError, match="'R1', on which times of jumps"):
        model.gradient(*run)
    for match, arguments, settings in (
        ("R22", run, {"by": ["R22"]}),
        ("maximum", ("maximum(v)", (0.0, 1.0)), {"by": ["C1"]}),
        ("outside the run", ("at(3, v)", (0.0, 1.0)), {"by": ["C1"]}),
        ("times, values", ({"v": 3.0}, (0.0, 1.0)), {"by": ["C1"]}),
        ("as many times", ({"v": ([0.0], [1.0, 2.0])}, (0.0, 1.0)), {"by": ["C1"]}),
        ("positive standard", ({"v": ([0.0], [1.0], 0.0)}, (0.0, 1.0)), {"by": ["C1"]}),
        ("must be an expression", (3.0, (0.0, 1.0)), {"by": ["C1"]}),
        ("Python functions", run, {"by": ["C1"], "inputs": {"F": lambda t: t}}),
    ):
        with pytest.raises(cotree.ModelError, match=match):
            model.gradient(*arguments, **settings)
    for method in ("rodas5", "cvode", "LSODA"):
        with pytest.raises(cotree.SolveError, match=f"'{method}': use dopri5, .*or forward sensi"):
            model.gradient(*run, ["C1"], method=method)
