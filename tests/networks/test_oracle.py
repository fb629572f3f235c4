"""Random linear networks against an independent solution of all their equations at once."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
import pytest
from evaluated_kernels import EvaluatedKernels
from oracle import (
    Element,
    LinearNetwork,
    Tableau,
    instant,
    instant_along,
    random_network,
    step_response,
)

from cotree.errors import Error, FormulationError
from cotree.model.linearize import Linearizer
from cotree.model.model import CompiledModel
from cotree.pipeline import formulate, generate
from cotree.program.text import ModelText
from cotree.sensitivity.graphs import form_equations, input_columns

if TYPE_CHECKING:
    from cotree import Scene

# Values lie between 0.5 and 2 in networks of some forty equations, whose condition numbers stay
# below 1e6 but for rare draws: ten digits of sixteen are left.
TOLERANCE = 1e-10
# Derivatives pass through the inverse twice.
SECOND = 1e-8

CHUNKS, CHUNK = 12, 30


def python_model(scene: Scene, wanted: list[str]) -> CompiledModel:
    """Evaluate the program in Python: hundreds of networks need no compiler."""
    _, equations, _ = formulate(scene, wanted, None)
    program, _ = generate(equations)
    return CompiledModel(ModelText.of(program), EvaluatedKernels(program))


def rate_of(network: LinearNetwork, rates: np.ndarray, state: str) -> float:
    """Rate of a state from the rates of potentials and currents."""
    at = {name: i for i, name in enumerate(network.outputs)}
    edge, _, symbol = state.rpartition(".")
    if symbol == "i":
        return float(rates[at[state]])
    plus, minus = (
        0.0 if node == "ground" else rates[at[f"{node}.v"]] for node in network.edges[edge]
    )
    return float(plus - minus)


def check_values(network: LinearNetwork, seed: int) -> None:
    """Compare outputs, rates and sensitivities at random states."""
    wanted = [f"p_{e.name}" for e in network.elements][:3]
    model = python_model(network.scene(), wanted)
    rng, t = np.random.default_rng(seed), 0.3
    x = rng.normal(size=len(model.states))
    # Those that vanish are never anything else, which the rates below are to show.
    s = rng.normal(size=(len(model.states), len(wanted))) * model.structure.sensitivity_pattern
    states = dict(zip(model.states, x, strict=True))
    values, rates, determined = instant(network, states, t)
    n = len(values)
    assert determined[:n].all()  # there are no fewer states than the network has
    size = 1.0 + np.abs(values).max() + np.abs(rates).max()
    assert np.abs(model.output_values(t, x) - values).max() <= TOLERANCE * size
    for state, rate in zip(model.states, model.rhs(t, x), strict=True):
        assert abs(rate - rate_of(network, rates, state)) <= TOLERANCE * size, state
    of_rates = model.sensitivity_rhs(t, x, s)
    of_outputs = model.output_sensitivity(t, x, s)
    for j, name in enumerate(wanted):
        along = dict(zip(model.states, s[:, j], strict=True))
        d = instant_along(network, states, along, t, name.removeprefix("p_"))
        size = 1.0 + np.abs(d).max()
        assert np.abs(of_outputs[:, j] - d[:n]).max() <= SECOND * size, name
        for state, found in zip(model.states, of_rates[:, j], strict=True):
            assert abs(found - rate_of(network, d[n:], state)) <= SECOND * size, (state, name)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("chunk", range(CHUNKS))
@pytest.mark.parametrize("is_silly", [False, True])
def test_random_networks_are_solved_right_or_refused(chunk, is_silly):
    """Those with one solution are solved; those with none or many are refused with a reason."""
    outcomes: Counter[str] = Counter()
    for seed in range(chunk * CHUNK, (chunk + 1) * CHUNK):
        network = random_network(seed, is_silly=is_silly)
        if Tableau.of(network).is_regular:
            check_values(network, seed)
            outcomes["solved"] += 1
        else:
            with pytest.raises(Error):
                python_model(network.scene(), [])
            outcomes["refused"] += 1
    assert outcomes["solved"] >= CHUNK // 4  # or this would test nothing


@pytest.mark.sampled(2)
@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_transfer_functions_of_random_networks(chunk):
    """A, B, C, D against the equations in the frequency domain; sources are inputs."""
    solved = 0
    for seed in range(chunk * CHUNK, (chunk + 1) * CHUNK):
        network = random_network(seed)
        tableau = Tableau.of(network)
        if not tableau.is_regular:
            continue
        scene = network.scene(inputs=True)
        try:
            first, _, _ = formulate(scene, (), None)
        except FormulationError as error:
            if "depends on an input" not in str(error):
                raise
            continue  # a storage is tied to it
        p = np.array([row.value for row in scene.parameters.values()])
        n_states = len(first.states)
        linearizer = Linearizer(form_equations(first, ()), input_columns(first))
        linear = linearizer.at(0.0, np.zeros(n_states), p, np.zeros(len(network.sources)))
        for s in (0.1 + 0.2j, 1.3j, 2.0 - 0.7j):
            inside = np.linalg.solve(s * np.eye(n_states) - linear.A, linear.B)
            expected = tableau.transfer(s)
            # Poles may come near: the size of the response says how near.
            size = 1.0 + np.abs(expected).max(initial=0.0) + np.abs(inside).max(initial=0.0)
            found = linear.C @ inside + linear.D
            assert np.abs(found - expected).max(initial=0.0) <= TOLERANCE * size
        solved += 1
    assert solved >= CHUNK // 2


@pytest.mark.compiler
@pytest.mark.parametrize("seed", [3, 8, 14, 22, 31, 40])
def test_step_responses_of_random_networks(seed):
    """Simulated in compiled code against a numerical inversion of the Laplace transform."""
    network = random_network(seed)
    scene = network.scene(inputs=True)
    for name in list(scene.inputs):
        scene.inputs.pop(name)
        scene.input(name, 1.0)
    times = np.array([0.4, 1.0, 2.5])
    result = scene.compile().simulate((0.0, 2.5), times, rtol=1e-11, atol=1e-12, throw=True)
    for j, t in enumerate(times):
        expected = step_response(network, t)
        found = [result[name.replace(".", "_")][j] for name in network.outputs]
        # The inversion holds eight digits of poles as near as these networks have them.
        assert np.abs(found - expected).max() <= 1e-7 * (1.0 + np.abs(expected).max())


@pytest.mark.sampled(7)
@pytest.mark.parametrize("seed", range(60))
def test_the_powers_of_all_ports_sum_to_zero(seed):
    """Tellegen's theorem, at states and unknowns of any values; diodes in every second network."""
    network = random_network(seed)
    if not Tableau.of(network).is_regular:
        pytest.skip("has no solution")
    scene = network.scene()
    if seed % 2 == 0:
        rng = np.random.default_rng(seed)
        nodes = ["ground", *network.nodes]
        for k in range(3):
            a, b = rng.choice(len(nodes), 2, replace=False)
            ends = (nodes[a], nodes[b])
            scene.edge(f"D{k}", "diode", *ends, saturation_current=0.1, thermal_voltage=1.0)
    edges = [*network.edges, *(name for name in scene.edges if name.startswith("D"))]
    for name in edges:
        short = name.replace(".", "_")
        scene.output(f"across_{short}", f"{name}.v")
        scene.output(f"through_{short}", f"{name}.i")
    model = python_model(scene, [])
    x = np.random.default_rng(seed).normal(size=len(model.states))
    values = dict(zip(model.outputs, model.output_values(0.7, x), strict=True))
    shorts = [name.replace(".", "_") for name in edges]
    powers = np.array([values[f"across_{s}"] * values[f"through_{s}"] for s in shorts])
    # Rounding of sums of as many terms as there are edges.
    assert abs(powers.sum()) <= 1e-12 * (1.0 + np.abs(powers).sum())
    for e in network.elements:
        if e.kind == "T":
            own = [p for s, p in zip(shorts, powers, strict=True) if s.startswith(f"{e.name}_")]
            assert abs(sum(own)) <= 1e-12 * (1.0 + np.abs(powers).sum())


def test_a_block_of_branches_and_chords_is_solved_with_its_own_pivots():
    """Couplings of branches to chords have opposite signs across the diagonal."""
    for seed in (139, 199, 227, 369):
        check_values(random_network(seed), seed)


def test_currents_of_storages_in_loops_through_a_transformer():
    for seed in (41, 71):
        check_values(random_network(seed), seed)


@pytest.mark.parametrize("n", [3, 12])
def test_many_transformers_on_one_bus(n):
    """Each primary is across the source, so that each secondary is the branch."""
    elements = [Element("V0", (("bus", "ground"),), 1.0)]
    for i in range(1, n + 1):
        load = (f"a{i}", "ground")
        elements.append(Element(f"T{i}", (("bus", "ground"), load), 0.5 + 0.1 * i))
        elements.append(Element(f"R{i}", (load,), 1.0))
        elements.append(Element(f"L{i}", (load,), 1.0))
    check_values(LinearNetwork(tuple(elements)), 0)


def test_a_source_is_not_displaced_by_a_transformer_across_it():
    two = (("a", "ground"), ("ground", "a"))
    elements = (
        Element("R0", (two[0],), 1.0),
        Element("T1", two, 1.762),
        Element("V2", (two[0],), 1.0),
    )
    with pytest.raises(Error, match="T1"):
        python_model(LinearNetwork(elements).scene(), [])
