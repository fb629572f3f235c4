"""Experiments: measured data and the conditions under which they were recorded."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import ParameterError, brief
from cotree.estimation.conditions import TRANSFORMATIONS
from cotree.estimation.tables import read_table, split_unit
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from cotree.estimation.tables import Table


class Experiment:
    """Measured data of one run and the conditions under which they were recorded.

    Parameters
    ----------
    data : path of a CSV file, DataFrame, or mapping of str to array_like
        A column of increasing times, [s], and any number of measured columns, all of shape
        (n_times,). Missing values are nan, or empty in a file. A unit may be part of the name of a
        column, ``angle [deg]``; columns without a unit are in SI.
    inputs : mapping of str to number, str or (times, values), optional
        Inputs of this run in place of the scene's; see :meth:`cotree.Model.simulate`. New names in
        expressions are parameters, which are given in ``parameters`` or estimated. A column with
        the name of an input is used as that input, with linear interpolation, unless the input is
        given here.
    initial, parameters : mapping of str to float or str, optional
        Initial values of states and values of parameters in this run, in SI; a string is the name
        of an estimated parameter.
    observables : mapping of str to str, or sequence of str, optional
        What each column measures: an expression of states, outputs and anything else that the
        outputs of a scene may use. If absent, the columns named after states and outputs are used.
    noise : number, str, or mapping of str to number or str, optional
        Standard deviation of the noise, of each column in a mapping: a number in the unit of the
        column, the name of another column, or an expression or an estimated parameter in SI. It is
        estimated if absent.
    units : mapping of str to str, optional
        Units of columns whose names do not contain them.
    transform : str or mapping of str to str, optional
        ``log`` or ``log10``, for each column in a mapping: the logarithms of measured and computed
        values are compared, and the noise is that of the logarithms.
    time : str, optional
        Name of the time column; ``t`` or ``time`` if absent.
    t_start : float
        Time at which the run starts, [s]; there are no measurements before it.
    name : str, optional
        Name in tables and plots; the name of the file, or the number of the experiment, if absent.

    Raises
    ------
    ParameterError, UnitError, SceneError
        If the data cannot be read; the message names file, row and column.

    Examples
    --------
    >>> run = Experiment({"time": [0, 1, 2], "T [degC]": [80, 62, 50]}, noise=0.5,
    ...                  observables={"T": "body.T"})
    >>> run.table.t.tolist()
    [0.0, 1.0, 2.0]
    """

    def __init__(
        self,
        data: Any,
        *,
        inputs: Mapping[str, Any] | None = None,
        initial: Mapping[str, float | str] | None = None,
        parameters: Mapping[str, float | str] | None = None,
        observables: Mapping[str, str] | Sequence[str] | None = None,
        noise: float | str | Mapping[str, float | str] | None = None,
        units: Mapping[str, str] | None = None,
        transform: str | Mapping[str, str] | None = None,
        time: str | None = None,
        t_start: float = 0.0,
        name: str | None = None,
    ) -> None:
        is_file = isinstance(data, (str, os.PathLike))
        self.name = name if name is not None or not is_file else Path(data).stem
        where = "the data" if self.name is None else f"the data of experiment '{self.name}'"
        self.table: Table = read_table(data, where, time)
        self.where = self.table.where
        for word, given in (("inputs", inputs), ("initial", initial), ("parameters", parameters)):
            if given is not None and not isinstance(given, Mapping):
                raise ParameterError(f"{word} of {self.where} must be a mapping of names to values")
        self.inputs = dict(inputs or {})
        self.initial = {k: self._value("initial", k, v) for k, v in (initial or {}).items()}
        self.parameters = {
            k: self._value("parameters", k, v) for k, v in (parameters or {}).items()
        }
        self.observables = self._observed(observables)
        self._noise = self._by_column("noise", noise)
        self._units = self._by_column("units", units)
        self._transform = self._by_column("transform", transform)
        for word in self._transform.values():
            if word not in TRANSFORMATIONS:
                listed = ", ".join(map(repr, TRANSFORMATIONS))
                raise ParameterError(
                    f"transform of {self.where} is {brief(repr(word))}: give {listed}"
                )
        self.t_start = check_number(t_start, f"t_start of {self.where}")
        early = np.flatnonzero(self.table.t < self.t_start)
        if early.size:
            raise ParameterError(
                f"{self.where}, {self.table.rows[early[0]]}: the time {self.table.t[early[0]]:g} s "
                f"is before the start of the run at {self.t_start:g} s: give t_start"
            )

    def __repr__(self) -> str:
        names = ", ".join(self.table.columns)
        t = self.table.t
        return f"<Experiment {self.name or ''}: {names} at {t.size} times to {t[-1]:g} s>"

    def noise_of(self, column: str) -> float | str | None:
        """Return the standard deviation of a column as given; None if it is to be estimated."""
        found = self._noise.get(column, self._noise.get(""))
        if found is None or isinstance(found, str):
            return found
        return check_number(found, f"the noise of column '{column}' of {self.where}")

    def unit_of(self, column: str) -> str | None:
        """Return the unit of a column from ``units``, or None."""
        return self._units.get(column)

    def transform_of(self, column: str) -> str:
        """Return the transformation under which values of a column are compared."""
        return str(self._transform.get(column, self._transform.get("", "lin")))

    def _value(self, what: str, name: object, value: Any) -> float | str:
        """Check a value: a number, or the name of an estimated parameter."""
        where = f"'{brief(str(name))}' in {what} of {self.where}"
        return value if isinstance(value, str) else check_number(value, where)

    def _observed(self, given: Any) -> dict[str, str] | None:
        """Read what the columns measure; keys are names without units."""
        if given is None:
            return None
        if isinstance(given, str):
            given = [given]
        if not isinstance(given, Mapping):
            given = {name: split_unit(str(name))[0] for name in given}
        if not given:
            raise ParameterError(f"observables of {self.where} names no column: omit it")
        for name, text in given.items():
            if isinstance(text, bool) or not isinstance(text, str):
                raise ParameterError(
                    f"column '{brief(str(name))}' of {self.where} measures {text!r}: give an "
                    "expression of states and outputs in quotes"
                )
        return {self.table.column(str(name)).name: text for name, text in given.items()}

    def _by_column(self, what: str, given: Any) -> dict[str, Any]:
        """Read a mapping by column; a single value for all columns has an empty key."""
        if given is None:
            return {}
        if not isinstance(given, Mapping):
            return {"": given}
        try:
            return {self.table.column(str(name)).name: value for name, value in given.items()}
        except ParameterError as error:
            raise ParameterError(f"{what}: {error}") from None
