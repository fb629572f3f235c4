"""A plan carried out: the value of every variable, with blocks solved; and its derivatives.

Linear blocks are solved by elimination. Unknowns that an equation is nonlinear in stay: they
become algebraic unknowns, and their equations residuals. A sensitivity graph goes the same way
with differentiated rules; a block has the same matrix there, factorised once.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from cotree.dag.traverse import substitute, symbols_in
from cotree.formulation.networks.blocks import factorise_block
from cotree.formulation.networks.nodal import factorise_nodal
from cotree.formulation.networks.plan import Block
from cotree.formulation.networks.rubbing import is_holding

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable, Mapping

    from cotree.dag.nodes import Dag, Node
    from cotree.formulation.networks.plan import Plan
    from cotree.formulation.networks.rules import Given, Tangent, Variable
    from cotree.formulation.networks.terminals import Terminals
    from cotree.linear.factors import LinearSolver


#: An unknown with its equation.
_Pair = tuple["Variable", "Variable"]

#: From this many unknowns on, blocks of resistances are solved in potentials without counting what
#: the branches would take: their derivatives alone grow with the square of the number.
_MANY = 64

#: From this many nonlinear unknowns on, those that are linear stay beside them where no step of a
#: method pays for it: each equation has a few unknowns then, and a full matrix is never formed.
_MANY_BENT = 24


@dataclass(frozen=True)
class SolvedBlock:
    """A block whose linear unknowns have been solved for.

    Attributes
    ----------
    linear, nonlinear : tuple of (Variable, Variable)
        Unknowns with their equations.
    factors : LinearSolver
        Of the linear equations by the linear unknowns.
    """

    linear: tuple[tuple[Variable, Variable], ...]
    nonlinear: tuple[tuple[Variable, Variable], ...]
    factors: LinearSolver


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
    *,
    is_static: bool = False,
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
    is_static : bool
        Whether there are no states, so that nothing but a start is ever solved for.
    """
    dag = terminals.time.dag
    solved = Solved(dag, plan, {})
    for step in plan.steps:
        if isinstance(step, Block):
            _solve_block(solved, terminals, step, algebraic_symbol, is_safe(step), is_static)
        else:
            solved.values[step] = plan.rules[step].value(dag, solved.values)
    return solved


def _nothing(node: Node, standing: Mapping[Node, Node]) -> Tangent:
    return {}


def _solve_block(
    solved: Solved,
    terminals: Terminals,
    block: Block,
    algebraic_symbol: Callable[[int], Node],
    is_safe: bool,
    is_static: bool,
) -> None:
    """Find which unknowns are linear, and solve for them."""
    dag, rules = solved.dag, solved.plan.rules
    symbols = {v: dag.symbol("block", i) for i, v in enumerate(block.unknowns)}
    # A trial evaluation at symbols of the unknowns shows which equations are linear in which.
    trial = {**solved.values, **symbols}
    for variable in block.inner:
        trial[variable] = rules[variable].value(dag, trial)
    pairs = tuple(zip(block.unknowns, block.residuals, strict=True))
    nodal = None
    may_hold = any(is_holding(terminals.ports, u) for u in block.unknowns)
    may_share = partial(_may_share, may_hold)
    if is_safe and len(pairs) >= _MANY:
        nodal = factorise_nodal(terminals, block, rules, trial)
    matrix: list[dict[int, Node]] = []
    if nodal is None:
        linear, nonlinear, matrix = _linearise(
            solved,
            block,
            symbols,
            trial,
            partial(_stays, terminals),
            may_share,
        )
    else:
        linear = tuple(pair for pair in pairs if pair[0] not in nodal[1])
        nonlinear = tuple(pair for pair in pairs if pair[0] in nodal[1])
    if is_static and len(nonlinear) >= _MANY_BENT:
        linear, nonlinear, matrix, nodal = (), pairs, [], None
    # Nonlinear unknowns become states without a rate, numbered in the order of the blocks.
    kept = {u: algebraic_symbol(len(solved.algebraic) + i) for i, (u, _) in enumerate(nonlinear)}
    solved.algebraic.update(kept)
    known = {symbols[u]: symbol for u, symbol in kept.items()}
    # Residuals at linear unknowns of zero: the right-hand side, with opposite sign.
    rest = substitute(
        [trial[r] for _, r in linear], {**known, **{symbols[u]: dag.zero for u, _ in linear}}
    )
    if nodal is None:
        n_nonzeros = sum(map(len, matrix))
        entries = iter(substitute([e for row in matrix for e in row.values()], known))
        matrix = [{j: next(entries) for j in row} for row in matrix]
        # Potentials as unknowns may be fewer than branch variables: take what costs less.
        if is_safe and linear and not nonlinear:
            nodal = factorise_nodal(terminals, block, rules, trial, n_nonzeros)
    factors = (
        nodal[0]
        if nodal
        else factorise_block(dag, matrix, is_safe, sum(not may_share(u) for u, _ in linear))
    )
    found = factors.solve([-value for value in rest])
    known |= {symbols[u]: value for (u, _), value in zip(linear, found, strict=True)}
    for variable, symbol in symbols.items():
        solved.values[variable] = known[symbol]
    values = substitute([trial[v] for v in block.inner], known)
    solved.values.update(zip(block.inner, values, strict=True))
    for _, residual in linear:
        solved.values[residual] = dag.zero
    solved.blocks[block] = SolvedBlock(linear, nonlinear, factors)


def _may_share(may_hold: bool, variable: Variable) -> bool:
    """Tell whether an unknown may be undetermined: a force, where edges that stick share it."""
    # Two brakes on either side of a gear leave the torque of its teeth open, besides their own.
    return may_hold and variable[0] == "through"


def _stays(terminals: Terminals, variable: Variable) -> bool:
    """Tell whether an unknown stays one: of contents, or the friction on a joint."""
    name = variable[1]
    # Accelerations of a mechanism are eliminated later, at the forces that act on it.
    if name in terminals.couplings and is_holding(terminals.ports, variable):
        return True
    return name in terminals.stores and terminals.stores[name].unknown == variable


def _linearise(
    solved: Solved,
    block: Block,
    symbols: Mapping[Variable, Node],
    trial: Mapping[Variable, Node],
    stays: Callable[[Variable], bool],
    is_shared: Callable[[Variable], bool],
) -> tuple[tuple[_Pair, ...], tuple[_Pair, ...], list[dict[int, Node]]]:
    """Tell linear from nonlinear unknowns; give the matrix of the linear equations by the linear.

    Parameters
    ----------
    symbols : mapping of Variable to Node
        Of the block's unknowns.
    trial : mapping of Variable to Node
        Values at these.
    stays : callable
        Whether an unknown stays even where equations are linear in it: a start that is given what
        follows from a total of contents has to find it among the unknowns.
    is_shared : callable
        Whether an unknown may be undetermined, where others share what it does.
    """
    # What stands outside the block does not change.
    d: defaultdict[Variable, Tangent] = defaultdict(dict)
    d |= {v: {v: solved.dag.one} for v in block.unknowns}
    _differentiate(solved.plan, block.inner, trial, d, _nothing)
    pairs = list(zip(block.unknowns, block.residuals, strict=True))
    # An unknown that occurs in a derivative by the unknowns enters some equation nonlinearly.
    bent = set(symbols_in([node for _, row in pairs for node in d[row].values()]))
    kept = {u for u in block.unknowns if symbols[u] in bent or stays(u)}
    nonlinear = tuple((u, r) for u, r in pairs if u in kept)
    # Forces that edges which stick may share come last: nothing else may be undetermined.
    linear = tuple(
        sorted(((u, r) for u, r in pairs if u not in kept), key=lambda pair: is_shared(pair[0]))
    )
    places: dict[Hashable, int] = {u: i for i, (u, _) in enumerate(linear)}
    matrix: list[dict[int, Node]] = []
    for _, r in linear:
        row = {places[u]: entry for u, entry in d[r].items() if u in places and not entry.is_zero}
        matrix.append(dict(sorted(row.items())))
    return linear, nonlinear, matrix


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
        d[unknown] = dict(given(solved.values[unknown], {}))
    # At first the linear unknowns stand still: this gives the right-hand sides.
    for unknown, _ in own.linear:
        d[unknown] = {}
    _differentiate(solved.plan, block.inner, solved.values, d, given)
    # Nonlinear unknowns only: their tangents are given, and nothing is solved for.
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
    # With the tangents of the unknowns known, those of the inner variables follow again.
    if keys:
        _differentiate(solved.plan, block.inner, solved.values, d, given)
