"""Options of an FMU, checked before anything is formed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.codegen.integrators import INTEGRATORS
from cotree.errors import CodegenError, nearest

if TYPE_CHECKING:
    from collections.abc import Sequence

VERSIONS = (2, 3)
KINDS = ("ModelExchange", "CoSimulation")


@dataclass(frozen=True)
class FmuChoice:
    """Options of an FMU.

    Attributes
    ----------
    version : int
        2 or 3, the version of the interface.
    kinds : tuple of str
        Of ``KINDS``.
    integrator : str or None
        Of Co-Simulation; None for one that suits the model.
    inputs : tuple of str or None
        Inputs that are set from outside; None for those that are constants in the scene.
    platforms : tuple of str or None
        Platforms of its libraries; None for this machine.
    """

    version: int = 3
    kinds: tuple[str, ...] = KINDS
    integrator: str | None = None
    inputs: tuple[str, ...] | None = None
    platforms: tuple[str, ...] | None = None


def choose(
    version: int,
    kinds: Sequence[str] | str,
    integrator: str | None,
    inputs: Sequence[str] | None,
    platforms: Sequence[str] | None,
) -> FmuChoice:
    """Take a choice, or refuse it.

    Raises
    ------
    CodegenError
        If there is no such version, kind or integrator.
    """
    wanted = (kinds,) if isinstance(kinds, str) else tuple(kinds)
    if version not in VERSIONS or isinstance(version, bool):
        raise CodegenError(f"there is no FMI {version} here: give version 2 or 3")
    for kind in wanted:
        if kind not in KINDS:
            raise CodegenError(f"there is no kind of FMU '{kind}'{nearest(str(kind), KINDS)}")
    if not wanted:
        raise CodegenError("an FMU needs a kind: give ModelExchange, CoSimulation or both")
    if integrator is not None and integrator not in INTEGRATORS:
        raise CodegenError(
            f"an FMU cannot have the integrator '{integrator}'{nearest(integrator, INTEGRATORS)}"
        )
    return FmuChoice(
        version,
        tuple(kind for kind in KINDS if kind in wanted),
        integrator,
        None if inputs is None else _listed(inputs),
        None if platforms is None else _listed(platforms),
    )


def _listed(names: Sequence[str] | str) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)
