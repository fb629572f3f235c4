"""A reader of the front page reaches the answers to common questions within two clicks."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
LINK = re.compile(r"(?<!!)\[[^\]]*\]\(([^)#\s]+\.md)?(?:#[^)\s]*)?\)")
TOCTREE = re.compile(r"```\{toctree\}\n(.*?)```", re.DOTALL)
CARD = re.compile(r"^:link: (\S+)$", re.MULTILINE)
# The question, the page that answers it, and words of the answer.
ANSWERS = [
    ("how to drop C into a project", "how_to/drop_in.md", "CMake, make and pkg-config"),
    ("how to fit data", "how_to/fit_to_data.md", "`cotree.fit` estimates parameters"),
    ("what a mode is", "events.md", "A mode is a number"),
    ("which method to choose", "solvers.md", "## Which method"),
    ("how to add a component", "how_to/own_component.md", "The law of a component"),
]


def linked_pages(page: Path) -> set[Path]:
    """Return the pages to which links, toctrees and cards of a page lead."""
    text = page.read_text(encoding="utf-8")
    prose = re.sub(r"^```(?!\{toctree).*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    targets = [target for target in LINK.findall(prose) if target]
    entries = [line.strip() for block in TOCTREE.findall(text) for line in block.splitlines()]
    targets += [f"{e}.md" for e in [*entries, *CARD.findall(text)] if e and not e.startswith(":")]
    return {(page.parent / target).resolve() for target in targets}


@pytest.mark.parametrize(("question", "page", "words"), ANSWERS, ids=[row[0] for row in ANSWERS])
def test_answers_are_two_clicks_from_the_front_page(question: str, page: str, words: str):
    first = {p for p in linked_pages(DOCS / "index.md") if p.is_file()}
    second = {q for p in first for q in linked_pages(p)}
    assert DOCS / page in first | second, question
    assert words in (DOCS / page).read_text(encoding="utf-8")


def test_pages_of_the_front_page_exist():
    # Pages of the gallery are generated when the documentation is built.
    pages = [p for p in linked_pages(DOCS / "index.md") if DOCS / "examples" not in p.parents]
    assert [str(p) for p in pages if not p.is_file()] == []
