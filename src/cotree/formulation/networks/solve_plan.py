"""Plans: the order in which variables are computed, blocks of equations, and derivatives.

Variables that depend on each other (resistive meshes, loops of storages) form a strongly connected
component of the dependency graph. Tearing turns some of them into unknowns with one equation each,
so that all other variables can be computed in sequence.

Branches with unknown across variables divide their tree into parts; each of these variables is the
difference between the potentials of two parts. With these potentials as unknowns, and the balances
of the parts as equations, a chord couples only the two parts that it connects, instead of all
branches along its f-circuit.

Linear blocks are solved by elimination. Unknowns that occur nonlinearly become algebraic unknowns,
and their equations become residuals. Sensitivity graphs have the same block matrices, which are
therefore factorised only once.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from functools import partial
from math import inf
from typing import TYPE_CHECKING

from cotree.components import Kind
from cotree.dag.multi_output import SolveShape, solve
from cotree.dag.nodes import Dag, Node, substitute, symbols_in
from cotree.domains import DOMAINS
from cotree.errors import FormulationError
from cotree.formulation.networks.rules import Given, Lawful, Rule, Tangent, Unknown, Variable
from cotree.formulation.networks.unilateral_forces import is_holding
from cotree.linear.factors import LinearSolver, factorise_definite
from cotree.tolerances import TINY

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Hashable, Iterable, Mapping, Sequence

    from cotree.formulation.networks.terminals import Terminals


@dataclass(frozen=True)
class CoupledBlock:
    """Variables that depend on each other and are solved for together."""

    unknowns: tuple[Variable, ...]  # unknowns of the block, each with one equation
    residuals: tuple[Variable, ...]  # residuals of these equations, which must be zero
    inner: tuple[Variable, ...]  # variables computed from the unknowns; residuals are last


@dataclass(frozen=True)
class SolvePlan:
    """Variables and blocks in the order of computation, and the rules of all variables."""

    steps: tuple[Variable | CoupledBlock, ...]
    rules: dict[Variable, Rule]


def make_plan(terminals: Terminals, roots: Iterable[Variable]) -> SolvePlan:
    """Return the order in which ``roots``, and the variables they need, are computed."""
    rules = _gather(terminals.rule, roots)
    steps: list[Variable | CoupledBlock] = []
    for part in _parts({variable: rule.needs for variable, rule in rules.items()}):
        (first, *others) = part
        # A single variable that does not depend on itself is computed from earlier variables.
        if not others and first not in rules[first].needs:
            # An unknown outside all loops: its equation does not depend on it.
            if isinstance(rules[first], Unknown):
                raise FormulationError(_undetermined(terminals, first))
            steps.append(first)
        else:
            steps.append(_tear(terminals, rules, part))
    return SolvePlan(tuple(steps), rules)


def _undetermined(terminals: Terminals, variable: Variable) -> str:
    port = terminals.ports[variable[1]]
    row = DOMAINS[port.terminal.domain]
    name = row.across[0] if variable[0].startswith("across") else row.through
    return (
        f"the law of '{port.name}' does not depend on its own {name}, which nothing else "
        "determines: make the law depend on it, or remove the edge"
    )


def _gather(
    rule_of: Callable[[Variable], Rule], roots: Iterable[Variable], known: Container[Variable] = ()
) -> dict[Variable, Rule]:
    """Return the rules of all variables that the roots need, except variables in ``known``."""
    rules: dict[Variable, Rule] = {}
    waiting = list(dict.fromkeys(roots))[::-1]
    while waiting:
        variable = waiting.pop()
        if variable not in rules and variable not in known:
            rules[variable] = rule_of(variable)
            waiting += reversed(rules[variable].needs)
    return rules


def _parts(needs: Mapping[Variable, Sequence[Variable]]) -> list[list[Variable]]:
    """Return the strongly connected components, each after the components on which it depends."""
    import networkx

    graph = networkx.DiGraph()
    graph.add_nodes_from(needs)
    graph.add_edges_from((a, b) for a, others in needs.items() for b in others)
    order = {variable: i for i, variable in enumerate(needs)}
    # The search completes a component after all components on which it depends.
    return [
        sorted(part, key=order.__getitem__)
        for part in networkx.strongly_connected_components(graph)
    ]


def _rank(variable: Variable, terminals: Terminals) -> int:
    """Return the priority of a variable for tearing: symmetric equations precede couplings."""
    quantity, name = variable
    # The equations for rates of states have the symmetric matrix of capacities or inertances. The
    # conductance matrix of resistive branches is also symmetric.
    if quantity.endswith("_rate") and (quantity.removesuffix("_rate"), name) in terminals.states:
        return 0
    if not terminals.is_branch(name):
        return 2
    return 0 if terminals.ports[name].kind in (Kind.DISSIPATOR, Kind.SPRING) else 1


def _tear(
    terminals: Terminals, rules: dict[Variable, Rule], part: Sequence[Variable]
) -> CoupledBlock:
    """Turn variables of a component into unknowns, so that all others can be computed in order."""
    torn = {v: rules[v] for v in part if isinstance(rules[v], Unknown)}
    could = {v: unknown for v in part if v not in torn and (unknown := terminals.torn(v))}
    # Tear rank by rank until the others can be computed in order. Rank -1 is always torn.
    for rank in (-1, 0, 1, 2):
        torn |= {v: unknown for v, unknown in could.items() if _rank(v, terminals) == rank}
        residuals = [rule.residual for rule in torn.values()]  # type: ignore[attr-defined]
        # The equations of torn variables may need further variables.
        extra = _gather(terminals.rule, residuals, rules)
        inside = {v: rules[v] for v in part if v not in torn} | extra
        needs = {v: [n for n in rule.needs if n in inside] for v, rule in inside.items()}
        pieces = _parts(needs)
        if all(len(piece) == 1 and piece[0] not in needs[piece[0]] for piece in pieces):
            rules |= torn | extra
            return CoupledBlock(tuple(torn), tuple(residuals), tuple(piece[0] for piece in pieces))
    # A cycle always contains a variable that is no sum.
    raise AssertionError("a component without a variable to tear")


@dataclass(frozen=True)
class _Nodal:
    """Branch equations that are solved for the potentials of parts of the tree."""

    dag: Dag
    factors: LinearSolver  # solver of the balances of the parts for their potentials
    #: For each branch: its sign, and the index of the branch that leads to it, or -1.
    above: tuple[tuple[int, int], ...]

    def solve(self, rhs: Sequence[Node]) -> list[Node]:
        if all(value.is_zero for value in rhs):
            return list(rhs)
        # The right-hand side of a branch enters the balances of the parts at both ends.
        balances = [self.dag.zero] * len(rhs)
        for i, (value, (sign, parent)) in enumerate(zip(rhs, self.above, strict=True)):
            out = value if sign > 0 else -value
            balances[i] = balances[i] + out
            if parent >= 0:
                balances[parent] = balances[parent] - out
        potentials = self.factors.solve(balances)
        found = []
        for potential, (sign, parent) in zip(potentials, self.above, strict=True):
            # The across variable of a branch is a difference between potentials of two parts.
            across = potential - potentials[parent] if parent >= 0 else potential
            found.append(across if sign > 0 else -across)
        return found


def factorise_nodal(
    terminals: Terminals,
    block: CoupledBlock,
    rules: Mapping[Variable, Rule],
    values: Mapping[Variable, Node],
    n_nonzeros: float = inf,
) -> tuple[LinearSolver, frozenset[Variable]] | None:
    """Factorise the linear equations of a block in the potentials of parts of the tree.

    Return the solver, and the nonlinear unknowns, which the solver treats as known. Return None
    unless the block consists of one-port resistances, the unknowns are branches, the chords are
    linear, and the equations of the potentials have fewer entries than ``n_nonzeros``.
    """
    conductances = _conductances(terminals, block, rules, values)
    if conductances is None:
        return None
    linear = [unknown for unknown in block.unknowns if unknown in conductances]
    names = [name for _, name in linear]
    # Unknown branches divide the tree into parts. Within a part, potentials differ by known
    # amounts. The part of the reference has the index -1 and the potential zero.
    parts = terminals.topology(names[0]).parts(names) if linear else {}
    rows: list[dict[int, Node]] = [{} for _ in linear]
    for (_, name), conductance in conductances.items():
        port = terminals.ports[name]
        ends = parts.get(port.head, -1), parts.get(port.tail, -1)
        # The across variable is known if both ends are in one part.
        if ends[0] == ends[1]:
            continue
        signs = [(i, sign) for i, sign in zip(ends, (1, -1), strict=True) if i >= 0]
        for i, a in signs:
            for j, b in signs:
                # Laplacian matrix of the parts, with the conductances as weights.
                rows[i][j] = rows[i].get(j, conductance.dag.zero) + conductance * float(a * b)
    # Use potentials only if their equations have fewer entries.
    if not linear or sum(map(len, rows)) >= n_nonzeros:
        return None
    dag = conductances[linear[0]].dag
    above = terminals.topology(names[0]).above(names)
    solver = _Nodal(dag, factorise_definite(dag, rows), tuple(above))
    return solver, frozenset(block.unknowns) - conductances.keys()


def _conductances(
    terminals: Terminals,
    block: CoupledBlock,
    rules: Mapping[Variable, Rule],
    values: Mapping[Variable, Node],
) -> dict[Variable, Node] | None:
    """Return the conductances of a block's linear resistances; None if potentials are no option."""
    unknowns = set(block.unknowns)
    symbols = {values[unknown] for unknown in unknowns}
    found: dict[Variable, Node] = {}
    for quantity, name in (*block.unknowns, *block.inner):
        # Sums and residuals have no conductance.
        if quantity in ("path", "flow", "residual_across"):
            continue
        port = terminals.ports[name] if quantity in ("across", "through") else None
        if port is None or port.kind is not Kind.DISSIPATOR or port.terminal.port != "":
            return None
        if quantity == "through":
            continue
        is_unknown = (quantity, name) in unknowns
        # Potentials determine only across variables of branches: other unknowns are not allowed.
        if is_unknown != terminals.is_branch(name):
            return None
        law = ("residual_across" if is_unknown else "through", name)
        conductance = _conductance(rules[law], values)
        if conductance is None:
            return None
        # A law is linear if its slope does not depend on the unknowns. A nonlinear branch remains
        # an unknown. A nonlinear chord couples parts nonlinearly, so potentials are not used.
        if symbols.isdisjoint(symbols_in([conductance])):
            found[quantity, name] = conductance
        elif not is_unknown:
            return None
    return found


def _conductance(rule: Rule, values: Mapping[Variable, Node]) -> Node | None:
    """Return the derivative of a one-port's law with respect to its across variable."""
    if not isinstance(rule, Lawful):
        return None
    known = {name: values[variable] for name, variable in rule.arguments}
    dag = next(iter(known.values())).dag
    return rule.law.partial_value(dag, known, "across")


@dataclass(frozen=True)
class _AtRunTime:
    """Equations with scaled rows and columns; their pivots are chosen at run time."""

    dag: Dag
    matrix: tuple[tuple[Node, ...], ...]
    row_scales: tuple[Node, ...]
    column_scales: tuple[Node, ...]
    n_determined: int

    def solve(self, rhs: Sequence[Node]) -> list[Node]:
        """Solve, even if the right-hand side is zero: the solution includes a check of the rank."""
        n = len(rhs)
        scaled = [value * scale for value, scale in zip(rhs, self.row_scales, strict=True)]
        found = solve(
            self.dag, self.matrix, scaled, self.dag.zero, SolveShape(n, self.n_determined)
        )
        return [value * s for value, s in zip(found, self.column_scales, strict=False)]


def _at_run_time(dag: Dag, matrix: Sequence[Sequence[Node]], n_determined: int) -> _AtRunTime:
    """Divide rows, then columns, by the sums of their magnitudes, to make pivots comparable."""
    n = range(len(matrix))
    # Rows have different units: without scaling, pivots and rank would depend on units.
    rows = tuple(1.0 / _size(dag, row) for row in matrix)
    scaled = [[matrix[i][j] * rows[i] for j in n] for i in n]
    columns = tuple(1.0 / _size(dag, [scaled[i][j] for i in n]) for j in n)
    return _AtRunTime(
        dag,
        tuple(tuple(scaled[i][j] * columns[j] for j in n) for i in n),
        rows,
        columns,
        n_determined,
    )


def _size(dag: Dag, entries: Sequence[Node]) -> Node:
    # TINY keeps a row of zeros at zero instead of nan, so that the rank is reduced.
    total = dag.constant(TINY)
    for entry in entries:
        total = total + dag.function("abs", entry)
    return total


def factorise_block(
    dag: Dag, matrix: Sequence[Mapping[int, Node]], is_safe: bool, n_determined: int
) -> LinearSolver:
    """Factorise the equations of a block, given as rows of nonzero entries.

    ``is_safe`` means that the matrix, if it is symmetric, is positive definite in every state. The
    first ``n_determined`` unknowns must have a unique solution.
    """
    # For a symmetric positive definite matrix, any order of pivots is stable.
    if is_safe and _is_symmetric(matrix):
        return factorise_definite(dag, matrix)
    n = range(len(matrix))
    return _at_run_time(dag, [[row.get(j, dag.zero) for j in n] for row in matrix], n_determined)


def _is_symmetric(matrix: Sequence[Mapping[int, Node]]) -> bool:
    """Return whether a matrix is symmetric; it is not if both branches and chords are torn."""
    return all(
        matrix[j].get(i) is entry for i, row in enumerate(matrix) for j, entry in row.items()
    )


#: An unknown, and the residual of the equation that determines it.
_Pair = tuple["Variable", "Variable"]

#: Resistance blocks with at least this number of unknowns use potentials in any case: derivatives
#: in branch variables, needed to count entries, would cost the square of this number.
_MANY = 64

#: With at least this number of nonlinear unknowns, a static network keeps all unknowns: each
#: equation then has few unknowns, and no full matrix is formed.
_MANY_BENT = 24


@dataclass(frozen=True)
class SolvedBlock:
    """A block after the elimination of its linear unknowns."""

    #: Linear unknowns and their equations; nonlinear unknowns and their equations.
    linear: tuple[tuple[Variable, Variable], ...]
    nonlinear: tuple[tuple[Variable, Variable], ...]
    factors: LinearSolver  # factors of the linear equations


@dataclass(frozen=True)
class Solved:
    """The values of all variables in a network."""

    dag: Dag  # arena of the nodes
    plan: SolvePlan  # order in which variables are computed
    values: dict[Variable, Node]  # values of the variables computed so far
    blocks: dict[CoupledBlock, SolvedBlock] = field(default_factory=dict)
    #: Algebraic unknowns, which are not eliminated, with their symbols.
    algebraic: dict[Variable, Node] = field(default_factory=dict)

    @property
    def residuals(self) -> list[Variable]:
        """The residuals of the equations for the algebraic unknowns."""
        return [r for block in self.blocks.values() for _, r in block.nonlinear]


def solve_plan(
    terminals: Terminals,
    plan: SolvePlan,
    algebraic_symbol: Callable[[int], Node],
    is_safe: Callable[[CoupledBlock], bool],
    *,
    is_static: bool = False,
) -> Solved:
    """Compute the values of all variables in a plan.

    ``is_safe`` returns whether physics makes a block's linear equations symmetric and positive
    definite. ``is_static`` means that there are no states, and that only a start is computed.
    """
    dag = terminals.time.dag
    solved = Solved(dag, plan, {})
    for step in plan.steps:
        if isinstance(step, CoupledBlock):
            _solve_block(solved, terminals, step, algebraic_symbol, is_safe(step), is_static)
        else:
            solved.values[step] = plan.rules[step].value(dag, solved.values)
    return solved


def _solve_block(
    solved: Solved,
    terminals: Terminals,
    block: CoupledBlock,
    algebraic_symbol: Callable[[int], Node],
    is_safe: bool,
    is_static: bool,
) -> None:
    """Separate the linear unknowns of a block, and solve for them."""
    dag, rules = solved.dag, solved.plan.rules
    symbols = {v: dag.symbol("block", i) for i, v in enumerate(block.unknowns)}
    # Evaluate the block with symbolic unknowns: derivatives then show which unknowns are linear.
    trial = {**solved.values, **symbols}
    for variable in block.inner:
        trial[variable] = rules[variable].value(dag, trial)
    pairs = tuple(zip(block.unknowns, block.residuals, strict=True))
    nodal = None
    may_hold = any(is_holding(terminals.ports, u) for u in block.unknowns)

    def may_share(variable: Variable) -> bool:
        # Torques are indeterminate if, for example, brakes on both sides of a gear stick.
        return may_hold and variable[0] == "through"

    if is_safe and len(pairs) >= _MANY:
        nodal = factorise_nodal(terminals, block, rules, trial)
    matrix: list[dict[int, Node]] = []
    if nodal is None:
        linear, nonlinear, matrix = _linearise(
            solved, block, symbols, trial, partial(_stays, terminals), may_share
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
    # The residuals at zero linear unknowns are the negative right-hand side.
    rest = substitute(
        [trial[r] for _, r in linear], {**known, **{symbols[u]: dag.zero for u, _ in linear}}
    )
    if nodal is None:
        n_nonzeros = sum(map(len, matrix))
        entries = iter(substitute([e for row in matrix for e in row.values()], known))
        matrix = [{j: next(entries) for j in row} for row in matrix]
        # Potentials are used if they have fewer nonzero entries than the branch variables.
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


def _stays(terminals: Terminals, variable: Variable) -> bool:
    """Return whether an unknown is not eliminated: of contents, fields, or friction on a joint."""
    quantity, name = variable
    # Fields of friction depend on accelerations of the mechanism, which are eliminated later.
    if quantity == "field":
        return True
    if name in terminals.couplings and is_holding(terminals.ports, variable):
        return True
    return name in terminals.stores and terminals.stores[name].unknown == variable


def _linearise(
    solved: Solved,
    block: CoupledBlock,
    symbols: Mapping[Variable, Node],
    trial: Mapping[Variable, Node],
    stays: Callable[[Variable], bool],
    is_shared: Callable[[Variable], bool],
) -> tuple[tuple[_Pair, ...], tuple[_Pair, ...], list[dict[int, Node]]]:
    """Separate linear from nonlinear unknowns, and return the matrix of the linear ones.

    An unknown that ``stays`` counts as nonlinear even if the equations are linear in it. An unknown
    that ``is_shared`` may be indeterminate.
    """
    # Variables outside the block count as constant.
    d: defaultdict[Variable, Tangent] = defaultdict(dict)
    d |= {v: {v: solved.dag.one} for v in block.unknowns}
    _differentiate(solved.plan, block.inner, trial, d, lambda node, replacements: {})
    pairs = list(zip(block.unknowns, block.residuals, strict=True))
    # The equations are nonlinear in unknowns that occur in the derivatives.
    bent = set(symbols_in([node for _, row in pairs for node in d[row].values()]))
    kept = {u for u in block.unknowns if symbols[u] in bent or stays(u)}
    nonlinear = tuple((u, r) for u, r in pairs if u in kept)
    # Forces that sticking edges may share come last, since only these may be indeterminate.
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
    plan: SolvePlan,
    variables: Iterable[Variable],
    values: Mapping[Variable, Node],
    d: dict[Variable, Tangent],
    given: Given,
) -> None:
    for variable in variables:
        d[variable] = plan.rules[variable].tangent(values, d, given)


def differentiate_plan(solved: Solved, given: Given) -> dict[Variable, Tangent]:
    """Differentiate a plan along several directions at once; zero derivatives are omitted."""
    d: dict[Variable, Tangent] = {}
    for step in solved.plan.steps:
        if isinstance(step, CoupledBlock):
            _differentiate_block(solved, step, d, given)
        else:
            d[step] = solved.plan.rules[step].tangent(solved.values, d, given)
    return d


def _differentiate_block(
    solved: Solved, block: CoupledBlock, d: dict[Variable, Tangent], given: Given
) -> None:
    """Solve for the derivatives of a block's unknowns with its factorised matrix."""
    own = solved.blocks[block]
    for unknown, _ in own.nonlinear:
        d[unknown] = dict(given(solved.values[unknown], {}))
    # With zero derivatives of the linear unknowns, residuals are the negative right-hand sides.
    for unknown, _ in own.linear:
        d[unknown] = {}
    _differentiate(solved.plan, block.inner, solved.values, d, given)
    # If all unknowns are nonlinear, their tangents are known; nothing is left to solve.
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
    # Recompute the tangents of inner variables from those of the unknowns.
    if keys:
        _differentiate(solved.plan, block.inner, solved.values, d, given)
