"""Kernels of other tools for the same equations, differentiated by each tool.

The tools are CasADi (SX functions as C), heyoka (compiled functions), SymPy (``diff`` and ``cse``
printed as C) and Pinocchio (C++ of a chain). If a kernel is not available within a time limit, its
note states this.
"""

from __future__ import annotations

import ctypes
import importlib
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from kernel_pydy import pydy
from peer_equations import Equations
from timing import Contender, compile_c, compiler, harness, loop, pointer, within

LIMIT = 100.0  # seconds that a compiler, or a tool before it, gets
BEST = ("-O3", "-march=native", "-fno-math-errno")
_FEW = 150_000  # operations beyond which -O3 is not waited for
_CLANG = ("clang", "-O1", "-march=native", "-ffp-contract=fast")


def levels(n_operations: int) -> list[tuple[str, ...]]:
    """Return the compiler commands to try, the best first."""
    best = [(compiler(), *BEST)] if n_operations <= _FEW else []
    return [*best, *([_CLANG] if shutil.which("clang") else [])]


def places(model: Any) -> tuple[list[int], list[int]]:
    """Return the rows and columns of the entries of the Jacobian, in their order."""
    starts, rows = model.kernels.layout.column_starts, list(model.kernels.layout.row_indices)
    columns = [j for j in range(len(starts) - 1) for _ in range(starts[j], starts[j + 1])]
    return rows, columns


# ---- CasADi


def casadi_function(model: Any, kernel: str) -> Any:
    """Build a kernel as a function of x, s and p."""
    import casadi as ca

    n, free = len(model.states), list(model.parameters)
    x, p = ca.SX.sym("x", n), ca.SX.sym("p", len(free))
    states, parameters = ([v[i] for i in range(v.numel())] for v in (x, p))
    made = Equations(model, ca, states, parameters, ca.SX(0), free)
    rates = ca.vertcat(*made.rates)
    wanted = list(model.sensitivities)
    s = ca.SX.sym("s", n, len(wanted))
    if kernel == "rhs":
        out = [rates]
    elif kernel == "jacobian":
        out = [ca.jacobian(rates, x)]
    else:
        along = ca.vertcat(*(parameters[free.index(name)] for name in wanted))
        by_tangents = ca.jtimes(rates, ca.vertcat(x, along), ca.vertcat(s, ca.SX.eye(len(wanted))))
        out = [rates, by_tangents]
    function = ca.Function("peer", [x, s, p], out)
    if kernel == "augmented_rhs":
        by_product = ca.jacobian(rates, x) @ s + ca.jacobian(rates, along)
        other = ca.Function("peer", [x, s, p], [rates, by_product])
        function = min(function, other, key=casadi_operations)
    return function


def casadi_operations(function: Any) -> int:
    """Return the number of instructions other than constants, arguments and results."""
    import casadi as ca

    none = (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_PARAMETER)
    return sum(function.instruction_id(i) not in none for i in range(function.n_instructions()))


def casadi(model: Any, kernel: str, x: Any, s: Any) -> Contender:
    """Generate a kernel by CasADi and compile it at the best level that ends in time."""
    import casadi as ca

    began = time.process_time()
    function = casadi_function(model, kernel)
    writer = ca.CodeGenerator("peer.c", {"casadi_int": "long long int"})
    writer.add(function)
    text = writer.dump()
    n_operations = casadi_operations(function)
    found = Contender(n_operations, len(text), time.process_time() - began, 0.0, "")
    path, found.compilation, found.note = compile_c(text, levels(n_operations), LIMIT)
    if path is None:
        return found
    library = ctypes.CDLL(str(path))
    address = ctypes.cast(library.peer, ctypes.c_void_p).value or 0
    given = [x.copy(), s.copy(), np.array(model.default_parameters)]
    outs = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    ffi = harness()[0]
    arguments = ffi.new("const double *[]", max(function.sz_arg(), 3))
    for i, array in enumerate(given):
        arguments[i] = pointer(array)
    results = ffi.new("double *[]", max(function.sz_res(), len(outs)))
    for i, array in enumerate(outs):
        results[i] = pointer(array)
    iw, w = ffi.new("long long[]", function.sz_iw() + 1), np.zeros(function.sz_w() + 1)
    found.call = loop("casadi", address, given[0], [arguments, results, iw, w])
    found.call.keeps += (given, outs, library)  # type: ignore[attr-defined]

    def value() -> Any:
        if kernel != "jacobian":
            return np.concatenate(outs)
        sparsity = function.sparsity_out(0)
        dense = np.zeros((len(model.states),) * 2)
        dense[sparsity.get_triplet()] = outs[0]
        return dense[places(model)]

    found.value = value
    return found


# ---- heyoka


def _heyoka_objects(model: Any, kernel: str, folder: Path) -> None:
    """Compile with and without vectors in a process that can be terminated."""
    import heyoka as hy

    n, free = len(model.states), list(model.parameters)
    x = hy.make_vars(*(f"x{i}" for i in range(n)))
    p = [hy.par[i] for i in range(len(free))]
    made = Equations(model, hy, x, p, hy.time, free)
    rates = [hy.expression(rate) for rate in made.rates]
    variables = list(x)
    if kernel == "jacobian":
        tensors = hy.diff_tensors(rates, diff_args=list(x), diff_order=1)
        dense = tensors.jacobian
        rates = [hy.expression(dense[i, j]) for i, j in zip(*places(model), strict=True)]
    elif kernel == "augmented_rhs":
        along = [p[free.index(name)] for name in model.sensitivities]
        system = hy.var_ode_sys(list(zip(x, rates, strict=True)), along, order=1)
        variables, rates = (list(side) for side in zip(*system.sys, strict=True))
        # Names of sensitivities, and their order, are heyoka's: state by state.
    for name, with_vectors in (("plain", False), ("vectors", True)):
        made = hy.cfunc(rates, vars=variables, opt_level=3, slp_vectorize=with_vectors)
        (folder / f"{name}.part").write_bytes(made.llvm_states[0].object_code)
        (folder / f"{name}.part").rename(folder / f"{name}.o")
    (folder / "operations").write_text(str(len(made.dc) - len(variables) - len(rates)))


def heyoka(model: Any, kernel: str, x: Any, s: Any) -> Contender:
    """Return the machine code of heyoka, the faster of two variants."""
    import heyoka as hy

    folder, began = Path(tempfile.mkdtemp(prefix="peer")), time.perf_counter()
    within(LIMIT, _heyoka_objects, (model, kernel, folder))
    took = time.perf_counter() - began
    found = Contender(None, None, 0.0, took, f"stopped after {LIMIT:.0f} s")
    n, m = len(model.states), len(model.sensitivities)
    with_s = kernel == "augmented_rhs"
    # Sensitivities go state by state here, parameter by parameter elsewhere.
    order, back = (np.arange(n * m).reshape(a, b).T.ravel() for a, b in ((m, n), (n, m)))
    best = np.inf
    for libheyoka in Path(hy.__file__).parents[1].glob("heyoka.libs/libheyoka*.so*"):
        ctypes.CDLL(str(libheyoka), mode=ctypes.RTLD_GLOBAL)  # its sines
    for name in ("plain", "vectors"):
        if not (folder / f"{name}.o").exists():
            continue
        subprocess.run(
            [compiler(), "-shared", f"{name}.o", "-o", f"{name}.so", "-lm"], cwd=folder, check=True
        )
        library = ctypes.CDLL(str(folder / f"{name}.so"))
        address = ctypes.cast(library.cfunc, ctypes.c_void_p).value or 0
        inside = np.concatenate([x, s[order]]) if with_s else x.copy()
        size = n * (1 + m) if with_s else len(places(model)[0]) if kernel == "jacobian" else n
        p, out = np.array(model.default_parameters), np.zeros(size)
        call = loop("heyoka", address, inside, [p, out])
        call.keeps += (library,)  # type: ignore[attr-defined]
        call(100)
        least = min(call(1000) for _ in range(20))
        if least >= best:
            continue
        best, found.call, found.note = least, call, f"LLVM -O3, {name}"
        if with_s:
            found.value = lambda out=out: np.concatenate([out[:n], out[n:][back]])
        else:
            found.value = lambda out=out: out
    if (folder / "operations").exists():
        found.operations = int((folder / "operations").read_text())
    return found


# ---- SymPy


def sympy_text(model: Any, kernel: str) -> tuple[str, int]:
    """Return the C text of ``diff`` and ``cse``, and its number of operations."""
    import sympy
    from sympy.codegen.rewriting import create_expand_pow_optimization

    n, free = len(model.states), list(model.parameters)
    x = sympy.symbols([f"x{i}" for i in range(n)], real=True)
    p = sympy.symbols([f"p{i}" for i in range(len(free))], real=True)
    made = Equations(model, sympy, x, p, sympy.Integer(0), free)
    rates = sympy.Matrix(made.rates)
    outs = list(rates)
    inside = list(x)
    if kernel == "jacobian":
        dense = rates.jacobian(x)
        outs = [dense[i, j] for i, j in zip(*places(model), strict=True)]
    elif kernel == "augmented_rhs":
        m = len(model.sensitivities)
        s = sympy.Matrix(n, m, lambda i, j: sympy.Symbol(f"s{j}_{i}", real=True))
        along = [p[free.index(name)] for name in model.sensitivities]
        outs += list((rates.jacobian(x) * s + rates.jacobian(along)).T)
        inside += list(s.T)
    shared, reduced = sympy.cse(outs, optimizations="basic", list=True)
    powers = create_expand_pow_optimization(6)
    lines = ["#include <math.h>", "void peer(const double *in, double *out)", "{"]
    lines += [f"    const double {name} = in[{i}];" for i, name in enumerate([*inside, *p])]
    count = 0
    for name, value in shared:
        count += int(sympy.count_ops(value))
        lines.append(f"    const double {name} = {sympy.ccode(powers(value))};")
    for i, value in enumerate(reduced):
        count += int(sympy.count_ops(value))
        lines.append(f"    out[{i}] = {sympy.ccode(powers(value))};")
    return "\n".join([*lines, "}", ""]), count


def _write_sympy(model: Any, kernel: str, folder: Path) -> None:
    began = time.process_time()
    text, count = sympy_text(model, kernel)
    (folder / "counts").write_text(f"{count} {time.process_time() - began}")
    (folder / "part").write_text(text)
    (folder / "part").rename(folder / "text")


def sympy(model: Any, kernel: str, x: Any, s: Any, limit: float = LIMIT) -> Contender:
    """Differentiate by SymPy and apply ``cse``, in a process that can be terminated."""
    importlib.import_module("sympy.codegen.rewriting")  # what that takes is not its own
    folder = Path(tempfile.mkdtemp(prefix="peer"))
    within(limit, _write_sympy, (model, kernel, folder))
    found = Contender(None, None, limit, 0.0, f"stopped after {limit:.0f} s")
    if not (folder / "text").exists():
        return found
    text, (count, took) = (folder / "text").read_text(), (folder / "counts").read_text().split()
    found.operations, found.generation, found.c_bytes = int(count), float(took), len(text)
    path, found.compilation, found.note = compile_c(text, levels(found.operations), LIMIT)
    if path is None:
        return found
    library = ctypes.CDLL(str(path))
    address = ctypes.cast(library.peer, ctypes.c_void_p).value or 0
    s = s if kernel == "augmented_rhs" else s[:0]
    inside = np.concatenate([x, s, model.default_parameters])
    n, m = len(model.states), len(model.sensitivities)
    sizes = {"rhs": n, "jacobian": len(places(model)[0]), "augmented_rhs": n * (1 + m)}
    out = np.zeros(sizes[kernel])
    found.call = loop("plain", address, inside, [out])
    found.call.keeps += (library,)  # type: ignore[attr-defined]
    found.value = lambda: out
    return found


# ---- Pinocchio


def pinocchio_chain(n: int, folder: Path, seconds: float = 0.5) -> dict[str, float]:
    """Return minimum times of Pinocchio's C++ for the chain of n rods, [ns].

    The derivatives are with respect to positions, velocities and torques. The program is that of
    ``robots.py``; it is built in the folder if it does not exist.
    """
    import pinocchio
    import robots

    model = pinocchio.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    inertia = pinocchio.Inertia(1.0, np.array([0.5, 0.0, 0.0]), np.diag([0.0, 0.0, 1.0 / 12.0]))
    joint, place = 0, pinocchio.SE3.Identity()
    for i in range(n):
        joint = model.addJoint(joint, pinocchio.JointModelRZ(), place, f"h{i}")
        model.appendBodyToJoint(joint, inertia, pinocchio.SE3.Identity())
        place = pinocchio.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    program = robots.Peers(folder).loop
    text = Path(tempfile.mkdtemp(prefix="peer")) / "chain.txt"
    model.saveToText(str(text))
    printed = robots.run([str(program), str(text), str(seconds)])[0] if program else None
    found = map(float, (printed or "").split())
    return dict(zip(("rhs", "jacobian"), found, strict=False))


PEERS = {"CasADi": casadi, "heyoka": heyoka, "SymPy": sympy, "PyDy": pydy}
