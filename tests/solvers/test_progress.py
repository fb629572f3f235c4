from __future__ import annotations

import io
import sys
import time

import pytest

from cotree.solvers.budgets import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_a_bar_on_terminals_only(monkeypatch, stream):
    monkeypatch.setattr(sys, "stderr", stream())
    monkeypatch.setattr("cotree.solvers.budgets.PATIENCE", 0.0)
    monkeypatch.setattr("cotree.solvers.budgets._REFRESH", 0.0)
    with Progress("dop853", (2.0, 0.0)) as progress:
        progress.reached(1.5)
        progress.reached(1.0)
        time.sleep(0.02)
    shown = sys.stderr.getvalue()
    assert ("dop853" in shown) == (stream is Terminal)


def test_short_runs_show_nothing(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    with Progress("dop853", (0.0, 1.0)) as progress:
        progress.reached(0.5)
    assert sys.stderr.getvalue() == ""
