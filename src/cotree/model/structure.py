"""Patterns of a model: entries of its Jacobian, colours of its columns, reach of its parameters.

In: the patterns that a program's layout holds. Out: the same for users and for their solvers.
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
        """Pattern as a SciPy CSC matrix of True, ordered like the one of ``jacobian_sparse``."""
        return self.sparse(np.ones(len(self._rows), dtype=np.bool_))

    def sparse(self, values: npt.NDArray[Any]) -> csc_matrix:
        """Put values where the Jacobian may be nonzero."""
        from scipy.sparse import csc_matrix

        n = len(self.layout.states)
        return csc_matrix((values, self._rows, self.layout.column_starts), shape=(n, n))

    def by_rows(self, values: npt.NDArray[np.float64]) -> csr_matrix:
        """Put values where the Jacobian may be nonzero, compressed by rows."""
        return self.sparse(values).tocsr()

    def full(self, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Put values where the Jacobian may be nonzero, and zeros elsewhere.

        Further axes of the values are further axes of what is given.
        """
        n = len(self.layout.states)
        dense = np.zeros((n, n, *values.shape[1:]))
        dense[self._rows, self._columns] = values
        return dense

    @cached_property
    def jacobian_colouring(self) -> npt.NDArray[np.intp]:
        """Colours of the Jacobian's columns, from 0, shape (n_states,).

        Columns of one colour have no entry in the same row, so that the product of the Jacobian
        with the sum of their unit vectors holds all their entries: as many products, or
        differences of right-hand sides, as there are colours give the whole. The colours are
        greedy, those with the fewest neighbours last: not always the fewest there can be.

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
        # A full row joins every pair of columns, and the graph would hold them all.
        if n in map(len, by_row):
            return np.arange(n)  # one row has them all
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
        # Places go parameter by parameter, as sensitivities do in z.
        return pattern.reshape(m, n).T.copy()

    @cached_property
    def _rows(self) -> npt.NDArray[np.intp]:
        return np.array(self.layout.row_indices, dtype=np.intp)

    @cached_property
    def _columns(self) -> npt.NDArray[np.intp]:
        starts = self.layout.column_starts
        counts = [end - start for start, end in itertools.pairwise(starts)]
        return np.repeat(np.arange(len(counts)), counts)
