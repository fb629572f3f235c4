"""A model that was compiled with sensitivities, without them: for runs that need states alone.

In: a compiled model. Out: one with the same kernels, whose layout names no sensitivities, so that
whatever asks for these finds none. In C, a run without sensitivities calls kernels of states alone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.model.model import CompiledModel
from cotree.records import changed

if TYPE_CHECKING:
    from cotree.model.arrays import Array
    from cotree.model.kernels import NativeModel


def states_only(model: CompiledModel) -> CompiledModel:
    """Give a model without its sensitivities; itself where it has none."""
    if not model.sensitivities:
        return model
    found: CompiledModel = model.kept.of(StatesOnly, lambda: StatesOnly(model))
    return found


class StatesOnly(CompiledModel):
    """A model without the sensitivities that it was compiled with.

    Parameters
    ----------
    model : CompiledModel
        The model.
    """

    def __init__(self, model: CompiledModel) -> None:
        program = model._program
        layout = replace(
            program.layout,
            sensitivities=(),
            sensitivity_starts=(0,),
            sensitivity_rows=(),
            input_sensitivities=((),) * len(program.layout.inputs),
        )
        super().__init__(replace(program, layout=layout), model._kernels)
        # Threads prepare the same kernels through either model, and both have to know for what.
        self._own = model._own
        rest, n, m = model._rest, len(model.states), len(model.sensitivities)
        if rest is None:
            return

        def states_at_rest(t: float, p: Array, u: Array | None, s: Array) -> tuple[Array, Array]:
            return rest(t, p, u, np.zeros((n, m)))[0], s

        self._rest = states_at_rest

    def initial_sensitivity(self, p: Any = None) -> Array:
        """Give the sensitivities of the initial states, none, shape (n_states, 0)."""
        return np.zeros((len(self.states), 0))

    def native(self, p: Array) -> NativeModel | None:
        """Give the model as C sees it; see :meth:`PreparedKernels.native`."""
        native = super().native(p)
        # The kernel of the states alone may be there where the one with sensitivities is too long.
        return native and changed(native, can_extend=self._program.can_extend)
