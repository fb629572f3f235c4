"""Implementation of :meth:`cotree.Model.ensemble`."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from cotree.errors import ModelError
from cotree.model.arrays import as_array
from cotree.scene.settings import settings_from

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Unpack

    from cotree.ensemble.members import Members
    from cotree.model.model import CompiledModel
    from cotree.scene.settings import Settings, SettingsDict
    from cotree.spec import BuildSpec


# Largest number of edges and of characters with which a scene is stored as an attribute. HDF5
# limits attributes to 64 KiB, and writing a large scene takes seconds.
_MOST_EDGES, _LONGEST_TEXT = 200, 2**15


def run_members(
    model: _Compiling,
    t_span: tuple[float, float] | None = None,
    members: Any = None,
    *,
    t_eval: Any = None,
    method: str | None = None,
    sensitivities: bool = True,
    outputs: Sequence[str] | None = None,
    parameters: Any = None,
    initial: Mapping[str, float] | None = None,
    inputs: Mapping[str, Any] | None = None,
    threads: int | None = None,
    lanes: int | None = None,
    executor: Any = None,
    store: Any = None,
    progress: bool = True,
    on_error: str = "keep",
    **settings: Unpack[SettingsDict],
) -> Any:
    """Run an ensemble, whose members differ in parameters and initial values.

    Parameters
    ----------
    t_span : (float, float), optional
        Start and end, [s]; by default up to the scene's ``t_end``.
    members : DataFrame, mapping, sequence of mappings, Grid or Samples
        A column for each parameter, initial state or initial sensitivity
        ``d(STATE)/d(PARAMETER)`` that members set: a DataFrame, whose index labels the members;
        arrays of one length, or numbers that apply to all members, by name; a list of mappings,
        one for each member; :func:`cotree.grid`; or :func:`cotree.sample`. Parameters of
        expressions in ``inputs`` may be columns, too.
    t_eval : int or array_like of shape (n_t,), optional
        Number of output times, evenly spaced, or the times; by default 101.
    method : str, optional
        As for :meth:`simulate`. If it is ``auto``, the method is chosen once for all members, by
        trial runs with the common values and of the members with the extreme values of each column.
    sensitivities : bool
        Whether to integrate the sensitivities with which the model was compiled.
    outputs : sequence of str, optional
        Outputs to evaluate, by default all. States are always returned.
    parameters, initial, inputs
        Values that all members share, as for :meth:`simulate`.
    threads : int, optional
        Number of threads, by default that of processors. It does not change any bit of the results.
    lanes : int, optional
        Number of members that an explicit method integrates in one SIMD vector, by default the
        processor's vector width; 1, the default for fewer than 100 members, disables vectors.
    executor : concurrent.futures.Executor, optional
        Runs blocks of members instead of threads: ``ProcessPoolExecutor()``, a client of
        ``dask.distributed`` or its executor, ``MPIPoolExecutor()`` of mpi4py. ``threads`` is then
        the number of threads of each worker, by default one. Blocks of dead workers are run again.
    store : path, optional
        A folder in which finished results are stored. If the call is interrupted, the same call
        computes only the missing results; several processes may run it at once. The values of
        the Dataset are then read from this folder on access.
    progress : bool
        Whether to show a progress bar at a terminal, after the first second.
    on_error : {"keep", "raise"}
        Whether the results of a failed member are nan, with its message, or MemberError is raised.
    **settings
        Tolerances, budgets and other settings of each member, as for :meth:`simulate`.

    Returns
    -------
    xarray.Dataset
        Every state and output by its name with the dimensions ``member``, or those of the grid,
        and ``time``; its sensitivities as ``d(NAME)`` with the last dimension ``parameter``. For
        each member ``status`` (0 if it succeeded), ``message``, ``steps`` and ``seconds``; for
        each event the number of its occurrences, ``n(EVENT)``, its times, ``t(EVENT)``, padded
        with nan, and ``d(t(EVENT))``. Values that members set are coordinates; initial values
        are called ``initial(STATE)``. Ctrl-C returns the finished members.

    Raises
    ------
    ModelError
        If members, or values that they share, are invalid; the message names column and row.
    SolveError
        If a setting is invalid; with ``on_error="raise"``, if a member fails.
    StoreError
        If the store cannot be used or contains another ensemble; the message names the difference.
    Error
        If xarray is not installed.

    Examples
    --------
    >>> import cotree
    >>> model = cotree.load("slider-pendulum").compile(["k"])
    >>> runs = model.ensemble((0, 10), cotree.grid(L=[0.9, 1.0, 1.1], k=[40, 50]))
    >>> runs["d(j1.s)"].dims
    ('L', 'k', 'time', 'parameter')
    >>> round(float(runs["j1.s"].sel(L=1.0, k=50, time=10)), 6)
    0.526045
    """
    # Imported here, since most programs run no ensembles.
    from cotree.ensemble.dataset import check_xarray
    from cotree.ensemble.members import read_members
    from cotree.ensemble.run import Execution, make_plan, run_ensemble
    from cotree.ensemble.trial import POINTS
    from cotree.scene.variants import expressions_among

    check_xarray()
    given = {
        "t_span": t_span,
        "t_eval": POINTS if t_eval is None else t_eval,
        "method": method,
        "parameters": parameters,
        "initial": initial,
        "inputs": inputs,
        "sensitivities": sensitivities,
        **settings,
    }
    shared = settings_from(model._defaults, given)
    execution = Execution(threads, executor, store, progress, on_error)
    rows = read_members(members)
    compiled, shared = _compiled_for(model, shared, rows)
    plan = make_plan(compiled, shared, rows, outputs=outputs, lanes=lanes)
    expressions = expressions_among(inputs or {})
    attributes = {**_described(model), "model": compiled.digest, "inputs": expressions}
    return run_ensemble(plan, rows, execution, attributes)


class _Compiling(Protocol):
    """A model that can be compiled again with its inputs replaced by expressions."""

    _defaults: Any
    kernels: CompiledModel
    parameters: tuple[str, ...]
    states: tuple[str, ...]
    inputs: tuple[str, ...]

    @property
    def spec(self) -> BuildSpec: ...

    def _variant(self, settings: Settings) -> tuple[_Compiling, Settings]: ...


def _described(model: _Compiling) -> dict[str, str]:
    """Return an attribute with the text of the model's scene, unless it is long."""
    # A scene with user-registered types cannot be written as TOML.
    with contextlib.suppress(ModelError):
        text = _text_of(model.spec)
        return {"scene_toml": text} if 0 < len(text) <= _LONGEST_TEXT else {}
    return {}


@lru_cache(maxsize=8)
def _text_of(spec: BuildSpec) -> str:
    from cotree.scene.toml_text import scene_text

    return scene_text(spec.scene) if len(spec.scene.edges) <= _MOST_EDGES else ""


def _compiled_for(model: _Compiling, settings: Settings, members: Members) -> tuple[Any, Settings]:
    """Return the model in which gains of input expressions are parameters, and its settings."""
    from cotree.ensemble.members import check_columns

    given, names = settings.parameters, model.parameters
    is_array = given is not None and not isinstance(given, Mapping)
    values = as_array(given, (len(names),), "the parameters").tolist() if is_array else ()
    shared = dict(zip(names, values, strict=True)) if is_array else dict(given or {})
    # The scene has no values of gains: use medians, which do not depend on the order of members.
    taken = {*names, *model.states, *model.inputs}
    gains = {
        name: float(np.median(members.rows[:, j]))
        for j, name in enumerate(members.columns)
        if name not in taken and name not in model.spec.scene.parameters
    }
    variant, rest = model._variant(replace(settings, parameters={**gains, **shared}))
    compiled = variant.kernels
    # An array has values for all parameters, including those that members set.
    check_columns(members.columns, compiled, () if is_array else shared, settings.initial)
    own = {name: value for name, value in gains.items() if name in compiled.parameters}
    return compiled, replace(rest, parameters={**own, **shared})
