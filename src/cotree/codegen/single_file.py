"""The files of a project in one header and one source.

In: text by file name. Out: the text of ``<prefix>.h`` and ``<prefix>.c``. Names of the runtime
begin with the prefix, too, so that a program can contain several models. A part is the text of one
source. Macros of a part end with it. If several parts have a name at file scope, that of a later
part begins with the name of the part.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_INCLUDE = re.compile(r'^ *# *include "([\w.]+)"\n', re.MULTILINE)
_SYSTEM = re.compile(r"^#include (<\w+\.h>)\n", re.MULTILINE)
_GUARD = re.compile(r"^#ifndef (\w+_H)\n#define \1\n", re.MULTILINE)
_LANGUAGE = re.compile(r'^#ifdef __cplusplus\n(?:extern "C" \{|\})\n#endif\n', re.MULTILINE)
_MARKS = re.compile(r"^/\* cotree: (?:begin|end) of the part that cffi reads \*/\n", re.MULTILINE)
_MACRO = re.compile(r"^ *# *define (\w+)", re.MULTILINE)
#: Comments and strings, which stay, and bodies of structures, of which types may have new names.
_APART = re.compile(r"(/\*.*?\*/|\"(?:[^\"\\\n]|\\.)*\"|\bstruct \w* ?\{[^{}]*\})", re.DOTALL)
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
#: Functions and variables that only their own file knows, and types.
_STATIC = re.compile(
    r"^(?:COTREE_\w+ )*(?:static|COTREE_PRIVATE)\b[^;{}()=\[\]]*?\b(\w+)(?=\s*[(\[=;])",
    re.MULTILINE,
)
_VARIABLE = re.compile(
    r"^(?:COTREE_\w+ )*static\b[^;{}()=\[\]]*?\b(\w+)(?=\s*[\[=;])", re.MULTILINE
)
_ARGUMENT = re.compile(r"\b\w+ \*?(\w+)(?=[,)])")
_TYPE = re.compile(r"^\} (\w+);|^(?:typedef )?struct (\w+) \{", re.MULTILINE)
_TYPEDEF = re.compile(r"^typedef (?:const )?(?:struct )?\w+ ([^{}();]*);", re.MULTILINE)
_ENUM = re.compile(r"^(?:typedef )?enum\b[^{;]*\{(.*?)\}", re.MULTILINE | re.DOTALL)
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
    includes = "".join(f'#include "{name}"\n' for name in _public(texts, prefix))
    header = _inlined(includes, texts, seen)
    public = {*seen}
    sources = sorted(
        (name for name in texts if name.endswith(".c")),
        key=lambda name: (name == "main.c", name.startswith("cotree_"), name),
    )
    parts, taken = [], _own_names(header)
    for name in sources:
        part = _inlined(texts[name], texts, seen)
        shared = _own_names(part) & taken
        # Arguments and variables of another part would hide what has their name.
        others = "".join(text for own, text in texts.items() if own != name)
        shared |= {*_VARIABLE.findall(_COMMENT.sub("", part))} & {*_words(others)}
        shared |= {*_STATIC.findall(_COMMENT.sub("", part))} & {*_ARGUMENT.findall(others)}
        stem = "own" if name == f"{prefix}.c" else name.removesuffix(".c").removeprefix("cotree_")
        part = _renamed(part, {own: f"{stem}_{own}" for own in sorted(shared)})
        taken |= _own_names(part)
        part += "".join(f"#undef {macro}\n" for macro in _ending(texts[name]))
        if name == "main.c":
            part = f"#ifdef {prefix.upper()}_MAIN\n{part}#endif\n"
        parts.append(part)
    private = {
        macro
        for name in texts
        if name.endswith(".h") and name in seen and name not in public
        for macro in _MACRO.findall(_bare(texts[name]))
    }
    parts.append("".join(f"#undef {macro}\n" for macro in sorted(private)))
    whole = {f"{prefix}.h": header, f"{prefix}.c": "\n".join(parts)}
    names = _prefixed(whole.values(), prefix)
    return {
        f"{prefix}.h": _finished_header(whole[f"{prefix}.h"], prefix, names),
        f"{prefix}.c": _finished_source(whole[f"{prefix}.c"], prefix, names),
    }


def prefixed(text: str, texts: Mapping[str, str], prefix: str) -> str:
    """Write a further file of the project with the names that the joined ones have."""
    names = _prefixed(texts.values(), prefix)
    return _with_names(text, names, prefix)


def _public(texts: Mapping[str, str], prefix: str) -> list[str]:
    """List the headers that a program of one's own may include: those of the main program."""
    return [f"{prefix}.h", *_INCLUDE.findall(texts["main.c"])]


def _inlined(text: str, texts: Mapping[str, str], seen: set[str]) -> str:
    """Write headers in the place of the first lines that include them."""

    def inline(found: re.Match[str]) -> str:
        name = found[1]
        if name in seen or name not in texts:
            return ""
        header = texts[name]
        if _GUARD.search(header):
            seen.add(name)  # others are meant to be included several times
            header = _bare(header)
        return _inlined(header, texts, seen)

    return _INCLUDE.sub(inline, text)


def _bare(header: str) -> str:
    """Return a header without its guard and without what compilers of C++ read."""
    text = _GUARD.sub("", header, count=1)
    text = text[: text.rindex("#endif")]
    return _MARKS.sub("", _LANGUAGE.sub("", text)).rstrip("\n") + "\n"


def _own_names(text: str) -> set[str]:
    """Return the names at file scope that another part may have, too."""
    code = _COMMENT.sub("", text)
    found = {*_STATIC.findall(code)}
    types = {name for row in _TYPE.findall(code) for name in row if name}
    types |= {name.strip(" *") for row in _TYPEDEF.findall(code) for name in row.split(",")}
    # Types of the runtime have names of their own, and may be declared before they are defined.
    found |= {name for name in types if not name.startswith("cotree_")}
    for body in _ENUM.findall(code):
        found |= {*re.findall(r"\b([A-Za-z]\w*)\b(?=\s*(?:=[^,]*)?(?:,|$))", body.strip())}
    return found


def _words(text: str) -> list[str]:
    return re.findall(r"\b[A-Za-z_]\w*", text)


def _ending(source: str) -> list[str]:
    """List the macros of a source, which end with it."""
    return sorted(dict.fromkeys(_MACRO.findall(source)))


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
    words = {word for text in texts for word in _words(text)}
    found = {}
    for word in words:
        own = _OWN.fullmatch(word)
        if own is None:
            continue
        begin = prefix if own[1] == "cotree" else prefix.upper()
        name = f"{begin}_{own[2]}"
        # A kernel, or a list of names, may have the name already.
        found[word] = f"{name}_type" if name in words else name
    return found


def _finished_header(text: str, prefix: str, names: Mapping[str, str]) -> str:
    first, _, rest = text.partition("*/\n")
    body = _tidy(f"{_SYSTEM.sub('', rest)}")
    system = "".join(f"#include {name}\n" for name in sorted({*_SYSTEM.findall(text)}))
    guard = f"{prefix.upper()}_H"
    opened = '#ifdef __cplusplus\nextern "C" {\n#endif\n'
    closed = "#ifdef __cplusplus\n}\n#endif\n"
    whole = f"#ifndef {guard}\n#define {guard}\n\n{system}\n{opened}\n{body}\n{closed}\n#endif\n"
    return _with_names(f"{first}*/\n{whole}", names, prefix)


def _finished_source(text: str, prefix: str, names: Mapping[str, str]) -> str:
    system = "".join(f"#include {name}\n" for name in sorted({*_SYSTEM.findall(text)}))
    first, _, rest = text.partition("*/\n")
    body = _tidy(_SYSTEM.sub("", rest))
    whole = f'{first}*/\n#include "{prefix}.h"\n\n{system}\n{body}'
    return _with_names(whole, names, prefix)


def _with_names(text: str, names: Mapping[str, str], prefix: str) -> str:
    text = _OWN.sub(lambda found: names.get(found[0], found[0]), text)
    return text.replace("cotree_##", f"{prefix}_##")


def _tidy(text: str) -> str:
    return re.sub(r"\n{3,}", "\n\n", text).strip("\n") + "\n"
