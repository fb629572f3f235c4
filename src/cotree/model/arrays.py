"""Arrays checked on input, sparsity patterns, and C objects owned by Python."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.arguments import by_name, doubles
from cotree.errors import ParameterError, nearest
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from scipy.sparse import csc_matrix, csr_matrix

    from cotree.equations import DerivedParameter
    from cotree.program.layout import Layout
    from cotree.quantities import Quantity

Array = npt.NDArray[np.float64]

# Largest number of entries whose sum in Python takes less time than a test of each entry in NumPy.
_FEW = 50


def are_finite(values: Array) -> bool:
    """Return whether no entry of a one-dimensional array is nan or infinite."""
    # The sum of finite entries may overflow, so each entry is tested if it is not finite.
    if len(values) <= _FEW and math.isfinite(sum(values.tolist())):
        return True
    return bool(np.isfinite(values).all())


def as_array(value: Any, shape: Sequence[int], what: str) -> Array:
    """Return a contiguous copy as doubles; raise ParameterError if the shape is wrong."""
    array = doubles(value)  # this copies, because callers may change their array
    if array is None:
        raise ParameterError(f"{what} must be an array of numbers of shape {tuple(shape)}")
    if array.shape != tuple(shape):
        raise ParameterError(
            f"{what} must be an array of shape {tuple(shape)}, not of shape {array.shape}"
        )
    return array


def as_parameters(
    values: Any,
    places: Mapping[str, int],
    defaults: Array,
    derived: Sequence[DerivedParameter] = (),
) -> Array:
    """Return all parameters from values by name or an array; raise ParameterError if invalid."""
    values = by_name(values)
    if not isinstance(values, Mapping):
        return as_array(values, (len(places),), "the parameters")
    p = defaults.copy()
    for name, value in values.items():
        if name not in places:
            followers = [row for row in derived if row.name == name]
            if followers:
                raise ParameterError(f"{followers[0].dependence}: set these instead")
            raise ParameterError(
                f"the model has no tunable parameter '{name}'{nearest(name, places)}"
            )
        p[places[name]] = check_number(value, f"parameter '{name}'")
    return p


def in_order(values: Any, names: Sequence[str], kind: str) -> Any:
    """Return labelled values as a list in the order of ``names``; return other values unchanged."""
    # A pandas table has one row per name and one column per point.
    if hasattr(values, "to_dict") and np.ndim(values) == 2:
        labels = list(values.index)
        if not all(isinstance(name, str) for name in labels):
            return values
        found = dict(zip(labels, values.to_numpy(), strict=True))
    else:
        found = by_name(values)
    if not isinstance(found, Mapping):
        return values
    for name in found:
        if name not in names:
            raise ParameterError(f"the model has no {kind} '{name}'{nearest(name, names)}")
    for name in names:
        if name not in found:
            raise ParameterError(f"{kind} '{name}' has no value: give all {len(names)} of them")
    return [found[name] for name in names]


def one_point(values: Any, names: Sequence[str], kind: str) -> Array:
    """Return the states or inputs of one point, given by name or in order, as an array."""
    return as_array(in_order(values, names, kind), (len(names),), f"the {kind}s")


def derived_values(derived: Sequence[DerivedParameter], p: Array) -> dict[str, float]:
    """Return the values of derived parameters, by name."""
    if not derived:
        return {}
    from cotree.dag.evaluate import evaluate
    from cotree.dag.nodes import PARAMETER

    dag = derived[0].node.dag
    symbols = {dag.symbol(PARAMETER, i): value for i, value in enumerate(p.tolist())}
    with np.errstate(all="ignore"):
        found = evaluate([row.node for row in derived], symbols)
    return {row.name: float(value) for row, value in zip(derived, found, strict=True)}


def is_many(y: Any) -> bool:
    """Return whether the states form a matrix, with one column per point."""
    try:
        return np.ndim(y) == 2
    except ValueError:  # raised if rows have different lengths
        return False


def pointer_to(ffi: Any, array: Array) -> Any:
    """Return a pointer that keeps the array alive, or NULL if the array is empty."""
    # A pointer from array.data would dangle, because its memory view may be garbage collected.
    return ffi.from_buffer("double[]", array) if array.size else ffi.NULL


class CObjects:
    """C objects that live as long as this object; ``errors`` collects exceptions of callbacks."""

    def __init__(self, ffi: Any, *kept: Any) -> None:
        self._ffi, self._kept = ffi, list(kept)
        self.errors: list[BaseException] = []

    def new(self, *what: Any) -> Any:
        """Return a new C object from ``ffi.new``."""
        self._kept.append(self._ffi.new(*what))
        return self._kept[-1]

    def ints(self, values: Sequence[int]) -> Any:
        """Return a new C array of integers; it contains one zero if the sequence is empty."""
        return self.new("int[]", list(values) or [0])

    def quantities(self, rows: Sequence[Quantity]) -> Any:
        """Return a C array of ``cotree_quantity``."""
        found = self.new("cotree_quantity[]", max(1, len(rows)))
        for row, own in zip(rows, found, strict=False):
            own.name, own.unit = (
                self.new("char[]", text.encode()) for text in (row.name, row.unit)
            )
        return found

    def tables(self, replaced: Mapping[int, tuple[Any, Any]]) -> Any:
        """Return a C array of ``cotree_table_input`` for times and values by index of the input."""
        tables = self.new("cotree_table_input[]", max(1, len(replaced)))
        for row, (place, (times, values)) in zip(tables, replaced.items(), strict=False):
            row.input, row.length = place, len(times)
            own = (np.asarray(array, dtype=float) for array in (times, values))
            row.t, row.u = map(self.pointer, own)
        return tables

    def pointer(self, array: npt.NDArray[Any], kind: str = "double") -> Any:
        """Return a pointer to an array; C must not dereference it if the array is empty."""
        array = np.ascontiguousarray(array) if array.size else np.zeros(1, dtype=array.dtype)
        self._kept.append(self._ffi.from_buffer(f"{kind}[]", array))
        return self._kept[-1]

    def callback(self, kind: str, function: Callable[..., int]) -> Any:
        """Return a C callback that calls a Python function; it stores exceptions and returns -1."""

        def remember(kind: Any, error: BaseException, traceback: Any) -> None:
            self.errors.append(error)

        self._kept.append(self._ffi.callback(kind, function, error=-1, onerror=remember))
        return self._kept[-1]


class Structure:
    """Sparsity patterns of a model's derivatives.

    Parameters
    ----------
    layout : Layout
        The layout of the model.
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
        """Return the Jacobian as a CSC matrix from its nonzero values."""
        from scipy.sparse import csc_matrix

        n = len(self.layout.states)
        return csc_matrix((values, self._rows, self.layout.column_starts), shape=(n, n))

    def by_rows(self, values: npt.NDArray[np.float64]) -> csr_matrix:
        """Return the Jacobian as a CSR matrix from its nonzero values."""
        return self.sparse(values).tocsr()

    def full(self, values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the Jacobian as a full array from its nonzero values."""
        n = len(self.layout.states)
        dense = np.zeros((n, n))
        dense[self._rows, self._columns] = values
        return dense

    @property
    def jacobian_places(self) -> npt.NDArray[np.intp]:
        """Indices of the nonzero values in the flattened full Jacobian."""
        return self._rows * len(self.layout.states) + self._columns

    @cached_property
    def jacobian_colouring(self) -> npt.NDArray[np.intp]:
        """Colours of the Jacobian's columns, numbered from 0, shape (n_states,).

        Columns of one colour have no nonzero in a common row. One finite difference, or one product
        of the Jacobian with the sum of their unit vectors, therefore yields all their entries. The
        colouring is greedy in smallest-last order and may use more colours than necessary.

        References
        ----------
        A. R. Curtis, M. J. D. Powell, J. K. Reid, On the estimation of sparse Jacobian matrices,
        IMA Journal of Applied Mathematics 13 (1974); D. W. Matula, L. L. Beck, Smallest-last
        ordering, Journal of the ACM 30 (1983).

        Examples
        --------
        >>> from cotree import load
        >>> load("battery-cell").compile().kernels.structure.jacobian_colouring.tolist()
        [0, 0, 0]
        """
        import networkx

        n = len(self.layout.states)
        by_row: list[list[int]] = [[] for _ in range(n)]
        for row, column in zip(self._rows.tolist(), self._columns.tolist(), strict=True):
            by_row[row].append(column)
        # If a row is full, every column needs its own colour, and the graph would be complete.
        if n in map(len, by_row):
            return np.arange(n)
        graph = networkx.Graph()
        graph.add_nodes_from(range(n))
        for columns in by_row:
            graph.add_edges_from(itertools.combinations(columns, 2))
        colours = networkx.greedy_color(graph, "smallest_last")
        return np.array([colours[column] for column in range(n)], dtype=np.intp)

    @property
    def sensitivity_pattern(self) -> npt.NDArray[np.bool_]:
        """Mask of the sensitivities that may be nonzero, shape (n_states, n_sensitivities).

        A sensitivity marked False is identically zero, because the state does not depend on the
        parameter. It is neither computed nor integrated. The columns are in the order of
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
        # In z, all sensitivities to one parameter are consecutive.
        return pattern.reshape(m, n).T.copy()

    @cached_property
    def _rows(self) -> npt.NDArray[np.intp]:
        return np.array(self.layout.row_indices, dtype=np.intp)

    @cached_property
    def _columns(self) -> npt.NDArray[np.intp]:
        starts = self.layout.column_starts
        counts = [end - start for start, end in itertools.pairwise(starts)]
        return np.repeat(np.arange(len(counts)), counts)
