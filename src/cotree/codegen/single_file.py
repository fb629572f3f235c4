"""The files of a project in one header and one source.

In: text by file name. Out: the text of ``<prefix>.h`` and ``<prefix>.c``. Names of the runtime
begin with the prefix, too, so that a program can contain several models. A part is the text of one
source. Macros of a part end with it. A name at file scope that another part contains begins with
the name of its part.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from cotree.codegen.runtime import INCLUDE, SYSTEM

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

#: Guards of headers, what compilers of C++ read, and marks for cffi.
_FRAME = re.compile(
    r'^#ifndef (\w+_H)\n#define \1\n|^#ifdef __cplusplus\n(?:extern "C" \{|\})\n#endif\n'
    r"|^/\* cotree: (?:begin|end) of the part that cffi reads \*/\n",
    re.MULTILINE,
)
_MACRO = re.compile(r"^ *# *define (\w+)", re.MULTILINE)
#: Comments and strings, which stay, and bodies of structures, of which types may have new names.
_APART = re.compile(r"(/\*.*?\*/|\"(?:[^\"\\\n]|\\.)*\"|\bstruct \w* ?\{[^{}]*\})", re.DOTALL)
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
#: Functions, variables and types that only their own file knows.
_PRIVATE = re.compile(
    r"^(?:COTREE_\w+ )*(?:static|COTREE_PRIVATE)\b[^;{}()=\[\]]*?\b(\w+)(?=\s*[(\[=;])"
    r"|^\} (\w+)(?=;)|^typedef \w+ (\w+)(?:, (\w+))?;",
    re.MULTILINE,
)
_WORD = re.compile(r"\b[A-Za-z_]\w*")
_OWN = re.compile(r"\b(cotree|COTREE)_(\w+)\b(?!\.[ch]\b)")


def single_file(texts: Mapping[str, str], prefix: str) -> dict[str, str]:
    """Join the C files of a project.

    Parameters
    ----------
    texts : mapping of str to str
        Headers and sources by name, ``main.c`` among them.
    prefix : str
        What names of the model begin with.

    Returns
    -------
    dict of str to str
        The header and the source. The main program is compiled where ``<PREFIX>_MAIN`` is defined.
    """
    seen: set[str] = set()
    # A program of one's own may include what the main program includes.
    public = [f"{prefix}.h", *INCLUDE.findall(texts["main.c"])]
    header = _inlined("".join(f'#include "{name}"\n' for name in public), texts, seen)
    hidden = {*texts} - seen
    sources = sorted(
        (name for name in texts if name.endswith(".c")),
        key=lambda name: (name == "main.c", name.startswith("cotree_"), name),
    )
    parts = {name: _inlined(texts[name], texts, seen) for name in sources}
    words = {name: _words(part) for name, part in parts.items()}
    for name in sources:
        others = _words(header).union(*(words[other] for other in sources if other != name))
        stem = "own" if name == f"{prefix}.c" else name.removesuffix(".c").removeprefix("cotree_")
        names = {own: f"{stem}_{own}" for own in sorted(_private(texts[name]) & others)}
        parts[name] = _renamed(parts[name], names) + _undefined(texts[name])
    parts["main.c"] = f"#ifdef {prefix.upper()}_MAIN\n{parts['main.c']}#endif\n"
    private = "".join(_FRAME.sub("", texts[name]) for name in sorted(hidden & seen))
    source = "\n".join([*parts.values(), _undefined(private)])
    guard = f"{prefix.upper()}_H"
    language = "#ifdef __cplusplus\n{}\n#endif\n"
    opening, closing = language.format('extern "C" {'), language.format("}")
    whole = {
        f"{prefix}.h": _framed(
            header, f"#ifndef {guard}\n#define {guard}\n\n", opening, f"\n{closing}\n#endif\n"
        ),
        f"{prefix}.c": _framed(source, f'#include "{prefix}.h"\n\n', "", ""),
    }
    found = _prefixed(whole.values(), prefix)
    return {name: _with_names(text, found, prefix) for name, text in whole.items()}


def prefixed(text: str, texts: Mapping[str, str], prefix: str) -> str:
    """Write a further file of the project with the names that the joined ones have."""
    return _with_names(text, _prefixed(texts.values(), prefix), prefix)


def _inlined(text: str, texts: Mapping[str, str], seen: set[str]) -> str:
    """Write headers in the place of the first lines that include them."""

    def inline(found: re.Match[str]) -> str:
        name = found[1]
        if name in seen or name not in texts:
            return ""
        header = texts[name]
        if _FRAME.search(header):
            seen.add(name)  # others are meant to be included several times
            header = _FRAME.sub("", header[: header.rindex("#endif")]).rstrip("\n") + "\n"
        return _inlined(header, texts, seen)

    return INCLUDE.sub(inline, text)


def _private(source: str) -> set[str]:
    """Return the names at file scope of a source; those of the runtime differ from all others."""
    rows = _PRIVATE.findall(_COMMENT.sub("", source))
    return {name for row in rows for name in row if name and not name.startswith("cotree_")}


def _words(text: str) -> set[str]:
    return {*_WORD.findall(_COMMENT.sub("", text))}


def _undefined(text: str) -> str:
    """End the macros of a text."""
    return "".join(f"#undef {macro}\n" for macro in sorted({*_MACRO.findall(text)}))


def _renamed(part: str, names: Mapping[str, str]) -> str:
    """Write names of a part anew; members of structures keep theirs."""
    if not names:
        return part
    name = rf"(?<![\w.>\"])({'|'.join(map(re.escape, names))})\b(?![\"/])"
    every, types = re.compile(name), re.compile(rf"{name}(?= (?:\*?\w|{{))")
    pieces = _APART.split(part)
    for i, piece in enumerate(pieces):
        if i % 2 == 0:
            pieces[i] = every.sub(lambda found: names[found[1]], piece)
        elif piece.endswith("}"):
            pieces[i] = types.sub(lambda found: names[found[1]], piece)
    return "".join(pieces)


def _prefixed(texts: Iterable[str], prefix: str) -> dict[str, str]:
    """Map names of the runtime to those that begin with the prefix."""
    words = {word for text in texts for word in _WORD.findall(text)}
    begins = {"cotree": prefix, "COTREE": prefix.upper()}
    found = {word: f"{begins[own[1]]}_{own[2]}" for word in words if (own := _OWN.fullmatch(word))}
    # A kernel, or a list of names, may have the name already.
    return {word: f"{name}_type" if name in words else name for word, name in found.items()}


def _framed(text: str, guard: str, opening: str, closing: str) -> str:
    """Write the first comment, then the headers of C that a text includes, then the text."""
    first, _, rest = text.partition("*/\n")
    system = "".join(sorted({*SYSTEM.findall(text)}))
    body = re.sub(r"\n{3,}", "\n\n", SYSTEM.sub("", rest)).strip("\n")
    return f"{first}*/\n{guard}{system}\n{opening}\n{body}\n{closing}"


def _with_names(text: str, names: Mapping[str, str], prefix: str) -> str:
    text = _OWN.sub(lambda found: names.get(found[0], found[0]), text)
    return text.replace("cotree_##", f"{prefix}_##")
