"""Rates of a model as an external function of CasADi."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import ParameterError

if TYPE_CHECKING:
    from cotree.model.rates import Rates


def casadi_function(rates: Rates) -> Any:
    """Make a ``casadi.Callback`` with arguments x, u and p, and result dx.

    Parameters
    ----------
    rates : Rates
        The function.

    Raises
    ------
    ParameterError
        If the package is missing.
    """
    try:
        casadi: Any = import_module("casadi")
    except ImportError:
        raise ParameterError(
            "as_casadi() needs the package casadi: run `pip install casadi` (the extra "
            "cotree[casadi])"
        ) from None

    sizes, names = rates.sizes, ("x", "u", "p")
    n = sizes[0]

    class Jacobian(casadi.Callback):  # type: ignore[misc]
        """The derivatives by each argument; CasADi passes the value, too."""

        def __init__(self, name: str, given: list[str], results: list[str], options: Any) -> None:
            super().__init__()
            self._names = given, results
            self.construct(name, options)

        def get_n_in(self) -> int:
            return 4

        def get_n_out(self) -> int:
            return 3

        def get_name_in(self, i: int) -> str:
            return self._names[0][i]

        def get_name_out(self, i: int) -> str:
            return self._names[1][i]

        def get_sparsity_in(self, i: int) -> Any:
            # The value is not read.
            return casadi.Sparsity.dense(sizes[i], 1) if i < 3 else casadi.Sparsity(n, 1)

        def get_sparsity_out(self, i: int) -> Any:
            return casadi.Sparsity.dense(n, sizes[i])

        def eval(self, arg: Any) -> Any:
            return [casadi.DM(block) for block in rates.derivatives(*map(_flat, arg[:3]))]

    class Function(casadi.Callback):  # type: ignore[misc]
        """The rates."""

        def __init__(self) -> None:
            super().__init__()
            self._jacobian: Any = None
            self.construct("rates")

        def get_n_in(self) -> int:
            return 3

        def get_n_out(self) -> int:
            return 1

        def get_name_in(self, i: int) -> str:
            return names[i]

        def get_name_out(self, i: int) -> str:
            return "dx"

        def get_sparsity_in(self, i: int) -> Any:
            return casadi.Sparsity.dense(sizes[i], 1)

        def get_sparsity_out(self, i: int) -> Any:
            return casadi.Sparsity.dense(n, 1)

        def eval(self, arg: Any) -> Any:
            return [casadi.DM(rates(*map(_flat, arg)))]

        def has_jacobian(self) -> bool:
            return True

        def get_jacobian(self, name: str, given: Any, results: Any, options: Any) -> Any:
            # Kept: CasADi does not own what it is given.
            self._jacobian = Jacobian(name, list(given), list(results), options)
            return self._jacobian

    return Function()


def _flat(value: Any) -> Any:
    return np.asarray(value.full(), dtype=float).ravel()
