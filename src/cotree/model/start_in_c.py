"""Starts that C finds, by ``templates/runtime/start/cotree_start.c``.

In: a model at the start, and initial values of a run. Out: a ``Start``; or None where C does not
find one, or not all that there may be to say about it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.codegen.start_tables import start_declarations, start_files, start_tables
from cotree.model.consistent import Start
from cotree.model.kernels import build_engine, shared_code
from cotree.sharing import locked_cache

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.build import LoadedLibrary
    from cotree.equations import Quantity
    from cotree.model.arrays import Array
    from cotree.model.model import CompiledModel, Moment
    from cotree.program import Layout

#: Of more algebraic unknowns than these, sparse factorisations, which C has none of, cost less.
_MOST_UNKNOWNS = 200


@locked_cache
def load_start() -> LoadedLibrary | None:
    """Build and load the start, once; None without a compiler."""
    return build_engine(shared_code(start_files, start_declarations))


class StartInC:
    """Starts of one model.

    Parameters
    ----------
    model : CompiledModel
        The model, whose kernels are C.
    library : LoadedLibrary
        Of :func:`load_start`.

    Attributes
    ----------
    tables : cdata
        The model's ``cotree_start_tables``.
    address, function : int
        Addresses of these and of ``cotree_start_once``.
    """

    def __init__(self, model: CompiledModel, library: LoadedLibrary) -> None:
        self._ffi, self._lib = library.ffi, library.lib
        self._kept: list[Any] = [library]
        self.tables = filled_tables(library.ffi, model.layout, self._kept)
        for content, _ in model.layout.followers:
            # At an operating point contents follow from voltages.
            self.tables.given[content] &= not model.begins_at_rest
        self.address = int(self._ffi.cast("uintptr_t", self.tables))
        self.function = int(self._ffi.cast("uintptr_t", self._function(library)))

    def _function(self, library: LoadedLibrary) -> Any:
        kind = "int (*)(cotree_start_call *)"
        return library.ffi.cast(kind, library.ffi.addressof(library.lib, "cotree_start_once"))

    def find(
        self, at: Moment, initial: Mapping[str, float], given: Array | None = None
    ) -> Start | None:
        """Find the start of a run; None where Python has to, see :func:`find_start`.

        Parameters
        ----------
        at : Moment
            The model at the start.
        initial : mapping of str to float
            Initial values of states in place of the scene's.
        given : ndarray, shape (n_states * (1 + n_sensitivities),), optional
            All initial values and their sensitivities, if they are not the scene's alone.
        """
        model, ffi = at.model, self._ffi
        native = model.native(at.p)
        assert native is not None
        states, n, m = model.states, len(model.states), len(model.sensitivities)
        places = np.array([states.index(name) for name in initial], dtype=np.intc)
        values, z = np.array([float(v) for v in initial.values()]), np.empty(n * (1 + m))
        if not np.isfinite(values).all():
            return None
        c = ffi.new("cotree_start_call *")
        c.model, c.tables = ffi.cast("cotree_model *", native.address), self.tables
        c.p, c.k, c.z = map(self._doubles, (native.p, native.k, z))
        c.t, c.has_sensitivities, c.n_set = at.t, m > 0, len(initial)
        c.set, c.values = ffi.from_buffer("int[]", places), self._doubles(values)
        if given is not None:
            c.initial = self._doubles(given)
        rows, held = self._inputs(at)
        c.n_replaced, c.replaced = len(held), rows
        if self._lib.cotree_start_once(c) != 0:
            return None
        # Differences cannot move values that Python gives.
        if given is not None and c.is_chosen and m > 0:
            return None
        return Start(z[:n].copy(), z[n:].reshape(m, n).T.copy(), bool(c.is_chosen))

    def _doubles(self, array: Array) -> Any:
        return self._ffi.from_buffer("double[]", array)

    def _inputs(self, at: Moment) -> tuple[Any, list[Any]]:
        """Return the inputs in place of the scene's as tables of one point, and what they read."""
        given = [] if at.u is None else at.u.tolist()
        rows, held = self._ffi.new("cotree_table_input[]", max(1, len(given))), []
        for i, value in enumerate(given):
            own = self._ffi.new("double[]", [0.0, value])
            rows[i].input, rows[i].length, rows[i].t, rows[i].u = i, 1, own, own + 1
            held.append(own)
        return rows, held


def filled_tables(ffi: Any, layout: Layout, kept: list[Any]) -> Any:
    """Return a model's ``cotree_start_tables``.

    Parameters
    ----------
    ffi : FFI
        That of a library which declares the structure.
    layout : Layout
        The model's.
    kept : list
        What keeps the structure alive is appended here.
    """

    def new(*what: Any) -> Any:
        kept.append(ffi.new(*what))
        return kept[-1]

    def ints(values: tuple[int, ...]) -> Any:
        return new("int[]", list(values) or [0])

    def quantities(rows: Sequence[Quantity]) -> Any:
        found = new("cotree_quantity[]", max(1, len(rows)))
        for row, own in zip(rows, found, strict=False):
            own.name, own.unit = (new("char[]", text.encode()) for text in (row.name, row.unit))
        return found

    tables, c = start_tables(layout), new("cotree_start_tables *")
    if tables.has_assembly:
        c.assembly = rows = new("cotree_assembly_tables *")
        for name in ("n_coordinates", "n_speeds", "n_values", "n_rows", "n_start", "n_groups"):
            setattr(rows, name, getattr(tables, name))
        rows.n_quaternions, rows.n_conditions = len(tables.quaternions), len(tables.is_rate)
        for name in ("value_rows", "quaternions", "is_rate", "groups"):
            setattr(rows, name, ints(getattr(tables, name)))
        rows.rows = quantities(tables.rows)
    for name in ("given", "seeds", "contents", "redundant_starts", "redundant_states"):
        setattr(c, name, ints(getattr(tables, name)))
    c.n_contents, c.n_redundant = len(tables.contents) // 2, len(tables.redundant)
    c.redundant = quantities(tables.redundant)
    return c


def start_in_c(model: CompiledModel) -> StartInC | None:
    """Return what finds starts of a model in C; None where Python has to, always."""
    layout = model.layout
    if layout.n_algebraic > _MOST_UNKNOWNS or model.backend != "C":
        return None
    library = load_start()
    return None if library is None else StartInC(model, library)


def find_in_c(at: Moment, initial: Mapping[str, float], given: Array | None = None) -> Start | None:
    """Find a start in C, see :meth:`StartInC.find`; None where C does not, or of unknown names."""
    found, states = at.model.start_in_c, at.model.states
    is_known = all(name in states for name in initial) and math.isfinite(at.t)
    return found.find(at, initial, given) if found is not None and is_known else None
