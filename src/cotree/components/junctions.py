"""Junctions of semiconductors as SymPy expressions: currents, charges, and their capacities.

Capacities are the derivatives of charges, C = dQ/dv, so that the current into a junction is the
rate of its charge.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cotree.components.component import optional

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.components.component import Field


def symbol(name: str) -> Any:
    """Make the symbol that stands for an argument of a law."""
    import sympy

    return sympy.Symbol(name, real=True)


def junction_current(voltage: Any, saturation_current: Any, thermal_voltage: Any) -> Any:
    """Form the current of a junction: I (exp(v / V) - 1).

    Parameters
    ----------
    voltage : sympy.Expr
        v across the junction, [V].
    saturation_current, thermal_voltage : sympy.Expr
        I, [A], and V, [V].

    References
    ----------
    W. Shockley, Bell Syst. Tech. J. 28 (1949) 435.
    """
    import sympy

    # Reverse currents saturate at -I; the thermal voltage is k T / e times the ideality factor.
    return saturation_current * (sympy.exp(voltage / thermal_voltage) - 1)


def depletion_capacity(voltage: Any, prefix: str, share: Any = None) -> Any:
    """Give C (1 - v/V)^-m, and beyond the share F of V the tangent to it.

    The base of the power is held above 1 - F, so that neither it nor its derivatives are ever
    undefined.

    Parameters
    ----------
    voltage : sympy expression
        Of the junction.
    prefix : str
        Of the fields; see :func:`depletion_fields`.
    share : sympy expression, optional
        F; the field ``forward_share`` where absent.
    """
    import sympy

    names = ("capacitance", "potential", "grading")
    capacitance, potential, grading = (symbol(f"{prefix}_{name}") for name in names)
    share = symbol("forward_share") if share is None else share
    # ``over`` is what v/V exceeds F by: it holds the base at 1 - F and drives the tangent.
    over = sympy.Max(0, voltage / potential - share)
    base = 1 - voltage / potential + over
    # Value and slope are continuous where the tangent begins.
    return capacitance * base ** (-grading) * (1 + grading * over / (1 - share))


def depletion_fields(prefix: str, potential: float, grading: float) -> tuple[Field, ...]:
    """Make the fields of a depletion capacitance, except the start of its linear continuation.

    Parameters
    ----------
    prefix : str
        How the names of the fields begin.
    potential, grading : float
        Default of the built-in potential, [V], and of the grading coefficient.
    """
    return (
        optional(f"{prefix}_capacitance", "F", "of its charge at no voltage", 0.0, "nonnegative"),
        optional(f"{prefix}_potential", "V", "built in", potential, "positive"),
        optional(f"{prefix}_grading", "1", "exponent of the doping", grading, "nonnegative"),
    )


FORWARD_SHARE = optional(
    "forward_share", "1", "of the potential built in, where the capacitance goes on straight", 0.5
)


def split_extras(
    fields: tuple[Field, ...], given: Mapping[str, Any]
) -> tuple[frozenset[str], dict[str, Any]]:
    """Find which of some fields add a term to a law.

    Parameters
    ----------
    fields : tuple of Field
        Fields whose term is left out where they are zero or not given.
    given : mapping of str to object
        The fields that a scene gives.

    Returns
    -------
    has : frozenset of str
        Names of the fields that add a term.
    rest : dict
        The given fields, without those that add nothing.
    """
    names = {row.name for row in fields}
    has = frozenset(name for name in names if not is_absent(given.get(name)))
    # Fields that add nothing are dropped, for the adapted component has no use of them.
    return has, {
        key: item
        for key, item in given.items()
        if item is not None and (key in has or key not in names)
    }


def is_absent(value: Any) -> bool:
    """Say whether a field is not given, or zero as a number."""
    return value is None or (isinstance(value, (int, float)) and value == 0)
