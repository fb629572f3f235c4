"""The C text of a program. Texts from caches and other processes contain the program as bytes."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

from cotree.quiet import without_collection
from cotree.sharing import locked_cached_property

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.program.layout import Layout
    from cotree.program.program import Program


@dataclass(frozen=True)
class Traits:
    """Properties of a program that determine how its kernels are called."""

    n_results: Mapping[str, int]  # number of results of each C kernel
    #: Sensitivity parameters on which neither states nor outputs depend.
    unreached: tuple[str, ...]
    is_rheonomic: bool  # whether conditions on initial states depend on time
    constant_inputs: tuple[str, ...]  # names of inputs that depend on parameters only
    has_constant_start: bool  # whether initial values are independent of all parameters
    has_time_events: bool  # whether inputs or rates have time events
    has_longest_step: bool  # whether there are upper bounds of the step size

    def can_extend(self, layout: Layout) -> bool:
        """Return whether algebraic unknowns can be integrated throughout a run."""
        if layout.kinks:
            return False  # the rates of algebraic unknowns jump at kinks of the residuals
        name = "extended_augmented_rhs" if layout.sensitivities else "extended_rhs"
        return bool(self.n_results.get(name))


@dataclass(frozen=True)
class ModelText:
    """A program and its C text."""

    layout: Layout
    traits: Traits
    stored: Program | bytes = field(repr=False)  # program after its passes, or its pickle
    files: Mapping[str, str] = field(default_factory=dict)  # contents of the C files by name
    #: Whether the files lack the Jacobian, which is long and has its own files when first needed.
    is_divided: bool = False
    declarations: str = ""  # C declarations for cffi
    prefix: str = ""  # prefix of all names in the C text
    #: Number of operations in the longest C function, and in all functions.
    n_written: int = 0
    n_written_in_all: int = 0
    slow_causes: str = ""  # sentences on parameter values of the scene that require short steps
    cautions: tuple[str, ...] = ()  # warnings issued by each compilation

    @classmethod
    def of(cls, program: Program, **text: Any) -> ModelText:
        """Build the text of a program; without files, its kernels cannot be compiled."""
        return cls(program.layout, program.traits, program, **text)

    @locked_cached_property
    def program(self) -> Program:
        """The program after its passes."""
        if isinstance(self.stored, bytes):
            with without_collection():
                program: Program = pickle.loads(self.stored)
            return program
        return self.stored

    def __getstate__(self) -> dict[str, Any]:
        own = {row.name: getattr(self, row.name) for row in fields(self)}
        if not isinstance(self.stored, bytes):
            own["stored"] = pickle.dumps(self.stored, pickle.HIGHEST_PROTOCOL)
        return own
