"""Damaged models: each gives a scene, or one sentence with the file."""

from __future__ import annotations

import random
import re

import pytest
from damage import cut, damaged, flip, insert, read_in_time, repeat, replaced
from sbml_texts import whole_text

import cotree
from cotree.api import Scene
from cotree.pipeline import formulate

pytest.importorskip("libsbml")

from cotree.readers.sbml.scene import read_sbml_text

_NASTY = ("", "0", "-1", "NaN", "INF", "1e308", "1e999", "x" * 600, "\x00", "&lt;", "&#0;", "<!--")
_NASTY += ("<!DOCTYPE r [<!ENTITY a 'b'>]>", "<apply/>", "<ci> A </ci>", "<cn> 1e400 </cn>")
_NASTY += (
    "lambda",
    "ground",
    "t",
    "A_0",
    "V",
    "R",
    "A",
    "f",
    "<times/>",
    "</apply>",
    "<piecewise/>",
)
_LONGEST_TIME = 2.0  # seconds; a model of this size takes some milliseconds


def _value(text, rng):
    return replaced(text, rng, r'"[^"]*"', f'"{rng.choice(_NASTY)}"')


def _word(text, rng):
    words = re.findall(r"[A-Za-z_][\w-]*", text) or ["x"]
    return replaced(text, rng, r"[A-Za-z_][\w-]*", rng.choice(words))


DAMAGES = (_value, _value, _word, _word, _word, cut, repeat, flip, insert(_NASTY))


def _check(seed):
    rng = random.Random(seed)
    text = damaged(whole_text(), rng, DAMAGES)
    scene, message = read_in_time(
        lambda: read_sbml_text(text, "damaged.xml", Scene).scene, _LONGEST_TIME, seed
    )
    if scene is None:
        assert message.startswith("damaged.xml"), (seed, message)
        assert "\n" not in message, (seed, message)
        assert len(message) < 600, (seed, message)
        return False
    said = ""
    try:
        formulate(scene, [], tree=None)
    except cotree.Error as error:
        said = str(error)
    assert "\n" not in said, seed
    return True


def test_damaged_models_give_scenes_or_sentences():
    accepted = sum(_check(seed) for seed in range(60))
    assert 0 < accepted < 60  # some damages change a number only


@pytest.mark.campaign
def test_thousands_of_damaged_models():
    for seed in range(1000, 4000):
        _check(seed)
