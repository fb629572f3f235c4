"""Rates of a model as a function of JAX."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import ParameterError

if TYPE_CHECKING:
    from cotree.model.rates import Rates


def jax_function(rates: Rates) -> Any:
    """Make a function of JAX with arguments x, u and p.

    It may be compiled, mapped over points and differentiated, forwards and backwards, once: its
    derivatives are values of C, which JAX cannot differentiate any further.

    Parameters
    ----------
    rates : Rates
        The function.

    Raises
    ------
    ParameterError
        If the package is missing, or computes in single precision.
    """
    try:
        jax: Any = import_module("jax")
    except ImportError:
        raise ParameterError(
            "as_jax() needs the package jax: run `pip install jax` (the extra cotree[jax])"
        ) from None
    if not jax.config.jax_enable_x64:
        raise ParameterError(
            "as_jax() computes in double precision, which JAX leaves off: call "
            'jax.config.update("jax_enable_x64", True) first'
        )
    numbers, n = jax.numpy, rates.sizes[0]
    value = jax.ShapeDtypeStruct((n,), np.float64)
    blocks = tuple(jax.ShapeDtypeStruct((n, size), np.float64) for size in rates.sizes)

    def evaluate(x: Any, u: Any, p: Any) -> Any:
        return rates(*map(_as_vector, (x, u, p)))

    def derive(x: Any, u: Any, p: Any) -> Any:
        return rates.derivatives(*map(_as_vector, (x, u, p)))

    def evaluated(x: Any, u: Any, p: Any) -> Any:
        return jax.pure_callback(evaluate, value, x, u, p, vmap_method="sequential")

    function: Any = jax.custom_jvp(evaluated)

    def jvp(primals: Any, tangents: Any) -> Any:
        found = jax.pure_callback(derive, blocks, *primals, vmap_method="sequential")
        change = sum(block @ tangent for block, tangent in zip(found, tangents, strict=True))
        return function(*primals), change

    function.defjvp(jvp)

    def called(x: Any, u: Any = (), p: Any = None) -> Any:
        given = rates.values if p is None else p
        return function(*(numbers.asarray(row, dtype=np.float64) for row in (x, u, given)))

    return called


def _as_vector(value: Any) -> Any:
    return np.asarray(value, dtype=float).ravel()
