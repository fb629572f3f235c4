"""The order in which the variables of the networks follow from each other, alone or in blocks.

What depends on itself (resistive meshes, storages in loops of their like) is a strongly connected
part of the graph of dependencies. Some of its variables are torn: they become unknowns with an
equation of their own, such that the others follow from them one by one.
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

    unknowns: tuple[Variable, ...]  # those with an equation each
    residuals: tuple[Variable, ...]  # the equations: what must be zero
    inner: tuple[Variable, ...]  # what follows from the unknowns, in order, the residuals last


@dataclass(frozen=True)
class Plan:
    """Variables and blocks, each after what it needs, and the rules of all variables."""

    steps: tuple[Variable | Block, ...]
    rules: dict[Variable, Rule]


def make_plan(terminals: Terminals, roots: Iterable[Variable]) -> Plan:
    """Order the variables that the roots need.

    Raises FormulationError if an equation does not depend on the unknown that it should give.
    """
    rules = _gather(terminals.rule, roots)
    steps: list[Variable | Block] = []
    for part in _parts({variable: rule.needs for variable, rule in rules.items()}):
        (first, *others) = part
        # A part of one variable that does not need itself follows from those before it.
        if not others and first not in rules[first].needs:
            # An unknown outside every loop: its equation does not lead back to it.
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
        f"the law of '{port.name}' does not depend on its own {name}, which nothing else gives: "
        "let it depend on that, or take the edge out"
    )


def _gather(
    rule_of: Callable[[Variable], Rule],
    roots: Iterable[Variable],
    known: Container[Variable] = (),
) -> dict[Variable, Rule]:
    """Find the rules of all variables that the roots need, but for those that are known."""
    rules: dict[Variable, Rule] = {}
    waiting = list(dict.fromkeys(roots))[::-1]
    while waiting:
        variable = waiting.pop()
        if variable not in rules and variable not in known:
            rules[variable] = rule_of(variable)
            waiting += reversed(rules[variable].needs)
    return rules


def _parts(needs: Mapping[Variable, Sequence[Variable]]) -> list[list[Variable]]:
    """List the strongly connected parts, each after those that it needs."""
    import networkx

    graph = networkx.DiGraph()
    graph.add_nodes_from(needs)
    graph.add_edges_from((a, b) for a, others in needs.items() for b in others)
    order = {variable: i for i, variable in enumerate(needs)}
    # The search leaves a part when all that it leads to has been left.
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
    """Make unknowns of some variables of a part, so that the others follow one by one."""
    torn = {v: rules[v] for v in part if isinstance(rules[v], Unknown)}
    could = {v: unknown for v in part if v not in torn and (unknown := terminals.torn(v))}
    # Tear variables of one rank after another until the rest follows one by one.
    # Rank -1 is of none: at first only what is an unknown in any case is torn.
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
    raise AssertionError("a part without a variable to tear")  # sums alone cannot need themselves
