"""The results of an ensemble as an ``xarray.Dataset``.

In: a plan, members and their results. Out: variables by the names that results of single runs have,
as views of the arrays that the blocks were collected in. Attributes are texts and numbers alone, so
that netCDF and Zarr take them.
"""

from __future__ import annotations

import json
import platform
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.ensemble.batch import pattern_of
from cotree.ensemble.lanes import refusal_of
from cotree.ensemble.members import MEMBER
from cotree.ensemble.pattern import Unfit
from cotree.ensemble.plan import FEW
from cotree.errors import Error
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.ensemble.members import Members
    from cotree.ensemble.plan import Block, Happened, Plan
    from cotree.solvers.base import FloatArray

TIME, PARAMETER, OCCURRENCE = "time", "parameter", "occurrence"

_PER_MEMBER = {
    "status": "0 done, -1 failed, -2 a budget was spent, -3 not run",
    "message": "why a member failed",
    "steps": "accepted steps",
    "seconds": "time to run",
}
_TAKEN = {MEMBER, TIME, PARAMETER, OCCURRENCE, "parameter_unit", *_PER_MEMBER}


def check_xarray() -> Any:
    """Give the module xarray.

    Raises
    ------
    Error
        If it is not installed.
    """
    try:
        import xarray
    except ImportError as error:
        raise Error(
            "ensembles give their results as an xarray.Dataset: run `pip install xarray pandas`, "
            "or install the extra, `pip install cotree[ensembles]`"
        ) from error
    return xarray


class Frame:
    """All of a Dataset but its results: dimensions, coordinates and attributes.

    Parameters
    ----------
    plan : Plan
        What the members share.
    members : Members
        What each of them sets.
    attributes : mapping of str to object
        Further attributes of the Dataset; ``inputs`` among them are expressions that were compiled
        into the model.

    Attributes
    ----------
    dims, shape : tuple of str, tuple of int
        The dimensions of members, and their lengths.
    """

    def __init__(self, plan: Plan, members: Members, attributes: Mapping[str, Any]) -> None:
        self.plan, self.members = plan, members
        self._attributes = dict(attributes)
        # The model that runs has them compiled in; a call gives them to the scene's own.
        self._expressions = self._attributes.pop("inputs", {})
        self._names = Names(plan)
        axes = tuple(self._names.column(name) for name in members.dimensions)
        self.dims = axes if members.is_grid else (MEMBER,)
        self.shape = members.shape

    def dataset(self, variables: Mapping[str, Any]) -> Any:
        """Put variables into an ``xarray.Dataset``."""
        plan, members = self.plan, self.members
        return check_xarray().Dataset(
            variables,
            _coordinates(plan, members, self._names, self.dims),
            {**self._attributes, **_attributes(plan, members, self._expressions)},
        )

    def variables(self, shape: tuple[int, ...], block: Block) -> dict[str, Any]:
        """Give the variables of some members: dimensions, values and attributes by name.

        Parameters
        ----------
        shape : tuple of int
            Lengths of the members' dimensions, here.
        block : Block
            Their results, of which the values are views.
        """
        plan, dims, names = self.plan, self.dims, self._names
        model, units = plan.model, plan.model.layout.units
        found: dict[str, Any] = {}
        n, n_y = len(model.states), len(plan.outputs)
        n_s = len(model.sensitivities) if plan.has_sensitivities else 0
        n_t = len(plan.settings.t_eval)
        # Views: z goes parameter by parameter behind the states.
        y = block.z[:, :, :n].reshape(*shape, n_t, n)
        s = block.z[:, :, n:].reshape(*shape, n_t, n_s, n) if n_s else None
        outputs = block.outputs.reshape(*shape, n_t, n_y)
        slopes = block.output_sensitivities.reshape(*shape, n_t, n_s, n_y)
        rows = [
            (name, y[..., i], None if s is None else s[..., i])
            for i, name in enumerate(model.states)
        ]
        rows += [
            (row.name, row.sum_of(y), None if s is None else row.sum_of(s))
            for row in model.layout.positions
        ]
        rows += [(name, outputs[..., i], slopes[..., i]) for i, name in enumerate(plan.outputs)]
        told = {row.name: row.doc for row in model.layout.outputs}
        for name, values, slope in rows:
            title = names.value(name)
            about = _about(units.get(name, ""), told.get(name) or name)
            found[title] = ((*dims, TIME), values, about)
            if n_s:
                unit = units.get(name, "")
                about = _about(f"{unit or '1'} / unit of parameter", f"sensitivity of {name}")
                found[f"d({title})"] = ((*dims, TIME, PARAMETER), slope, about)
        per_member = {
            "status": block.status,
            "message": np.array(block.messages, dtype=object),
            "steps": block.steps,
            "seconds": block.seconds,
        }
        for name, values in per_member.items():
            about = {"long_name": _PER_MEMBER[name]} | ({"units": "s"} if name == "seconds" else {})
            found[name] = (dims, values.reshape(shape), about)
        return found | _events(plan, dims, shape, block.happened)


class Names:
    """Names of variables and coordinates, of which no two are the same.

    Parameters
    ----------
    plan : Plan
        What the members share.
    """

    def __init__(self, plan: Plan) -> None:
        self._states = plan.model.states
        self._values = {*plan.model.states, *plan.outputs}

    def value(self, name: str) -> str:
        """Give the name of a state's or output's variable: its own, unless it is taken."""
        return f"value({name})" if name in _TAKEN else name

    def column(self, name: str) -> str:
        """Give the name of the coordinate of what members set."""
        if name in self._states:
            return f"initial({name})"
        return f"parameter({name})" if name in _TAKEN or name in self._values else name


def _coordinates(
    plan: Plan, members: Members, names: Names, dims: tuple[str, ...]
) -> dict[str, Any]:
    """Give the coordinates of members, times and parameters."""
    layout = plan.model.layout
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
        for dim, (name, values) in zip(dims, members.dimensions.items(), strict=True):
            found[dim] = (dim, values, about[name])
    else:
        found[MEMBER] = (MEMBER, members.dimensions[MEMBER])
        for j, name in enumerate(members.columns):
            found[names.column(name)] = (MEMBER, members.rows[:, j], about[name])
    found[TIME] = (TIME, plan.settings.t_eval, {"units": "s"})
    if plan.has_sensitivities:
        parameters = plan.model.sensitivities
        found[PARAMETER] = (PARAMETER, np.array(parameters, dtype=object))
        units = [layout.units.get(name, "") for name in parameters]
        found["parameter_unit"] = (PARAMETER, np.array(units, dtype=object))
    return found


def _events(
    plan: Plan, dims: tuple[str, ...], shape: tuple[int, ...], happened: Happened
) -> dict[str, Any]:
    """Give how often each event happened, and its times, padded with nan to the most of all."""
    found: dict[str, Any] = {}
    n_members, n_s = int(np.prod(shape)), happened.s.shape[1]
    rows = plan.model.layout.events
    own = [happened.event == i for i in range(len(rows))]
    counts = [np.bincount(happened.member[mask], minlength=n_members) for mask in own]
    most = max((int(count.max(initial=0)) for count in counts), default=0)
    for row, mask, count in zip(rows, own, counts, strict=True):
        # Times of a member stand one after another: what is left is their place among its own.
        starts = np.cumsum(count) - count
        member = happened.member[mask]
        place = np.arange(len(member)) - starts[member]
        times = np.full((n_members, most), np.nan)
        times[member, place] = happened.t[mask]
        title = row.name
        about = {"long_name": f"how often {title} happened"}
        found[f"n({title})"] = (dims, count.reshape(shape), about)
        about = _about("s", f"times of {title}")
        found[f"t({title})"] = ((*dims, OCCURRENCE), times.reshape(*shape, most), about)
        if plan.has_sensitivities:
            slopes = np.full((n_members, most, n_s), np.nan)
            slopes[member, place] = happened.s[mask]
            about = _about("s / unit of parameter", f"sensitivities of the times of {title}")
            found[f"d(t({title}))"] = (
                (*dims, OCCURRENCE, PARAMETER),
                slopes.reshape(*shape, most, n_s),
                about,
            )
    return found


def _about(unit: str, name: str) -> dict[str, str]:
    """Give the attributes of a variable; one whose unit is not known has none."""
    return {"long_name": name} | ({"units": unit} if unit else {})


def _attributes(plan: Plan, members: Members, expressions: Mapping[str, str]) -> dict[str, Any]:
    """Tell with what the members were run, so that they can be run again."""
    settings = plan.settings
    versions = {"cotree": VERSION, "python": platform.python_version(), "numpy": np.__version__}
    told: dict[str, Any] = {
        "scene": plan.model.layout.name,
        "method": settings.method,
        "rtol": float(settings.rtol),
        "atol": float(settings.atol),
        "t_span": np.array(settings.t_span, dtype=float),
        "settings": json.dumps(_told(plan, expressions), sort_keys=True),
        "versions": json.dumps(versions),
        "lanes": _of_lanes(plan, len(members.rows)),
    }
    if members.origin:
        told["members"] = json.dumps(dict(members.origin))
    return told


def _of_lanes(plan: Plan, n_members: int) -> str:
    """Say whether members run side by side, or why not."""
    found = pattern_of(plan)
    if isinstance(found, Unfit):
        return f"members run one after another, in Python: {found.why}"
    why = refusal_of(found)
    if plan.lanes == 1 and n_members < FEW:
        why = f"lanes are not compiled for fewer than {FEW} members, unless lanes= asks for it"
    if why:
        return f"members run one after another: {why}"
    near = ", except for those that come near a corner of the rates"
    is_forwards = plan.settings.t_span[1] >= plan.settings.t_span[0]
    return f"members run side by side{near if plan.model.layout.corners and is_forwards else ''}"


def _told(plan: Plan, expressions: Mapping[str, str]) -> dict[str, Any]:
    """Give the arguments of the call as what JSON can tell, but for members and times.

    Functions of Python are told by their names.
    """
    names = (
        *("t_span", "method", "rtol", "atol", "parameters", "initial", "inputs", "scales"),
        *("error_test_sensitivities", "max_step", "max_steps", "max_events", "time_limit"),
        "project",
    )
    told = {name: _plain(getattr(plan.settings, name)) for name in names}
    told["inputs"] = {**told["inputs"], **expressions}
    # Where members may leave the method that was chosen for all, only this says so.
    told["method"] = "auto" if plan.is_chosen else told["method"]
    # Gains that members set have values here for the model's sake alone.
    shared = told["parameters"] or {}
    told["parameters"] = {n: v for n, v in shared.items() if n not in plan.columns}
    return {**told, "sensitivities": plan.has_sensitivities, "outputs": list(plan.outputs)}


def _plain(value: Any) -> Any:
    """Turn mappings, arrays and numbers into those that JSON has."""
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float) or hasattr(type(value), "__float__"):
        return float(value)
    if hasattr(value, "items"):
        return {str(name): _plain(item) for name, item in value.items()}
    if callable(value):
        return f"the function {getattr(value, '__name__', 'of Python')}"
    return [_plain(item) for item in _items(value)]


def _items(value: Iterable[Any] | FloatArray) -> Iterable[Any]:
    return value.tolist() if isinstance(value, np.ndarray) else value
