"""A meeting point of threads, each of which asks for predictions: all are computed in one call."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.ensemble.interrupts import stopped_by_interrupt

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.estimation.likelihood import Predictions


class Stopped(BaseException):
    """Nothing is computed any more; no error, so that nothing catches it by accident."""


class Rendezvous:
    """Gathers what threads ask for, until all that still work have asked.

    Parameters
    ----------
    compute : callable
        Gives an answer for each of several questions, an array with a row for each; it is called in
        the thread that waits for the others, to which Ctrl-C comes.
    """

    def __init__(self, compute: Callable[[Any], Sequence[Predictions]]) -> None:
        self._compute = compute
        self._changed = threading.Condition()
        self._asked: dict[int, Any] = {}
        self._answers: dict[int, Predictions] = {}
        self._working: set[int] = set()
        self._is_stopped = False

    def ask(self, number: int, theta: Any) -> Predictions:
        """Ask from a thread, and wait for the answer.

        Raises
        ------
        Stopped
            If nothing is computed any more.
        """
        with self._changed:
            self._asked[number] = np.array(theta, dtype=float)
            self._changed.notify_all()
            self._changed.wait_for(lambda: number in self._answers or self._is_stopped)
            if number in self._answers:
                return self._answers.pop(number)
            raise Stopped

    def meet(self, works: Sequence[Callable[[], None]], told: Callable[[int, int], None]) -> bool:
        """Let functions work, each in its own thread, until all have ended.

        Parameters
        ----------
        works : sequence of callable
            They call :meth:`ask` with their number.
        told : callable
            Called after each computation with the number of functions that have ended, and of
            predictions.

        Returns
        -------
        bool
            Whether Ctrl-C came, after which all of them were stopped.
        """
        self._working = set(range(len(works)))
        errors: list[BaseException] = []
        threads = [
            threading.Thread(target=self._work, args=(i, work, errors), daemon=True)
            for i, work in enumerate(works)
        ]
        n_computed = 0
        with stopped_by_interrupt() as stop:
            try:
                for thread in threads:
                    thread.start()
                while self._gathered() and not stop.is_set():
                    numbers = sorted(self._asked)
                    found = self._compute(np.array([self._asked[i] for i in numbers]))
                    n_computed += len(numbers)
                    self._answer(dict(zip(numbers, found, strict=True)))
                    told(len(works) - len(self._working), n_computed)
            finally:
                with self._changed:
                    self._is_stopped = True
                    self._changed.notify_all()
                for thread in threads:
                    if thread.ident is not None:
                        thread.join()
            if errors:
                raise errors[0]
            return stop.is_set()

    def _work(self, number: int, work: Callable[[], None], errors: list[BaseException]) -> None:
        try:
            work()
        except BaseException as error:
            errors.append(error)
        finally:
            with self._changed:
                self._working.discard(number)
                self._changed.notify_all()

    def _gathered(self) -> bool:
        """Wait until all that work have asked; say whether any does."""
        with self._changed:
            self._changed.wait_for(lambda: len(self._asked) == len(self._working))
            return bool(self._working)

    def _answer(self, found: dict[int, Predictions]) -> None:
        with self._changed:
            self._asked.clear()
            self._answers.update(found)
            self._changed.notify_all()
