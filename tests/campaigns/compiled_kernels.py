"""Random scenes whose kernels are compared between compilers, levels, the nodes and differences.

A scene is formed once. Its C text is compiled by every compiler at every level, and as part of a C
project by the project's own Makefile; each kernel is called at random points and compared with the
nodes that it was printed from, and these with differences of the rates.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import subprocess
from typing import TYPE_CHECKING, Any

import numpy as np
from evaluated_kernels import EvaluatedKernels
from random_scenes import inertia, random_loop, random_mechanism, random_scene, vector

from cotree import Scene
from cotree.build import BuildOptions, build_library, find_toolchain, load_library
from cotree.codegen.c_files import cdef, render_model
from cotree.codegen.context import model_context
from cotree.errors import ParameterError, SingularSystemError, SolveError
from cotree.export.c_project import write_c_project
from cotree.model.kernels import Kernels
from cotree.pipeline import formulate, generate
from cotree.program.text import ModelText
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path

    from cotree.program.program import Program

COMPILERS = ("gcc", "clang")
LEVELS = ("-O0", "-Og", "-O1", "-O2", "-O3", "native")

#: Kernels against their nodes, of the largest result: sines of several angles differ from those of
#: the C library in the last place, and mass matrices enlarge that some thousand times.
SAME = 1e-9
#: Differences of fourth order, of the largest entry and rate: steps of 1e-3 leave 1e-11 of the
#: fifth derivatives, which are up to 1e4 times as large near singular positions.
NEAR = 1e-6
STEP = 1e-3

# ------------------------------------------------------------------------------------------------
# Scenes


def make(seed: int) -> tuple[Scene, list[str], list[str] | None]:
    """Build a random scene, choose what it has sensitivities to, and name a tree or none."""
    rng = random.Random(seed)
    made = FAMILIES[seed % len(FAMILIES)](seed, rng)
    scene, tree = made if isinstance(made, tuple) else (made, None)
    names = rng.sample(list(scene.parameters), min(len(scene.parameters), seed // 8 % 4))
    return scene, names, tree


def _tree(seed: int, rng: random.Random) -> Scene:
    return random_scene(seed, rng.randint(1, 4))


def _planar_tree(seed: int, rng: random.Random) -> Scene:
    return random_scene(seed, rng.randint(1, 5), is_planar=True)


def _mechanism(seed: int, rng: random.Random) -> Scene:
    return random_mechanism(seed, rng.randint(1, 3))


def _loop(seed: int, rng: random.Random) -> tuple[Scene, list[str]]:
    return random_loop(seed, is_planar=rng.random() < 0.5)


def _law(rng: random.Random, names: Iterable[str]) -> str:
    """A smooth law of some names, between 0.6 and 1.4."""
    a, b = rng.choice([*names]), round(rng.uniform(0.1, 0.4), 3)
    shapes = ("1 + {b}*sin({a})**3", "1 + {b}*tanh({a})", "2**({b}*cos({a}))", "exp({b}*sin({a}))")
    return rng.choice(shapes).format(a=a, b=b)


def _arm_of_laws(seed: int, rng: random.Random) -> Scene:
    """A spatial chain with few freedoms whose axes and arms are numbers, and laws about it."""
    scene = Scene(f"laws-{seed}", gravity=[2.6, "-g", -3.0])
    scene.parameter("g", 9.81)
    scene.parameter("b", 0.4)
    ends, moves = ["ground"], ["t"]
    for i in range(rng.randint(2, 4)):
        moves += [f"j{i}.theta", f"j{i}.theta_dot"]
        start = {"theta": rng.uniform(-1.0, 1.0), "theta_dot": rng.uniform(-1.0, 1.0)}
        law = {"damping": f"0.2*({_law(rng, ['b'])})", "torque": f"2*({_law(rng, moves)}) - b"}
        scene.edge(f"j{i}", "revolute", ends[-1], f"A{i}", axis=vector(rng), initial=start, **law)
        turned = {"rotation": vector(rng)} if rng.random() < 0.4 else {}
        scene.edge(f"a{i}", "arm", f"A{i}", f"C{i}", vector=vector(rng), **turned)
        tensor: Any = inertia(rng) if rng.random() < 0.7 else 0.3
        scene.edge(f"m{i}", "rigid_body", "ground", f"C{i}", mass=1.1, inertia=tensor)
        ends.append(f"C{i}")
        scene.output(f"x{i}", f"C{i}.ax")
    # Few elements leave columns of the Jacobian with constants alone, which become tables.
    wanted = rng.sample(["spring", "damper", "line_force"], rng.randint(1, 3))
    damping = f"0.1*({_law(rng, moves)})"
    if "spring" in wanted:
        axis = {"axis": [1, -0.4, 0.3], "stiffness": "3*b + 1", "damping": damping}
        scene.edge("f", "spring", ends[-2], ends[-1], **axis)
    if wanted != ["spring"]:
        scene.edge("wall", "arm", "ground", "P", vector=[-5.9, 5.3, 4.0])
    if "damper" in wanted:
        scene.edge("e", "damper", "P", ends[-1], damping=f"b*({_law(rng, ['b'])})")
    if "line_force" in wanted:
        scene.edge("l", "line_force", "P", ends[-2 % len(ends)], force="1 - 0.1*rate")
    return scene


def two_arms() -> Scene:
    """Build two bodies on hinges, with a spring between them.

    Its Jacobian came out as zero from gcc 12 at -O2: columns of unit vectors were a table whose
    zeros had no initialiser.
    """
    scene = Scene("two-arms", gravity=[2.6, -7.9, -3.0])
    scene.parameter("b", 0.4)
    axes = ([0.3, 0.8, 0.2], [0.8, 0.3, 0.5])
    tensors = ([[2.2, 0.1, -0.1], [0.1, 2.8, 0.0], [-0.1, 0.0, 2.0]], 0.3)
    for i, node in enumerate(("ground", "C0")):
        start = {"theta": 0.5, "theta_dot": 0.2}
        scene.edge(f"j{i}", "revolute", node, f"A{i}", axis=axes[i], damping="b", initial=start)
        turned = {"rotation": [0.9, 0.5, 0.6]} if i else {}
        scene.edge(f"a{i}", "arm", f"A{i}", f"C{i}", vector=[0.6, 0.4, 0.4], **turned)
        scene.edge(f"m{i}", "rigid_body", "ground", f"C{i}", mass=1.1, inertia=tensors[i])
    law = {"stiffness": "3*b", "damping": "0.1*(1 + 0.4*sin(j1.theta + b))"}
    scene.edge("e", "spring", "C0", "C1", axis=[1, -0.4, 0.3], **law)
    return scene


def _circuit(seed: int, rng: random.Random) -> Scene:
    """Capacitors at nodes that resistors, inductors and diodes join."""
    scene = Scene(f"circuit-{seed}")
    for name in "abc":
        scene.parameter(name, round(rng.uniform(0.5, 2.0), 3))
    scene.input("u1", "sin(t)")
    scene.edge("V", "voltage_source", "n0", "ground", voltage="2*u1 + a")
    moves = ["u1"]
    for i in range(1, rng.randint(3, 8)):
        start = {"v": rng.uniform(-0.5, 0.5)}
        scene.edge(f"C{i}", "capacitor", f"n{i}", "ground", capacitance="b", initial=start)
        moves.append(f"C{i}.v")
        scene.edge(f"R{i}", "resistor", f"n{i - 1}", f"n{i}", resistance=_law(rng, moves))
        beside = f"n{rng.randrange(i)}"
        kind = rng.choice(["inductor", "diode", "current_source", "none"])
        if kind == "inductor":
            scene.edge(f"L{i}", kind, beside, f"n{i}", inductance="c")
        elif kind == "diode":
            scene.edge(f"D{i}", kind, beside, f"n{i}", saturation_current=1e-6)
        elif kind == "current_source":
            scene.edge(f"I{i}", kind, beside, f"n{i}", current=f"0.2*({_law(rng, moves)})")
    scene.output("y", f"n{i}.v*R1.i")
    return scene


def _hydraulics(seed: int, rng: random.Random) -> Scene:
    """Tanks that pipes, orifices and resistors join, and a pump."""
    scene = Scene(f"hydraulics-{seed}")
    for name in "abc":
        scene.parameter(name, round(rng.uniform(0.5, 2.0), 3))
    scene.input("u1", "sin(t)")
    scene.edge("P", "flow_source", "ground", "n0", flow="1 + 0.3*u1*a")
    for i in range(rng.randint(2, 6)):
        start = {"p": rng.uniform(1.0, 3.0)}
        own = {"density": 1.0, "gravity": "b", "initial": start}
        scene.edge(f"T{i}", "tank", f"n{i}", "ground", area=_law(rng, ["c"]), **own)
        other = f"n{rng.randrange(i)}" if i else "ground"
        kind = rng.choice(["pipe", "orifice", "hydraulic_resistor"])
        fields: dict[str, Any] = {"resistance": 0.7}
        if kind == "pipe":
            fields |= {"inertance": "c"}
        elif kind == "orifice":
            fields = {"area": 0.5, "coefficient": 0.6, "density": 1.0}
        scene.edge(f"R{i}", kind, f"n{i}", other, **fields)
    scene.output("y", f"n{i}.p*R0.q")
    return scene


def _switched(seed: int, rng: random.Random) -> Scene:
    """Masses on springs with stops, tables and laws that jump, and an event."""
    scene = Scene(f"switched-{seed}")
    for name in "abc":
        scene.parameter(name, round(rng.uniform(0.5, 2.0), 3))
    scene.mode("count", 0)
    points = sorted(rng.uniform(-2.0, 2.0) for _ in range(rng.randint(2, 6)))
    values: Any = [round(rng.uniform(-1.0, 1.0), 3) for _ in points]
    kind = rng.choice(["linear", "monotone"])
    if kind == "linear":  # of parameters, which only these may have
        values = [f"a*{value}" for value in values]
    scene.table("curve", points, values, interpolation=kind)
    for i in range(rng.randint(1, 4)):
        before = f"B{i - 1}" if i else "ground"
        own = {"initial": {"s": rng.uniform(-1.0, 1.0), "v": rng.uniform(-1.0, 1.0)}}
        scene.edge(f"m{i}", "translational_mass", "ground", f"B{i}", mass="b", **own)
        scene.edge(f"k{i}", "translational_spring", before, f"B{i}", stiffness="3*c")
        x, v = f"m{i}.s", f"m{i}.v"
        laws = (
            f"curve({x})",
            f"sign({v} - 0.1)*{x}",
            f"max({x} - 0.3, 0)*a",
            f"where({x} > 0.2, sin({v}), b)",
            f"abs({x} + {v}) + mod({x}, 0.7)",
        )
        force = f"-({rng.choice(laws)}) - 0.1*{v}"
        scene.edge(f"f{i}", "force_source", "ground", f"B{i}", force=force)
    scene.event("passes", "m0.s - 0.1*a", set={"count": "count + 1"})
    scene.output("y", "m0.s*count")
    return scene


FAMILIES: tuple[Callable[[int, random.Random], Any], ...] = (
    _arm_of_laws,
    _tree,
    _circuit,
    _mechanism,
    _hydraulics,
    _planar_tree,
    _switched,
    _loop,
)

# ------------------------------------------------------------------------------------------------
# Constant arrays

_ARRAY = re.compile(r"([\w()]+)\s*\[([^\]]*)\]\s*=\s*(\{|\w+\s*;)")
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_DEFINED = re.compile(r"#define (\w+)[ \t]+(.+)")
_ENUM = re.compile(r"\benum\b[^{;]*\{([^}]*)\}")


def left_out(files: Mapping[str, str]) -> list[str]:
    """List the constant arrays of some C files that have entries without an initialiser.

    Compilers fold loads from them, and gcc 12 takes a vector that begins at such an entry for
    zeros.
    """
    plain = {file: _COMMENT.sub("", text.replace("\\\n", " ")) for file, text in files.items()}
    of_headers: dict[str, str] = {}
    for file, text in plain.items():
        of_headers |= _constants(text) if file.endswith(".h") else {}
    found = []
    for file, text in plain.items():
        defined = of_headers | _constants(text)  # other sources may mean others by these names
        for match in _ARRAY.finditer(text):
            # A declaration begins behind the end of what stands before it; that of a structure
            # holds semicolons, and ends its line.
            line = text[text.rfind("\n", 0, match.start()) + 1 : match.start()]
            if "const" not in line and not line.startswith("}"):
                continue
            name, length, start = match.groups()
            body = text[match.end() - 1 :] if start == "{" else defined[start.rstrip("; \n")]
            items = list(_items(body))
            n = _count(length, defined) if length else len(items)
            if any(item.startswith("[") for item in items) or n != len(items):
                found.append(f"{file}: {name}[{length}]")
    return found


def _constants(text: str) -> dict[str, str]:
    """Return macros and enumerators by name."""
    defined = dict(_DEFINED.findall(text))
    for enum in _ENUM.findall(text):
        names = [row.partition("=") for row in enum.split(",")]
        defined |= {a.strip(): b.strip() or str(i) for i, (a, _, b) in enumerate(names)}
    return defined


def _count(length: str, defined: Mapping[str, str]) -> int:
    """Evaluate a length: a number, a name, or products and sums of them."""
    while names := [name for name in re.findall(r"[A-Za-z_]\w*", length) if name in defined]:
        length = re.sub(rf"\b{names[0]}\b", f"({defined[names[0]]})", length)
    assert re.fullmatch(r"[\d\s()*+-]+", length), length
    return int(eval(length))


def _items(text: str) -> Iterator[str]:
    """Split an initialiser in braces at its own commas."""
    depth, item = 0, ""
    for token in re.findall(r'"(?:\\.|[^"\\])*"|[^"]', text):
        depth += (token in ("{", "(")) - (token in ("}", ")"))
        if depth == 0 or (token == "," and depth == 1):
            if item.strip():
                yield item.strip()
            item = ""
            if depth == 0:
                return
        elif not (token == "{" and depth == 1):
            item += token


# ------------------------------------------------------------------------------------------------
# Kernels


def compiled(program: Program, compiler: str, level: str) -> Kernels:
    """Compile a program's own text as models are compiled."""
    context = model_context(program)
    files = dict(render_model(context))
    options = BuildOptions(native=True) if level == "native" else BuildOptions(level)
    os.environ["CC"] = compiler
    toolchain = find_toolchain()
    assert toolchain is not None
    library = build_library(
        files,
        abi_version=ABI_VERSION,
        n_operations=context.n_written,
        options=options,
        toolchain=toolchain,
    )
    declarations = cdef(files["cotree_abi.h"], context.prefix)
    return Kernels(
        ModelText.of(program, prefix=context.prefix), load_library(library.path, declarations)
    )


def made(program: Program, compiler: str, flags: str, folder: Path) -> Kernels:
    """Compile the model of a C project by the project's Makefile."""
    write_c_project(program, folder, "dopri5", t_end=1.0, rtol=1e-6, atol=1e-8)
    context = model_context(program)
    prefix = context.prefix
    flags = [f"CC={compiler}", f"CFLAGS={flags} -fPIC"]
    for command in (
        ["make", *flags, f"{prefix}.o"],
        [compiler, "-shared", "-o", f"{prefix}.so", f"{prefix}.o", "-lm"],
    ):
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
    declarations = cdef((folder / "cotree_abi.h").read_text(), prefix)
    return Kernels(
        ModelText.of(program, prefix=prefix), load_library(folder / f"{prefix}.so", declarations)
    )


class Points:
    """Random arguments of kernels, near the start of a scene."""

    def __init__(self, program: Program, rng: np.random.Generator) -> None:
        layout, self.rng = program.layout, rng
        self.p = np.array(layout.parameter_values)
        self.n_sensitivities = max(len(layout.sensitivities), 1) * len(layout.states)
        self.start = np.zeros(len(layout.states))
        own = EvaluatedKernels(program)
        own.prepare(self.p)
        if program.kernels["initial"].is_present:
            self.start = own("initial", 0.0, *3 * (np.zeros(0),))
        self.n_inputs = len(layout.inputs)

    def draw(self) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        """Draw a time, states, sensitivities and inputs."""
        x = self.start + self.rng.uniform(-0.2, 0.2, len(self.start))
        s = self.rng.uniform(-1.0, 1.0, self.n_sensitivities)
        return self.rng.uniform(0.0, 1.0), x, s, self.rng.uniform(-1.0, 1.0, self.n_inputs)


def differing(program: Program, kernels: Kernels, seed: int) -> Iterator[str]:
    """List the kernels whose results are not those of their nodes, at two points."""
    points, own = Points(program, np.random.default_rng(seed)), EvaluatedKernels(program)
    for each in (own, kernels):
        each.prepare(points.p)
    for _ in range(2):
        at = points.draw()
        for name, kernel in program.kernels.items():
            if not kernel.is_present or name == "prepare" or not kernel.results:
                continue
            found: list[Any] = []
            for each in (own, kernels):
                try:
                    found.append(each(name, *at).copy())
                except (SingularSystemError, SolveError):
                    found.append(None)
            expected, result = found
            if expected is None or result is None:
                if (expected is None) != (result is None):
                    yield f"{name}: one of them is singular"
                continue
            finite = np.isfinite(expected)
            size = np.abs(expected[finite]).max(initial=0.0)
            off = np.abs(np.where(finite, result - expected, 0.0)).max()
            if off > SAME * max(size, 1e-3) or np.any(np.isfinite(result) != finite):
                yield f"{name}: off by {off:.1e} of {size:.1e}"


def unlike_differences(program: Program, seed: int) -> Iterator[str]:
    """List the derivatives that are not those of differences of the rates."""
    points, layout = Points(program, np.random.default_rng(seed)), program.layout
    own, n = EvaluatedKernels(program), len(layout.states)
    t, x, s, u = points.draw()

    def rates(shift: np.ndarray, parameter: str = "", amount: float = 0.0) -> np.ndarray:
        p = points.p.copy()
        names = [row.name for row in layout.parameters]
        if parameter in names:
            p[names.index(parameter)] += amount
        own.prepare(p)
        return own("rhs", t, x + shift, s, u)

    def slope(shift: np.ndarray, parameter: str = "") -> np.ndarray:
        f = {k: rates(k * STEP * shift, parameter, k * STEP) for k in (-2, -1, 1, 2)}
        return (f[-2] - 8.0 * f[-1] + 8.0 * f[1] - f[2]) / (12.0 * STEP)

    def check(what: str, found: np.ndarray, expected: np.ndarray) -> Iterator[str]:
        size = max(1.0, np.abs(expected).max(initial=0.0), np.abs(rates(0.0 * x)).max())
        off = np.abs(found - expected).max(initial=0.0)
        if not off <= NEAR * size:
            yield f"{what}: off differences by {off:.1e} of {size:.1e}"

    try:
        own.prepare(points.p)
        values = own("jacobian", t, x, s, u)
        n_rows = len(program.kernels["rhs"].results)
        dense = np.zeros((n_rows, n))
        for j in range(n):
            part = slice(layout.column_starts[j], layout.column_starts[j + 1])
            dense[[*layout.row_indices[part]], j] = values[part]
        yield from check("jacobian", dense, np.column_stack([slope(row) for row in np.eye(n)]))
        if not layout.sensitivities or layout.n_algebraic:
            return
        own.prepare(points.p)
        together = own("augmented_rhs", t, x, s, u)[n_rows:]
        for j, name in enumerate(layout.sensitivities):
            part = slice(layout.sensitivity_starts[j], layout.sensitivity_starts[j + 1])
            rows = [*layout.sensitivity_rows[part]]
            direction = np.zeros(n)
            direction[rows] = s[part]
            yield from check(f"d/d{name}", together[part], slope(direction, name)[rows])
    except (SingularSystemError, SolveError, ParameterError):
        return  # near a singular position, or a parameter at the end of its range


def formed(seed: int) -> Program:
    """Form the program of a random scene."""
    return generate(formulate(*make(seed))[1])[0]


def available() -> list[str]:
    """List the compilers that are installed."""
    return [name for name in COMPILERS if shutil.which(name)]
