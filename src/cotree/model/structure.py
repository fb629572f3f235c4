"""Patterns of a model's derivatives: Jacobian, colouring of its columns, sensitivities.

In: the patterns of a program's layout. Out: the same as arrays, for users and solvers.
"""

from __future__ import annotations

import itertools
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt
    from scipy.sparse import csc_matrix, csr_matrix

    from cotree.program.layout import Layout


class Structure:
    """The structure of a model's derivatives, known before they are evaluated.

    Parameters
    ----------
    layout : Layout
        The model's.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout

    @property
    def jacobian_pattern(self) -> npt.NDArray[np.bool_]:
        """Mask of the entries of the Jacobian that may be nonzero, shape (n_states, n_states)."""
        return np.asarray(self.jacobian_sparsity.toarray(), dtype=np.bool_)

    @property
    def jacobian_sparsity(self) -> csc_matrix:
        """Pattern of the Jacobian: a SciPy CSC matrix of True, ordered like ``jacobian_sparse``."""
        return self.sparse(np.ones(len(self._rows), dtype=np.bool_))

    def sparse(self, values: npt.NDArray[Any]) -> csc_matrix:
        """Return a CSC matrix of the values of the Jacobian's entries."""
        from scipy.sparse import csc_matrix

        n = len(self.layout.states)
        return csc_matrix((values, self._rows, self.layout.column_starts), shape=(n, n))

    def by_rows(self, values: npt.NDArray[np.float64]) -> csr_matrix:
        """Return a CSR matrix of the values of the Jacobian's entries."""
        return self.sparse(values).tocsr()

    def full(self, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the full Jacobian of the values of its entries.

        Further axes of the values are further axes of the result.
        """
        n = len(self.layout.states)
        dense = np.zeros((n, n, *values.shape[1:]))
        dense[self._rows, self._columns] = values
        return dense

    @cached_property
    def jacobian_colouring(self) -> npt.NDArray[np.intp]:
        """Colours of the Jacobian's columns, from 0, shape (n_states,).

        Columns of one colour have no entry in the same row. One product of the Jacobian with the
        sum of their unit vectors, or one difference of right-hand sides, hence yields all their
        entries. The colouring is greedy, vertices of smallest degree last; it need not be minimal.

        References
        ----------
        A. R. Curtis, M. J. D. Powell, J. K. Reid, On the estimation of sparse Jacobian matrices,
        IMA Journal of Applied Mathematics 13 (1974); D. W. Matula, L. L. Beck, Smallest-last
        ordering, Journal of the ACM 30 (1983).

        Examples
        --------
        >>> from cotree import load
        >>> load("battery-cell").compile().structure.jacobian_colouring.tolist()
        [0, 1, 2]
        """
        import networkx

        n = len(self.layout.states)
        by_row: list[list[int]] = [[] for _ in range(n)]
        for row, column in zip(self._rows.tolist(), self._columns.tolist(), strict=True):
            by_row[row].append(column)
        # A full row connects every pair of columns, and the graph would store all pairs.
        if n in map(len, by_row):
            return np.arange(n)  # one row has entries in all columns
        graph = networkx.Graph()
        graph.add_nodes_from(range(n))
        for columns in by_row:
            # Columns with an entry in the same row must not share a colour.
            graph.add_edges_from(itertools.combinations(columns, 2))
        colours = networkx.greedy_color(graph, "smallest_last")
        return np.array([colours[column] for column in range(n)], dtype=np.intp)

    @property
    def sensitivity_pattern(self) -> npt.NDArray[np.bool_]:
        """Mask of the sensitivities that may be nonzero, shape (n_states, n_sensitivities).

        A sensitivity marked False is zero at all times: no path leads from the parameter to the
        state. It is neither computed nor integrated. The columns are in the order of
        ``sensitivities``.

        Examples
        --------
        >>> from cotree import load
        >>> model = load("battery-cell").compile(["R0", "R1", "Q"])
        >>> model.states
        ('cell.pair1.v', 'cell.pair2.v', 'cell.soc')
        >>> model.kernels.structure.sensitivity_pattern.tolist()
        [[False, True, False], [False, False, False], [False, False, True]]
        """
        n, m = len(self.layout.states), len(self.layout.sensitivities)
        pattern = np.zeros(m * n, dtype=np.bool_)
        pattern[list(self.layout.sensitivity_places)] = True
        # Sensitivities in z are ordered by parameter.
        return pattern.reshape(m, n).T.copy()

    @cached_property
    def _rows(self) -> npt.NDArray[np.intp]:
        return np.array(self.layout.row_indices, dtype=np.intp)

    @cached_property
    def _columns(self) -> npt.NDArray[np.intp]:
        starts = self.layout.column_starts
        counts = [end - start for start, end in itertools.pairwise(starts)]
        return np.repeat(np.arange(len(counts)), counts)
