"""One linear map of many columns: the node ``map``.

Sensitivities to many parameters differ in their input values, not in the operations on them. Such
statements are kept once, and C applies them to several columns at a time. The arguments of the
node are the values that all columns share, then the columns one by one; its results are those of
the first column, those of the second, and so on. A value that vanishes in a column because all
inputs that it depends on are zero there is known to do so, and left out.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from cotree.dag.operations import OPERATIONS
from cotree.dag.symbols import COLUMN, PACKED_SENSITIVITY, SENSITIVITY, SHARED
from cotree.dag.traverse import dependent, reachable, substitute

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from cotree.dag.nodes import Dag, Node

#: Operations that values of a column may be made by; divisions by shared values become products.
_LINEAR = frozenset({"add", "sub", "mul", "neg"})
#: Operations that give a finite value wherever their arguments are finite, but for overflow.
_FINITE = _LINEAR | {"abs", "sign", "floor", "sin", "cos", "atan", "tanh", "select"}
#: Columns that C takes at a time on most machines; values that vanish in all are left out.
BLOCK = 4


@dataclass(frozen=True, eq=False)
class LinearMap:
    """Operations that are applied to each column.

    Attributes
    ----------
    results : tuple of Node
        In terms of the symbols ``(SHARED, i)`` and ``(COLUMN, i)``.
    n_shared, n_inputs : int
        Number of values that all columns share, and length of each column.
    given : tuple of int
        Of each column, which inputs may be other than zero: as bits, the first lowest.
    """

    results: tuple[Node, ...]
    n_shared: int
    n_inputs: int
    given: tuple[int, ...]

    @property
    def n_columns(self) -> int:
        """Number of columns."""
        return len(self.given)

    @cached_property
    def order(self) -> list[Node]:
        """Every value of one column, in order of evaluation."""
        return reachable(self.results)

    @cached_property
    def supports(self) -> dict[Node, int]:
        """Columns in which each value may be other than zero: as bits, the first lowest.

        Values that do not depend on a column have none.
        """
        found: dict[Node, int] = {}
        for node in self.order:
            # The union over all arguments is safe: a value may be found to be nonzero too often,
            # never too seldom.
            own = 0
            if node.op == "symbol" and node.data[0] == COLUMN:
                bit = 1 << node.data[1]
                own = sum(1 << j for j, given in enumerate(self.given) if given & bit)
            for arg in node.args:
                own |= found[arg]
            # The shared arguments come first, then one column after another.
            found[node] = own
        return found

    @cached_property
    def counts(self) -> Counter[str]:
        """Operations of all columns, by kind: each where its result may be other than zero."""
        counts: Counter[str] = Counter()
        for node in self.statements:
            counts[node.op] += self.supports[node].bit_count()
        return counts

    @cached_property
    def statements(self) -> list[Node]:
        """Values that are computed for one column."""
        return [node for node in self.order if node.args]

    def blocks(self, node: Node) -> int:
        """Tell in which blocks of columns a value may be other than zero, as bits."""
        support, all_of_one = self.supports[node], (1 << BLOCK) - 1
        places = range(0, self.n_columns, BLOCK)
        return sum(1 << k for k, at in enumerate(places) if support >> at & all_of_one)

    @cached_property
    def n_times(self) -> int:
        """Number of times that statements are run, summed over all blocks."""
        return sum(self.blocks(node).bit_count() for node in self.statements)

    @property
    def n_results(self) -> int:
        """Number of results of all columns together."""
        return len(self.results) * self.n_columns

    def columns(self, args: Sequence[Any]) -> list[Sequence[Any]]:
        """Cut the columns out of the arguments of a node."""
        n, first = self.n_inputs, self.n_shared
        return [args[first + n * j : first + n * (j + 1)] for j in range(self.n_columns)]

    @cached_property
    def inputs(self) -> list[Node]:
        """The symbols that the results are made of: shared values, then those of one column."""
        dag = self.results[0].dag
        shared = [dag.symbol(SHARED, i) for i in range(self.n_shared)]
        return shared + [dag.symbol(COLUMN, i) for i in range(self.n_inputs)]

    def given_to(self, args: Sequence[Any]) -> list[list[Any]]:
        """List what stands for :attr:`inputs` in each column, from the arguments of a node."""
        return [[*args[: self.n_shared], *column] for column in self.columns(args)]

    def n_sensitive(self, args: Sequence[Node]) -> int:
        """Count the leading inputs that form the argument ``s``, one column after another."""
        columns, n = self.columns(args), 0
        # C reads such columns in place, from the argument ``s``; all others are gathered row by
        # row.
        while n < self.n_inputs and _sensitivity(columns[0][n]) == n:
            n += 1
        places = range(self.n_columns * n)
        given = (_sensitivity(value) for column in columns for value in column[:n])
        return n if all(a == b for a, b in zip(places, given, strict=True)) else 0

    def evaluate(self, values: Sequence[Any]) -> list[Any]:
        """Apply the map to numbers, or to arrays of them."""
        found: list[Any] = []
        for given in self.given_to(values):
            known: dict[Node, Any] = dict(zip(self.inputs, given, strict=True))
            for node in self.order:
                if node.op == "constant":
                    known[node] = node.value
                elif node.args:
                    known[node] = OPERATIONS[node.op].array(*(known[arg] for arg in node.args))
            found += [known[root] for root in self.results]
        return found


def _sensitivity(node: Node) -> int:
    """Give the place of a sensitivity in the argument of kernels; -1 for anything else."""
    is_given = node.op == "symbol" and node.data[0] in (SENSITIVITY, PACKED_SENSITIVITY)
    return node.data[1] if is_given else -1


def form_map(
    dag: Dag, results: Sequence[Node], inputs: Sequence[Node], columns: Sequence[Sequence[Node]]
) -> tuple[LinearMap, tuple[Node, ...]] | None:
    """Form a map from results that are linear in some symbols.

    Parameters
    ----------
    dag : Dag
        The arena.
    results : sequence of Node
        Linear and homogeneous in ``inputs``.
    inputs : sequence of Node
        Symbols that stand for the values of one column.
    columns : sequence of sequence of Node
        The columns that it will be applied to, which tell the values that are zero.

    Returns
    -------
    (LinearMap, tuple of Node) or None
        The map and what its columns share. None where something is not made by sums and products:
        a linear system that is solved at run time, or a choice that keeps a value out where it has
        none, as ``where(x > 0, sqrt(x), 0)`` does.
    """
    given = tuple(
        sum(1 << i for i, value in enumerate(column) if not value.is_zero) for column in columns
    )
    # Inputs that are zero in all columns fold away before the statements are formed.
    idle = {
        node: dag.zero for i, node in enumerate(inputs) if not any(bits >> i & 1 for bits in given)
    }
    products = _as_products(dag, substitute(results, idle), inputs)
    if products is None:
        return None
    results = products
    order = reachable(results)
    among = dependent(order, inputs)
    # Values that depend on a column, as opposed to those that all columns share.
    varying = among - set(inputs)
    if not all(_is_linear(node, among) for node in varying):
        return None
    # A result that no input reaches is constant, and no homogeneous linear function.
    if any(root not in varying and root not in inputs and not root.is_zero for root in results):
        return None
    own = {node: dag.symbol(COLUMN, i) for i, node in enumerate(inputs)}
    shared = {
        arg: None
        for node in order
        if node in varying
        for arg in node.args
        # Constants stay in the statements, as numbers in C; other shared values become arguments.
        if arg not in varying and arg not in own and arg.op != "constant"
    }
    own |= {node: dag.symbol(SHARED, i) for i, node in enumerate(shared)}
    body = tuple(substitute(results, own))
    return LinearMap(body, len(shared), len(inputs), given), tuple(shared)


def _is_linear(node: Node, varying: Container[Node]) -> bool:
    """Tell whether a value is linear in those of its arguments that vary."""
    # A product is linear if one factor varies, a sum if all terms do: constants would be affine.
    times = sum(arg in varying for arg in node.args)
    return node.op in _LINEAR and (times == 1 if node.op == "mul" else times == len(node.args))


def _as_products(dag: Dag, results: Sequence[Node], inputs: Sequence[Node]) -> list[Node] | None:
    """Turn divisions by shared values, and choices that these make, into products.

    Solutions of linear systems with shared matrices become sums of those for unit vectors. None
    where a choice is no such product: a weight of zero does not keep out what is infinite or nan.
    """
    varying = set(inputs)
    unsafe: set[Node] = set()
    made: dict[Node, Node] = {}
    inverses: dict[Node, list[tuple[Node, ...]]] = {}
    for node in reachable(results):
        if node.args and (node.op not in _FINITE or any(arg in unsafe for arg in node.args)):
            unsafe.add(node)
        if not any(arg in varying for arg in node.args):
            continue
        varying.add(node)
        args = [made.get(arg, arg) for arg in node.args]
        if node.op == "div" and node.args[1] not in varying:
            # The reciprocal is shared by all columns.
            made[node] = args[0] * (1.0 / args[1])
        elif node.op == "select" and node.args[0] not in varying:
            if any(arg in unsafe for arg in node.args[1:]):
                return None
            # A choice that all columns share is a sum with weights one and zero.
            share = dag.select(args[0], dag.one, dag.zero)
            made[node] = share * args[1] + (1.0 - share) * args[2]
        elif node.op == "result" and _has_shared_matrix(node.args[0], varying):
            (system,) = node.args
            if system not in inverses:
                inverses[system] = _for_unit_vectors(system)
            n = system.data.size
            # x = A^-1 b, from the columns of the inverse, which all columns of the map share.
            rhs = [made.get(arg, arg) for arg in system.args[n * n : n * n + n]]
            columns = [solution[node.data] for solution in inverses[system]]
            # The rank, behind the unknowns, is that of the matrix alone.
            made[node] = columns[0] if node.data >= n else _product(dag, columns, rhs)
        else:
            made[node] = dag.rebuild(node, tuple(args))
    return [made.get(root, root) for root in results]


def _has_shared_matrix(node: Node, varying: Container[Node]) -> bool:
    """Tell whether it is a linear system of which only the right-hand side varies."""
    if node.op != "solve":
        return False
    n = node.data.size
    return not any(arg in varying for arg in (*node.args[: n * n], *node.args[n * n + n :]))


def _for_unit_vectors(system: Node) -> list[tuple[Node, ...]]:
    """Solve a linear system for each unit vector in place of its right-hand side."""
    dag, n = system.dag, system.data.size
    found = []
    for j in range(n):
        unit = [dag.one if i == j else dag.zero for i in range(n)]
        given = (*system.args[: n * n], *unit, *system.args[n * n + n :])
        found.append(dag.several("solve", given, system.data, n + 2))
    return found


def _product(dag: Dag, row: Sequence[Node], column: Sequence[Node]) -> Node:
    return sum((a * b for a, b in zip(row, column, strict=True)), dag.zero)


def apply_map(
    dag: Dag, linear: LinearMap, shared: Sequence[Node], columns: Sequence[Sequence[Node]]
) -> list[tuple[Node, ...]]:
    """Apply a map to columns.

    Parameters
    ----------
    dag : Dag
        The arena.
    linear : LinearMap
        The map.
    shared : sequence of Node
        Arguments that all columns have in common.
    columns : sequence of sequence of Node
        Arguments of each column.

    Returns
    -------
    list of tuple of Node
        The results of each column.
    """
    args = [*shared, *(value for column in columns for value in column)]
    flat = dag.several("map", args, linear, linear.n_results)
    n = len(linear.results)
    return [flat[n * j : n * (j + 1)] for j in range(linear.n_columns)]
