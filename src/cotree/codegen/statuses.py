"""Status numbers of C jobs, and their descriptions for messages."""

from __future__ import annotations

#: Descriptions of the values of ``cotree_status`` in order, without capital and full stop. In C,
#: the names begin with ``COTREE_``.
SENTENCES = {
    "OK": "success",
    "BAD_ARGUMENT": "a size, time, tolerance or initial value is out of range",
    "TOO_MANY_STEPS": "too many steps are needed",
    "STEP_TOO_SMALL": "the step size fell to rounding level",
    "RATE_FAILED": "the right-hand side fails",
    "RATE_NOT_FINITE": "the right-hand side is not finite",
    "RATE_STOPPED": "the right-hand side stopped the integration",
    "PROJECTION_FAILED": (
        "the projection onto the constraints fails, or moves a step by many tolerances"
    ),
    "NO_MEMORY": "SUNDIALS could not allocate memory",
    "NOT_FINITE": "the solution is no longer finite",
    "NOT_SOLVED": "the algebraic unknowns cannot be solved for",
    "NOT_PROJECTED": "the constraints cannot be satisfied",
    "CANNOT_START": "the integrator cannot start",
    "TOO_TIGHT": "the tolerances are too tight for double precision",
    "ERROR_TEST_FAILED": "the error test failed repeatedly, or at the minimum step size",
    "NOT_CONVERGED": "Newton's method failed repeatedly, or at the minimum step size",
    "SENSITIVITIES_FAILED": "the rates of the sensitivities cannot be evaluated",
    "FLAGGED": "the integrator returned an unknown flag",
    "FOLD": "the algebraic unknowns would jump to another solution",
}

#: Values of ``cotree_status`` by name.
NUMBERS = {name: number for number, name in enumerate(SENTENCES)}

#: Names of the failures in ``cotree_events_status``; see :mod:`cotree.solvers.messages`.
EVENT_FAILURES = {
    20: "EVENTS_FAILED",
    21: "EVENTS_NOT_FINITE",
    22: "EVENTS_SET_NOT_FINITE",
    23: "EVENTS_CONTRADICT",
    24: "EVENTS_UNDERDETERMINED",
    25: "EVENTS_REST_AT_ZERO",
    26: "EVENTS_GRAZING",
    27: "EVENTS_ACCUMULATE",
    28: "EVENTS_CHATTER",
    29: "EVENTS_CASCADE",
    40: "EVENTS_SLIDING",
    41: "EVENTS_LEAVES_JUMP",
    42: "EVENTS_NOT_COMMUTING",
    43: "EVENTS_NO_MODES",
    51: "EVENTS_INDETERMINATE",
    44: "EVENTS_LOCKED_DIRECTION",
    45: "EVENTS_NEGATIVE_GAP",
    46: "EVENTS_NO_IMPULSES",
    47: "EVENTS_COUPLED_IMPACTS",
    49: "EVENTS_ENERGY_GAIN",
    50: "EVENTS_NOT_UNIQUE",
    52: "EVENTS_LOSSY_IMPACT",
    53: "EVENTS_LEAVES_ROOT",
    48: "EVENTS_BELOW_TOLERANCE",
}

#: Status if a sensitivity is undefined after a breakpoint; ``turned`` of the job is its index.
TURNED = 60
