"""Batching of predictions: threads wait until all have made a request, which one call computes."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.ensemble.interrupts import stopped_by_interrupt

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.estimation.likelihood import Predictions


class Stopped(BaseException):
    """Computation was stopped; a ``BaseException``, so that no handler catches it by accident."""


class Rendezvous:
    """Collects the requests of threads until all active ones are waiting.

    Parameters
    ----------
    compute : callable
        Computes the predictions of a batch, an array with a row for each request. It is called in
        the thread that called :meth:`meet`, which receives Ctrl-C.
    """

    def __init__(self, compute: Callable[[Any], Sequence[Predictions]]) -> None:
        self._compute = compute
        self._changed = threading.Condition()
        self._asked: dict[int, Any] = {}
        self._answers: dict[int, Predictions] = {}
        self._working: set[int] = set()
        self._is_stopped = False

    def ask(self, number: int, theta: Any) -> Predictions:
        """Request predictions from a thread, and wait for them.

        Raises
        ------
        Stopped
            If computation was stopped.
        """
        with self._changed:
            self._asked[number] = np.array(theta, dtype=float)
            self._changed.notify_all()
            self._changed.wait_for(lambda: number in self._answers or self._is_stopped)
            if number in self._answers:
                return self._answers.pop(number)
            raise Stopped

    def meet(self, works: Sequence[Callable[[], None]], report: Callable[[int, int], None]) -> bool:
        """Run functions, each in its own thread, until all have returned.

        Parameters
        ----------
        works : sequence of callable
            The functions, which call :meth:`ask` with their number.
        report : callable
            Called after each batch with the numbers of functions that have returned and of
            predictions computed.

        Returns
        -------
        bool
            Whether Ctrl-C was pressed, upon which all functions were stopped.
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
                    report(len(works) - len(self._working), n_computed)
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
        """Wait until all active threads have made a request; tell whether there are any."""
        with self._changed:
            self._changed.wait_for(lambda: len(self._asked) == len(self._working))
            return bool(self._working)

    def _answer(self, found: dict[int, Predictions]) -> None:
        with self._changed:
            self._asked.clear()
            self._answers.update(found)
            self._changed.notify_all()
