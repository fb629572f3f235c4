"""Parameters of the equations: those derived from others, and those that sensitivities are to."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from cotree.equations import DerivedParameter
from cotree.errors import ParameterError, nearest
from cotree.scene.expressions import Expression

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.formulation.first_graph import FirstGraph


def derived_parameters(
    first: FirstGraph, units: Mapping[str, str] | None = None
) -> tuple[DerivedParameter, ...]:
    """List the parameters of a scene that are derived from others, with units that are found."""
    units = units or {}
    nodes, names = first.system.parameters, tuple(first.system.tunable)
    return tuple(
        DerivedParameter(
            row.name,
            units.get(row.name, row.unit),
            row.doc,
            row.value.text,
            nodes[row.name],
            names,
        )
        for row in first.scene.parameters.values()
        if isinstance(row.value, Expression)
    )


def check_wanted(first: FirstGraph, wanted: Sequence[str]) -> None:
    """Refuse names that nothing can have a sensitivity to.

    Raises
    ------
    ParameterError
        If one is neither a parameter nor a state, is not tunable, is derived, or occurs twice.
    """
    tunable = list(first.system.tunable)
    states = [state.name for state in first.states]
    derived = {row.name: row for row in derived_parameters(first)}
    for name, times in Counter(wanted).items():
        if times > 1:
            raise ParameterError(f"the sensitivity to '{name}' is asked for twice")
        if name in tunable or name in states:
            continue
        if name in derived:
            raise ParameterError(
                f"{derived[name].told}: take sensitivities to those, which pass through it"
            )
        if name in first.scene.parameters:
            raise ParameterError(
                f"parameter '{name}' is not tunable, so nothing has a sensitivity to it: "
                "declare it tunable"
            )
        raise ParameterError(
            f"'{name}' is neither a parameter nor a state{nearest(name, [*tunable, *states])}"
        )
