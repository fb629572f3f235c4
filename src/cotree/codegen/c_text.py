"""C text as data: its tokens, and its items at file scope.

Texts follow one convention, which formatters keep: what begins at file scope begins in the first
column, a comment stands above what it is about, and an empty line ends a paragraph. Bodies are
indented.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator, Mapping, Sequence

#: Comments, strings, words, and what stands between them.
_TOKEN = re.compile(r'/\*.*?\*/|"(?:[^"\\\n]|\\.)*"|\w+|->|[^\w"/-]+|.', re.DOTALL)

#: Qualifier of functions that other programs call.
_EXPORT = "COTREE_EXPORT"
#: What headers stand between for compilers of C++.
_FRAME = ("COTREE_BEGIN_DECLS\n", "COTREE_END_DECLS\n")


@dataclass(frozen=True, slots=True)
class Item:
    """A comment, a directive or a declaration at file scope."""

    text: str
    names: tuple[str, ...] = ()  # what it defines or declares, enumerators included

    @property
    def is_comment(self) -> bool:
        """Return whether it is a comment."""
        return self.text.startswith("/*")

    @property
    def is_directive(self) -> bool:
        """Return whether the preprocessor reads it."""
        return self.text.startswith("#")

    @property
    def is_private(self) -> bool:
        """Return whether no other file knows the names, if the item stands in a source."""
        head = self.text.partition("{")[0].partition("(")[0].partition("=")[0]
        return not self.is_directive and bool({"static", "COTREE_PRIVATE", "typedef"} & words(head))


@cache
def tokens(text: str) -> tuple[str, ...]:
    """Split a text into comments, strings, words and the rest."""
    return tuple(_TOKEN.findall(text))


def is_word(token: str) -> bool:
    """Return whether a token is a name or a keyword."""
    return token[:1].isalpha() or token[:1] == "_"


def words(text: str) -> frozenset[str]:
    """Return the names and keywords of a text, without those of comments and strings."""
    return frozenset(filter(is_word, tokens(text)))


def squeezed(text: str) -> str:
    """Return a text without two empty lines in a row."""
    while "\n\n\n" in text:
        text = text.replace("\n\n\n", "\n\n")
    return text


def included(line: str) -> str | None:
    """Return the header beside a file that a line includes, if it does so."""
    begin = '#include "'
    return line.rstrip()[len(begin) : -1] if line.startswith(begin) else None


def includes(text: str) -> list[str]:
    """List the headers beside a file that it includes."""
    return [name for name in map(included, text.splitlines()) if name is not None]


def unframed(header: str) -> tuple[str, str]:
    """Return the first comment of a header, and the rest without its guard, if it has one."""
    comment, guard, body = header.partition("\n#ifndef ")
    if not guard or "#" in comment:
        return header, ""
    return comment, body[body.index("\n#define ") + 1 : body.rindex("#endif")].partition("\n")[
        2
    ].strip() + "\n"


@cache
def paragraphs(text: str) -> tuple[tuple[Item, ...], ...]:
    """Split a text into items, by the empty lines between these."""
    found: list[list[Item]] = [[]]
    lines = iter(text.splitlines(keepends=True))
    for line in lines:
        if line.strip():
            found[-1].append(_item(line, lines))
        else:
            found.append([])
    return tuple(map(tuple, filter(None, found)))


def items(text: str) -> list[Item]:
    """List the items of a text."""
    return [item for paragraph in paragraphs(text) for item in paragraph]


def _item(line: str, lines: Iterator[str]) -> Item:
    """Read an item that begins with a line."""
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
    depth = line.count("{") - line.count("}")
    while depth > 0 or not line.partition("/*")[0].rstrip().endswith((";", "}")):
        text += (line := next(lines))
        depth += line.count("{") - line.count("}")
    return Item(text, _declared(text))


def _declared(text: str) -> tuple[str, ...]:
    """Return the names that a declaration introduces."""
    bare = "".join(token for token in tokens(text) if not token.startswith("/*"))
    head, brace, body = bare.partition("{")
    if head.startswith("typedef ") and "(*" in head:  # a type of functions
        return (head.partition("(*")[2].partition(")")[0],)
    argument, closed, _ = head.partition("(")[2].partition(")(")
    if closed and argument.isidentifier():  # a macro writes the name of a function
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
    """Leave out what nothing uses of files that are the same for every model.

    Parameters
    ----------
    texts : mapping of str to str
        C text by file name, whose conditions are decided.
    shared : container of str
        Names of those files. What is exported stays; so do conditions that a paragraph opens and
        does not close, such as the guards of headers, and headers without one, whose names follow
        from macros.

    Returns
    -------
    dict of str to str
        Text by file name.
    """
    cut = {
        name
        for name, text in texts.items()
        if name in shared and (name.endswith(".c") or unframed(text)[1])
    }
    rows = [
        row
        for name, text in texts.items()
        for paragraph in paragraphs(text)
        for row in _parts(paragraph, is_shared=name in cut)
    ]
    reached = _reached([item for item, is_kept in rows if is_kept], [item for item, _ in rows])
    found = dict(texts)
    for name in cut:
        text = squeezed("\n".join(_without(p, reached) for p in paragraphs(texts[name])))
        found[name] = _without_unused_macros(text) if name.endswith(".c") else text
    return found


def _without_unused_macros(text: str) -> str:
    """Leave out the macros of a source that nothing else in it mentions."""
    counts = Counter(filter(is_word, tokens(text)))
    # Macros follow those that they mention.
    for item in reversed(items(text)):
        own = Counter(filter(is_word, tokens(item.text)))
        if item.text.startswith("#define") and all(counts[n] == own[n] for n in item.names):
            counts -= own
            text = text.replace(item.text, "", 1)
    return squeezed(text)


def exported(texts: Iterable[str], types: Sequence[str] = ()) -> str:
    """Return exported functions, some types, and what these need, without comments.

    Parameters
    ----------
    texts : iterable of str
        Headers, in an order in which each follows those that it includes.
    types : sequence of str
        Names of types.
    """
    rows = [item for text in texts for item in items(text) if item.names and not item.is_directive]
    roots = [i for i in rows if _EXPORT in i.text or not {*types}.isdisjoint(i.names)]
    reached = _reached(roots, rows)
    found = "".join(item.text for item in rows if not reached.isdisjoint(item.names))
    return "".join(
        token for token in tokens(found) if not token.startswith("/*") and token != _EXPORT
    )


def _reached(fresh: list[Item], rows: Iterable[Item]) -> set[str]:
    """Return the names that some items mention, and those that what defines these mentions."""
    by_name: dict[str, list[Item]] = {}
    for item in rows:
        for name in item.names:
            by_name.setdefault(name, []).append(item)
    reached: set[str] = set()
    while fresh:
        found = words(fresh.pop().text) - reached
        reached |= found
        fresh += [item for word in found for item in by_name.get(word, ())]
    return reached


def _parts(paragraph: Sequence[Item], *, is_shared: bool) -> list[tuple[Item, bool]]:
    """Return what is kept or left out together, and whether it is kept in any case."""
    levels = [_level(item) for item in paragraph]
    if not any(levels):
        found = [item for item in paragraph if not item.is_comment]
        return [(i, not is_shared or not i.names or _EXPORT in i.text) for i in found]
    joined = "".join(item.text for item in paragraph)
    names = tuple(name for item in paragraph for name in item.names)
    return [(Item(joined, names), not is_shared or not names or sum(levels) != 0)]


def _level(item: Item) -> int:
    """Return one for a directive that opens a condition, minus one for its end."""
    return item.text.startswith("#if") - item.text.startswith("#endif")


def _without(paragraph: Sequence[Item], reached: set[str]) -> str:
    """Write what of a paragraph is used; nothing if only comments would stay."""
    kept = {
        part.text
        for part, is_kept in _parts(paragraph, is_shared=True)
        if is_kept or not reached.isdisjoint(part.names)
    }
    if not kept and not all(item.is_comment for item in paragraph):
        return ""
    whole = "".join(item.text for item in paragraph)
    if whole in kept:
        return whole
    return "".join(item.text for item in paragraph if item.is_comment or item.text in kept)
