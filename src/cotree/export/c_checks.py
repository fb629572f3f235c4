"""Checks before a C project or an FMU is written, and the start that it needs.

Without a compiler, constraints are tested at the scene's initial values, and the written program
finds its start itself.
"""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cotree.build import BuildOptions
from cotree.codegen.tableaus import FIXED
from cotree.dag.continuity import jumps_at_time_events
from cotree.dag.nodes import substitute
from cotree.errors import CodegenError, SceneError, brief
from cotree.model.bound import BoundModel
from cotree.model.loading import load_model
from cotree.model.start import Start, scene_start
from cotree.model.unknowns import content_sizes
from cotree.naming import c_identifier
from cotree.pipeline import text_of
from cotree.tolerances import RANK, loose_rtol, rtol_fault

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.codegen.targets import Target
    from cotree.model.model import CompiledModel
    from cotree.program.program import Program


@dataclass(frozen=True)
class Evaluated:
    """A program with its consistent start, which is computed at its first use."""

    program: Program
    given: CompiledModel | None = None  # the model, if it has been compiled already

    @cached_property
    def model(self) -> CompiledModel:
        """The compiled program."""
        if self.given is not None:
            return self.given
        return load_model(text_of(self.program), BuildOptions())

    @property
    def is_possible(self) -> bool:
        """Whether the kernels are compiled and can be called."""
        return self.model.backend != "none"

    @cached_property
    def start(self) -> Start:
        """The start at the program's parameter values; without a compiler, the initial values."""
        if self.is_possible:
            return scene_start(self.model)
        n, m = len(self.program.layout.states), len(self.program.layout.sensitivities)
        y, s = (np.array(self.initial(name)) for name in ("initial", "initial_sensitivity"))
        return Start(y, s.reshape(m, n).T)

    def initial(self, kernel: str) -> list[float]:
        """Evaluate a kernel at t = 0 with the scene's parameters and initial values."""
        p, program = self.program.layout.parameter_values, self.program
        known = {"t": (0.0,), "p": p, "x": program.values("initial", {"p": p})}
        known["u"] = program.values("inputs", known)
        return program.values(kernel, known)

    def found_start(self) -> Start | None:
        """Return the start if it must be computed, else None; check redundant initial values."""
        layout = self.program.layout
        # Constraints, further conditions and algebraic unknowns require a computed start, and so do
        # discontinuous expressions, whose modes must be found.
        is_sought = layout.constraints or layout.start_rows or layout.n_algebraic
        is_sought = is_sought or any(row.is_jump for row in layout.events)
        if not layout.states or not (is_sought or layout.redundant):
            return None
        start = self.start
        return start if is_sought else None

    def sizes(self, start: Start) -> list[float]:
        """List the factor of each state's absolute tolerance; empty if all are one."""
        # Factors differ from one only if a state is the sum of the contents of several storages.
        if not self.program.layout.followers or not self.is_possible:
            return []
        at = BoundModel(self.model, 0.0, self.model.default_parameters)
        sizes = content_sizes(at, start.y)
        return [] if sizes is None else sizes.tolist()

    def is_dependent(self) -> bool:
        """Return whether the constraints are linearly dependent at the start, or nearly so."""
        edges = self.program.layout.constraint_edges
        if not edges:
            return False
        if not self.is_possible:
            rows = np.reshape(self.initial("gradient"), (len(edges), -1))
            return bool(np.linalg.matrix_rank(rows, RANK * np.max(np.abs(rows))) < len(edges))
        # Runs compute the rank in the same way.
        held = BoundModel(self.model, 0.0, self.model.default_parameters)
        return bool(held.singular(0.0, self.start.z))


def check_numbers(t_end: float, rtol: float, atol: float) -> None:
    """Raise SceneError if the end time or a tolerance is invalid; warn if ``rtol`` is loose."""
    if not math.isfinite(t_end):
        raise SceneError(f"t_end is {t_end}: give a finite number")
    fault = rtol_fault(rtol, least=0.0)
    if fault:
        raise SceneError(fault)
    # Zero is allowed: only the relative tolerance then limits the error. nan is rejected.
    if not (math.isfinite(atol) and atol >= 0.0):
        raise SceneError(f"atol is {atol}: give a finite number that is not negative")
    if loose_rtol(rtol):
        warnings.warn(loose_rtol(rtol), RuntimeWarning, stacklevel=4)


def check_methods(methods: Sequence[str]) -> None:
    """Raise CodegenError if a method occurs twice or a fixed-step method is not the only one."""
    fixed = [name for name in methods if name in FIXED]
    if fixed and len(methods) > 1:
        raise CodegenError(
            f"{fixed[0]} has fixed steps, and cannot be combined with other methods: give it alone"
        )
    for name in methods:
        if methods.count(name) > 1:
            raise CodegenError(f"integrator '{name}' is named twice")


def check_prefix(prefix: str) -> str:
    """Return the prefix of a project's names and files if it is a valid C identifier."""
    is_name = re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,63}", prefix) is not None
    if not is_name or c_identifier(prefix) != prefix:
        raise CodegenError(
            f"'{brief(prefix)}' cannot be the prefix of names in C: give a letter followed by at "
            "most 63 letters, digits or underscores; keywords of C, 'main' and names that begin "
            "with 'cotree_' are not allowed"
        )
    return prefix


def check_range(program: Program, target: Target) -> None:
    """Raise CodegenError if a parameter is beyond the range of the number type."""
    layout = program.layout
    for row, value in zip(layout.parameters, layout.parameter_values, strict=True):
        if not target.holds(value):
            raise CodegenError(
                f"parameter '{row.name}' is {value:g}, beyond the range of {target.scalar}: scale "
                "the units of the scene, or write the project in double precision"
            )


def check_step(program: Program, integrator: str, step: float | None) -> None:
    """Raise CodegenError if the step size does not suit the integrator or the scene.

    Fixed steps pass over events, so they exclude state events and jumps of sensitivities.
    """
    if integrator not in FIXED:
        if step is not None:
            raise CodegenError(
                f"{integrator} controls its step size: give step only for {' or '.join(FIXED)}"
            )
        return
    if step is None or not (math.isfinite(step) and step > 0.0):
        raise CodegenError(f"{integrator} has fixed steps: give step, a positive number of seconds")
    if program.layout.events:
        raise CodegenError(
            f"{integrator} does not locate events, and scene '{program.layout.name}' has "
            f"'{program.layout.events[0].name}': use dopri5, rkf45 or dop853"
        )
    _check_kinks(program, integrator)


def _check_kinks(program: Program, integrator: str) -> None:
    """Raise CodegenError if sensitivities jump at time events, which fixed-step methods pass over.

    Sensitivities jump only if rates do. A kink of the rates only reduces the order of the method.
    """
    dag, layout = program.dag, program.layout
    events = [event for own in program.time_events.values() for event in own]
    moving = [
        name
        for j, name in enumerate(layout.sensitivities)
        # Check the derivatives of the first time and of the period of each time event.
        if any(not d.is_zero for event in events for d in event.along[j])
    ]
    if not moving:
        return
    # With fixed parameters and inputs of the scene, rates can jump at known times only.
    known = {dag.symbol("u", i): v for i, v in enumerate(program.kernels["inputs"].results)}
    values = {dag.symbol("p", i): dag.constant(v) for i, v in enumerate(layout.parameter_values)}
    rates = substitute(substitute(list(program.kernels["rhs"].results), known), values)
    time = dag.symbol("t", 0)
    for state, rate in zip(layout.states, rates, strict=True):
        if jumps_at_time_events(dag, rate, time):
            raise CodegenError(
                f"the rate of '{state.name}' jumps at times that depend on '{moving[0]}', so that "
                f"sensitivities jump, too, but {integrator} does not locate these times: use "
                f"dopri5, rkf45 or dop853, or compile without sensitivities to '{moving[0]}'"
            )


def check_loops(program: Program, integrator: str, is_dependent: bool) -> None:
    """Raise CodegenError if constraints are dependent and the stages of the method violate them."""
    if is_dependent:
        raise CodegenError(
            f"constraints of scene '{program.layout.name}' are dependent at the start, which "
            f"{integrator} does not support: use dopri5, rkf45 or dop853"
        )
