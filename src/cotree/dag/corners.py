"""Times at which integration restarts, as numbers; :mod:`cotree.dag.time_events` finds them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

    FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RestartTimes:
    """Times at which integration restarts, ascending, with their derivatives along m directions."""

    times: FloatArray
    slopes: FloatArray  # derivatives of the times along each direction
    #: Largest difference of the derivatives among coinciding time events.
    spreads: FloatArray
    #: Largest magnitude of the first time of a periodic event, [s]; it determines the rounding
    #: errors.
    scale: float = 0.0

    def __len__(self) -> int:
        return len(self.times)

    @classmethod
    def none(cls) -> RestartTimes:
        """Return an empty list."""
        return cls(np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)))

    @property
    def moved(self) -> RestartTimes:
        """The time events whose time, or that of a coinciding one, moves along some direction."""
        moves = (self.slopes != 0.0).any(axis=1) | (self.spreads != 0.0).any(axis=1)
        return RestartTimes(self.times[moves], self.slopes[moves], self.spreads[moves], self.scale)

    def rows_at(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return which times are time events, with slopes and spreads (zero for others)."""
        shape = (len(times), self.slopes.shape[1])
        slopes, spreads, places = np.zeros(shape), np.zeros(shape), np.zeros(len(times), bool)
        if len(self):
            near = np.minimum(np.searchsorted(self.times, times), len(self) - 1)
            places = self.times[near] == times
            slopes[places], spreads[places] = self.slopes[near][places], self.spreads[near][places]
        return places, slopes, spreads
