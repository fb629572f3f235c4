"""The pages of the site hold: their code runs, and numbers in comments are true."""

from __future__ import annotations

import re
from pathlib import Path
from unittest.mock import patch

import pytest

from cotree.components import COMPONENTS

DOCS = Path(__file__).parents[1] / "docs"
PAGES = ["index.md", "first_steps.md", "coming_from.md", "theory.md"]
PAGES += sorted(f"how_to/{page.name}" for page in (DOCS / "how_to").glob("*.md"))


@pytest.mark.compiler
@pytest.mark.sampled(4)
@pytest.mark.parametrize("page", PAGES)
def test_the_code_of_a_page_runs(page, tmp_path, monkeypatch):
    """Blocks share their names; a number is right to its last digit."""
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    with patch.dict(COMPONENTS):  # takes back what a page registers
        text = (DOCS / page).read_text(encoding="utf-8")
        for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
            exec(compile(block, page, "exec"), names)
            for expression, number in re.findall(r"^(\S.*)  # (-?\d+\.\d+) ", block, re.MULTILINE):
                half_a_digit = 0.5 * 10.0 ** -len(number.partition(".")[2])
                assert abs(eval(expression, names) - float(number)) <= half_a_digit, expression
