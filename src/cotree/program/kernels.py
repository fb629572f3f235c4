"""Registry of kernels, with the arguments and results of each."""

from __future__ import annotations

from dataclasses import dataclass

#: Arguments of kernels; all are arrays except ``t``. ``k`` contains the results of ``prepare``.
ARGUMENTS: dict[str, str] = {
    "t": "time",
    "x": "states",
    "s": "sensitivities, parameter by parameter",
    "u": "inputs",
    "p": "parameters",
    "k": "prepared values",
    "v": "a direction of the states",
}


@dataclass(frozen=True)
class KernelSpec:
    """Description of a kernel."""

    name: str  # name of the kernel; in C it follows the model's name
    arguments: tuple[str, ...]  # keys of :data:`ARGUMENTS` in order; the result array follows in C
    result: str  # C name of the result array
    doc: str  # description of the results
    #: Kernel whose last results are the results of this one; C calls it and copies them. Or empty.
    tail_of: str = ""
    #: Whether every model has the kernel. C omits other kernels without results.
    is_required: bool = False
    #: Whether the argument ``s`` and the results omit sensitivities that are identically zero.
    is_packed: bool = False
    #: Suffix of the kernel's field in the model structure, if another field has this name.
    of: str = ""

    @property
    def field(self) -> str:
        """Name of the kernel's field in the model structure."""
        return self.name + self.of

    @property
    def type(self) -> str:
        """C type of a pointer to the kernel, determined by its arguments."""
        return f"cotree_{_TYPES[self.arguments]}_kernel"


_STATE = ("t", "x", "u", "p", "k")
_SENSITIVITY = ("t", "x", "s", "u", "p", "k")

#: Names of the function types in ``cotree_abi.h`` by arguments.
_TYPES = {
    ("p",): "prepare",
    ("p", "k"): "parameter",
    ("t", "p", "k"): "input",
    _STATE: "state",
    _SENSITIVITY: "sensitivity",
}

_ROWS = (
    KernelSpec(
        "prepare",
        ("p",),
        "k",
        "the n_prepared values that depend only on parameters",
        is_required=True,
    ),
    KernelSpec("initial", ("p", "k"), "x", "initial states", is_required=True),
    KernelSpec("initial_sensitivity", ("p", "k"), "s", "sensitivities of the initial states"),
    KernelSpec("inputs", ("t", "p", "k"), "u", "the scene's own inputs", of="_of_time"),
    KernelSpec("rhs", _STATE, "dx", "rates of the states", is_required=True),
    KernelSpec(
        "jacobian",
        _STATE,
        "values",
        "derivatives of rhs with respect to the states: n_nonzeros values, column by column",
        is_required=True,
    ),
    KernelSpec(
        "augmented_rhs",
        _SENSITIVITY,
        "dz",
        "rates of the states, then of the sensitivities; s and dz omit those that are always zero",
        is_packed=True,
    ),
    KernelSpec(
        "sensitivity_rhs",
        _SENSITIVITY,
        "ds",
        "rates of the sensitivities; s and ds omit those that are always zero",
        # In C, this kernel must follow the kernel that it calls.
        tail_of="augmented_rhs",
        is_packed=True,
    ),
    KernelSpec("outputs", _STATE, "y", "outputs", of="_of_state"),
    KernelSpec("output_sensitivity", _SENSITIVITY, "dy", "sensitivities of the outputs"),
    KernelSpec(
        "constraints",
        _STATE,
        "c",
        "residuals: constraints, their rates, norms of quaternions minus one",
    ),
    KernelSpec("constraint_sensitivity", _SENSITIVITY, "dc", "sensitivities of the constraints"),
    KernelSpec(
        "gradient",
        _STATE,
        "g",
        "derivatives of the constraint rates with respect to the speeds, row by row",
    ),
    KernelSpec(
        "start",
        _STATE,
        "c",
        "residuals of the initial conditions; redundant values from the states, then as prescribed",
    ),
    KernelSpec(
        "start_gradient", _STATE, "g", "derivatives of start with respect to the speeds, row by row"
    ),
    KernelSpec("start_sensitivity", _SENSITIVITY, "dc", "sensitivities of start"),
    KernelSpec("projection", _STATE, "dx", "a Newton step from the states towards the constraints"),
    KernelSpec(
        "sensitivity_projection",
        _SENSITIVITY,
        "ds",
        "the step after which sensitivities satisfy the differentiated constraints",
    ),
    KernelSpec(
        "events",
        _STATE,
        "g",
        "event functions, then switching functions; branch numbers of tables; quantities",
    ),
    KernelSpec("jumps", _STATE, "r", "new values of the targets of each event, in order"),
    KernelSpec(
        "event_sensitivity",
        _SENSITIVITY,
        "dg",
        "for each parameter, sensitivities of events, zeros for kinks, sensitivities of new values",
    ),
    KernelSpec(
        "event_rates",
        _SENSITIVITY,
        "dg",
        "time derivatives of events, kinks, new values and residuals of algebraic unknowns; s "
        "contains the rates of the states",
    ),
    KernelSpec(
        "event_ranges",
        _SENSITIVITY,
        "r",
        "bounds of the value and of the rate of each nonlinear event or kink; s contains the lower "
        "and upper bounds of all quantities, then of their rates",
    ),
    KernelSpec(
        "algebraic_step",
        _STATE,
        "d",
        "a step from a guess of the algebraic unknowns: rates of the states after it; the step and "
        "its last term, n_algebraic each; its size relative to the radius of convergence, about 1 "
        "if the series fails; error growth of pivots",
    ),
    KernelSpec("extended_rhs", _STATE, "dx", "rates of states and algebraic unknowns"),
    KernelSpec(
        "extended_augmented_rhs",
        _SENSITIVITY,
        "dz",
        "rates of states and algebraic unknowns, then of the states' sensitivities; s and dz omit "
        "those that are always zero",
        is_packed=True,
    ),
    KernelSpec(
        "algebraic_sensitivity",
        _SENSITIVITY,
        "ds",
        "sensitivities of the algebraic unknowns; s contains only those of the states",
        is_packed=True,
    ),
)

#: All kernels by name, in the order of the model structure.
KERNELS: dict[str, KernelSpec] = {row.name: row for row in _ROWS}
