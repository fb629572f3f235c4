"""A row of a bench before it is complete."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cotree.studies.accuracy import worse
from cotree.studies.bench_row import BenchRow

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.solvers.base import Statistics


@dataclass
class Trial:
    """A method at a tolerance, with what is known of it so far; see :class:`BenchRow`."""

    method: str
    rtol: float
    atol: float
    seconds: list[float] = field(default_factory=list)
    tried: float = math.nan  # how long the first run took, [s]
    errors: tuple[float, float] = (math.nan, math.nan)
    own_errors: tuple[float, float] = (math.nan, math.nan)
    statistics: Statistics | None = None
    status: int = -1
    message: str = ""

    @property
    def stood_in(self) -> bool:
        """Tell whether another method computed it."""
        return self.statistics is not None and self.statistics.method != self.method

    @property
    def error(self) -> float:
        """Give the largest of all errors, infinity where none is known."""
        known = worse(*self.errors, *self.own_errors)
        return math.inf if math.isnan(known) else known

    def row(self) -> BenchRow:
        """Give the row."""
        return BenchRow(
            method=self.method,
            rtol=self.rtol,
            atol=self.atol,
            # The median passes over single runs that the machine has delayed.
            seconds=statistics.median(self.seconds) if self.seconds else math.nan,
            least=min(self.seconds, default=math.nan),
            noise=_noise(self.seconds),
            n_runs=len(self.seconds),
            error_states=self.errors[0],
            error_sensitivities=self.errors[1],
            own_error_states=self.own_errors[0],
            own_error_sensitivities=self.own_errors[1],
            statistics=self.statistics,
            status=self.status,
            message=self.message,
        )


def _noise(seconds: Sequence[float]) -> float:
    """Give how far the lower quartile lies above the least."""
    if not seconds:
        return math.nan
    times = sorted(seconds)
    # What disturbs a run only makes it longer: quick ones say how well the least is known.
    return times[max(1, len(times) // 4) if len(times) > 1 else 0] / times[0] - 1.0
