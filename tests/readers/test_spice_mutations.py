"""Thousands of damaged netlists: each gives a scene, or one sentence with file and line."""

from __future__ import annotations

import random
import re
import time
from pathlib import Path

import pytest

import cotree
from cotree.api import Scene
from cotree.pipeline import formulate
from cotree.readers.spice import read_spice_text

NETLISTS = sorted((Path(__file__).parent / "netlists").glob("*.cir"))

NASTY = (
    *("", "0", "-1", "nan", "inf", "1e308", "1e999", "-1e-320", "0x10", "1_0", "1meg", "3mil"),
    *("é", "١", "\x00", "\ufffe", " ", "\t", "\n", "\r\n", "\n+", "\n*", "\n.end\n", ";", "$ x"),
    *("{", "}", "{}", "{1/0}", "{a**b}", "{2**99999}", "{9**9**9**9}", "'", "''", "=", "==", "("),
    *("__import__('os')", "{__import__}", "lambda", "%s", "${x}", "a" * 700, "../../x", "ground"),
    *("\n.include /etc/passwd\n", "\n.lib x\n", "\n.subckt a b\n", "\n.ends\n", "\nX1 a b a\n"),
    *("\n.param p={p}\n", "\n.param p=1\n", "\n.model m D(\n", "\n.tran 1 1\n", " uic", " ic=1"),
    *("\n.subckt s a b\nX1 a b s\nX2 a b s\n.ends\nX9 1 2 s\n", "\nK9 L1 L1 1\n", "\nB1 a 0 v=1\n"),
)
_LONGEST_TIME = 3.0  # seconds; a netlist of this size takes a few milliseconds


def damaged(text, rng):
    """Damage a text in one to five places."""
    for _ in range(rng.choice((1, 1, 1, 2, 3, 5))):
        text = rng.choice((_cut, _repeat, _insert, _insert, _flip, _word, _word, _line, _number))(
            text, rng
        )
    return text


def _span(text, rng):
    start = rng.randrange(len(text) + 1)
    return start, min(len(text), start + rng.randrange(rng.choice((4, 40, 400))))


def _cut(text, rng):
    start, end = _span(text, rng)
    return text[:start] + text[end:]


def _repeat(text, rng):
    start, end = _span(text, rng)
    return text[:end] + text[start:end] * rng.choice((1, 1, 2, 20)) + text[end:]


def _insert(text, rng):
    at = rng.randrange(len(text) + 1)
    return text[:at] + rng.choice(NASTY) + text[at:]


def _flip(text, rng):
    at = rng.randrange(max(1, len(text)))
    return text[:at] + chr(rng.choice((rng.randrange(128), rng.randrange(0xD800)))) + text[at + 1 :]


def _replaced(text, rng, pattern, made):
    found = list(re.finditer(pattern, text))
    if not found:
        return text
    match = rng.choice(found)
    return text[: match.start()] + made + text[match.end() :]


def _word(text, rng):
    words = re.findall(r"[^\s(),={}]+", text) or ["x"]
    return _replaced(text, rng, r"[^\s(),={}]+", rng.choice((*words, rng.choice(NASTY))))


def _number(text, rng):
    made = rng.choice((*NASTY[:12], str(rng.uniform(-5, 5)), "1e-9"))
    return _replaced(text, rng, r"\d+\.?\d*", made)


def _line(text, rng):
    lines = text.split("\n")
    row = lines.pop(rng.randrange(len(lines)))
    if rng.random() < 0.7:
        lines.insert(rng.randrange(len(lines) + 1), row)
    return "\n".join(lines)


def check(seed, sources):
    """Read a damaged netlist; give the scene, or None for a sentence."""
    rng = random.Random(seed)
    text = damaged(rng.choice(sources), rng)
    began, scene, message = time.process_time(), None, ""
    try:
        scene = read_spice_text(text, "damaged.cir", Scene)
    except cotree.SceneError as error:
        message = str(error)
    assert time.process_time() - began < _LONGEST_TIME, seed
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


def test_damaged_netlists():
    check_range(range(2_000), 20)


@pytest.mark.slow
def test_many_damaged_netlists():
    check_range(range(10_000, 20_000), 200)


def test_bytes_that_are_no_text(tmp_path):
    """What cannot be decoded is refused with its line too."""
    path = tmp_path / "damaged.cir"
    path.write_bytes(b"title\nR1 a 0 1\nR2 \xff 0 1\n")
    with pytest.raises(cotree.SceneError, match=r"damaged\.cir:3: not a text"):
        cotree.read_spice(path)
