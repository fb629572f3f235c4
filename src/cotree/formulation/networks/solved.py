"""A plan carried out: the value of every variable, with blocks solved; and its derivatives.

Linear blocks are solved by elimination. Unknowns that an equation is nonlinear in stay: they
become algebraic unknowns, and their equations residuals. A sensitivity graph goes the same way
with differentiated rules; a block has the same matrix there, factorised once.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cotree.dag.traverse import substitute, symbols_in
from cotree.formulation.networks.blocks import Solver, factorise_block
from cotree.formulation.networks.nodal import factorise_nodal
from cotree.formulation.networks.plan import Block

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable, Mapping

    from cotree.dag.nodes import Dag, Node
    from cotree.formulation.networks.plan import Plan
    from cotree.formulation.networks.rules import Given, Tangent, Variable
    from cotree.formulation.networks.terminals import Terminals


@dataclass(frozen=True)
class SolvedBlock:
    """A block whose linear unknowns have been solved for.

    Attributes
    ----------
    linear, nonlinear : tuple of (Variable, Variable)
        Unknowns with their equations.
    factors : Solver
        Of the linear equations by the linear unknowns.
    """

    linear: tuple[tuple[Variable, Variable], ...]
    nonlinear: tuple[tuple[Variable, Variable], ...]
    factors: Solver


@dataclass(frozen=True)
class Solved:
    """The values of a network's variables.

    Attributes
    ----------
    dag : Dag
        The arena.
    plan : Plan
        How they follow from each other.
    values : dict of Variable to Node
        Their values.
    blocks : dict of Block to SolvedBlock
        The blocks.
    algebraic : dict of Variable to Node
        The unknowns that stay, with their symbols.
    """

    dag: Dag
    plan: Plan
    values: dict[Variable, Node]
    blocks: dict[Block, SolvedBlock] = field(default_factory=dict)
    algebraic: dict[Variable, Node] = field(default_factory=dict)

    @property
    def residuals(self) -> list[Variable]:
        """The equations of the algebraic unknowns."""
        return [r for block in self.blocks.values() for _, r in block.nonlinear]


def solve_plan(
    terminals: Terminals,
    plan: Plan,
    algebraic_symbol: Callable[[int], Node],
    is_safe: Callable[[Block], bool],
) -> Solved:
    """Form the value of every variable.

    Parameters
    ----------
    terminals : Terminals
        Where the plan is from.
    plan : Plan
        Variables in order.
    algebraic_symbol : callable
        Gives the symbol of an algebraic unknown by its number.
    is_safe : callable
        Whether a block's linear equations are symmetric and positive definite by physics.
    """
    dag = terminals.time.dag
    solved = Solved(dag, plan, {})
    for step in plan.steps:
        if isinstance(step, Block):
            _solve_block(solved, terminals, step, algebraic_symbol, is_safe(step))
        else:
            solved.values[step] = plan.rules[step].value(dag, solved.values)
    return solved


def _nothing(node: Node) -> Tangent:
    return {}


def _solve_block(
    solved: Solved,
    terminals: Terminals,
    block: Block,
    algebraic_symbol: Callable[[int], Node],
    is_safe: bool,
) -> None:
    """Find which unknowns are linear, and solve for them."""
    dag, rules = solved.dag, solved.plan.rules
    symbols = {v: dag.symbol("block", i) for i, v in enumerate(block.unknowns)}
    trial = {**solved.values, **symbols}
    for variable in block.inner:
        trial[variable] = rules[variable].value(dag, trial)
    # What stands outside the block does not change.
    d: defaultdict[Variable, Tangent] = defaultdict(dict)
    d |= {v: {v: dag.one} for v in block.unknowns}
    _differentiate(solved.plan, block.inner, trial, d, _nothing)
    pairs = list(zip(block.unknowns, block.residuals, strict=True))
    bent = {s for _, row in pairs for s in symbols_in(list(d[row].values()))}
    nonlinear = tuple((u, r) for u, r in pairs if symbols[u] in bent)
    linear = tuple((u, r) for u, r in pairs if symbols[u] not in bent)
    kept = {u: algebraic_symbol(len(solved.algebraic) + i) for i, (u, _) in enumerate(nonlinear)}
    solved.algebraic.update(kept)
    known = {symbols[u]: symbol for u, symbol in kept.items()}
    rest = substitute(
        [trial[r] for _, r in linear], {**known, **{symbols[u]: dag.zero for u, _ in linear}}
    )
    rows = [
        {i: e for i, e in enumerate(d[r].get(u, dag.zero) for u, _ in linear) if not e.is_zero}
        for _, r in linear
    ]
    flat = [(i, j, e) for i, row in enumerate(rows) for j, e in row.items()]
    entries = substitute([e for _, _, e in flat], known)
    matrix: list[dict[int, Node]] = [{} for _ in rows]
    for (i, j, _), entry in zip(flat, entries, strict=True):
        matrix[i][j] = entry
    factors = None
    if is_safe and linear and not nonlinear:
        factors = factorise_nodal(terminals, block, rules, trial, d, len(flat))
    factors = factors or factorise_block(dag, matrix, is_safe)
    found = factors.solve([-value for value in rest])
    known |= {symbols[u]: value for (u, _), value in zip(linear, found, strict=True)}
    for variable, symbol in symbols.items():
        solved.values[variable] = known[symbol]
    values = substitute([trial[v] for v in block.inner], known)
    solved.values.update(zip(block.inner, values, strict=True))
    for _, residual in linear:
        solved.values[residual] = dag.zero
    solved.blocks[block] = SolvedBlock(linear, nonlinear, factors)


def _differentiate(
    plan: Plan,
    variables: Iterable[Variable],
    values: Mapping[Variable, Node],
    d: dict[Variable, Tangent],
    given: Given,
) -> None:
    for variable in variables:
        d[variable] = plan.rules[variable].tangent(values, d, given)


def differentiate_plan(solved: Solved, given: Given) -> dict[Variable, Tangent]:
    """Run the plan over the sensitivity graphs of several directions at once.

    Parameters
    ----------
    solved : Solved
        The first graph's variables.
    given : Given
        Derivatives of states, parameters, inputs and fields.

    Returns
    -------
    dict of Variable to Tangent
        Derivatives of every variable; those along directions that it does not depend on are
        absent.
    """
    d: dict[Variable, Tangent] = {}
    for step in solved.plan.steps:
        if isinstance(step, Block):
            _differentiate_block(solved, step, d, given)
        else:
            d[step] = solved.plan.rules[step].tangent(solved.values, d, given)
    return d


def _differentiate_block(
    solved: Solved, block: Block, d: dict[Variable, Tangent], given: Given
) -> None:
    """Solve for the derivatives of a block's unknowns, with the matrix that is factorised."""
    own = solved.blocks[block]
    for unknown, _ in own.nonlinear:
        d[unknown] = dict(given(solved.values[unknown]))
    for unknown, _ in own.linear:
        d[unknown] = {}
    _differentiate(solved.plan, block.inner, solved.values, d, given)
    if not own.linear:
        return
    zero = solved.dag.zero
    keys: dict[Hashable, None] = {}
    for _, residual in own.linear:
        keys |= dict.fromkeys(d[residual])
    for key in keys:
        found = own.factors.solve([-d[residual].get(key, zero) for _, residual in own.linear])
        for (unknown, _), value in zip(own.linear, found, strict=True):
            if not value.is_zero:
                d[unknown][key] = value
    if keys:
        _differentiate(solved.plan, block.inner, solved.values, d, given)
