"""Damage to texts of any kind, for readers that must answer it with one sentence."""

from __future__ import annotations

import re
import time

import cotree


def damaged(text, rng, damages):
    """Damage a text in one to five places; each way is called with text and random numbers."""
    for _ in range(rng.choice((1, 1, 1, 2, 3, 5))):
        text = rng.choice(damages)(text, rng)
    return text


def _span(text, rng):
    start = rng.randrange(len(text) + 1)
    return start, min(len(text), start + rng.randrange(rng.choice((4, 40, 400))))


def cut(text, rng):
    start, end = _span(text, rng)
    return text[:start] + text[end:]


def repeat(text, rng):
    start, end = _span(text, rng)
    return text[:end] + text[start:end] * rng.choice((1, 1, 2, 20)) + text[end:]


def flip(text, rng):
    at = rng.randrange(max(1, len(text)))
    return text[:at] + chr(rng.choice((rng.randrange(128), rng.randrange(0xD800)))) + text[at + 1 :]


def insert(pieces):
    """Put one of some pieces anywhere."""

    def done(text, rng):
        at = rng.randrange(len(text) + 1)
        return text[:at] + rng.choice(pieces) + text[at:]

    return done


def replaced(text, rng, pattern, made):
    """Put something in the place of one match."""
    found = list(re.finditer(pattern, text))
    if not found:
        return text
    match = rng.choice(found)
    return text[: match.start()] + made + text[match.end() :]


def read_in_time(read, longest, seed):
    """Return the content of a text or the message that refuses it, within a processor time.

    One that took longer is read once more: other work on a machine lengthens these, too.
    """
    for _ in range(2):
        began, scene, message = time.process_time(), None, ""
        try:
            scene = read()
        except cotree.SceneError as error:
            message = str(error)
        seconds = time.process_time() - began
        if seconds < longest:
            break
    assert seconds < longest, seed
    return scene, message
