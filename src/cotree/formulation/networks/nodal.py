"""Blocks of resistances in the potentials of nodes, where these couple fewer equations.

Unknown branches cut their tree into parts; the across variable of each is the difference of the
potentials of two parts. With these potentials as unknowns, and the balance of each part in the
place of the f-cutset equations, a chord couples the two parts that it joins, where in terms of
branches it couples all those along its f-circuit.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING

from cotree.components import Kind
from cotree.dag.traverse import symbols_in
from cotree.formulation.networks.rules import Lawful
from cotree.linear.factors import factorise_definite

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.formulation.networks.plan import Block
    from cotree.formulation.networks.rules import Rule, Variable
    from cotree.formulation.networks.terminals import Terminals
    from cotree.linear.factors import LinearSolver


@dataclass(frozen=True)
class _Nodal:
    """Equations of branches, solved in the potentials of parts.

    Attributes
    ----------
    factors : LinearSolver
        Of the balances of the parts by their potentials.
    above : tuple of (int, int)
        For each branch its sign, and which other one leads to it; -1 for none.
    """

    dag: Dag
    factors: LinearSolver
    above: tuple[tuple[int, int], ...]

    def solve(self, rhs: Sequence[Node]) -> list[Node]:
        """Solve for one right-hand side."""
        if all(value.is_zero for value in rhs):
            return list(rhs)
        # A right-hand side of a branch enters the balance of the part beyond and of that before.
        balances = [self.dag.zero] * len(rhs)
        for i, (value, (sign, parent)) in enumerate(zip(rhs, self.above, strict=True)):
            out = value if sign > 0 else -value
            balances[i] = balances[i] + out
            if parent >= 0:
                balances[parent] = balances[parent] - out
        potentials = self.factors.solve(balances)
        found = []
        for potential, (sign, parent) in zip(potentials, self.above, strict=True):
            # Back from potentials of parts to across variables of the branches between them.
            across = potential - potentials[parent] if parent >= 0 else potential
            found.append(across if sign > 0 else -across)
        return found


def factorise_nodal(
    terminals: Terminals,
    block: Block,
    rules: Mapping[Variable, Rule],
    values: Mapping[Variable, Node],
    n_nonzeros: float = inf,
) -> tuple[LinearSolver, frozenset[Variable]] | None:
    """Factorise the linear equations of a block in the potentials of its parts.

    Parameters
    ----------
    terminals : Terminals
        Knows the trees.
    block : Block
        The block.
    rules, values : mapping
        Of all variables.
    n_nonzeros : float
        How many entries the equations of the branches have.

    Returns
    -------
    (LinearSolver, frozenset of Variable) or None
        With the unknowns that are nonlinear: they count as known. None where the block holds
        anything but one-port resistances of which the unknowns are branches, all chords being
        linear, or where potentials couple no fewer equations.
    """
    conductances = _conductances(terminals, block, rules, values)
    if conductances is None:
        return None
    linear = [unknown for unknown in block.unknowns if unknown in conductances]
    names = [name for _, name in linear]
    # Cut at the unknown branches, the tree falls apart; within a part potentials differ by known
    # amounts. The part of the reference has the number -1 and potential zero.
    parts = terminals.parts(names) if linear else {}
    rows: list[dict[int, Node]] = [{} for _ in linear]
    for (_, name), conductance in conductances.items():
        port = terminals.ports[name]
        ends = parts.get(port.head, -1), parts.get(port.tail, -1)
        # Both ends in one part: its across variable is known.
        if ends[0] == ends[1]:
            continue
        signs = [(i, sign) for i, sign in zip(ends, (1, -1), strict=True) if i >= 0]
        for i, a in signs:
            for j, b in signs:
                # The Laplacian of the parts, weighted by conductances.
                rows[i][j] = rows[i].get(j, conductance.dag.zero) + conductance * float(a * b)
    # Potentials pay only if their equations have fewer entries.
    if not linear or sum(map(len, rows)) >= n_nonzeros:
        return None
    dag = conductances[linear[0]].dag
    solver = _Nodal(dag, factorise_definite(dag, rows), tuple(terminals.above(names)))
    return solver, frozenset(block.unknowns) - conductances.keys()


def _conductances(
    terminals: Terminals,
    block: Block,
    rules: Mapping[Variable, Rule],
    values: Mapping[Variable, Node],
) -> dict[Variable, Node] | None:
    """List the conductances of a block's resistances, but of nonlinear branches."""
    unknowns = set(block.unknowns)
    symbols = {values[unknown] for unknown in unknowns}
    found: dict[Variable, Node] = {}
    for quantity, name in (*block.unknowns, *block.inner):
        # Sums and equations carry no conductance of their own.
        if quantity in ("path", "flow", "residual_across"):
            continue
        port = terminals.ports[name] if quantity in ("across", "through") else None
        if port is None or port.kind is not Kind.DISSIPATOR or port.terminal.port != "":
            return None
        if quantity == "through":
            continue
        is_unknown = (quantity, name) in unknowns
        # Potentials determine across variables of branches; any other unknown has no place among
        # them.
        if is_unknown != terminals.is_branch(name):
            return None
        law = ("residual_across" if is_unknown else "through", name)
        conductance = _conductance(rules[law], values)
        if conductance is None:
            return None
        # Linear where the slope does not depend on the unknowns. A branch that is not stays
        # unknown; a chord that is not would couple parts nonlinearly, and rules out potentials.
        if symbols.isdisjoint(symbols_in([conductance])):
            found[quantity, name] = conductance
        elif not is_unknown:
            return None
    return found


def _conductance(rule: Rule, values: Mapping[Variable, Node]) -> Node | None:
    """Give the derivative of a one-port's law by its across variable."""
    if not isinstance(rule, Lawful):
        return None
    known = {name: values[variable] for name, variable in rule.arguments}
    dag = next(iter(known.values())).dag
    return rule.law.partial_value(dag, known, "across")
