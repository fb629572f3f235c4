"""Inductors that K statements couple: those that share flux become one edge."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any, TypeVar

from cotree.components.windings import WINDINGS, coupling_field
from cotree.errors import brief, nearest
from cotree.readers.subcircuit_scope import Coupled

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.readers.spice_lines import Line
    from cotree.readers.subcircuit_scope import Instance

_Key = TypeVar("_Key")


def find_couplings(place: Instance, lines: list[Line]) -> None:
    """Find the inductors that are coupled, before they are written.

    Raises
    ------
    SceneError
        If one is not there, two are coupled twice, or too many share flux.
    """
    inductors = {line.key: line for line in lines if line.key[0] == "l"}
    for line in lines:
        if line.key[0] == "k":
            _couple(place, line, inductors)


def _couple(place: Instance, line: Line, inductors: Mapping[str, Line]) -> None:
    """Couple the inductors of a K statement, each with each."""
    names = [word.lower() for word in line.words[1:-1]]
    if len(names) < 2 or "=" in line.words:
        raise line.at.error(f"{line.name} needs two inductors or more, and a number")
    for name in names:
        if name not in inductors:
            raise line.at.error(
                f"{line.name} couples '{brief(name)}', which is no inductor here"
                f"{nearest(name, inductors)}"
            )
    # Merge the groups of both inductors: coupling is transitive through shared flux.
    whole = Coupled()
    for name in names:
        old = place.coupled.get(name, Coupled({name: inductors[name]}))
        whole.inductors |= old.inductors
        whole.couplings |= old.couplings
    for pair in combinations(names, 2):
        if pair[0] == pair[1] or frozenset(pair) in whole.couplings:
            raise line.at.error(f"'{brief(pair[0])}' is coupled twice to '{brief(pair[1])}'")
        whole.couplings[frozenset(pair)] = line
    whole.inductors = _in_order(whole.inductors)
    whole.couplings = _in_order(whole.couplings)
    if len(whole.inductors) > len(WINDINGS):
        raise line.at.error(f"more than {len(WINDINGS)} inductors share flux")
    place.coupled.update(dict.fromkeys(whole.inductors, whole))


def _in_order(lines: dict[_Key, Line]) -> dict[_Key, Line]:
    return dict(sorted(lines.items(), key=lambda item: item[1].at.line))


def complete_signs(place: Instance, coupled: Coupled) -> dict[str, float] | None:
    """Give the sign of each winding against the first, if they are coupled without leakage.

    Returns
    -------
    dict of str to float, or None
        None where no coupling is 1 or -1 as a number.

    Raises
    ------
    SceneError
        If only some are, or their signs contradict each other.
    """
    values = {
        pair: (place.scope.value(line.words[-1], line.at), line)
        for pair, line in coupled.couplings.items()
    }
    # Only numbers can be told to be complete; parameters may change.
    complete = {pair: value for pair, (value, _) in values.items() if value in (1.0, -1.0)}
    if not complete:
        return None
    # The first winding defines the direction of the flux; zero marks a coupling that is not
    # complete.
    first, *others = coupled.inductors
    signs = {first: 1.0} | {name: complete.get(frozenset((first, name)), 0.0) for name in others}
    # With one flux the coupling of two windings is the product of their signs against the first.
    for a, b in combinations(coupled.inductors, 2):
        pair = frozenset((a, b))
        if complete.get(pair, 0.0) != signs[a] * signs[b] or not signs[a] * signs[b]:
            line = values[pair][1] if pair in values else next(iter(coupled.couplings.values()))
            raise line.at.error(
                f"windings that are coupled completely have no flux but one, by which '{brief(a)}' "
                f"and '{brief(b)}' are coupled, too: give all of their couplings as 1 or -1, or "
                "all smaller"
            )
    return signs


def coupled_fields(
    place: Instance, coupled: Coupled, windings: Mapping[str, tuple[list[str], Any]]
) -> dict[str, Any]:
    """Give the fields of coupled inductors.

    Parameters
    ----------
    place : Instance
        The circuit that they stand in.
    coupled : Coupled
        The inductors, and the line of each coupling.
    windings : mapping of str to (list of str, value)
        By inductor: its nodes and its inductance, [H].
    """
    fields: dict[str, Any] = {}
    number = {name: i for i, name in enumerate(coupled.inductors, 1)}
    for name, (nodes, inductance) in windings.items():
        i = number[name]
        fields[WINDINGS[i - 1]], fields[f"inductance{i}"] = nodes, inductance
    values: dict[str, Any] = {}
    for pair, line in coupled.couplings.items():
        # A statement may couple several inductors: its number is one parameter for all of their
        # pairs.
        if line.key not in values:
            values[line.key] = place.principal(line, line.words[-1], "1")
        i, j = (number[name] for name in pair)
        fields[coupling_field(i, j)] = values[line.key]
    return fields
