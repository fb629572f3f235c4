"""Rendering of templates, and access to the C modules in ``templates/runtime``.

A module consists of a public header, an internal header if its sources share declarations, and the
sources whose first inclusion is one of these headers.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from typing import TYPE_CHECKING

from cotree.codegen.c_text import squeezed, unframed, without_unused
from cotree.codegen.printing import wrapped
from cotree.codegen.targets import DOUBLE, Target
from cotree.errors import CodegenError
from cotree.files import includes, template_folder
from cotree.naming import c_comment, c_string
from cotree.program.kernels import KERNELS
from cotree.version import ABI_VERSION, VERSION

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    import jinja2


#: Maximum size of a C file, [byte].
LARGEST_FILE = 200_000_000


@cache
def environment(target: Target = DOUBLE, *, is_html: bool = False) -> jinja2.Environment:
    """Return the Jinja environment that renders templates; names are escaped if ``is_html``.

    C templates contain ``{{ real }}`` for the type of numbers, ``{{ f }}`` after each literal and
    function of ``math.h``, ``{{ DBL }}`` for the prefix of names in ``float.h``, and functions that
    return tolerances and the limits of the range. Filters convert numbers and texts to literals,
    texts to comments, and items to lines of a readable length.
    """
    import jinja2

    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(template_folder()),
        # A missing name raises an error instead of rendering as empty text.
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=is_html,  # naming.py escapes names and texts for C
    )
    # Macros imported by templates see only the globals of the environment.
    made.globals |= {
        "real": target.scalar,
        "f": target.suffix,
        "DBL": target.limits,
        "HUGE_VAL": target.infinity,
        "strtod": target.reader,
        "share": target.share,
        "extreme": target.extreme,
    }
    made.filters |= {
        "constant": target.constant,
        "literal": target.literal,
        "c_string": c_string,
        "c_comment": c_comment,
        "filled": lambda items: wrapped(map(str, items)),
    }
    return made


def render(template: str, target: Target = DOUBLE, **context: object) -> str:
    """Return a rendered template; raise CodegenError if its length or a number is out of range."""
    text = environment(target).get_template(template).render(**context)
    if len(text) > LARGEST_FILE:
        raise CodegenError(
            f"the C source has {len(text)} characters: request fewer sensitivities or outputs"
        )
    return text


@dataclass(frozen=True)
class Features:
    """Parts of the runtime that are compiled; by default all parts."""

    sensitivities: bool = True  # whether the model has sensitivities
    inputs: bool = True  # whether the model has inputs
    algebraic: bool = True  # whether the model has algebraic unknowns
    constraints: bool = True  # whether states are projected onto constraints
    events: bool = True  # whether the model has events, or kinks at times that depend on states
    modes: bool = True  # whether events have modes: dry friction, loads, rigid stops
    discs: bool = True  # whether there is friction on planes in space
    #: Whether rates have kinks at times that depend on sensitivity parameters.
    moving_breakpoints: bool = True
    implicit: bool = True  # whether an implicit method uses a Jacobian
    helper: bool = True  # whether the caller's function searches states if iterations fail
    mending: bool = True  # whether prescribed initial values may be changed to satisfy constraints
    sundials: bool = True  # whether SUNDIALS may integrate the model
    #: For FMUs: whether the start satisfies constraints or conditions, or selects modes; whether
    #: time events or upper bounds of the step size exist.
    start: bool = True
    breakpoints: bool = True
    #: For FMUs: whether Model Exchange and Co-Simulation are supported.
    exchange: bool = True
    steps: bool = True

    def macros(self) -> dict[str, bool]:
        """Return the value of each feature's macro, by name."""
        return {
            f"COTREE_HAS_{row.name.upper()}": bool(getattr(self, row.name)) for row in fields(self)
        }


#: All features, as compiled for Python.
ALL = Features()


_INTERNAL = "_internal.h"
#: Inserted before the joined sources of a module: it makes their private functions static.
_PRIVATE = "#undef COTREE_PRIVATE\n#define COTREE_PRIVATE static\n"


def with_runtime(
    files: Mapping[str, str],
    target: Target = DOUBLE,
    *,
    features: Features = ALL,
    has_sources: bool = True,
) -> dict[str, str]:
    """Add ``cotree_abi.h`` and the modules that texts include; ``features`` select their parts."""
    found = {name: resolve(text, features.macros()) for name, text in files.items()}
    waiting = [name for text in found.values() for name in includes(text)]
    while waiting:
        header = waiting.pop(0)
        if header in found or (header != "cotree_abi.h" and header not in _paths()):
            continue  # already present, or not a module of the runtime
        added = {header: header_text(header, target, features)}
        if has_sources:
            added |= source_texts(header, target, features)
        found |= added
        waiting += [name for text in added.values() for name in includes(text)]
    return found


def project_files(files: Mapping[str, str], target: Target, features: Features) -> dict[str, str]:
    """Add the runtime modules that ``files`` include, without unused parts."""
    shared = _paths().keys() - {name for name in files if name.endswith(".c")}
    return without_unused(with_runtime(files, target, features=features), shared)


def header_text(name: str, target: Target = DOUBLE, features: Features = ALL) -> str:
    """Return the text of a public header, including ``cotree_abi.h``."""
    text = _abi(target) if name == "cotree_abi.h" else _read(name)
    return _resolved(text, target, features)


def _abi(target: Target) -> str:
    kernels = tuple(KERNELS.values())
    return render(
        "c/cotree_abi.h.jinja", target, abi_version=ABI_VERSION, generator=VERSION, kernels=kernels
    )


def source_texts(header: str, target: Target = DOUBLE, features: Features = ALL) -> dict[str, str]:
    """Return a module's sources by name; sources that share an internal header are joined."""
    names = _sources(header)
    internal = header.replace(".h", _INTERNAL)
    if internal not in _paths():
        return {name: _resolved(_read(name), target, features) for name in names}
    shared = f'#include "{internal}"\n'
    head, _, first = _resolved(_read(names[0]), target, features).partition(shared)
    others = (_resolved(_read(name), target, features).replace(shared, "") for name in names[1:])
    _, own = unframed(_resolved(_read(internal), target, features))
    parts = [own, first, *filter(_has_code, others)]
    text = _without_repeated_headers("\n".join(part.lstrip() for part in parts))
    return {names[0]: f"{head}{_PRIVATE}{text}"}


def _has_code(text: str) -> bool:
    """Return whether a text contains more than comments and directives."""
    return any(line[:1].isalpha() for line in text.splitlines())


def _without_repeated_headers(text: str) -> str:
    seen: set[str] = set()
    lines = []
    for line in text.splitlines(keepends=True):
        if line not in seen:
            lines.append(line)
        if line.startswith("#include <"):
            seen.add(line)
    return squeezed("".join(lines))


@cache
def _paths() -> dict[str, Path]:
    return {path.name: path for path in sorted(template_folder().glob("runtime/*/*.[ch]"))}


@cache
def _read(name: str) -> str:
    try:
        return _paths()[name].read_text("ascii")
    except KeyError:
        raise CodegenError(f"the runtime has no file {name}: install cotree again") from None


@cache
def _sources(header: str) -> list[str]:
    """Return the sources of a header; the source of the same name is first."""
    own = header.removesuffix(".h")
    found = []
    for name in _paths():
        if name.endswith(".c") and includes(_read(name))[0] in (header, own + _INTERNAL):
            found.append(name)
    return sorted(found, key=lambda name: (name != f"{own}.c", name))


def _resolved(text: str, target: Target, features: Features) -> str:
    """Remove the parts of a text that do not apply to the type of numbers or to the features."""
    return resolve(text, {"COTREE_SINGLE": target.digits != DOUBLE.digits, **features.macros()})


def resolve(text: str, known: Mapping[str, bool]) -> str:
    """Evaluate preprocessor conditions on known macros, and remove the text they exclude.

    Conditions have the form ``#if NAME`` or ``#if !NAME``, or combine such terms with ``&&`` or
    ``||``; conditions on unknown macros remain. A default between ``#ifndef NAME`` and ``#endif``
    is removed if the macro is known.
    """
    if not any(name in text for name in known):
        return text
    lines: list[str] = []
    # For each open condition: whether it is evaluated here, and whether its lines remain.
    open_: list[tuple[bool, bool]] = []
    for line in text.splitlines():
        if (value := _value(line, known)) is not None:
            open_.append((True, value))
        elif line.startswith("#ifndef ") and line.removeprefix("#ifndef ") in known:
            open_.append((True, False))
        elif line.startswith("#if"):
            open_.append((False, True))
            _keep(lines, line, open_)
        elif line == "#else" and open_[-1][0]:
            open_[-1] = (True, not open_[-1][1])
        elif line.startswith("#endif"):
            if not open_[-1][0]:
                _keep(lines, line, open_)
            open_.pop()
        else:
            _keep(lines, line, open_)
    return squeezed("\n".join(lines) + "\n")


def _value(line: str, known: Mapping[str, bool]) -> bool | None:
    """Return the value of a condition on known macros; None if the line is none."""
    if not line.startswith("#if "):
        return None
    operator, join = (" || ", any) if "||" in line else (" && ", all)
    terms = line.removeprefix("#if ").split(operator)
    if not all(term.removeprefix("!") in known for term in terms):
        return None
    return join(known[term.removeprefix("!")] != term.startswith("!") for term in terms)


def _keep(lines: list[str], line: str, open_: Iterable[tuple[bool, bool]]) -> None:
    if all(is_kept for _, is_kept in open_):
        lines.append(line)
