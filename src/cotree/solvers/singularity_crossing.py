"""Passing singular configurations, where constraints lose rank and steps shrink towards nothing.

Near such a configuration accelerations at points off the constraints grow like the inverse of the
distance to it, and the error test would shorten steps towards it without end. That is why the
right-hand side of a constrained motion is evaluated at projected points. At the tightest
tolerances rounding, enlarged in the same way, does it still: then a stretch as long as an ordinary
step is crossed with a looser tolerance.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.solvers.job import Job
    from cotree.solvers.problem import Problem

# Steps below this share of the longest of the last ones are short: those of methods with a memory
# vary more.
_SHORT = {False: 0.3, True: 0.03}

# So many short steps in a row are no accident of the step size control.
_MANY = 15

_REMEMBERED = 40

#: How much looser the tolerance is over the stretch that crosses a singular configuration, and at
#: most, so that rounding, enlarged by the inverse of the distance, no longer decides.
LOOSENED, LOOSEST = 1e3, 1e-9


class Passage:
    """Watches the steps of a constrained motion; it is mutable and belongs to one integration.

    Attributes
    ----------
    crossed : list of float
        Times where a stretch was crossed with a looser tolerance, [s].
    names : tuple of str
        The edges whose constraints lose rank there.
    lost : tuple of str
        The same where the run ended.
    """

    def __init__(self) -> None:
        self.crossed: list[float] = []
        self.names: tuple[str, ...] = ()
        self.lost: tuple[str, ...] = ()
        self._steps: deque[float] = deque(maxlen=_REMEMBERED)
        self._short = 0

    def restarted(self) -> None:
        """Forget the steps: a method with a memory begins anew with short ones."""
        self._steps.clear()
        self._short = 0

    def watch(self, step: float, has_memory: bool) -> None:
        """Take note of the length of a step, [s]."""
        is_short = step < _SHORT[has_memory] * self.longest
        self._short = self._short + 1 if is_short else 0
        # Short steps are left out, or `longest` would shrink along with them.
        if not is_short:
            self._steps.append(step)

    @property
    def longest(self) -> float:
        """Length of an ordinary step, [s]."""
        return max(self._steps, default=0.0)

    @property
    def is_stuck(self) -> bool:
        """Whether steps stay short."""
        return self._short >= _MANY

    def cross(self, t: float, names: tuple[str, ...]) -> None:
        """Note that a stretch is being crossed, and the edges whose constraints lose rank."""
        self.crossed.append(t)
        self.names = tuple(dict.fromkeys((*self.names, *names)))
        self._short = 0

    def summary(self) -> str:
        """Say what was crossed, and what ended the run; nothing where nothing was."""
        return " ".join(crossing_sentences(self.crossed, self.names, self.lost))


def singular_positions(problem: Problem, job: Job, *, has_failed: bool) -> list[str]:
    """Return sentences on the singular positions that a job in C crossed, or at which it failed."""
    if problem.singular is None:
        return []
    names = tuple(name for t, y in job.crossings for name in problem.singular(t, y))
    lost = problem.singular(float(job.job.t), job.z) if has_failed else ()
    return crossing_sentences([t for t, _ in job.crossings], tuple(dict.fromkeys(names)), lost)


def crossing_sentences(
    crossed: Sequence[float], names: tuple[str, ...], lost: tuple[str, ...]
) -> list[str]:
    """Return sentences on singular positions.

    Parameters
    ----------
    crossed : sequence of float
        Times where stretches with a looser tolerance began, [s].
    names : tuple of str
        The edges whose constraints lose rank there.
    lost : tuple of str
        The same at a position at which a run failed.
    """
    sentences = []
    if lost:
        sentences.append(
            f"There the constraints of {_listed(lost)} nearly lose rank, which enlarges "
            "rounding, most of all in sensitivities: loosen rtol."
        )
    if crossed:
        places = ", ".join(f"{t:.6g}" for t in crossed[:4])
        more = ", ..." if len(crossed) > 4 else ""
        sentences.append(
            f"Singular configurations were crossed with a looser tolerance after t = {places}"
            f"{more}: there the constraints of {_listed(names)} lose rank."
        )
    return sentences


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(f"'{name}'" for name in names)
