"""Template data of the main program of a C project.

In: a program, the methods that are compiled in, and the start. Out: the context of its template.
Numbers that follow from parameters when the text is written (the start, the times of kinks) are
constants there. Parameters that they depend on are marked, and the main program refuses to change
them.
"""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.codegen.integrators import INTEGRATORS
from cotree.codegen.printing import wrapped
from cotree.codegen.start_tables import start_tables
from cotree.codegen.tableaus import FIXED
from cotree.dag.nodes import symbols_in
from cotree.dag.switching_times import value_of
from cotree.scene.settings import MOST_STEPS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cotree.codegen.context import ModelContext
    from cotree.codegen.start_tables import StartTables
    from cotree.codegen.tableaus import FixedStep, RosenbrockTableau, Tableau
    from cotree.codegen.targets import Target
    from cotree.dag.nodes import Node
    from cotree.model.consistent import Start
    from cotree.program.program import Program

#: Every method of C projects, by name: those that control their steps, and those of one length.
METHODS: dict[str, Tableau | RosenbrockTableau | FixedStep] = {**INTEGRATORS, **FIXED}

#: Kernels on whose parameters a computed start depends.
_OF_START = (
    "initial",
    "initial_sensitivity",
    "constraints",
    "constraint_sensitivity",
    "gradient",
    "start",
    "start_gradient",
    "start_sensitivity",
)


@dataclass(frozen=True)
class Numbers:
    """The default numbers of a run."""

    t_end: float  # end time, [s]
    #: Tolerances.
    rtol: float
    atol: float
    step: float | None = None  # length of all steps of a method of ``FIXED``, [s]


@dataclass(frozen=True)
class MainContext:
    """The values that the template of the main program receives."""

    model: ModelContext
    integrator: str  # the first method
    methods: list[str]  # all that are compiled in
    implicit: list[str]  # those among them that take a Jacobian
    #: C literals.
    t_end: str
    rtol: str
    atol: str
    has_rtol: bool  # whether something is solved to a relative tolerance
    #: A C initialiser for each time, or each row of times with a period, of a kink: the first time,
    #: the period or zero, and one if there are none before the first.
    stops: list[str]
    max_step: str
    seeds: list[int]  # positions of the sensitivity parameters, -1 for initial values
    #: Lines of C literals: the initial states and sensitivities, if C cannot compute them;
    #: otherwise empty.
    start: list[str]
    #: Tables of a start that C finds, since it has to satisfy further conditions.
    start_tables: StartTables | None
    guess: list[str]  # lines of C literals: its guesses, if there are any
    is_strict: bool  # whether constraints are dependent, so that rates are taken on them
    step: str  # fixed step size; empty if the step size is controlled
    is_extended: bool  # whether algebraic unknowns are integrated, too
    sizes: list[str]  # lines of C literals: the factor of each state's absolute tolerance, if any
    least_size: str  # the smallest of these if it is below one
    #: Lines with a one for each parameter on which constants of the text depend, otherwise a zero;
    #: empty if there is none.
    held: list[str]
    most_steps: int  # steps that a run takes at most without an event or a stop

    def conditions(self) -> dict[str, bool]:
        """Return the values of the macros that its plain C is selected by."""
        model, layout = self.model, self.model.layout
        found = {
            "ALGEBRAIC": layout.n_algebraic > 0,
            "CONSTRAINTS": bool(layout.constraints),
            "EVENTS": bool(layout.events),
            "EXPLICIT": len(self.implicit) < len(self.methods),
            "EXTENDED": self.is_extended,
            "FIXED": bool(self.step),
            "GUARDS": bool(model.guards),
            "GUESS": bool(self.guess),
            "HELD": bool(self.held),
            "LEAST_SIZE": bool(self.least_size),
            "METHODS": len(self.methods) > 1,
            "OUTPUTS": bool(layout.outputs),
            "PARAMETERS": bool(layout.parameters),
            "RTOL": self.has_rtol,
            "SIZES": bool(self.sizes),
            "START": bool(self.start),
            "STOPS": bool(self.stops),
            "TABLES": self.start_tables is not None,
            "TURNS": bool(layout.sensitivities and self.stops),
        }
        return {f"COTREE_MAIN_{name}": value for name, value in found.items()}


def main_context(
    program: Program,
    model: ModelContext,
    methods: Sequence[str],
    numbers: Numbers,
    start: Start | None,
    sizes: Sequence[float],
    *,
    is_strict: bool,
    is_found: bool,
) -> MainContext:
    """Build the template data of the main program.

    ``methods`` begin with the default one; ``sizes`` are factors of the absolute tolerances of
    states. ``start`` is the start at the scene's parameters, if it has to be found, and
    ``is_found`` whether C finds it, also at other values. ``is_strict``: constraints are dependent,
    and rates are taken on them.
    """
    implicit = [name for name in methods if METHODS[name].is_implicit]
    target = model.target
    has_explicit = len(implicit) < len(methods)
    least = min(1.0, *sizes) if sizes else 1.0
    return MainContext(
        model=model,
        integrator=methods[0],
        methods=list(methods),
        implicit=implicit,
        t_end=target.literal(numbers.t_end),
        rtol=target.literal(numbers.rtol),
        atol=target.literal(numbers.atol),
        has_rtol=numbers.step is None or not implicit,
        # Steps of one length pass over these.
        stops=[] if numbers.step is not None else _stop_rows(program, target),
        max_step=_max_step(program, target),
        seeds=_seeds(program),
        start=[] if start is None or is_found else _lines(start.z, target),
        start_tables=start_tables(program.layout) if start is not None and is_found else None,
        guess=_guess(program, start, target) if start is not None and is_found else [],
        is_strict=is_strict,
        step="" if numbers.step is None else target.literal(numbers.step),
        is_extended=has_explicit
        and program.traits.can_extend(program.layout)
        and not program.layout.events,
        sizes=_lines(sizes, target),
        least_size=target.literal(least) if least < 1.0 else "",
        held=_held(program, has_start=start is not None and not is_found),
        most_steps=MOST_STEPS,
    )


def held_parameters(program: Program, *, has_start: bool) -> frozenset[int]:
    """Return the places of the parameters on which numbers of the text depend."""
    roots: list[Node] = []
    if has_start:
        layout = program.layout
        roots += [node for name in _OF_START for node in program.kernels[name].results]
        # Algebraic unknowns follow from their equations, whose rates are residuals.
        if layout.n_algebraic:
            n = len(layout.states)
            roots += program.kernels["rhs"].results[n - layout.n_algebraic :]
            roots += program.kernels["inputs"].results
        if any(row.is_jump for row in layout.events):
            roots += [*program.kernels["events"].results, *program.kernels["inputs"].results]
    for stop in (stop for own in program.stops.values() for stop in own):
        roots += [stop.first, *(d for pair in stop.along for d in pair)]
        roots += [] if stop.period is None else [stop.period]
    roots += [limit for own in program.longest_steps.values() for limit in own]
    return frozenset(s.data[1] for s in symbols_in(roots) if s.data[0] == "p")


def _held(program: Program, *, has_start: bool) -> list[str]:
    held = held_parameters(program, has_start=has_start)
    n = len(program.layout.parameters)
    return wrapped(str(int(i in held)) for i in range(n)) if held else []


def _guess(program: Program, start: Start, target: Target) -> list[str]:
    """Return guesses of algebraic unknowns and of modes of friction and stops, if any."""
    layout = program.layout
    if not layout.n_algebraic and not any(row.part for row in layout.events):
        return []
    return _lines(start.y, target)


def _seeds(program: Program) -> list[int]:
    places = {row.name: i for i, row in enumerate(program.layout.parameters)}
    # Initial values of states have no place among the parameters.
    return [places.get(name, -1) for name in program.layout.sensitivities]


def _stop_rows(program: Program, target: Target) -> list[str]:
    """Return the times of kinks of inputs and rates, at the program's parameter values."""
    symbols = program.dag
    values = {symbols.symbol("p", i): v for i, v in enumerate(program.layout.parameter_values)}
    rows = set()
    for stop in (stop for own in program.stops.values() for stop in own):
        first = value_of(stop.first, values)
        # Some times do not exist at these values, such as a quotient by a zero parameter.
        if not math.isfinite(first):
            continue
        period = value_of(stop.period, values)
        # C needs positive periods. The sign of a period and of its derivatives is changed together.
        sign = math.copysign(1.0, period)
        slopes = [value_of(d, values) for pair in stop.along for d in pair]
        # A single time has a period of zero.
        if not math.isfinite(period) or period == 0.0:
            period, slopes[1::2] = 0.0, [0.0] * len(stop.along)
        slopes[1::2] = [sign * d for d in slopes[1::2]]
        rows.add((first, abs(period), sign * stop.starts, *slopes))
    return [f"{{{', '.join(map(target.literal, row))}}}" for row in sorted(rows)]


def _max_step(program: Program, target: Target) -> str:
    """Return the longest step at the program's parameter values; empty if steps are unlimited."""
    longest = program.longest_step(program.layout.parameter_values)
    return target.literal(longest) if math.isfinite(longest) else ""


def _lines(values: Iterable[float], target: Target) -> list[str]:
    text = " ".join(f"{target.literal(value)}," for value in values)
    return textwrap.wrap(text, 96, break_long_words=False, break_on_hyphens=False)
