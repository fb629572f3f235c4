"""Every pass and every choice: values stay on all shipped scenes, counts fall on a named one."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from network_scenes import rc_ladder
from rod_chain import rod_chain

import cotree
from cotree import choice
from cotree.choice import choose_first_graph
from cotree.codegen import context, maps
from cotree.codegen.context import model_context
from cotree.codegen.kernel_blocks import Blocks, cut_into_blocks
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import ARGUMENT_OF, reachable, symbols_in
from cotree.pipeline import formulate, generate, trees_to_try
from cotree.program import columns
from cotree.program.columns import form_curvature, form_time_slope
from cotree.program.lower import lower
from cotree.program.passes import RECIPE, run_passes
from cotree.sensitivity.graphs import form_equations

SHIPPED = sorted(path.stem for path in (Path(cotree.__file__).parent / "scenes").glob("*.toml"))
# Values are of size 1 to 1000, and some are small differences of others: each route regroups sums
# and divisions, which leaves some ten roundings of the largest value of a kernel.
RTOL = 1e-11


@functools.cache
def _equations(name):
    scene = cotree.load(name)
    return formulate(scene, list(scene.parameters)[:3], None)[1]


@functools.cache
def _lowered(name):
    return lower(_equations(name))


def _point(program, seed):
    """Return all arguments of a program: parameters near the scene's, the rest at random."""
    layout, rng = program.layout, np.random.default_rng(seed)
    n, m = len(layout.states), len(layout.sensitivities)
    return {
        "t": rng.uniform(0.1, 2.0, 1),
        "x": rng.uniform(0.1, 0.6, n),
        "s": rng.uniform(-1.0, 1.0, n * max(m, 1)),
        "u": rng.uniform(0.1, 0.6, len(layout.inputs)),
        "p": np.array(layout.parameter_values) * rng.uniform(0.8, 1.2, len(layout.parameters)),
        "v": rng.uniform(-1.0, 1.0, n),
    }


def _evaluated(roots, point, numbers="real"):
    values = {
        node: point[ARGUMENT_OF[node.data[0]]][node.data[1]].item() for node in symbols_in(roots)
    }
    return np.array(evaluate(roots, values, numbers))


def _values(program, point):
    return {
        name: _evaluated(kernel.results, point)
        for name, kernel in program.kernels.items()
        if kernel.results and name != "prepare"
    }


def _close(found, expected):
    scale = np.max(np.abs(expected), initial=0.0)
    np.testing.assert_allclose(found, expected, rtol=RTOL, atol=RTOL * scale)


def _same_values(found, expected):
    """Compare all kernels of two programs at random points."""
    for seed in range(3):
        point = _point(expected, seed)
        values = _values(found, point)
        for name, known in _values(expected, point).items():
            _close(values[name], known)


# ---- values stay


@pytest.mark.sampled(9)
@pytest.mark.parametrize("name", RECIPE)
@pytest.mark.parametrize("scene", SHIPPED)
def test_passes_keep_the_values(scene, name):
    program = _lowered(scene)
    _same_values(RECIPE[name](program), program)


@pytest.mark.parametrize("scene", SHIPPED)
def test_maps_keep_the_values(scene, monkeypatch):
    """Of all directions, whether that is worth it or not."""
    monkeypatch.setattr(columns, "_WORTH", 0.0)
    written_out = lower(_equations(scene))
    monkeypatch.setattr(columns._Ways, "are_worth", lambda *_: True)
    mapped = lower(_equations(scene))
    assert mapped.layout.row_indices == written_out.layout.row_indices
    _same_values(mapped, written_out)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("scene", SHIPPED)
def test_formulations_give_the_same_rates(scene, monkeypatch):
    """In all axes and by both eliminations, of the tree that is chosen: the states are the same."""
    monkeypatch.setattr(choice, "_LONG", 1)
    described = cotree.load(scene)
    wanted = list(described.parameters)[:2]
    tree = choose_first_graph(described, trees_to_try(described, None), wanted)[1][0].trees
    programs = [
        lower(form_equations(first, wanted))
        for _, first in choice._tried(described, tree, wanted, 0.0)
    ]
    for program in programs[1:]:
        assert program.layout.states == programs[0].layout.states
        for seed in range(3):
            point = _point(program, seed)
            for name in ("rhs", "augmented_rhs", "outputs"):
                one, other = (p.kernels[name].results for p in (programs[0], program))
                _close(_evaluated(other, point), _evaluated(one, point))


@pytest.mark.parametrize("scene", SHIPPED)
def test_time_slopes_are_those_of_the_rates(scene):
    """Along a complex step of time, which inputs follow."""
    program = run_passes(_lowered(scene))[0]
    slope = form_time_slope(program)
    results = program.kernels["augmented_rhs"].results
    for seed in range(3):
        point = _point(program, seed)
        step = 1e-30
        point["t"] = point["t"] + 1j * step
        point["u"] = _evaluated(program.kernels["inputs"].results, point, "complex_")
        expected = _evaluated(results, point, "complex_").imag / step
        if slope is None:
            assert not np.any(expected)
            continue
        point["t"], point["u"] = point["t"].real, point["u"].real
        _close(_evaluated(slope.results, point), expected)


@pytest.mark.parametrize("scene", SHIPPED)
def test_curvatures_are_those_of_the_sensitivities_rates(scene):
    """Along a complex step of the states."""
    program = run_passes(_lowered(scene))[0]
    curvature = form_curvature(program)
    for seed in range(3):
        point = _point(program, seed)
        step = 1e-30
        moved = {**point, "x": point["x"] + 1j * step * point["v"]}
        results = program.kernels["sensitivity_rhs"].results
        expected = _evaluated(results, moved, "complex_").imag / step
        found = np.zeros(len(results))
        if curvature is not None:
            found[list(curvature.places)] = _evaluated(curvature.along.results, point)
        _close(found, expected)


# ---- counts fall


def _chain(n):
    scene, wanted = rod_chain(n)
    return formulate(scene, wanted, None)[1]


def _of_pass(name, scene, kernel, kinds):
    """Count operations of some kinds before and after a pass, those before it having run."""
    program = _lowered(scene)
    for each, transform in RECIPE.items():
        before, program = program, transform(program)
        if each == name:
            break
    found = (p.kernels[kernel].operations.by_kind for p in (before, program))
    return [sum(n for kind, n in row.items() if kinds is None or kind in kinds) for row in found]


def _with(monkeypatch, module, name, value, n_rods=10):
    with monkeypatch.context() as patch:
        patch.setattr(module, name, value)
        return model_context(generate(_chain(n_rods))[0])


def _reciprocals(_):
    return _of_pass("reciprocals", "bridge-rectifier", "jacobian", {"div"})


def _stage(_):
    return _of_pass("stage", "slider-pendulum", "augmented_rhs", None)


def _sines(_):
    """Sines and cosines are taken in one node, which counts as all of them."""
    program = run_passes(lower(_chain(5)))[1][1]
    kernels = (p.kernels["rhs"] for p in (program.earlier, program.later))
    kinds = ("sin", "cos", "sines")
    return [sum(node.op in kinds for node in kernel.order) for kernel in kernels]


def _n_values(program, kernel):
    return sum(node.op != "symbol" for node in reachable(program.kernels[kernel].results))


def _columns(monkeypatch):
    """Values that have to be written: a map counts once."""
    after = _n_values(lower(_chain(10)), "sensitivity_rhs")
    monkeypatch.setattr(columns, "_WORTH", 0.0)
    return _n_values(lower(_chain(10)), "sensitivity_rhs"), after


def _elimination(_):
    scene, _wanted = rod_chain(20)
    tried = choose_first_graph(scene, trees_to_try(scene, None), ())[1]
    by_matrix = min(row.n_operations for row in tried if not row.is_along_tree)
    return by_matrix, tried[0].n_operations


def _axes(_):
    """Rods have no axes of their own where that is cheaper, or those of their joints."""
    scene, _wanted = rod_chain(3)
    tried = choose_first_graph(scene, trees_to_try(scene, None), ())[1]
    return max(row.n_operations for row in tried), tried[0].n_operations


def _trees(_):
    tried = cotree.pipeline.count_trees(cotree.load("motor-linkage"))
    return max(row.n_operations for row in tried), tried[0].n_operations


def _curvature(_):
    """Values that depend on no direction are computed once at a point."""
    curvature = form_curvature(run_passes(_lowered("slider-pendulum"))[0])
    whole = replace(curvature.along, prepared={})
    return whole.operations.total, curvature.along.operations.total


def _loops(monkeypatch):
    program = generate(formulate(rc_ladder(100), (), None)[1])[0]
    after = sum(len(kernel.body.text) for kernel in model_context(program).kernels)
    monkeypatch.setattr(context, "roll", lambda rows, array="v": list(rows))
    return sum(len(kernel.body.text) for kernel in model_context(program).kernels), after


def _blocks(monkeypatch):
    def whole(_names, statements, *_):
        return Blocks([], list(statements))

    cuts = whole, cut_into_blocks
    models = [_with(monkeypatch, context, "cut_into_blocks", cut, 30) for cut in cuts]
    return [model.n_written for model in models]


def _blocks_of_maps(monkeypatch):
    found = []
    for longest in (10_000, 50):
        monkeypatch.setattr(maps, "_LONGEST_IN_TURN", longest)
        found.append(_with(monkeypatch, maps, "_LONGEST_BLOCK", longest))
    return [max(max(row.body.written) for row in model.maps) for model in found]


#: What falls, and by which factor at least: measured, and a tenth less.
FALLS = {
    _reciprocals: 1.6,
    _sines: 9.0,
    _stage: 1.07,
    _columns: 4.6,
    _elimination: 2.7,
    _axes: 4.6,
    _trees: 3.2,
    _curvature: 1.6,
    _loops: 13.0,
    _blocks: 1.85,
    _blocks_of_maps: 10.0,
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("counted", FALLS, ids=lambda f: f.__name__.strip("_"))
def test_counts_fall(counted, monkeypatch):
    before, after = counted(monkeypatch)
    assert before > FALLS[counted] * after
