"""Kernels that leave vanishing sensitivities out, with all of them for those who call.

In: the pattern of sensitivities. Out: a kernel of full arrays, with zeros in their places.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.program.kernels import KERNELS

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.model.arrays import Array
    from cotree.model.kernels import Kernels
    from cotree.program import Layout


def whole_kernel(
    kernels: Kernels, layout: Layout, name: str
) -> Callable[[float, Array, Array, Array], Array]:
    """Give a kernel as a function of time, states, all sensitivities and inputs.

    Parameters
    ----------
    kernels : Kernels
        The model's.
    layout : Layout
        Its patterns.
    name : str
        A name in ``KERNELS``.

    Returns
    -------
    callable
        Its result is a buffer: copy it to keep it.
    """
    n_all = len(layout.states) * len(layout.sensitivities)
    # Kernels without packed arguments are called as they are, at no cost.
    if not KERNELS[name].is_packed or len(layout.sensitivity_rows) == n_all:
        return lambda t, x, s, u: kernels(name, t, x, s, u)
    places = np.array(layout.sensitivity_places, dtype=np.intp)

    def call(t: float, x: Array, s: Array, u: Array) -> Array:
        packed = kernels(name, t, x, s[places], u)
        # Augmented kernels give the rates of the states first, then those of sensitivities.
        n_lead = len(packed) - len(places)
        whole = np.zeros(n_lead + n_all)
        whole[:n_lead] = packed[:n_lead]
        whole[n_lead + places] = packed[n_lead:]
        return whole

    return call
