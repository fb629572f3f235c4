"""The FMU of a compiled model, as :meth:`cotree.Model.export_fmu` writes it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cotree.export.evaluated import Evaluated
from cotree.export.fmu.write import FmuChoice, check_choice, write_fmu
from cotree.sharing import forming

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.compiled import Model
    from cotree.export.fmu.write import Fmu


def export_fmu(
    model: Model,
    path: str | Path,
    version: int,
    kinds: Sequence[str],
    integrator: str | None,
    inputs: Sequence[str] | None,
    platforms: Sequence[str] | None,
) -> Fmu:
    """Write a model as an FMU; see :meth:`cotree.Model.export_fmu`."""
    kinds = (kinds,) if isinstance(kinds, str) else tuple(kinds)
    choice = check_choice(
        FmuChoice(
            version,
            kinds,
            integrator,
            None if inputs is None else tuple(inputs),
            None if platforms is None else tuple(platforms),
        )
    )
    defaults = model._recipe.defaults
    numbers = {"t_end": defaults.t_end, "rtol": defaults.rtol, "atol": defaults.atol}
    rest = model.start() if model.begins_at_rest else None
    with forming:
        evaluated = Evaluated(model._program)
        return write_fmu(model._program, Path(path), choice, evaluated, **numbers, rest=rest)
