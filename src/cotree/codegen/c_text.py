"""Analysis of C text: tokens, and items at file scope.

The text must follow a convention that formatters preserve: items at file scope begin in the first
column, bodies are indented, comments precede their item, and empty lines end paragraphs.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator, Mapping, Sequence

#: Pattern of a token of C text: a comment, a string, a word, or the text between these.
_TOKEN = re.compile(r'/\*.*?\*/|"(?:[^"\\\n]|\\.)*"|\w+|->|[^\w"/-]+|.', re.DOTALL)

#: Qualifier of functions that other programs call.
_EXPORT = "COTREE_EXPORT"
#: Macros around the declarations in a header, for C++ compilers.
_FRAME = ("COTREE_BEGIN_DECLS\n", "COTREE_END_DECLS\n")


@dataclass(frozen=True, slots=True)
class Item:
    """A comment, a directive or a declaration at file scope."""

    text: str
    names: tuple[str, ...] = ()  # names that the declaration defines, including enumerators

    @property
    def is_comment(self) -> bool:
        """Whether the item is a comment."""
        return self.text.startswith("/*")

    @property
    def is_directive(self) -> bool:
        """Whether the item is a preprocessor directive."""
        return self.text.startswith("#")

    @property
    def is_private(self) -> bool:
        """Whether the names are local to the file, provided that the file is a source."""
        head = self.text.partition("{")[0].partition("(")[0].partition("=")[0]
        return not self.is_directive and bool({"static", "COTREE_PRIVATE", "typedef"} & words(head))


@cache
def tokens(text: str) -> tuple[str, ...]:
    """Split a text into comments, strings, words and other text."""
    return tuple(_TOKEN.findall(text))


def is_word(token: str) -> bool:
    """Return whether a token is a name or a keyword."""
    return token[:1].isalpha() or token[:1] == "_"


@cache
def words(text: str) -> frozenset[str]:
    """Return the names and keywords in a text, except in comments and strings."""
    return frozenset(filter(is_word, tokens(text)))


def squeezed(text: str) -> str:
    """Return a text in which consecutive empty lines are merged."""
    while "\n\n\n" in text:
        text = text.replace("\n\n\n", "\n\n")
    return text


def unframed(header: str) -> tuple[str, str]:
    """Return the first comment of a header, and the text inside its include guard.

    Without an include guard, return the whole header and an empty string.
    """
    comment, guard, body = header.partition("\n#ifndef ")
    if not guard or "#" in comment:
        return header, ""
    return comment, body[body.index("\n#define ") + 1 : body.rindex("#endif")].partition("\n")[
        2
    ].strip() + "\n"


@cache
def paragraphs(text: str) -> tuple[tuple[Item, ...], ...]:
    """Split a text at empty lines into paragraphs of items."""
    found: list[list[Item]] = [[]]
    lines = iter(text.splitlines(keepends=True))
    for line in lines:
        if line.strip():
            found[-1].append(_item(line, lines))
        else:
            found.append([])
    return tuple(map(tuple, filter(None, found)))


def items(text: str) -> list[Item]:
    """Return the functions, declarations and directives of a C text."""
    return [item for paragraph in paragraphs(text) for item in paragraph]


def _item(line: str, lines: Iterator[str]) -> Item:
    """Return the item that begins with ``line``; ``lines`` yields the lines after it."""
    text = line
    if line in _FRAME:
        return Item(line)
    if line.startswith("/*"):
        while "*/" not in line:
            text += (line := next(lines))
        return Item(text)
    if line.startswith("#"):
        while line.endswith("\\\n"):
            text += (line := next(lines))
        directive, *rest = [token for token in tokens(text) if is_word(token)]
        return Item(text, tuple(rest[:1]) if directive in ("define", "undef") else ())
    # A macro call that generates a function ends with a parenthesis.
    head = line.partition("(")[0]
    ends = (";", "}", ")") if head.isidentifier() and head.isupper() else (";", "}")
    depth = line.count("{") - line.count("}")
    while depth > 0 or not line.partition("/*")[0].rstrip().endswith(ends):
        text += (line := next(lines))
        depth += line.count("{") - line.count("}")
    return Item(text, _declared(text))


def _declared(text: str) -> tuple[str, ...]:
    bare = "".join(token for token in tokens(text) if not token.startswith("/*"))
    head, brace, body = bare.partition("{")
    if head.startswith("typedef ") and "(*" in head:  # a function type
        return (head.partition("(*")[2].partition(")")[0],)
    argument, closed, _ = head.partition("(")[2].partition(")(")
    if closed and argument.isidentifier():  # a macro generates a function with this name
        return (f"cotree_{argument}",)
    if "(" in head or "=" in head or not brace:
        head = head.partition("=")[0].partition("(")[0]
        return tuple(part.partition("[")[0].split()[-1].strip("*;") for part in head.split(","))
    inner, _, last = body.rpartition("}")
    found = {head.split()[-1], last.partition("=")[0].partition("[")[0].strip(" ,*;\n")}
    if "enum" in head.split():
        found |= {row.partition("=")[0].strip() for row in inner.split(",")}
    return tuple(sorted(found - {"enum", "struct", ""}))


def without_unused(texts: Mapping[str, str], shared: Container[str]) -> dict[str, str]:
    """Remove unused items from the files ``shared``, which are the same for every model.

    ``texts`` are C texts by file name, without preprocessor conditions on features. Exported items
    remain, and also conditions that are not closed in the same paragraph, such as include guards.
    Headers without an include guard remain because their names depend on macros.
    """
    cut = {
        name
        for name, text in texts.items()
        if name in shared and (name.endswith(".c") or unframed(text)[1])
    }
    rows = [
        (item, name, is_kept)
        for name, text in texts.items()
        for paragraph in paragraphs(text)
        for item, is_kept in _parts(paragraph, is_shared=name in cut)
    ]
    reached = _reached(
        [(item, name) for item, name, is_kept in rows if is_kept],
        [(item, name) for item, name, _ in rows],
    )
    return {
        name: squeezed("\n".join(_without(p, name, reached) for p in paragraphs(text)))
        if name in cut
        else text
        for name, text in texts.items()
    }


def exported(texts: Iterable[str], types: Sequence[str] = ()) -> str:
    """Return exported functions, ``types``, and the items that these need, without comments.

    Each header in ``texts`` must follow the headers that it includes.
    """
    rows = [item for text in texts for item in items(text) if item.names and not item.is_directive]
    roots = [i for i in rows if _EXPORT in i.text or not {*types}.isdisjoint(i.names)]
    reached = _reached([(item, "") for item in roots], [(item, "") for item in rows])
    found = "".join(item.text for item in rows if _is_reached(item, "", reached))
    return "".join(
        token for token in tokens(found) if not token.startswith("/*") and token != _EXPORT
    )


def _reached(
    fresh: list[tuple[Item, str]], rows: Iterable[tuple[Item, str]]
) -> set[tuple[str, str]]:
    """Return all names, with their scopes, that the items ``fresh`` need directly or indirectly."""
    by_name: dict[str, dict[str, list[tuple[Item, str]]]] = {}
    for row in rows:
        scope = _scope(*row)
        for name in row[0].names:
            by_name.setdefault(name, {}).setdefault(scope, []).append(row)
    reached: set[tuple[str, str]] = set()
    while fresh:
        item, file = fresh.pop()
        for word in words(item.text) & by_name.keys():
            for scope, declared in by_name[word].items():
                # A header may use macros that are defined in the source that includes it.
                is_known = scope in ("", file) or not file.endswith(".c")
                if is_known and (word, scope) not in reached:
                    reached.add((word, scope))
                    fresh += declared
    return reached


def _scope(item: Item, file: str) -> str:
    """Return the source to which the names of an item are local; empty if they are global."""
    is_private = item.is_private or item.text.startswith("#define")
    return file if is_private and file.endswith(".c") else ""


def _is_reached(item: Item, file: str, reached: set[tuple[str, str]]) -> bool:
    scope = _scope(item, file)
    return any((name, scope) in reached for name in item.names)


def _parts(paragraph: Sequence[Item], *, is_shared: bool) -> list[tuple[Item, bool]]:
    """Return groups of items that are removed together, and whether each group is always kept."""
    levels = [_level(item) for item in paragraph]
    if not any(levels):
        found = [item for item in paragraph if not item.is_comment]
        return [(i, not is_shared or not i.names or _EXPORT in i.text) for i in found]
    joined = "".join(item.text for item in paragraph)
    names = tuple(name for item in paragraph for name in item.names)
    return [(Item(joined, names), not is_shared or not names or sum(levels) != 0)]


def _level(item: Item) -> int:
    """Return 1 for a directive that opens a condition, -1 for one that closes it, 0 otherwise."""
    return item.text.startswith("#if") - item.text.startswith("#endif")


def _without(paragraph: Sequence[Item], file: str, reached: set[tuple[str, str]]) -> str:
    """Return a paragraph without unused parts; empty if only comments would remain."""
    kept = {
        part.text
        for part, is_kept in _parts(paragraph, is_shared=True)
        if is_kept or _is_reached(part, file, reached)
    }
    if not kept and not all(item.is_comment for item in paragraph):
        return ""
    whole = "".join(item.text for item in paragraph)
    if whole in kept:
        return whole
    return "".join(item.text for item in paragraph if item.is_comment or item.text in kept)
