"""Identity of an ensemble: all that its numbers follow from, by which calls share a store.

In: a plan. Out: an ``Identity`` of texts and numbers that JSON has, and the first difference
between two of them as a sentence.
"""

from __future__ import annotations

import hashlib
import json
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.codegen.render import template_folder
from cotree.errors import SolveError, brief
from cotree.model.signals import read_signals
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.ensemble.plan import Plan

# Longer values, as of tables, are told apart by their hash.
_LONGEST = 200

_SETTINGS = (
    *("method", "rtol", "atol", "initial", "scales", "error_test_sensitivities"),
    *("max_step", "max_steps", "max_events", "time_limit", "project"),
)


def identity_of(plan: Plan) -> dict[str, Any]:
    """Tell what all members of a plan share, by name.

    What members set, and the times, are coordinates of the results, and are compared there.

    Raises
    ------
    SolveError
        If inputs are functions of Python, of which nobody can tell whether they are the same.
    """
    model, settings = plan.model, plan.settings
    signals = read_signals(settings.inputs, model.inputs)
    for place in {*signals.by_position, *signals.sampled} - set(signals.tables):
        raise SolveError(
            f"input '{model.inputs[place]}' is a function of Python, and nobody can tell whether "
            "another call's is the same: with store=... give a table or an expression"
        )
    p = model.parameter_array(settings.parameters).tolist()
    values = dict(zip(model.parameters, p, strict=True))
    tables = {model.inputs[i]: [t, y] for i, (t, y) in signals.tables.items()}
    return {
        "cotree": VERSION,
        "scene": model.layout.name,
        "columns": list(plan.columns),
        **{name: _plain(getattr(settings, name)) for name in _SETTINGS},
        # Members that an automatically chosen method finds stiff are run with another one.
        "method_is_chosen": plan.is_chosen,
        "t_span": _plain(settings.t_span),
        "inputs": {name: _short(_plain(table)) for name, table in tables.items()},
        # A column goes before these.
        "parameters": {name: v for name, v in values.items() if name not in plan.columns},
        "leaves_explicit": plan.is_chosen,
        "outputs": list(plan.outputs),
        "sensitivities": list(model.sensitivities) if plan.has_sensitivities else [],
        "kernels": model.backend,
        "model": model.digest,
        "engine": _engine(),
    }


def first_difference(there: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    """Say what differs first, as a sentence without a capital and an end; empty if nothing does."""
    for name, value in here.items():
        # What was written came through JSON.
        old, new = there.get(name), json.loads(json.dumps(value))
        if old == new:
            continue
        if name == "model":
            return "its model has other equations, laws, names or compiler options"
        if name == "engine":
            return "it was written by another build of cotree, whose methods may differ"
        if isinstance(old, dict) and isinstance(new, dict):
            key = next(key for key in {**new, **old} if old.get(key) != new.get(key))
            return (
                f"of {name} '{key}' is {_told(old.get(key))} there and {_told(new.get(key))} here"
            )
        return f"{name} is {_told(old)} there and {_told(new)} here"
    return ""


def _told(value: Any) -> str:
    return "not given" if value is None else brief(json.dumps(value))


def _plain(value: Any) -> Any:
    """Turn mappings, arrays and numbers into those that JSON has."""
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if hasattr(value, "items"):
        return {str(name): _plain(item) for name, item in sorted(value.items())}
    if isinstance(value, float) or np.ndim(value) == 0:
        return float(value)
    return [_plain(item) for item in value]


def _short(value: Any) -> Any:
    text = json.dumps(value)
    if len(text) <= _LONGEST:
        return value
    return f"the table with hash {hashlib.sha256(text.encode()).hexdigest()[:16]}"


@cache
def _engine() -> str:
    """Hash the C text of the methods, from which the same version may have been built twice."""
    found = hashlib.sha256()
    for path in sorted(template_folder().rglob("*.jinja")):
        found.update(path.name.encode() + b"\0" + path.read_bytes())
    return found.hexdigest()
