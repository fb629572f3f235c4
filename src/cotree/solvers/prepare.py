"""Preparation of runs: data that runs with the same settings share, and problems of runs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Hashable, Mapping
from numbers import Number, Real
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from cotree.arguments import check_mapping
from cotree.errors import ParameterError, SolveError, check_known
from cotree.model.bound import BoundModel
from cotree.model.kernels import NO_COMPILER
from cotree.model.signals import ReplacedInputs, Sampled, read_signals
from cotree.model.start import find_start
from cotree.records import filled
from cotree.scene.expressions import check_positive
from cotree.scene.settings import Settings, in_python
from cotree.solvers.job import Shared
from cotree.solvers.problem import DENSE_LIMIT, RunProblem

if TYPE_CHECKING:
    import numpy.typing as npt

    from cotree.model.model import CompiledModel
    from cotree.model.start import Start
    from cotree.sharing import RecentCache
    from cotree.solvers.result import FloatArray
    from cotree.solvers.sampled_inputs import InputSamples

    Inputs = Callable[[float], FloatArray | None]

_NONE = np.zeros(0)


# Maximum fraction of nonzero entries for which sparse matrices cost less than dense ones.
_LARGEST_SHARE = 0.1


_T = TypeVar("_T")


def prepared(model: CompiledModel, settings: Settings) -> Preparation:
    """Return the preparation for the given settings from a cache, or a new one."""
    given = {**vars(settings), "parameters": None, "initial": None}
    kept: RecentCache[Preparation] = model.kept
    return cached_for(kept, given, lambda: Preparation(model, settings))


def cached_for(kept: RecentCache[_T], given: Mapping[str, Any], make: Callable[[], _T]) -> _T:
    """Return the value for the given settings from a cache, or compute it."""
    key = key_of(given)
    return make() if key is None else kept.of(key, make)


# Settings with more numbers are not cached, because comparing them takes too long.
_MOST_NUMBERS = 10_000

# Arrays up to this size are compared as lists of numbers, which is faster.
_FEW_NUMBERS = 4

# Types of values that are compared by value.
_PLAIN = frozenset((float, int, str, bool, type(None)))

# Types of functions; these are compared by identity.
_FUNCTIONS = (FunctionType, MethodType, BuiltinFunctionType)


def key_of(given: Mapping[str, Any]) -> Hashable | None:
    """Return a key equal for equal settings (functions by identity), or None if incomparable."""
    try:
        return tuple(given), _tokens(given.values())
    except _IncomparableError:
        return None


class _IncomparableError(Exception):
    """Raised if a value cannot be part of a key."""


def _tokens(values: Collection[Any]) -> Hashable:
    """Return a key that is equal for collections with equal values of the same types."""
    if len(values) > _MOST_NUMBERS:
        raise _IncomparableError
    # Zeros are compared as text, because 0.0 and -0.0 are equal but have different effects.
    own = [(x or str(x)) if type(x) in _PLAIN else _token(x) for x in values]
    return tuple(map(type, own)), tuple(own)


def _token(value: Any) -> Hashable:
    kind = type(value)
    if kind is tuple or kind is list:
        return kind, _tokens(value)
    if kind is np.ndarray and value.ndim:
        if value.size <= _FEW_NUMBERS:
            return _token(value.tolist())
        if value.size > _MOST_NUMBERS or value.dtype.hasobject:
            raise _IncomparableError
        return value.shape, value.dtype, value.tobytes()
    if isinstance(value, Mapping):
        return tuple(value), _tokens(value.values())
    if isinstance(value, Sampled):
        return _token(value.function), value.period
    if callable(value):
        return value if isinstance(value, _FUNCTIONS) else _Same(value)
    plain = in_python(value)
    if isinstance(plain, Number):  # Number includes fractions and decimals
        return plain or str(plain)
    if plain is value:
        raise _IncomparableError
    return plain or str(plain)


class _Same:
    def __init__(self, value: object) -> None:
        self._value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self._value is other._value

    def __hash__(self) -> int:
        return id(self._value)


class Preparation:
    """Data of a problem that all runs with the same settings share; thread-safe.

    Parameters and initial values of ``settings`` are ignored. Raises ModelError if an input is not
    accepted, and SolveError if settings are inconsistent or the model was not compiled.
    """

    def __init__(self, model: CompiledModel, settings: Settings) -> None:
        if model.backend != "C":
            raise SolveError(NO_COMPILER)
        if not settings.sensitivities:
            model = model.states_only
        layout = model.layout
        self.model, self.settings, self.units = model, settings, layout.units
        self._signals = read_signals(settings.inputs, model.inputs)
        _check_replaced(model, settings.inputs)
        # The constraints include the norms of quaternions.
        self._is_held = settings.project and bool(layout.constraints)
        sizes = parameter_sizes(model, settings.scales)
        self._size_of = sizes if any(isinstance(of, int) for of in sizes) else []
        self._has_time_events = model.traits.has_time_events or bool(settings.inputs)
        self._is_step_free = settings.max_step is None and model.traits.has_longest_step
        # Python functions among the inputs may have an internal state.
        self.asks_python = bool(self._signals.sampled) or any(
            place not in self._signals.tables for place in self._signals.by_position
        )
        n, m = len(model.states), len(model.sensitivities)
        # Each run replaces the functions, and the values that depend on parameters.
        self._template = RunProblem(
            rhs=_nothing,
            jacobian=None,
            n_states=n,
            n_sensitivities=m,
            z0=np.zeros(n * (1 + m)),
            settings=settings,
            scale=max(map(abs, settings.t_span)),
            names=model.states,
            parameters=model.sensitivities,
            scales=None if self._size_of else np.array(sizes, dtype=float),
            max_step=math.inf if settings.max_step is None else settings.max_step,
            constraints=model.constraints if self._is_held else (),
            n_algebraic=layout.n_algebraic,
            places=places_of(model),
            n_observed=n_observed(model),
            shared=Shared(is_repeatable=not self.asks_python),
            **_replaced_inputs(self._signals),
        )
        self._has_sparse = _has_sparse_jacobian(model)
        # Start of all runs without given initial values, unless it depends on parameters.
        self._start: Start | None = None
        self._has_constant_start = model.has_constant_start and not self.asks_python

    def run(self, parameters: Any, initial: Mapping[str, float]) -> RunProblem:
        """Return the problem of one run with the given parameters and initial values."""
        model, t_span = self.model, self.settings.t_span
        initial = check_mapping(initial, "initial") if initial else {}
        p = model.parameter_array(parameters)
        signals = self._signals
        samples: list[InputSamples] = []
        if signals.sampled:
            from cotree.solvers.sampled_inputs import reaching, with_samples

            signals, samples = with_samples(model, p, signals, t_span)
        u = _input_function(model, p, signals)
        model.set_parameters(p)
        bound, layout = BoundModel(model, t_span[0], p, u), model.layout
        start, reach = self._found_start(bound, initial), None
        if samples:
            # The first samples depend on the start, and the start on the samples.
            reach = reaching(model, p, samples, u)
            reach(t_span[0], start.z)
            bound = BoundModel(model, t_span[0], p, u)
            start = find_start(bound, initial)
        values = {
            **vars(self._template),
            "z0": start.z,
            "reach": reach,
            "note": start.note,
            "native": bound,
            # Governing and sensitivity equations, Eqs. (8) and (9) of the paper, form one system.
            "rhs": bound.augmented_rates if model.sensitivities else bound.rates,
            "jacobian": bound.jacobian,
            "held": bound if self._is_held else None,
            "singular": bound.singular if self._is_held and layout.constraint_edges else None,
            "state_rhs": bound.rates,
            "undefined": bound.undefined,
            "sparse_jacobian": bound.sparse_jacobian if self._has_sparse else None,
            "events": bound if layout.events else None,
            "has_kinks": bool(layout.kinks),
        }
        if samples:
            values |= _replaced_inputs(signals)
        if layout.followers:
            from cotree.model.unknowns import content_sizes

            values["sizes"] = content_sizes(bound, start.y)
        if self._is_step_free:
            values["max_step"] = model.longest_step(p, self.settings.inputs)
        if self._has_time_events:
            values |= self._restarts(p, signals)
        if self._size_of:
            values["scales"] = self._scales(p)
        if start.on_jump:
            raise SolveError(start.on_jump)
        return filled(RunProblem, values)

    def bound(self, p: FloatArray) -> BoundModel | None:
        """Return the model with parameters p if its runs project onto constraints, else None."""
        u = _input_function(self.model, p, self._signals)
        return BoundModel(self.model, self.settings.t_span[0], p, u) if self._is_held else None

    def _found_start(self, at: BoundModel, initial: Mapping[str, float]) -> Start:
        """Return the start of a run, which is computed only once if it is the same for all runs."""
        if initial or not self._has_constant_start:
            return find_start(at, initial)
        found = self._start
        if found is None:
            found = self._start = find_start(at, initial)
        return found

    def _scales(self, p: FloatArray) -> FloatArray:
        values = p.tolist()
        sizes = [abs(values[of] or 1.0) if isinstance(of, int) else of for of in self._size_of]
        return np.array(sizes)

    def _restarts(self, p: FloatArray, signals: ReplacedInputs) -> dict[str, Any]:
        """Return the fields of a problem that describe breakpoints, which depend on parameters."""
        settings, scale, begun = self.settings, self._template.scale, time.perf_counter()
        restarts = self.model.restart_times(
            p, settings.t_span, settings.inputs, signals.breakpoints, settings.time_limit
        )
        return {
            "seconds_taken": time.perf_counter() - begun,
            "scale": max(scale, restarts.scale),
            "breakpoints": restarts.times,
            # Sensitivities jump only at time events that depend on parameters.
            "shifts": restarts.moved,
        }


def _nothing(t: float, z: FloatArray) -> FloatArray:
    """Raise AssertionError: each run must replace the rates of the template."""
    raise AssertionError


def places_of(model: CompiledModel) -> npt.NDArray[np.intp] | None:
    """Return the indices in z of entries that are not identically zero; None if all may vary."""
    n, m = len(model.states), len(model.sensitivities)
    places = np.array(model.layout.sensitivity_places, dtype=np.intp)
    # In z, the sensitivities follow the n states.
    return None if len(places) == n * m else np.concatenate([np.arange(n), n + places])


def n_observed(model: CompiledModel) -> int:
    """Return the number of stored values per point, without states and sensitivities."""
    n_outputs = len(model.outputs) * (1 + len(model.sensitivities))
    return n_outputs + len(model.inputs) + len(model.constraints) + model.layout.n_algebraic


def parameter_sizes(model: CompiledModel, given: Mapping[str, float]) -> list[float | int]:
    """Return the size of each sensitivity parameter: a number, or the index of a parameter.

    An index stands for the parameter's value, or one if this is zero. Initial values have size one.
    """
    places = {name: i for i, name in enumerate(model.parameters)}
    found: list[float | int] = [places.get(name, 1.0) for name in model.sensitivities]
    for name, value in given.items():
        after = ", to which no sensitivity was asked for"
        check_known([name], model.sensitivities, "scales names", after, ParameterError)
        size = check_positive(value, f"the scale of '{name}'")
        found[model.sensitivities.index(name)] = size
    return found


def _check_replaced(model: CompiledModel, inputs: Mapping[str, Any]) -> None:
    """Raise ParameterError if sensitivities depend on an input of the scene that is replaced."""
    for name, value in inputs.items():
        # Two constant inputs both have zero rates, so the sensitivities remain valid.
        is_alike = isinstance(value, Real) and name in model.traits.constant_inputs
        if model.sensitivities and name in model.layout.event_inputs and not is_alike:
            raise ParameterError(
                f"input '{name}' affects when an event occurs, or what it sets, so sensitivities "
                "need the rate of the input: to replace it, compile scene.with_inputs(...), or "
                "compile without sensitivities"
            )
    for name, wanted in zip(model.inputs, model.layout.input_sensitivities, strict=True):
        if name in inputs and wanted:
            raise ParameterError(
                f"input '{name}' depends on '{wanted[0]}' in the scene, and the sensitivity to it "
                f"is compiled in: to replace the input, compile scene.with_inputs(...), or without "
                "that sensitivity"
            )


def _input_function(model: CompiledModel, p: FloatArray, signals: ReplacedInputs) -> Inputs:
    """Return the inputs as a function of time, which returns None for the model's own inputs."""
    if not model.inputs:
        return lambda t: _NONE
    if not signals.by_position:
        return lambda t: None
    own = model.bound("inputs", p)
    # The kernel returns a buffer that its next call overwrites, hence the copy.
    return lambda t: signals.apply(t, own(t, _NONE, _NONE, _NONE).copy())


def _has_sparse_jacobian(model: CompiledModel) -> bool:
    """Return whether the Jacobian is large and has few entries."""
    n = len(model.states)
    # The elimination of algebraic unknowns fills the Jacobian.
    if model.layout.n_algebraic or n <= DENSE_LIMIT:
        return False
    # Factors of matrices with many entries are almost full, so dense factorisation is faster.
    return len(model.layout.row_indices) <= _LARGEST_SHARE * n * n


def _replaced_inputs(signals: ReplacedInputs) -> dict[str, Any]:
    # C evaluates tables itself, but calls Python functions.
    others = {i: f for i, f in signals.by_position.items() if i not in signals.tables}
    return {"replaced": signals.tables, "functions": others}
