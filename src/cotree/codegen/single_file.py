"""Combination of the files of a project into one header and one source.

Names of the runtime get the model's prefix, so that a program can contain several models. A private
name of one source that also occurs in another source gets the name of the first source as prefix.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.codegen.c_text import (
    is_word,
    items,
    squeezed,
    tokens,
    unframed,
    words,
)
from cotree.files import included, includes

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence, Set


def single_file(texts: Mapping[str, str], prefix: str) -> dict[str, str]:
    """Combine C files into a header and a source; ``<PREFIX>_MAIN`` compiles the main program."""
    seen: set[str] = set()
    # Headers that the main program includes are public: other programs may include them.
    public = [f"{prefix}.h", *includes(texts["main.c"])]
    header = _inlined("".join(f'#include "{name}"\n' for name in public), texts, seen)
    hidden = {*texts} - seen
    sources = sorted(
        (name for name in texts if name.endswith(".c")),
        key=lambda name: (name == "main.c", name.startswith("cotree_"), name),
    )
    parts = {name: _inlined(texts[name], texts, seen) for name in sources}
    known = {name: words(part) for name, part in parts.items()}
    for name in sources:
        others = words(header).union(*(known[other] for other in sources if other != name))
        stem = "own" if name == f"{prefix}.c" else name.removesuffix(".c").removeprefix("cotree_")
        names = {own: f"{stem}_{own}" for own in _private(texts[name]) & others}
        parts[name] = _renamed(parts[name], names) + _undefined(texts[name])
    upper = prefix.upper()
    parts["main.c"] = f"#ifdef {upper}_MAIN\n{parts['main.c']}#endif\n"
    private = "".join(_inlined(f'#include "{name}"\n', texts, set()) for name in hidden & seen)
    source = "\n".join([*parts.values(), _undefined(private)])
    whole = {
        f"{prefix}.h": _framed(header, f"#ifndef {upper}_H\n#define {upper}_H\n\n", "\n#endif\n"),
        f"{prefix}.c": _framed(source, f'#include "{prefix}.h"\n\n', ""),
    }
    return {name: prefixed(text, whole, prefix) for name, text in whole.items()}


def prefixed(text: str, texts: Mapping[str, str], prefix: str) -> str:
    """Return a text with prefixed runtime names, different from all names in ``texts``."""
    return _with_names(text, frozenset[str]().union(*map(words, texts.values())), prefix)


def _with_names(text: str, taken: Set[str], prefix: str) -> str:
    found = [*tokens(text), "", ""]
    for i, token in enumerate(found[:-2]):
        if token.startswith("/*"):
            found[i] = f"/*{_with_names(token[2:], taken, prefix)}"
        elif is_word(token) and not (found[i + 1] == "." and found[i + 2] in ("c", "h")):
            found[i] = _prefixed(token, taken, prefix)
    return "".join(found)


def _prefixed(word: str, taken: Set[str], prefix: str) -> str:
    """Replace ``cotree`` at the beginning of a runtime name by the prefix."""
    for own, new in (("cotree_", prefix), ("COTREE_", prefix.upper())):
        if word.startswith(own):
            name = f"{new}_{word.removeprefix(own)}"
            # A kernel or an enumeration may already have this name.
            return f"{name}_type" if name in taken else name
    return word


def _inlined(text: str, texts: Mapping[str, str], seen: set[str]) -> str:
    """Replace the first inclusion of each header by its text, and remove later inclusions."""
    found = []
    for line in text.splitlines(keepends=True):
        name = included(line)
        if name is None:
            found.append(line)
        elif name in texts and name not in seen:
            comment, body = unframed(texts[name])
            if body:
                seen.add(name)  # headers without an include guard are inserted at every inclusion
            found.append(_inlined(f"{comment}\n\n{body}", texts, seen))
    return "".join(found)


def _private(source: str) -> set[str]:
    """Return the private names of a source, without runtime names, which are unique."""
    names = {name for item in items(source) if item.is_private for name in item.names}
    return {name for name in names if not name.startswith("cotree_")}


def _undefined(text: str) -> str:
    macros = {name for item in items(text) if item.is_directive for name in item.names}
    return "".join(f"#undef {macro}\n" for macro in sorted(macros))


def _renamed(part: str, names: Mapping[str, str]) -> str:
    """Replace names in a part of the text, but not members of structures."""
    found = [*tokens(part), "", ""]
    for i, is_member in enumerate(_are_members(found)):
        if not is_member:
            found[i] = names.get(found[i], found[i])
    return "".join(found)


def _are_members(found: Sequence[str]) -> Iterator[bool]:
    """Yield for each token whether it is a member: it follows ``.`` or ``->``, or is declared."""
    depth = body = 0  # open braces: in total, and in the body of a structure
    is_head = False
    for i, token in enumerate(found[:-2]):
        if is_word(token):
            is_head = is_head or token == "struct"
            is_type = not found[i + 1].strip(" *") and is_word(found[i + 2])
            yield found[i - 1].endswith((".", "->")) or (body > 0 and not is_type)
            continue
        if not token.startswith(("/*", '"')) and token.strip():
            body = depth + 1 if is_head and "{" in token and not body else body
            depth += token.count("{") - token.count("}")
            body = body if depth >= body else 0
            is_head = False
        yield False


def _framed(text: str, opening: str, closing: str) -> str:
    """Move all inclusions of C library headers, after the opening, below the first comment."""
    first, _, rest = text.partition("*/\n")
    lines = rest.splitlines(keepends=True)
    system = sorted({line for line in lines if line.startswith("#include <")})
    body = squeezed("".join(line for line in lines if line not in system)).strip("\n")
    return f"{first}*/\n{opening}{''.join(system)}\n{body}\n{closing}"
