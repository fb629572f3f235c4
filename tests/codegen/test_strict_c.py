"""The C text is clean for strict compilers and sanitizers."""

from __future__ import annotations

import os
import subprocess
from functools import cache, partial

import numpy as np
import pytest
from made_up_scenes import SWIRL_C, busy_scene, call_case, closed_scene, solve_case
from rod_chain import rod_chain

from cotree import load
from cotree.codegen import context
from cotree.codegen.c_files import STEPPERS, engine_files, render_model
from cotree.codegen.context import model_context
from cotree.codegen.kernel_blocks import cut_into_blocks
from cotree.dag.multi_output import SolveShape
from cotree.equations import Guard
from cotree.export.c_project import write_c_project
from cotree.pipeline import formulate, generate
from cotree.program.kernels import KERNELS
from cotree.program.passes import run_passes

pytestmark = pytest.mark.compiler

# Of models with algebraic unknowns only.
OF_UNKNOWNS = {
    "algebraic_step",
    "extended_rhs",
    "extended_augmented_rhs",
    "algebraic_sensitivity",
}


@pytest.fixture(params=[None, 8], ids=["whole", "cut"])
def in_blocks(request, monkeypatch):
    """Leave kernels whole, or cut them into blocks as short as may be."""
    if request.param:
        cut = partial(cut_into_blocks, longest=request.param)
        monkeypatch.setattr(context, "cut_into_blocks", cut)


def _files(program):
    return dict(render_model(model_context(program)))


@cache
def _busy():
    scene = busy_scene()
    return generate(formulate(scene, ["m", "a", "j3.theta"], None)[1])[0]


@cache
def _closed(sensitivities):
    branches = ["j1", "r1", "r0", "j2", "r2", "j3", "r3", "ball", "r5"]
    scene = closed_scene()
    scene.mode("count", 0)
    scene.event("hit", "j1.theta", direction=-1, impact={"restitution": "m/9"})
    scene.event("fast", "j2.theta_dot - t", set={"count": "count + L", "j2.theta": 0.1})
    scene.event("turned", "sin(3*j1.theta) - t", set={"count": "count + 1"})
    return generate(formulate(scene, list(sensitivities), branches)[1])[0]


@cache
def _rectifier(sensitivities):
    return generate(formulate(load("bridge-rectifier"), list(sensitivities), None)[1])[0]


@pytest.mark.parametrize("sensitivities", [[], ["k"], None])
def test_shipped_scenes_are_clean(program_of, scene_name, sensitivities, run_compiler):
    run_compiler(_files(program_of(scene_name, sensitivities)), "-c")


@pytest.mark.sampled(1)
@pytest.mark.parametrize("flags", [(), ("-DCOTREE_NO_VECTORS",), ("-march=native",)])
def test_maps_and_sines_in_vectors_are_clean(run_compiler, flags):
    """A short chain with sensitivities; and a long one, whose map holds loops of links."""
    for n, wanted in ((6, True), (40, False))[: 1 if flags else 2]:
        scene, names = rod_chain(n)
        program = generate(formulate(scene, names if wanted else (), None)[1])[0]
        files = _files(program)
        assert f"chain_{n}_vectors.h" in files
        run_compiler(files, "-c", *flags)


def test_a_busy_scene_with_hostile_texts_is_clean(run_compiler):
    files = _files(_busy())
    text = files["double_.c"]
    for piece in ("cotree_table(", "cotree_factorise(", " ? ", "(double)((", "sqrt(", "pow("):
        assert piece in text
    run_compiler(files, "-c")


@pytest.mark.sampled(1)
@pytest.mark.parametrize("sensitivities", [(), ("m", "L")])
def test_a_scene_with_constraints_is_clean(run_compiler, sensitivities):
    run_compiler(_files(_closed(sensitivities)), "-c")


@pytest.mark.parametrize("is_staged", [False, True])
def test_solve_call_and_table_are_clean(made_up, run_compiler, is_staged):
    for case in (call_case, lambda: solve_case(3)):
        dag, results = case()
        program = made_up(dag, n_parameters=12, outputs=results)
        if is_staged:
            program = run_passes(program)[0]
        run_compiler(_files(program), "-c")


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", STEPPERS)
def test_engines_are_clean(run_compiler, method):
    run_compiler(engine_files(method), "-c")


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("scene", "integrator", "step"),
    [
        ("bouncing-ball", "dop853", None),
        ("bridge-rectifier", "rodas5", None),
        ("slider-pendulum", "euler", 1e-3),
    ],
)
def test_what_a_c_project_compiles_is_clean(run_compiler, tmp_path, scene, integrator, step):
    """At the level of the command that is printed: compilers see more where they optimise."""
    program = generate(formulate(load(scene), (), None)[1])[0]
    project = write_c_project(
        program, tmp_path / "project", integrator, t_end=1.0, rtol=1e-6, atol=1e-8, step=step
    )
    names = [word for word in project.command.split() if word.endswith(".c")]
    assert "-O2" in project.command.split()
    files = {path.name: path.read_text() for path in project.directory.glob("*.[ch]")}
    assert set(names) <= set(files)
    run_compiler(files, "-c", "-O2")


def test_a_program_of_nothing_is_clean(made_up, run_compiler):
    from cotree.dag.nodes import Dag

    run_compiler(_files(made_up(Dag(), n_states=0, n_parameters=0)), "-c")


def test_functions_that_only_a_guard_calls_are_declared(made_up, run_compiler):
    from cotree.dag.nodes import Dag

    dag = Dag()
    guard = Guard(dag.function("exp", dag.symbol("p", 0)), "mass of edge 'b'", is_strict=True)
    run_compiler(_files(made_up(dag, guards=(guard,))), "-c")


def test_headers_stand_alone_and_serve_cpp(program_of, scene_name, run_compiler):
    files = _files(program_of(scene_name, ["k"]))
    prefix = scene_name.replace("-", "_")
    include = f'#include "{prefix}.h"\n#include "{prefix}.h"\nint main(void) {{ return 0; }}\n'
    headers = {name: text for name, text in files.items() if name.endswith(".h")}
    run_compiler({**headers, "alone.c": include}, "-c")


_MAIN = r"""
#include "%(prefix)s.h"
#include <stdio.h>
#include <stdlib.h>

/* Each array has exactly its size, so that the sanitizer sees a step beyond it. */
static double *array(int n)
{
    double *values = (double *)malloc((size_t)(n > 0 ? n : 1) * sizeof(double));
    int i;
    for (i = 0; i < n; ++i) values[i] = 0.3 + 0.1 * (double)i;
    return values;
}

static int show(const char *name, int status, const double *values, int n)
{
    int i;
    printf("%%s", name);
    for (i = 0; i < n; ++i) printf(" %%.17g", values[i]);
    printf("\n");
    return status;
}

int main(void)
{
    const cotree_model *m = %(prefix)s_abi();
    const int n = m->n_states, ns = n * m->n_sensitivities;
    double *x = array(n), *s = array(ns > n ? ns : n);
    double *u = array(m->n_inputs), *p = array(m->n_parameters);
    double *k = array(m->n_prepared), *dx = array(n), *values = array(m->n_nonzeros);
    double *x0 = array(n);
    int failed = 0, i;
    for (i = 0; i < m->n_parameters; ++i) p[i] = m->parameter_values[i];
    failed |= show("prepare", m->prepare(p, k), k, m->n_prepared);
    failed |= show("initial", m->initial(p, k, x0), x0, n);
    failed |= show("rhs", m->rhs(0.7, x, u, p, k, dx), dx, n);
    failed |= show("jacobian", m->jacobian(0.7, x, u, p, k, values), values, m->n_nonzeros);
%(optional)s
    for (i = 0; i < n; ++i) printf("# %%s %%s\n", m->states[i].name, m->states[i].unit);
    for (i = 0; i < m->n_guards; ++i) printf("# %%s\n", m->guards[i]);
    free(x); free(s); free(u); free(p); free(k); free(dx); free(values); free(x0);
    return failed;
}
"""


def _call_optional(program):
    """Write the calls of optional kernels: those without results have no pointer."""
    lines = []
    for name, kernel in program.kernels.items():
        spec, n = kernel.spec, len(kernel.results)
        if spec.is_required:
            continue
        arguments = ", ".join("0.7" if key == "t" else key for key in (*spec.arguments, "r"))
        lines += [f"    if (m->{spec.field} {'==' if n else '!='} NULL) return 2;"]
        if n:
            call = f'failed |= show("{name}", m->{spec.field}({arguments}), r, {n});'
            lines += [f"    {{ double *r = array({n}); {call} free(r); }}"]
    lines.append(f"    if (m->n_constraints != {len(program.layout.constraints)}) return 3;")
    return "\n".join(lines)


def _sanitized(program, prefix, run_compiler, extra=None):
    main = _MAIN % {"prefix": prefix, "optional": _call_optional(program)}
    path = run_compiler(
        {**_files(program), **(extra or {}), "main.c": main},
        "-g",
        "-fsanitize=address,undefined",
        "-fno-sanitize-recover=all",
        "-lm",
        "-o",
        "a.out",
    )
    done = subprocess.run(
        [path],
        capture_output=True,
        text=True,
        check=False,
        # Leak detection needs ptrace, which containers forbid.
        env={**os.environ, "ASAN_OPTIONS": "detect_leaks=0"},
    )
    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines() if not line.startswith("#")]
    return {name: np.array(values, dtype=float) for name, *values in rows}


def _check_against_python(program, found):
    from evaluated_kernels import EvaluatedKernels

    def ramp(n):
        return 0.3 + 0.1 * np.arange(n)

    layout, python = program.layout, EvaluatedKernels(program)
    n, m = len(layout.states), len(layout.sensitivities)
    python.prepare(np.array(layout.parameter_values))
    for name, values in found.items():
        if name != "prepare" and program.kernels[name].results:
            expected = python(name, 0.7, ramp(n), ramp(n * max(m, 1)), ramp(len(layout.inputs)))
            # The same operations in the same order, but for the reach of math functions and for
            # numpy's order of sums in the small linear systems.
            np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-13, err_msg=name)


@pytest.mark.sampled(2)
@pytest.mark.usefixtures("in_blocks")
def test_shipped_scenes_run_clean_under_sanitizers(program_of, scene_name, run_compiler):
    program = program_of(scene_name)
    found = _sanitized(program, scene_name.replace("-", "_"), run_compiler)
    _check_against_python(program, found)


@pytest.mark.sampled(1)
@pytest.mark.usefixtures("in_blocks")
def test_a_busy_scene_runs_clean_under_sanitizers(run_compiler):
    program = _busy()
    _check_against_python(program, _sanitized(program, "double_", run_compiler))


@pytest.mark.usefixtures("in_blocks")
def test_calls_run_clean_under_sanitizers(made_up, run_compiler):
    dag, results = call_case()
    program = made_up(dag, outputs=results)
    found = _sanitized(program, "made_up", run_compiler, {"swirl.c": SWIRL_C})
    _check_against_python(program, found)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("sensitivities", [(), ("m", "L")])
@pytest.mark.usefixtures("in_blocks")
def test_a_scene_with_constraints_runs_clean_under_sanitizers(run_compiler, sensitivities):
    program = _closed(sensitivities)
    found = _sanitized(program, "closed", run_compiler)
    names = list(KERNELS)
    optional = {*names[names.index("constraints") :]} - OF_UNKNOWNS
    # Of events, s stands for rates of states, or for how far these reach.
    of_sensitivities = {name for name in optional if "s" in KERNELS[name].arguments}
    of_sensitivities -= {"event_rates", "event_ranges"}
    assert optional & set(found) == (optional if sensitivities else optional - of_sensitivities)
    _check_against_python(program, found)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("sensitivities", [(), ("C", "Is")])
@pytest.mark.usefixtures("in_blocks")
def test_a_scene_with_algebraic_unknowns_runs_clean_under_sanitizers(run_compiler, sensitivities):
    program = _rectifier(sensitivities)
    found = _sanitized(program, "bridge_rectifier", run_compiler)
    # A model with sensitivities can also run its states alone, by the kernel without them.
    absent = set() if sensitivities else OF_UNKNOWNS - {"algebraic_step", "extended_rhs"}
    assert OF_UNKNOWNS & set(found) == OF_UNKNOWNS - absent
    _check_against_python(program, found)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("n", [1, 4])
@pytest.mark.usefixtures("in_blocks")
def test_redundant_systems_run_clean_under_sanitizers(made_up, run_compiler, n):
    # All parameters of a made-up program are one: so is every entry, and the rank.
    dag, results = solve_case(n, SolveShape(n, 0))
    program = made_up(dag, n_parameters=n * n + n, outputs=results)
    found = _sanitized(program, "made_up", run_compiler)
    assert found["outputs"][n:].tolist() == [1.0, 1.0]
    _check_against_python(program, found)
