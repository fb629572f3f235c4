"""The C of a model and of the engine that runs members of an ensemble, as one file of CUDA.

In: the C text of a model and a method. Out: the same text in one unit, which compilers of C++ take,
too, with the functions that threads of a graphics processor begin with.
"""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

from cotree.codegen.integrators import batch_files, engine_files
from cotree.codegen.render import render
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.codegen.model_text import ModelText

#: What each worker has for itself, in the order in which its memory holds it.
ROOMS = ("memory", "k", "u", "z", "times", "inputs", "outputs", "slopes")

_INCLUDE = re.compile(r'^#include "(\w+\.h)"\n', re.MULTILINE)
_SYSTEM = re.compile(r"^#include <.*>\n", re.MULTILINE)
_MACRO = re.compile(r"^#define (\w+)", re.MULTILINE)
# Functions that are joined into their callers take the compiler minutes; short ones are inline.
_APART = re.compile(r"^static (?!const|inline)(?=[^=;]*?\()", re.MULTILINE)
# Names that a file keeps for itself: functions and tables, types, and constants.
_STATIC = re.compile(r"^static [^=;(\n]*?\b(\w+)(?:\(|\[|\s*=|;)", re.MULTILINE)
_TYPE = re.compile(r"^(?:typedef .*?\b|\} )(\w+);", re.MULTILINE)
_ENUM = re.compile(r"^enum \{(.*?)\};", re.MULTILINE | re.DOTALL)


def cuda_text(model: ModelText, stepper: str) -> str:
    """Write the file.

    Parameters
    ----------
    model : ModelText
        The model.
    stepper : str
        An explicit method of ``codegen.integrators.INTEGRATORS``.
    """
    files = {**batch_files(), **engine_files(stepper), **model.files}
    sources = sorted(name for name in files if name.endswith(".c"))
    own = {name: _own_names(files[name]) for name in sources}
    shared = Counter(name for names in own.values() for name in names)
    seen: set[str] = set()
    # All headers come first: what they declare has the same name in all units.
    headers = "".join(_included(files, name, seen) for name in sources)
    units = [
        _unit(place, files[name], [word for word in own[name] if shared[word] > 1])
        for place, name in enumerate(sources)
    ]
    return render(
        "c/cuda/members.cu.jinja",
        generator=VERSION,
        units=headers + "\n".join(units),
        rooms=ROOMS,
        prefix=model.prefix,
        stepper=stepper,
    )


def _own_names(text: str) -> set[str]:
    """Find the names that a unit does not share with others."""
    constants = re.findall(r"\w+", " ".join(_ENUM.findall(text)))
    return {*_STATIC.findall(text), *_TYPE.findall(text), *constants}


def _included(files: Mapping[str, str], name: str, seen: set[str]) -> str:
    """Give the headers that a file includes, each behind those that it includes itself."""
    found = ""
    for header in _INCLUDE.findall(files[name]):
        if header not in seen:
            seen.add(header)
            found += _included(files, header, seen) + _without_includes(files[header])
    return found


def _without_includes(text: str) -> str:
    return _SYSTEM.sub("", _INCLUDE.sub("", text))


def _unit(place: int, text: str, names: list[str]) -> str:
    """Give a unit in which names that others have, too, get another end."""
    text = _without_includes(text)
    for name in names:
        # Members of structures keep their names.
        text = re.sub(rf"(?<![.>\w]){name}\b", f"{name}_{place}", text)
    ends = "".join(f"#undef {name}\n" for name in dict.fromkeys(_MACRO.findall(text)))
    return f"{_APART.sub('COTREE_STATIC ', text)}\n{ends}"
