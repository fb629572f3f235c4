"""Compiled kernels against the program in Python, hand-written equations and the complex step."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import sympy
from eq8 import HAND_WRITTEN
from evaluated_kernels import EvaluatedKernels

from cotree.dag.derivative import tangents
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import ARGUMENT_OF, symbols_in
from cotree.model.kernels import Kernels

pytestmark = pytest.mark.compiler

# Every route solves the same 2 by 2 system of condition below 100 with values of size 1 to 1000,
# in some fifty operations: 1e-12 of the largest value leaves a factor of ten.
RTOL = 1e-12
STEP = 1e-30  # complex step: no truncation error, and no subtraction


def close(found, expected):
    scale = np.max(np.abs(expected), initial=0.0)
    np.testing.assert_allclose(found, expected, rtol=RTOL, atol=RTOL * scale)


@functools.cache
def hand_written(name):
    return HAND_WRITTEN[name].functions()


def points(model, n_points=5):
    """Return random times, states, sensitivities and parameters near the scene's own."""
    rng = np.random.default_rng(len(model.states))
    n, m = len(model.states), len(model.sensitivities)
    for _ in range(n_points):
        p = model.default_parameters * rng.uniform(0.7, 1.3, len(model.parameters))
        yield rng.uniform(0, 5), rng.uniform(-2, 2, n), rng.uniform(-2, 2, (n, m)), p


def evaluated(program, name, t, y, s, p, numbers="complex_"):
    """Evaluate a kernel of a program from scratch, prepared values included."""
    roots = program.kernels[name].results
    arrays = {"t": [t], "x": y, "s": np.asarray(s).T.ravel(), "p": p, "u": []}
    values = {node: arrays[ARGUMENT_OF[node.data[0]]][node.data[1]] for node in symbols_in(roots)}
    return np.array(evaluate(roots, values, numbers))


def along(model, y, s, p, j, name):
    """Return y, p moved by a complex step along sensitivity j, that to parameter ``name``."""
    moved = p.astype(complex)
    moved[model.parameters.index(name)] += 1j * STEP
    return y + 1j * STEP * s[:, j], moved


def test_kernels_are_compiled(model_of, scene_name):
    assert model_of(scene_name).kernels.backend == "C"
    assert isinstance(model_of(scene_name).kernels.code, Kernels)


def test_every_compiled_kernel_equals_the_program_in_python(model_of, program_of, scene_name):
    model, python = model_of(scene_name), EvaluatedKernels(program_of(scene_name))
    compiled = model.kernels.code
    for t, y, s, p in points(model):
        compiled.prepare(p)
        model.kernels._own.prepared = None  # the model is shared: make it prepare again
        python.prepare(p)
        for name, size in result_sizes(model.kernels.layout).items():
            flat = np.ascontiguousarray(s.T).ravel()
            found = compiled(name, t, y, flat, np.zeros(0))
            assert found.shape == (size,)
            close(found, python(name, t, y, flat, np.zeros(0)))


def test_rhs_is_the_hand_written_one(model_of, scene_name):
    model = model_of(scene_name)
    accelerations, _ = hand_written(scene_name)
    n = len(model.states) // 2
    for t, y, _, p in points(model):
        found = model.rhs(t, y, p)
        assert np.array_equal(found[:n], y[n:])
        close(found[n:], accelerations(t, y, p))


def test_jacobian_and_sensitivities_are_the_hand_written_ones(model_of, scene_name):
    model = model_of(scene_name)
    _, derivatives = hand_written(scene_name)
    n_states = len(model.states)
    n = n_states // 2
    for t, y, s, p in points(model):
        by = derivatives(t, y, p)
        close(model.jacobian(t, y, p)[n:], by[:, :n_states])
        rates = model.sensitivity_rhs(t, y, s, p)
        assert np.array_equal(rates[:n], s[n:])
        close(rates[n:], by[:, :n_states] @ s + by[:, n_states:])


def test_jacobian_by_complex_step_and_its_pattern(model_of, program_of, scene_name):
    model, program = model_of(scene_name), program_of(scene_name)
    n = len(model.states)
    for t, y, s, p in points(model):
        stepped = np.zeros((n, n))
        for j in range(n):
            moved = y + 1j * STEP * np.eye(n)[j]
            stepped[:, j] = evaluated(program, "rhs", t, moved, s, p).imag / STEP
        dense = model.jacobian(t, y, p)
        close(dense, stepped)
        assert not np.any(stepped[~model.kernels.structure.jacobian_pattern])
        sparse = model.kernels.jacobian_sparse(t, y, p)
        assert sparse.has_sorted_indices
        assert np.array_equal(sparse.toarray(), dense)
        assert sparse.nnz == model.kernels.structure.jacobian_pattern.sum()


def test_sensitivity_rhs_by_complex_step(model_of, program_of, scene_name):
    model, program = model_of(scene_name), program_of(scene_name)
    for t, y, s, p in points(model):
        found = model.sensitivity_rhs(t, y, s, p)
        for j, name in enumerate(model.sensitivities):
            moved_y, moved_p = along(model, y, s, p, j, name)
            close(found[:, j], evaluated(program, "rhs", t, moved_y, s, moved_p).imag / STEP)


def test_output_sensitivity_by_complex_step(model_of, program_of, scene_name):
    model, program = model_of(scene_name), program_of(scene_name)
    for t, y, s, p in points(model):
        found = model.output_sensitivity(t, y, s, p)
        assert found.shape == (len(model.outputs), len(model.sensitivities))
        for j, name in enumerate(model.sensitivities):
            moved_y, moved_p = along(model, y, s, p, j, name)
            stepped = evaluated(program, "outputs", t, moved_y, s, moved_p).imag / STEP
            close(found[:, j], stepped)


def test_initial_sensitivity_by_complex_step(model_of, program_of, scene_name):
    model, program = model_of(scene_name), program_of(scene_name)
    for t, y, s, p in points(model):
        found = model.kernels.initial_sensitivity(p)
        for j, name in enumerate(model.sensitivities):
            _, moved = along(model, y, s, p, j, name)
            stepped = evaluated(program, "initial", t, y, s, moved).imag / STEP
            assert np.array_equal(found[:, j], stepped)


def test_augmented_rhs_is_both(model_of, scene_name):
    model = model_of(scene_name)
    for t, y, s, p in points(model):
        flat = np.ascontiguousarray(s.T).ravel()
        both = model.kernels.bound("augmented_rhs", p)(t, y, flat, None)
        n = len(model.states)
        close(both[:n], model.rhs(t, y, p))
        close(both[n:].reshape(-1, n).T, model.sensitivity_rhs(t, y, s, p))


def test_sensitivity_graphs_equal_derivatives_of_the_assembled_program(lowered_of, scene_name):
    """Two routes, one answer: sensitivity graphs, and tangents of the assembled rates."""
    program = lowered_of(scene_name)
    dag, layout = program.dag, program.layout
    n = len(layout.states)
    names = [row.name for row in layout.parameters]
    rng = np.random.default_rng(5)
    for j, name in enumerate(layout.sensitivities):
        seed = {dag.symbol("x", i): dag.symbol("s", n * j + i) for i in range(n)}
        seed[dag.symbol("p", names.index(name))] = dag.one
        assembled = tangents(program.kernels["rhs"].results, seed)
        graphs = program.kernels["sensitivity_rhs"].results[n * j : n * (j + 1)]
        symbols = symbols_in([*assembled, *graphs])
        values = dict(zip(symbols, rng.uniform(0.5, 1.5, len(symbols)).tolist(), strict=True))
        close(evaluate(graphs, values), evaluate(assembled, values))


def test_state_graphs_equal_derivatives_of_the_assembled_program(lowered_of, scene_name):
    program = lowered_of(scene_name)
    dag, layout, kernels = program.dag, program.layout, program.kernels
    starts, rng = layout.column_starts, np.random.default_rng(6)
    for j in range(len(layout.states)):
        assembled = tangents(kernels["rhs"].results, {dag.symbol("x", j): dag.one})
        column = kernels["jacobian"].results[starts[j] : starts[j + 1]]
        rows = layout.row_indices[starts[j] : starts[j + 1]]
        symbols = symbols_in([*assembled, *column])
        values = dict(zip(symbols, rng.uniform(0.5, 1.5, len(symbols)).tolist(), strict=True))
        dense = np.zeros(len(layout.states))
        dense[list(rows)] = evaluate(column, values)
        close(dense, evaluate(assembled, values))


def result_sizes(layout):
    """Return the number of results of each kernel but ``prepare``."""
    n, m = len(layout.states), len(layout.sensitivities)
    return {
        "initial": n,
        "initial_sensitivity": n * m,
        "inputs": len(layout.inputs),
        "rhs": n,
        "jacobian": len(layout.row_indices),
        "sensitivity_rhs": n * m,
        "augmented_rhs": n * (1 + m) if m else 0,
        "outputs": len(layout.outputs),
        "output_sensitivity": len(layout.outputs) * m,
    }


@pytest.mark.parametrize("name", HAND_WRITTEN)
def test_printed_equations_hold_for_the_compiled_rates(model_of, name):
    """Put the kernels' accelerations into the SymPy equations that people read."""
    import cotree

    model = model_of(name)
    equations = cotree.load(name).equations(list(model.sensitivities))
    symbols = equations.symbols
    n = len(model.states) // 2
    keys = [*model.parameters, "t", *model.states]
    keys += [f"{state}_ddot" for state in model.states[:n]]
    for parameter in model.sensitivities:
        keys += [(state, parameter) for state in model.states]
        keys += [(f"{state}_ddot", parameter) for state in model.states[:n]]
    rows = [*equations.governing, *(e for row in equations.sensitivity.values() for e in row)]
    left = sympy.lambdify([symbols[key] for key in keys], [row.lhs for row in rows], "numpy")
    for t, y, s, p in points(model):
        rates, along_p = model.rhs(t, y, p), model.sensitivity_rhs(t, y, s, p)
        tail = [np.concatenate([s[:, j], along_p[n:, j]]) for j in range(s.shape[1])]
        residuals = left(*np.concatenate([p, [t], y, rates[n:], *tail]))
        # Forces here reach 1000 N before they balance.
        np.testing.assert_allclose(residuals, 0.0, atol=RTOL * 1000)
