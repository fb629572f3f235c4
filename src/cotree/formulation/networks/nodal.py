"""Blocks of resistances in the potentials of nodes, where these couple fewer equations.

Unknown branches cut their tree into parts; the across variable of each is the difference of the
potentials of two parts. With these potentials as unknowns, and the balance of each part in the
place of the f-cutset equations, a chord couples the two parts that it joins, where in terms of
branches it couples all those along its f-circuit.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Kind
from cotree.formulation.elimination import factorise
from cotree.formulation.networks.rules import Lawful

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.formulation.networks.blocks import Solver
    from cotree.formulation.networks.plan import Block
    from cotree.formulation.networks.rules import Rule, Tangent, Variable
    from cotree.formulation.networks.terminals import Terminals

#: A conductance with the parts that it joins, and their signs.
_Link = tuple["Node", dict[int, int]]


@dataclass(frozen=True)
class _Nodal:
    """Equations of branches, solved in the potentials of parts.

    Attributes
    ----------
    factors : Solver
        Of the balances of the parts by their potentials.
    above : tuple of (int, int)
        For each branch its sign, and which other one leads to it; -1 for none.
    """

    dag: Dag
    factors: Solver
    above: tuple[tuple[int, int], ...]

    def solve(self, rhs: Sequence[Node]) -> list[Node]:
        """Solve for one right-hand side."""
        if all(value.is_zero for value in rhs):
            return list(rhs)
        balances = [self.dag.zero] * len(rhs)
        for i, (value, (sign, parent)) in enumerate(zip(rhs, self.above, strict=True)):
            out = value if sign > 0 else -value
            balances[i] = balances[i] + out
            if parent >= 0:
                balances[parent] = balances[parent] - out
        potentials = self.factors.solve(balances)
        found = []
        for potential, (sign, parent) in zip(potentials, self.above, strict=True):
            across = potential - potentials[parent] if parent >= 0 else potential
            found.append(across if sign > 0 else -across)
        return found


def factorise_nodal(
    terminals: Terminals,
    block: Block,
    rules: Mapping[Variable, Rule],
    values: Mapping[Variable, Node],
    d: Mapping[Variable, Tangent],
    n_nonzeros: int,
) -> Solver | None:
    """Factorise a block in the potentials of its parts.

    Parameters
    ----------
    terminals : Terminals
        Knows the trees.
    block : Block
        The block.
    rules, values, d : mapping
        Of all variables; the derivatives are along the block's unknowns.
    n_nonzeros : int
        How many entries the equations of the branches have.

    Returns
    -------
    Solver or None
        None where the block holds anything but one-port resistances of which the unknowns are
        branches, or where potentials couple no fewer equations.
    """
    links = _links(terminals, block, rules, values, d)
    if links is None:
        return None
    above = terminals.above([name for _, name in block.unknowns])
    dag = links[0][0].dag
    rows: list[dict[int, Node]] = [{} for _ in above]
    for conductance, along in links:
        ends: defaultdict[int, int] = defaultdict(int)
        for i, sign in along.items():
            own, parent = above[i]
            ends[i] += sign * own
            if parent >= 0:
                ends[parent] -= sign * own
        for i, a in ends.items():
            for j, b in ends.items():
                if a * b:
                    rows[i][j] = rows[i].get(j, dag.zero) + conductance * float(a * b)
    if sum(map(len, rows)) >= n_nonzeros:
        return None
    n = range(len(rows))
    matrix = tuple(tuple(rows[i].get(j, dag.zero) for j in n) for i in n)
    return _Nodal(dag, factorise(dag, matrix, [True] * len(rows)), tuple(above))


def _links(
    terminals: Terminals,
    block: Block,
    rules: Mapping[Variable, Rule],
    values: Mapping[Variable, Node],
    d: Mapping[Variable, Tangent],
) -> list[_Link] | None:
    """List the conductances, with the unknown branches that make up their across variable."""
    numbers = {unknown: i for i, unknown in enumerate(block.unknowns)}
    links: list[_Link] = []
    for quantity, name in (*block.unknowns, *block.inner):
        if quantity in ("path", "flow", "residual_across"):
            continue
        is_resistance = (
            quantity in ("across", "through")
            and terminals.ports[name].kind is Kind.DISSIPATOR
            and terminals.ports[name].terminal.port == ""
        )
        if not is_resistance:
            return None
        if quantity == "through":
            continue
        is_unknown = (quantity, name) in numbers
        if is_unknown != terminals.is_branch(name):
            return None
        law = ("residual_across" if is_unknown else "through", name)
        conductance = _conductance(rules[law], values)
        if conductance is None:
            return None
        along = {numbers[u]: node.value for u, node in d[quantity, name].items()}  # type: ignore[index]
        if not all(value in (1.0, -1.0) for value in along.values()):
            return None
        links.append((conductance, {i: int(value) for i, value in along.items() if value}))
    return links


def _conductance(rule: Rule, values: Mapping[Variable, Node]) -> Node | None:
    """Give the derivative of a one-port's law by its across variable."""
    if not isinstance(rule, Lawful):
        return None
    known = {name: values[variable] for name, variable in rule.arguments}
    dag = next(iter(known.values())).dag
    return rule.law.partial_value(dag, known, "across")
