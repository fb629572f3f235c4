"""The engine that a command line asks for, guessed before its packages are imported."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from cotree import cli
from cotree.model.kernels import load_columns
from cotree.solvers import engine


@pytest.fixture
def begun(monkeypatch):
    """Methods whose engines were begun."""
    found = []
    monkeypatch.setattr(engine, "build_ahead", lambda method, has_events: found.append(method))
    return found


@pytest.mark.parametrize(
    ("line", "method"),
    [
        ("run slider-pendulum", "auto"),
        ("run slider-pendulum --method rodas5", "rodas5"),
        ("--base free run --method=dopri5 slider-pendulum -s L", "dopri5"),
    ],
)
def test_the_engine_of_a_run_is_begun(begun, line, method):
    cli.begin_engine(line.split())
    assert begun == [method]


@pytest.mark.parametrize(
    "line",
    ["", "run", "check slider-pendulum", "run slider-pendulm", "run slider-pendulum --help"],
)
def test_no_other_line_begins_one(begun, line):
    cli.begin_engine(line.split())
    assert begun == []


@pytest.mark.parametrize(
    ("text", "methods"),
    [
        ("", ["auto"]),
        ('[simulation]\nmethod = "rodas5"', ["rodas5"]),
        ("[simulation]\nmethod = 5", []),
        ("simulation = 5", []),
        ("[simulation", []),
    ],
)
def test_the_method_of_a_file_is_read(begun, tmp_path, text, methods):
    file = tmp_path / "scene.toml"
    file.write_text(text)
    cli.begin_engine(["run", str(file)])
    assert begun == methods


def test_a_program_may_end_while_engines_are_built(tmp_path):
    """The thread ends silently when Python shuts down."""
    script = "from cotree.solvers.engine import build_ahead; build_ahead('auto')"
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, "XDG_CACHE_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""


def test_the_guess_imports_little():
    """Whatever it imports, the compiler waits for."""
    script = "import sys, cotree.cli; print('numpy' in sys.modules, 'click' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["False", "False"]


@pytest.mark.compiler
def test_engine_and_sweep_are_there_when_the_thread_has_ended(monkeypatch):
    asked = []
    monkeypatch.setattr(engine, "load_engine", lambda stepper, has_events: asked.append(stepper))
    engine._prepare(["dop853"], (), has_events=True)
    assert asked == ["dop853"]
    assert load_columns() is not None
