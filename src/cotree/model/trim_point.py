"""The result of trimming: values, derivatives and linearisation of an equilibrium or steady motion.

Derivatives follow from the conditions F(z, p) = 0 on the unknowns z: dz/dp = -F_z^+ F_p.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cotree.errors import ParameterError, brief, listed, nearest
from cotree.markup import labelled
from cotree.model.variation import Direction
from cotree.scene.given import check_names

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.model.arrays import Array
    from cotree.model.linearization import Linearization
    from cotree.model.linearize import Linearizer
    from cotree.model.model import CompiledModel
    from cotree.model.moment import Moment


class Conditions(NamedTuple):
    """The conditions on a point; see :meth:`cotree.Model.trim`."""

    solve: Sequence[str]
    fixed: Mapping[str, float]
    rates: Mapping[str, float | None]
    outputs: Mapping[str, float]
    guess: Mapping[str, float]


@dataclass(frozen=True, eq=False, repr=False)
class TrimPoint:
    """An equilibrium, or a point of a steady motion; a value by name is ``point["tau"]``.

    Attributes
    ----------
    model : cotree.Model
        The model.
    at : Moment
        Time, parameters and inputs.
    y : ndarray, shape (n_states,)
        States.
    unknowns : tuple of str
        Names of the unknowns.
    undetermined : tuple of tuple of str
        For each direction in which the point can move without violating the conditions, the
        unknowns involved. They stay close to the guess.
    residual : float
        The largest residual of the conditions, in their units.
    """

    model: CompiledModel
    at: Moment
    y: Array
    unknowns: tuple[str, ...]
    undetermined: tuple[tuple[str, ...], ...]
    residual: float
    places: tuple[tuple[str, int], ...] = field(default=())
    rows: tuple[int, ...] = field(default=())
    inverse: Array = field(default_factory=lambda: np.zeros((0, 0)))
    linearizer: Linearizer | None = None

    @property
    def t(self) -> float:
        """The time, [s]."""
        return self.at.t

    @property
    def p(self) -> Array:
        """The parameters, shape (n_parameters,)."""
        return self.at.p

    @property
    def u(self) -> Array:
        """The inputs, shape (n_inputs,)."""
        return self.at.inputs

    @property
    def is_unique(self) -> bool:
        """Whether the solution is locally unique."""
        return not self.undetermined

    @property
    def settings(self) -> dict[str, Any]:
        """Arguments of runs that start here: ``model.simulate((0, 1), **point.settings)``."""
        return {
            "initial": dict(zip(self.model.states, self.y.tolist(), strict=True)),
            "parameters": dict(zip(self.model.parameters, self.p.tolist(), strict=True)),
            "inputs": dict(zip(self.model.inputs, self.u.tolist(), strict=True)),
        }

    def __getitem__(self, name: str) -> float:
        """Return a state, input, parameter or output by name.

        Raises
        ------
        ParameterError
            If the name is unknown.
        """
        model = self.model
        groups = ((model.states, self.y), (model.inputs, self.u), (model.parameters, self.p))
        for names, values in groups:
            if name in names:
                return float(values[names.index(name)])
        if name in model.outputs:
            found = self.at.call("outputs", self.y)
            return float(found[model.outputs.index(name)])
        known = [*model.states, *model.inputs, *model.parameters, *model.outputs]
        raise ParameterError(
            f"the model has no variable or parameter '{brief(name)}'{nearest(name, known)}"
        )

    def linearize(
        self, *, reduced: bool = False, sensitivities: Sequence[str] | str = ()
    ) -> Linearization:
        """Linearise about the point; see :meth:`cotree.Model.linearize`.

        Derivatives by parameters are total: the unknowns change with the parameter such that the
        conditions remain satisfied.

        Parameters
        ----------
        reduced : bool
            Whether to linearise in independent deviations.
        sensitivities : sequence of str
            Names, other than unknowns, to differentiate A, B, C and D by.
        """
        names = check_names(sensitivities, "sensitivities")
        directions = {name: self._direction(name) for name in names}
        assert self.linearizer is not None
        return self.linearizer.about(self.at, self.y, reduced=reduced, directions=directions)

    def sensitivity(self, name: str, to: str) -> float:
        """Return the derivative of an unknown by a given parameter, input or state.

        Raises
        ------
        ParameterError
            If ``name`` is not an unknown, or ``to`` is one.
        """
        if name not in self.unknowns:
            raise ParameterError(f"'{brief(name)}' is not an unknown{nearest(name, self.unknowns)}")
        return float(self._moved(to)[0][self.unknowns.index(name)])

    def _moved(self, name: str) -> tuple[Array, Direction]:
        """Return the derivatives of the unknowns by a name, and its direction alone."""
        from cotree.model.trim import all_slopes, by_parameter

        model, at = self.model, self.at
        assert self.linearizer is not None
        y, u, p = (np.zeros(len(x)) for x in (model.states, model.inputs, model.parameters))
        if name in self.unknowns:
            raise ParameterError(
                f"'{name}' is an unknown: differentiate by a given quantity instead"
            )
        if name in model.parameters:
            place = model.parameters.index(name)
            p[place] = 1.0
            if at.u is None:
                u = self.linearizer.inputs_by_parameters(at, p)
            changed = by_parameter(self.linearizer, at, self.y, place)
        elif name in model.inputs:
            place = model.inputs.index(name)
            u[place] = 1.0
            changed = all_slopes(self.linearizer, at, self.y)[1][:, place]
        elif name in model.states:
            place = model.states.index(name)
            y[place] = 1.0
            changed = all_slopes(self.linearizer, at, self.y)[0][:, place]
        else:
            known = [*model.parameters, *model.inputs, *model.states]
            raise ParameterError(
                f"'{brief(name)}' is no tunable parameter, input or state of the model"
                f"{nearest(name, known)}"
            )
        return -self.inverse @ changed[list(self.rows)], Direction(y, u, p)

    def _direction(self, name: str) -> Direction:
        """Return the total derivative of the point by a name."""
        moved, found = self._moved(name)
        by_kind = {"y": found.y, "u": found.u, "p": found.p}
        for (kind, i), change in zip(self.places, moved, strict=True):
            by_kind[kind][i] = change
        return found

    def summary(self) -> str:
        """Describe whether the point is locally unique."""
        if self.is_unique:
            return "locally unique"
        parts = [
            f"'{names[0]}' may have any value" if len(names) == 1 else _together(names)
            for names in self.undetermined
        ]
        return f"not locally unique: {listed(parts)}"

    def __repr__(self) -> str:
        values = [(name, f"{self[name]:.8g}") for name in self.unknowns]
        shown = values[:12] + ([("...", f"{len(values) - 12} more")] if len(values) > 12 else [])
        return labelled(
            f"TrimPoint of {self.model.layout.name}",
            [
                ("point", self.summary()),
                *shown,
                ("residual", f"{self.residual:.2g}"),
            ],
        )


def _together(names: Sequence[str]) -> str:
    return f"{listed(repr(name) for name in names)} may change together"
