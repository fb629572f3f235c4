"""Parsed templates in the cache."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jinja2

from cotree.build import clear_cache
from cotree.codegen.bytecode import KeptBytecode

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def rendered(text: str) -> str:
    loader = jinja2.DictLoader({"a": text})
    return (
        jinja2.Environment(loader=loader, bytecode_cache=KeptBytecode("test"), autoescape=True)
        .get_template("a")
        .render(x=2)
    )


def test_a_template_is_parsed_once_and_anew_where_its_text_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COTREE_CACHE_DIR", str(tmp_path))
    assert rendered("x = {{ x }}") == "x = 2"
    (kept,) = tmp_path.glob("*.template")
    parsed = []
    monkeypatch.setattr(
        jinja2.Environment,
        "_parse",
        lambda self, *given: parsed.append(given) or jinja2.parser.Parser(self, *given).parse(),
    )
    assert rendered("x = {{ x }}") == "x = 2"
    assert not parsed
    # A damaged file counts as absent.
    kept.write_bytes(b"damaged")
    assert rendered("x = {{ x }}") == "x = 2"
    assert len(parsed) == 1
    assert rendered("y = {{ x }}") == "y = 2"
    assert len(list(tmp_path.glob("*.template"))) == 2
    assert clear_cache() >= 4  # with a checksum each


def test_a_folder_that_cannot_be_used_only_costs_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COTREE_CACHE_DIR", "not/absolute")
    assert rendered("x = {{ x }}") == "x = 2"
