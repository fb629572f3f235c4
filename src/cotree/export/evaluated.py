"""Evaluation of a program in Python at its parameter values, for the start of a C project.

A few evaluations need no compiler, which a machine that only writes C may not have.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.model.contents import content_sizes
from cotree.model.kernels import PythonKernels
from cotree.model.model import CompiledModel
from cotree.model.moment import Moment
from cotree.model.start import scene_start
from cotree.solvers.project import Projection

if TYPE_CHECKING:
    from cotree.model.consistent import Start
    from cotree.program import Program


@dataclass(frozen=True)
class Evaluated:
    """A program whose model and start are made once, when something first asks for them.

    Attributes
    ----------
    program : Program
        The program.
    """

    program: Program

    @cached_property
    def model(self) -> CompiledModel:
        """The model, without a library."""
        return CompiledModel(self.program, PythonKernels(self.program))

    @cached_property
    def start(self) -> Start:
        """The consistent start at the program's parameter values."""
        return scene_start(self.model)

    def found_start(self) -> Start | None:
        """Return the start where it has to be found; None where the initial values are the start.

        Redundant initial values are checked in either case.
        """
        layout = self.program.layout
        # Constraints, further conditions and algebraic unknowns make the start a problem to be
        # solved. A jumping expression must know the side that it starts on.
        is_sought = layout.constraints or layout.start_rows or layout.n_algebraic
        is_sought = is_sought or any(row.is_jump for row in layout.events)
        if not layout.states or not (is_sought or layout.redundant):
            return None
        start = self.start
        return start if is_sought else None

    def is_found_in_c(self, start: Start) -> bool:
        """Return whether ``cotree_start.c`` finds a start, too, with its sensitivities."""
        return not (start.is_mended or start.told)

    def sizes(self, start: Start) -> list[float]:
        """List the factors of the absolute tolerances of states; empty where all are one."""
        # Only what storages hold together has another size than one.
        if not self.program.layout.followers:
            return []
        at = Moment(self.model, 0.0, self.model.default_parameters)
        sizes = content_sizes(at, start.y)
        return [] if sizes is None else sizes.tolist()

    def is_dependent(self) -> bool:
        """Tell whether constraints of edges are dependent at the start, or nearly so."""
        if not self.program.layout.constraint_edges:
            return False
        # The rank is judged as the projection of a run would judge it.
        projection = Projection(self.model, self.model.default_parameters, lambda t: None)
        return bool(projection.singular(0.0, self.start.z))
