"""Docstrings, comments and messages are plain technical English."""

from __future__ import annotations

import io
import re
import tokenize
from pathlib import Path

import pytest

from cotree.components import COMPONENTS

ROOT = Path(__file__).parents[1]

# First words of a sentence about a function that does not say what it computes.
FIRST = re.compile(r"(Gives?|Tells?|Says?|Lets?|Stands? (?:at|for)|Goes|Looks? (?:at|up))\b")
# Persons, things that see, want and know, and phrases without a technical meaning.
ANYWHERE = re.compile(
    r"\b(nobody|anew|rests? aside|lets? (?:\w+ )?(?:go|happen)|wants? to|looks? (?:at|out)|"
    r"knows? (?:nothing|of it)|goes on|told apart|of (?:its|their) like|"
    r"is made of itself|leave it away|stands? still|what is there)\b",
    re.IGNORECASE,
)
FOLDERS = [ROOT / "src/cotree", ROOT / "templates"]
# The text of a field completes a table without the field's name: it is a noun phrase.
FRAGMENT = re.compile(r"(about|at|between|by|for|from|in|of|on|plus|that|what|where|which|with)\b")


def texts_of(path: Path) -> list[tuple[int, str]]:
    """Return the comments and the strings of several words in a file, with their lines."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        found = re.finditer(r"/\*.*?\*/|\{#.*?#\}", text, re.DOTALL)
        return [(text.count("\n", 0, m.start()) + 1, m.group()[2:-2]) for m in found]
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    wanted = (t for t in tokens if t.type in (tokenize.COMMENT, tokenize.STRING))
    return [(t.start[0], t.string.lstrip("#: ")) for t in wanted if " " in t.string]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_sentences_are_about_the_system(folder: Path):
    odd = []
    for path in sorted(p for p in folder.rglob("*") if p.suffix in {".py", ".c", ".h", ".jinja"}):
        for line, text in texts_of(path):
            start = text.lstrip("rRfF\"' ")
            if found := FIRST.match(start) or ANYWHERE.search(text):
                odd.append(f"{path.relative_to(ROOT)}:{line}: {found.group()}")
    assert odd == []


def test_texts_of_fields_stand_alone():
    rows = [(name, field) for name, row in COMPONENTS.items() for field in row.fields]
    assert [(name, f.name, f.doc) for name, f in rows if FRAGMENT.match(f.doc)] == []
