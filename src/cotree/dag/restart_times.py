"""Times at which integration restarts, found by :mod:`cotree.dag.time_events`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

    FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RestartTimes:
    """Ascending times at which integration restarts, with derivatives along m directions."""

    times: FloatArray
    slopes: FloatArray  # derivatives of the times along each direction
    #: Largest difference between the derivatives of coinciding time events.
    spreads: FloatArray
    #: Largest magnitude of the first times of periodic events, [s]; it scales rounding errors.
    scale: float = 0.0

    def __len__(self) -> int:
        return len(self.times)

    @classmethod
    def none(cls) -> RestartTimes:
        """Return an instance without times."""
        return cls(np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)))

    @property
    def moved(self) -> RestartTimes:
        """Time events with a nonzero derivative, or coinciding with an event that has one."""
        moves = (self.slopes != 0.0).any(axis=1) | (self.spreads != 0.0).any(axis=1)
        return RestartTimes(self.times[moves], self.slopes[moves], self.spreads[moves], self.scale)

    def rows_at(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return whether each time is a time event, and the slopes and spreads of all times."""
        shape = (len(times), self.slopes.shape[1])
        slopes, spreads, places = np.zeros(shape), np.zeros(shape), np.zeros(len(times), bool)
        if len(self):
            near = np.minimum(np.searchsorted(self.times, times), len(self) - 1)
            places = self.times[near] == times
            slopes[places], spreads[places] = self.slopes[near][places], self.spreads[near][places]
        return places, slopes, spreads
