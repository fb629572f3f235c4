"""Thousands of damaged robots: each gives a scene, or one sentence with file and line."""

from __future__ import annotations

import random
import re

import pytest
from damage import cut, damaged, flip, insert, read_in_time, repeat, replaced
from urdf_texts import ROBOTS, WHOLE

import cotree
from cotree.api import Scene
from cotree.files import read_text
from cotree.pipeline import formulate
from cotree.readers.urdf.scene import UrdfOptions, read_urdf_text

NASTY = (
    *(
        "",
        "0",
        "-1",
        "nan",
        "inf",
        "1e308",
        "-1e-320",
        "1e999",
        "0x10",
        "1_0",
        "1,5",
        "١",
        "é",
        "ÿ",
    ),
    *(
        "ground",
        "base",
        "__import__('os')",
        "lambda",
        "%s",
        "${x}",
        "a" * 600,
        "\x00",
        "\ufffe",
        " ",
    ),
    *(
        "&lt;",
        "&#0;",
        "&#x110000;",
        "&unknown;",
        "<!--",
        "-->",
        "<![CDATA[",
        "]]>",
        "<?x ?>",
        "<",
        ">",
    ),
    *("<!DOCTYPE r [<!ENTITY a 'b'>]>", '"', "'", "/", "../../x", "fixed", "floating", "planar"),
    *("<link name='base_link'/>", "<joint/>", "<mass/>", "0 0 0", "1 2 3", "\n", "\r\n", "\t"),
)
_LONGEST_TIME = 2.0  # seconds; a robot of this size takes a few milliseconds


def _value(text, rng):
    """Put something else into an attribute."""
    return replaced(text, rng, r'"[^"]*"', f'"{rng.choice(NASTY)}"')


def _number(text, rng):
    made = rng.choice((*NASTY[:12], str(rng.uniform(-5, 5)), "1e-9"))
    return replaced(text, rng, r"-?\d+\.?\d*", made)


def _word(text, rng):
    """Put another word of the file in the place of one: names, tags, attributes, types."""
    words = re.findall(r"[A-Za-z_][\w-]*", text) or ["x"]
    return replaced(text, rng, r"[A-Za-z_][\w-]*", rng.choice(words))


def _element(text, rng):
    """Drop an element, move it, or have it twice."""
    found = re.findall(r"<[^<>]*/>|<(?:inertial|link|joint|visual)\b.*?</[a-z]+>", text, re.DOTALL)
    if not found:
        return text
    piece = rng.choice(found)
    rest = text.replace(piece, "", 1)
    at = rng.choice([m.start() for m in re.finditer("<", rest)] or [0])
    return rng.choice((rest, rest[:at] + piece + rest[at:], text.replace(piece, piece * 2, 1)))


_DAMAGES = (
    cut,
    repeat,
    insert(NASTY),
    flip,
    _value,
    _value,
    _number,
    _word,
    _word,
    _element,
    _element,
)


def texts():
    named = {path.name: read_text(path, 10**6) for path in sorted(ROBOTS.glob("*.urdf"))}
    return [WHOLE, WHOLE, WHOLE, named["ur5_robot.urdf"], named["panda.urdf"]]


def check(seed, sources):
    """Read a damaged robot; give the scene, or the sentence."""
    rng = random.Random(seed)
    text = damaged(rng.choice(sources), rng, _DAMAGES)
    options = UrdfOptions(rng.choice(("fixed", "free")), rng.random() < 0.5)
    scene, message = read_in_time(
        lambda: read_urdf_text(text, "damaged.urdf", Scene, options), _LONGEST_TIME, seed
    )
    if scene is None:
        assert re.match(r"damaged\.urdf:\d+: \S", message), (seed, message)
        assert len(message) < 1000, (seed, message)
    assert "\n" not in message + "".join(scene.origin.notes if scene else ()), (seed, message)
    return scene


def check_range(seeds):
    sources = texts()
    scenes = [(seed, scene) for seed in seeds if (scene := check(seed, sources)) is not None]
    # Damage that nothing notices and damage that is refused must both be there in number.
    assert 0.1 < len(scenes) / len(seeds) < 0.9
    return scenes


def check_equations(scenes):
    """Form the equations of a scene that was read, or raise one of cotree's own errors."""
    messages = []
    for seed, scene in scenes:
        try:
            formulate(scene, [], None)
        except cotree.Error as error:
            messages.append((seed, str(error)))
    assert [row for row in messages if "\n" in row[1]] == []
    return len(scenes) - len(messages)


@pytest.mark.slow
def test_damaged_robots():
    scenes = check_range(range(800))
    small = [(seed, scene) for seed, scene in scenes if len(scene.edges) < 30]
    assert check_equations(small[:20]) > 5


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("first", [10_000, 15_000])
def test_many_damaged_robots(first):
    scenes = check_range(range(first, first + 2_000))
    small = [(seed, scene) for seed, scene in scenes if len(scene.edges) < 30]
    assert check_equations(small[:50]) > 12


def test_bytes_that_are_no_text(tmp_path):
    """The same for bytes: what cannot be decoded is refused with its line too."""
    source = WHOLE.encode()
    for seed in range(200):
        rng = random.Random(seed)
        data = bytearray(source)
        for _ in range(3):
            data[rng.randrange(len(data))] = rng.randrange(256)
        path = tmp_path / "damaged.urdf"
        path.write_bytes(data)
        message = ""
        try:
            cotree.read_urdf(path)
        except cotree.SceneError as error:
            message = str(error)
        assert not message or re.match(r".*damaged\.urdf:\d+: ", message), (seed, message)
    assert [file.name for file in tmp_path.iterdir()] == ["damaged.urdf"]
