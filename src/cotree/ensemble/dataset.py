"""The results of an ensemble as an ``xarray.Dataset``.

Variables are named as in results of single runs, and are views of the arrays of blocks. Attributes
are only texts and numbers, as netCDF and Zarr require.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import shutil
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.ensemble.batch import pattern_of
from cotree.ensemble.members import MEMBER, Members
from cotree.ensemble.pattern import NotBatchable, refusal_of
from cotree.ensemble.plan import FEW, Block, Plan
from cotree.ensemble.reasons import Reasons
from cotree.errors import Error, SceneError, SolveError, optional_package
from cotree.files import atomic_write, check_parent, check_suffix, target_path, write_csv
from cotree.quiet import without_warnings
from cotree.scene.settings import SHARED
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path
    from threading import Event

    from cotree.solvers.result import FloatArray


TIME, PARAMETER, OCCURRENCE = "time", "parameter", "occurrence"

_PER_MEMBER = {
    "status": "0 done, -1 failed, -2 a budget was spent, -3 not run",
    "message": "reason why a member failed",
    "steps": "accepted steps",
    "seconds": "wall-clock time",
}
_TAKEN = {MEMBER, TIME, PARAMETER, OCCURRENCE, "parameter_unit", *_PER_MEMBER}


def check_xarray() -> Any:
    """Return the module xarray; raise an error if it is not installed."""
    return optional_package("xarray", "results of ensembles need", "ensembles")


class DatasetSchema:
    """Dimensions, coordinates and attributes of the Dataset of an ensemble."""

    def __init__(self, plan: Plan, members: Members, attributes: Mapping[str, Any]) -> None:
        self.plan, self.members = plan, members
        self._attributes = dict(attributes)
        # Expressions of inputs, whose gains are parameters of the compiled model.
        self._expressions = self._attributes.pop("inputs", {})
        axes = tuple(self._column(name) for name in members.dimensions)
        self.dims = axes if members.is_grid else (MEMBER,)
        self.shape = members.shape

    def dataset(self, variables: Mapping[str, Any]) -> Any:
        """Build an ``xarray.Dataset`` from the variables."""
        own = _attributes(self.plan, self.members, self._expressions)
        return check_xarray().Dataset(variables, self._coordinates(), {**self._attributes, **own})

    def variables(self, shape: tuple[int, ...], block: Block) -> dict[str, Any]:
        """Return dimensions, values and attributes of each variable of a block, by name."""
        plan, dims, layout = self.plan, self.dims, self.plan.model.layout
        found: dict[str, Any] = {}
        n, n_y = len(plan.model.states), len(plan.outputs)
        n_s, n_t = plan.n_sensitivities, len(plan.settings.t_eval)
        # Each row of z contains the states, then their sensitivities by parameter.
        y = block.z[:, :, :n].reshape(*shape, n_t, n)
        s = block.z[:, :, n:].reshape(*shape, n_t, n_s, n)
        outputs = block.outputs.reshape(*shape, n_t, n_y)
        slopes = block.output_sensitivities.reshape(*shape, n_t, n_s, n_y)
        rows = [(name, y[..., i], s[..., i]) for i, name in enumerate(plan.model.states)]
        rows += [(row.name, row.sum_of(y), row.sum_of(s)) for row in layout.positions]
        rows += [(name, outputs[..., i], slopes[..., i]) for i, name in enumerate(plan.outputs)]
        docs = {row.name: row.doc for row in layout.outputs}
        for name, values, slope in rows:
            title = f"value({name})" if name in _TAKEN else name
            unit = layout.units.get(name, "")
            found[title] = ((*dims, TIME), values, _about(unit, docs.get(name) or name))
            if n_s:
                about = _about(f"{unit or '1'} / unit of parameter", f"sensitivity of {name}")
                found[f"d({title})"] = ((*dims, TIME, PARAMETER), slope, about)
        per_member = {
            "status": block.status,
            "message": np.array(block.messages, dtype=object),
            "steps": block.steps,
            "seconds": block.seconds,
        }
        for name, values in per_member.items():
            about = _about("s" if name == "seconds" else "", _PER_MEMBER[name])
            found[name] = (dims, values.reshape(shape), about)
        return found | self._events(shape, block.events)

    def _column(self, name: str) -> str:
        """Return the coordinate name of a column; it differs from the names of all variables."""
        plan = self.plan
        if name in plan.model.states:
            return f"initial({name})"
        return f"parameter({name})" if name in _TAKEN or name in plan.outputs else name

    def _coordinates(self) -> dict[str, Any]:
        plan, members, layout = self.plan, self.members, self.plan.model.layout
        docs = {row.name: row.doc for row in (*layout.parameters, *layout.outputs)}
        about = {
            name: _about(
                layout.units.get(name, ""),
                f"initial value of {name}" if name in plan.model.states else docs.get(name) or name,
            )
            for name in members.columns
        }
        found: dict[str, Any] = {}
        if members.is_grid:
            for dim, (name, values) in zip(self.dims, members.dimensions.items(), strict=True):
                found[dim] = (dim, values, about[name])
        else:
            found[MEMBER] = (MEMBER, members.dimensions[MEMBER])
            for j, name in enumerate(members.columns):
                found[self._column(name)] = (MEMBER, members.rows[:, j], about[name])
        found[TIME] = (TIME, plan.settings.t_eval, {"units": "s"})
        if plan.n_sensitivities:
            parameters = plan.model.sensitivities
            found[PARAMETER] = (PARAMETER, np.array(parameters, dtype=object))
            units = [layout.units.get(name, "") for name in parameters]
            found["parameter_unit"] = (PARAMETER, np.array(units, dtype=object))
        return found

    def _events(self, shape: tuple[int, ...], events: FloatArray) -> dict[str, Any]:
        """Return the counts and times of each event as variables; missing times are nan."""
        found: dict[str, Any] = {}
        n_members, n_s, dims = int(np.prod(shape)), self.plan.n_sensitivities, self.dims
        names = [row.name for row in self.plan.model.layout.events]
        members = events[:, 0].astype(np.intp)
        own = [events[:, 1] == i for i in range(len(names))]
        counts = [np.bincount(members[mask], minlength=n_members) for mask in own]
        most = max((int(count.max(initial=0)) for count in counts), default=0)
        for name, mask, count in zip(names, own, counts, strict=True):
            # Events are sorted by member, so subtracting its first index numbers a member's events.
            starts = np.cumsum(count) - count
            member = members[mask]
            place = np.arange(len(member)) - starts[member]
            times = np.full((n_members, most, 1 + n_s), np.nan)
            times[member, place] = events[mask, 2:]
            times = times.reshape(*shape, most, 1 + n_s)
            about = {"long_name": f"number of occurrences of {name}"}
            found[f"n({name})"] = (dims, count.reshape(shape), about)
            about = _about("s", f"times of {name}")
            found[f"t({name})"] = ((*dims, OCCURRENCE), times[..., 0], about)
            if n_s:
                about = _about("s / unit of parameter", f"sensitivities of the times of {name}")
                found[f"d(t({name}))"] = ((*dims, OCCURRENCE, PARAMETER), times[..., 1:], about)
        return found


def _about(unit: str, name: str) -> dict[str, str]:
    """Return the attributes of a variable, without ``units`` if the unit is unknown."""
    return {"long_name": name} | ({"units": unit} if unit else {})


def _attributes(plan: Plan, members: Members, expressions: Mapping[str, str]) -> dict[str, Any]:
    """Return the arguments and settings of the ensemble, so that it can be repeated."""
    settings = plan.settings
    versions = {"cotree": VERSION, "python": platform.python_version(), "numpy": np.__version__}
    found: dict[str, Any] = {
        "scene": plan.model.layout.name,
        "method": settings.method,
        "rtol": float(settings.rtol),
        "atol": float(settings.atol),
        "t_span": np.array(settings.t_span, dtype=float),
        "settings": json.dumps(_arguments(plan, expressions), sort_keys=True),
        "versions": json.dumps(versions),
        "lanes": _of_lanes(plan, len(members.rows)),
    }
    if members.origin:
        found["members"] = json.dumps(dict(members.origin))
    return found


def _of_lanes(plan: Plan, n_members: int) -> str:
    """Return a sentence that states whether members run in SIMD lanes, or the reason why not."""
    found = pattern_of(plan)
    if isinstance(found, NotBatchable):
        return f"members run one after another, in Python: {found.why}"
    why = refusal_of(found)
    if plan.lanes == 1 and n_members < FEW:
        why = f"lanes are not compiled for fewer than {FEW} members unless lanes= is given"
    if why:
        return f"members run one after another: {why}"
    near = ", except for those close to a kink or jump of the rates"
    is_forwards = plan.settings.t_span[1] >= plan.settings.t_span[0]
    return f"members run side by side{near if plan.model.layout.kinks and is_forwards else ''}"


def _arguments(plan: Plan, expressions: Mapping[str, str]) -> dict[str, Any]:
    """Return the arguments of the ensemble call, except members and times, as JSON values."""
    names = ("t_span", "parameters", "initial", "inputs", *SHARED)
    found = {name: plain(getattr(plan.settings, name)) for name in names}
    found["inputs"] = {**found["inputs"], **expressions}
    # If the method was chosen, stiff members may use another one, so "auto" is stored.
    found["method"] = "auto" if plan.is_chosen else found["method"]
    # Common values of parameters that members set have no effect and are omitted.
    shared = found["parameters"] or {}
    found["parameters"] = {n: v for n, v in shared.items() if n not in plan.columns}
    return {**found, "sensitivities": plan.n_sensitivities > 0, "outputs": list(plan.outputs)}


def plain(value: Any) -> Any:
    """Convert mappings, arrays and numbers to JSON values."""
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float) or hasattr(type(value), "__float__"):
        return float(value)
    if hasattr(value, "items"):
        return {str(name): plain(item) for name, item in value.items()}
    if callable(value):
        return f"the function {getattr(value, '__name__', 'of Python')}"
    return [plain(item) for item in (value.tolist() if isinstance(value, np.ndarray) else value)]


#: Suffixes of the supported file formats.
SUFFIXES = (".nc", ".zarr", ".csv")


def check_dataset_file(path: Path) -> None:
    """Check before the ensemble is run that its results can be written to a file."""
    suffix = check_suffix(path, SUFFIXES, "write")
    check_parent(path)
    is_zarr = any((path / name).exists() for name in ("zarr.json", ".zgroup"))
    if path.is_dir() and not (suffix == ".zarr" and is_zarr):
        raise SceneError(f"cannot write '{path}': it is a folder of other files; name another")


def write_dataset(dataset: Any, path: Path) -> None:
    """Write the Dataset of an ensemble to a file."""
    check_dataset_file(path)
    suffix = path.suffix.lower()
    if suffix == ".csv":
        write_csv(path, table_rows(dataset))
        return
    try:
        if suffix == ".nc":
            with atomic_write(path) as draft:
                dataset.to_netcdf(draft, engine="h5netcdf")
        else:
            _write_zarr(dataset, path)
    except ImportError as error:
        raise Error(
            f"cannot write '{path}': {error}; run `pip install cotree[ensembles]`"
        ) from error


def table_rows(dataset: Any) -> Iterator[list[Any]]:
    """Yield the rows of a table: column titles, then a row for each member and time.

    Columns are the values that members set, the time, and all results; missing values are empty.
    """
    dims = dataset["status"].dims
    columns = [name for name, row in dataset.coords.items() if set(row.dims) <= set(dims)]
    like = dataset["status"]
    settings = [
        dataset[name].broadcast_like(like).transpose(*dims).values.ravel() for name in columns
    ]
    titles, values = _curves(dataset, dims)
    yield [*columns, "time", *titles]
    for i in range(like.size):
        own = [column[i] for column in settings]
        for j, t in enumerate(dataset["time"].values):
            yield [*own, t, *(row[i, j] for row in values)]


def _curves(dataset: Any, dims: tuple[str, ...]) -> tuple[list[str], list[Any]]:
    """Return the titles and values of all results, each of shape (n_members, n_t)."""
    titles: list[str] = []
    values: list[Any] = []
    plain = [name for name, row in dataset.data_vars.items() if row.dims == (*dims, "time")]
    for name in plain:
        titles.append(name)
        values.append(_flat(dataset[name].values, 1))
    for name in plain:
        if f"d({name})" not in dataset:
            continue
        slopes = _flat(dataset[f"d({name})"].values, 2)
        for k, parameter in enumerate(dataset["parameter"].values):
            titles.append(f"d({name})/d({parameter})")
            values.append(slopes[..., k])
    return titles, values


def _flat(values: Any, n_last: int) -> Any:
    return values.reshape(-1, *values.shape[values.ndim - n_last :])


def _write_zarr(dataset: Any, path: Path) -> None:
    """Write a Zarr folder next to the old one, then replace the old one."""
    target = target_path(path)
    draft, old = (target.with_name(f".{target.name}.{os.getpid()}.{end}") for end in ("tmp", "old"))
    try:
        # Suppress Zarr's warning that xarray's consolidated metadata are not part of its format.
        with without_warnings(message="Consolidated metadata"):
            dataset.to_zarr(draft, mode="w")
        # A folder cannot replace another atomically, so neither exists for a moment.
        if target.exists():
            os.replace(target, old)
        os.replace(draft, target)
    except OSError as error:
        raise SceneError(f"cannot write '{target}': {error.strerror or error}") from None
    finally:
        for folder in (draft, old):
            with contextlib.suppress(OSError):
                shutil.rmtree(folder, ignore_errors=True)


class Collected:
    """Results in memory, with nan for members that are not computed yet."""

    def __init__(self, schema: DatasetSchema, ranges: Iterable[tuple[int, int]]) -> None:
        n_members = len(schema.members.rows)
        check_memory(member_bytes(schema.plan) * n_members, n_members)
        self._schema, self._ranges = schema, ranges
        self._whole, self.reasons = Block(schema.plan, n_members), Reasons()

    def ranges(self) -> Iterable[tuple[int, int]]:
        """Return the ranges of members to run."""
        return self._ranges

    def add_block(self, first: int, block: Block) -> None:
        """Copy the results of a block; ``first`` is the index of its first member."""
        there, whole = slice(first, first + len(block.status)), self._whole
        for name in ("z", "outputs", "output_sensitivities", "status", "messages", "steps"):
            getattr(whole, name)[there] = getattr(block, name)
        whole.seconds[there] = block.seconds
        events = block.events.copy()
        events[:, 0] += first
        whole.add_events(events)
        self.reasons.add(first, block.status, block.messages)

    def wait(self, stop: Event) -> bool:
        """Return whether members are missing. There are no other processes to wait for."""
        return False

    def close(self) -> None:
        """Do nothing, because no files are open."""

    def dataset(self) -> Any:
        """Return the results as an ``xarray.Dataset``."""
        block = self._whole.finished()
        return self._schema.dataset(self._schema.variables(self._schema.shape, block))


def member_bytes(plan: Plan) -> int:
    """Return the size of one member's results without events, [byte]."""
    n_values = len(plan.model.states) + len(plan.model.layout.positions) + len(plan.outputs)
    return 8 * int(np.size(plan.settings.t_eval)) * n_values * (1 + plan.n_sensitivities)


def check_memory(n_bytes: int, n_members: int) -> None:
    """Raise an error if the results would not fit in memory."""
    try:
        there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return  # the operating system does not report its memory
    if n_bytes > there:
        raise SolveError(
            f"the results of {n_members} members take {n_bytes / 2**30:.3g} GiB, and this machine "
            f"has {there / 2**30:.3g} GiB of memory: ask for fewer times or outputs, for no "
            "sensitivities, or give a store"
        )
