"""Thousands of damaged netlists: each gives a scene, or one sentence with file and line."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest
from damage import cut, damaged, flip, insert, read_in_time, repeat, replaced

import cotree
from cotree.api import Scene
from cotree.pipeline import formulate
from cotree.readers.spice.scene import read_spice_text

NETLISTS = sorted((Path(__file__).parent / "netlists").glob("*.cir"))

NASTY = (
    *("", "0", "-1", "nan", "inf", "1e308", "1e999", "-1e-320", "0x10", "1_0", "1meg", "3mil"),
    *("é", "١", "\x00", "\ufffe", " ", "\t", "\n", "\r\n", "\n+", "\n*", "\n.end\n", ";", "$ x"),
    *("{", "}", "{}", "{1/0}", "{a**b}", "{2**99999}", "{9**9**9**9}", "'", "''", "=", "==", "("),
    *("__import__('os')", "{__import__}", "lambda", "%s", "${x}", "a" * 700, "../../x", "ground"),
    *("\n.include /etc/passwd\n", "\n.lib x\n", "\n.subckt a b\n", "\n.ends\n", "\nX1 a b a\n"),
    *("\n.param p={p}\n", "\n.param p=1\n", "\n.model m D(\n", "\n.tran 1 1\n", " uic", " ic=1"),
    *("\n.subckt s a b\nX1 a b s\nX2 a b s\n.ends\nX9 1 2 s\n", "\nK9 L1 L1 1\n", "\nB1 a 0 v=1\n"),
    *("\nK8 L1 L2 0.1\n", " m=2", " POLY(2) a 0 b 0 1 2 3\n", "POLY"),
)
_LONGEST_TIME = 3.0  # seconds; a netlist of this size takes a few milliseconds


def _word(text, rng):
    words = re.findall(r"[^\s(),={}]+", text) or ["x"]
    return replaced(text, rng, r"[^\s(),={}]+", rng.choice((*words, rng.choice(NASTY))))


def _number(text, rng):
    made = rng.choice((*NASTY[:12], str(rng.uniform(-5, 5)), "1e-9"))
    return replaced(text, rng, r"\d+\.?\d*", made)


def _line(text, rng):
    lines = text.split("\n")
    row = lines.pop(rng.randrange(len(lines)))
    if rng.random() < 0.7:
        lines.insert(rng.randrange(len(lines) + 1), row)
    return "\n".join(lines)


_DAMAGES = (cut, repeat, *[insert(NASTY)] * 2, flip, _word, _word, _line, _number)


def check(seed, sources):
    """Read a damaged netlist; give the scene, or None for a sentence."""
    rng = random.Random(seed)
    text = damaged(rng.choice(sources), rng, _DAMAGES)
    scene, message = read_in_time(
        lambda: read_spice_text(text, "damaged.cir", Scene), _LONGEST_TIME, seed
    )
    if scene is None:
        assert re.match(r"damaged\.cir:\d+: \S", message), (seed, message)
        assert len(message) < 1000, (seed, message)
    assert "\n" not in message + "".join(scene.origin.notes if scene else ()), (seed, message)
    return scene


def check_range(seeds, n_formed):
    sources = [path.read_text() for path in NETLISTS]
    scenes = [(seed, scene) for seed in seeds if (scene := check(seed, sources)) is not None]
    # Damage that nothing notices and damage that is refused must both be there in number.
    assert 0.1 < len(scenes) / len(seeds) < 0.9
    small = [row for row in scenes if len(row[1].edges) < 12][:n_formed]
    messages = []
    for seed, scene in small:  # what was read gives equations, or one of cotree's own errors
        try:
            formulate(scene, [], None)
        except cotree.Error as error:
            messages.append((seed, str(error)))
    assert [row for row in messages if "\n" in row[1]] == []


@pytest.mark.slow
def test_damaged_netlists():
    check_range(range(2_000), 20)


@pytest.mark.slow
@pytest.mark.campaign
def test_many_damaged_netlists():
    check_range(range(10_000, 20_000), 200)


def test_bytes_that_are_no_text(tmp_path):
    """Bytes that cannot be decoded are refused with their line."""
    path = tmp_path / "damaged.cir"
    path.write_bytes(b"title\nR1 a 0 1\nR2 \xff 0 1\n")
    with pytest.raises(cotree.SceneError, match=r"damaged\.cir:3: not a text"):
        cotree.read_spice(path)
