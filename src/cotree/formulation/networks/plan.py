"""The order in which the variables of the networks follow from each other, alone or in blocks.

Variables that depend on themselves (resistive meshes, loops of storages) form a strongly connected
component of the dependency graph. Some of its variables are torn: they become unknowns with an
equation each, such that the others follow from them one by one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Kind
from cotree.domains import DOMAINS
from cotree.errors import FormulationError
from cotree.formulation.networks.rules import Unknown

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Mapping, Sequence

    from cotree.formulation.networks.rules import Rule, Variable
    from cotree.formulation.networks.terminals import Terminals


@dataclass(frozen=True)
class Block:
    """Variables that depend on each other, and are solved for together."""

    unknowns: tuple[Variable, ...]  # unknowns, with an equation each
    residuals: tuple[Variable, ...]  # the equations: residuals that must be zero
    inner: tuple[
        Variable, ...
    ]  # variables that follow from the unknowns, in order, the residuals last


@dataclass(frozen=True)
class Plan:
    """Variables and blocks, each after those it needs, and the rules of all variables."""

    steps: tuple[Variable | Block, ...]
    rules: dict[Variable, Rule]


def make_plan(terminals: Terminals, roots: Iterable[Variable]) -> Plan:
    """Order the variables that the roots need.

    Raises FormulationError if an equation does not depend on its unknown.
    """
    rules = _gather(terminals.rule, roots)
    steps: list[Variable | Block] = []
    for part in _parts({variable: rule.needs for variable, rule in rules.items()}):
        (first, *others) = part
        # A component of one variable that does not need itself follows from those before it.
        if not others and first not in rules[first].needs:
            # An unknown outside every loop: its equation does not depend on it.
            if isinstance(rules[first], Unknown):
                raise FormulationError(_undetermined(terminals, first))
            steps.append(first)
        else:
            steps.append(_tear(terminals, rules, part))
    return Plan(tuple(steps), rules)


def _undetermined(terminals: Terminals, variable: Variable) -> str:
    port = terminals.ports[variable[1]]
    row = DOMAINS[port.terminal.domain]
    name = row.across[0] if variable[0].startswith("across") else row.through
    return (
        f"the law of '{port.name}' does not depend on its own {name}, which nothing else "
        "determines: let it depend on that, or remove the edge"
    )


def _gather(
    rule_of: Callable[[Variable], Rule],
    roots: Iterable[Variable],
    known: Container[Variable] = (),
) -> dict[Variable, Rule]:
    """Collect the rules of all variables that the roots need, known ones excepted."""
    rules: dict[Variable, Rule] = {}
    waiting = list(dict.fromkeys(roots))[::-1]
    while waiting:
        variable = waiting.pop()
        if variable not in rules and variable not in known:
            rules[variable] = rule_of(variable)
            waiting += reversed(rules[variable].needs)
    return rules


def _parts(needs: Mapping[Variable, Sequence[Variable]]) -> list[list[Variable]]:
    """List the strongly connected components, each after those that it needs."""
    import networkx

    graph = networkx.DiGraph()
    graph.add_nodes_from(needs)
    graph.add_edges_from((a, b) for a, others in needs.items() for b in others)
    order = {variable: i for i, variable in enumerate(needs)}
    # The search leaves a component after all that it depends on.
    return [
        sorted(part, key=order.__getitem__)
        for part in networkx.strongly_connected_components(graph)
    ]


def _rank(variable: Variable, terminals: Terminals) -> int:
    """Return the tearing priority of a variable: symmetric equations come before couplings."""
    quantity, name = variable
    # Rates of states have the matrix of capacities or inertances, which is symmetric, as is that of
    # resistive branches in terms of conductances.
    if quantity.endswith("_rate") and (quantity.removesuffix("_rate"), name) in terminals.states:
        return 0
    if not terminals.is_branch(name):
        return 2
    return 0 if terminals.ports[name].kind in (Kind.DISSIPATOR, Kind.SPRING) else 1


def _tear(terminals: Terminals, rules: dict[Variable, Rule], part: Sequence[Variable]) -> Block:
    """Make some variables of a component unknowns, so that the others follow one by one."""
    torn = {v: rules[v] for v in part if isinstance(rules[v], Unknown)}
    could = {v: unknown for v in part if v not in torn and (unknown := terminals.torn(v))}
    # Tear variables of one rank after another until the rest follows one by one. No variable has
    # rank -1: at first only variables that are unknowns in any case are torn.
    for rank in (-1, 0, 1, 2):
        torn |= {v: unknown for v, unknown in could.items() if _rank(v, terminals) == rank}
        residuals = [rule.residual for rule in torn.values()]  # type: ignore[attr-defined]
        # Equations of torn variables may need variables that nothing else needed.
        extra = _gather(terminals.rule, residuals, rules)
        inside = {v: rules[v] for v in part if v not in torn} | extra
        needs = {v: [n for n in rule.needs if n in inside] for v, rule in inside.items()}
        pieces = _parts(needs)
        if all(len(piece) == 1 and piece[0] not in needs[piece[0]] for piece in pieces):
            rules |= torn | extra
            return Block(tuple(torn), tuple(residuals), tuple(piece[0] for piece in pieces))
    raise AssertionError(
        "a component without a variable to tear"
    )  # sums alone cannot depend on themselves
