"""Contexts into templates, and the runtime: ordinary C below ``templates/runtime``.

The runtime is the same for every model. In: the names of headers, or C text that includes them.
Out: their text and that of their sources. A folder of the runtime holds modules. A module is a
public header, an internal one where its sources share declarations, and the sources whose first
include is either of them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from typing import TYPE_CHECKING

from cotree.codegen.c_text import includes, squeezed, unframed, without_unused
from cotree.codegen.printing import wrapped
from cotree.codegen.targets import DOUBLE, Target
from cotree.errors import CodegenError
from cotree.files import template_folder
from cotree.naming import c_comment, c_string
from cotree.program.kernels import KERNELS
from cotree.version import ABI_VERSION, VERSION

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    import jinja2


#: Size limit of C text for compilation, in bytes.
LARGEST_FILE = 200_000_000


@cache
def environment(target: Target = DOUBLE, *, is_html: bool = False) -> jinja2.Environment:
    """Return the environment that fills templates; it escapes names and texts in HTML.

    Parameters
    ----------
    target : Target
        The type of numbers. Templates of C write ``{{ real }}`` for the type, ``{{ f }}`` behind
        each literal and each function of ``math.h``, ``{{ DBL }}`` for the beginning of the names
        in ``float.h``, and ask for tolerances and for the ends of the range. With doubles, ``f`` is
        empty and the others are what they are called. Filters write numbers and texts as literals,
        texts as comments, and items on lines of a readable length.
    is_html : bool
        Whether texts are HTML.
    """
    import jinja2

    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(template_folder()),
        # A name missing from a context raises an error instead of producing empty C text.
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=is_html,  # HTML only; names and texts in C have been escaped in naming.py
    )
    # Set in the environment, so that imported macros can use them as well.
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
    """Fill one template.

    Parameters
    ----------
    template : str
        Path below the template folder.
    target : Target
        The type of numbers.
    **context
        Typed contexts, see :mod:`cotree.codegen.context`.

    Raises
    ------
    CodegenError
        If the text grows beyond reason, or a coefficient is beyond the range of the type.
    """
    text = environment(target).get_template(template).render(**context)
    if len(text) > LARGEST_FILE:
        raise CodegenError(
            f"the C text has {len(text)} characters: ask for fewer sensitivities or outputs"
        )
    return text


@dataclass(frozen=True)
class Features:
    """The parts of the runtime that are compiled; by default all of them."""

    sensitivities: bool = True  # whether the model has sensitivities
    inputs: bool = True  # whether the model has inputs
    algebraic: bool = True  # whether the model has algebraic unknowns
    constraints: bool = True  # whether states are projected onto constraints
    events: bool = True  # whether the model has events, or kinks at times that depend on states
    modes: bool = True  # whether events have modes: dry friction, loads, rigid stops
    discs: bool = True  # whether there is friction on planes in space
    #: Whether rates have kinks at times that depend on parameters of sensitivity.
    moving_corners: bool = True
    implicit: bool = True  # whether an implicit method uses a Jacobian
    helper: bool = True  # whether a caller's function finds states if iterations fail
    mending: bool = True  # whether prescribed values may change to satisfy constraints
    sundials: bool = True  # whether the model may be integrated by SUNDIALS
    #: FMU: whether its start satisfies constraints or conditions, or selects modes; whether there
    #: are time events or upper bounds of the step size.
    start: bool = True
    breakpoints: bool = True
    #: For FMUs: whether they offer Model Exchange, and Co-Simulation.
    exchange: bool = True
    steps: bool = True

    def macros(self) -> dict[str, bool]:
        """Return the value of each macro by name."""
        return {
            f"COTREE_HAS_{row.name.upper()}": bool(getattr(self, row.name)) for row in fields(self)
        }


#: All features, as compiled for Python.
ALL = Features()


_INTERNAL = "_internal.h"
#: Text around sources in one file: functions that only one module calls become static.
_PRIVATE = "#undef COTREE_PRIVATE\n#define COTREE_PRIVATE static\n"


def with_runtime(
    files: Mapping[str, str],
    target: Target = DOUBLE,
    *,
    features: Features = ALL,
    has_sources: bool = True,
) -> dict[str, str]:
    """Add the modules that texts include, and those that these include.

    Parameters
    ----------
    files : mapping of str to str
        C text by file name.
    target : Target
        The type of numbers.
    features : Features
        What is compiled, in the files given, too.
    has_sources : bool
        Whether sources are added, too, or headers alone.

    Returns
    -------
    dict of str to str
        Text by file name: the files themselves, then ``cotree_abi.h`` and the runtime's.
    """
    found = {name: resolve(text, features.macros()) for name, text in files.items()}
    waiting = [name for text in found.values() for name in includes(text)]
    while waiting:
        header = waiting.pop(0)
        if header in found or (header != "cotree_abi.h" and header not in _paths()):
            continue  # the file is already present, or is one of the model
        added = {header: header_text(header, target, features)}
        if has_sources:
            added |= source_texts(header, target, features)
        found |= added
        waiting += [name for text in added.values() for name in includes(text)]
    return found


def project_files(files: Mapping[str, str], target: Target, features: Features) -> dict[str, str]:
    """Add the modules that texts include, without unused parts; see ``with_runtime``.

    Sources that are given stay whole.
    """
    shared = _paths().keys() - {name for name in files if name.endswith(".c")}
    return without_unused(with_runtime(files, target, features=features), shared)


def header_text(name: str, target: Target = DOUBLE, features: Features = ALL) -> str:
    """Return the text of a public header, ``cotree_abi.h`` among them."""
    text = _abi(target) if name == "cotree_abi.h" else _read(name)
    return _resolved(text, target, features)


def _abi(target: Target) -> str:
    kernels = tuple(KERNELS.values())
    return render(
        "c/cotree_abi.h.jinja", target, abi_version=ABI_VERSION, generator=VERSION, kernels=kernels
    )


def source_texts(header: str, target: Target = DOUBLE, features: Features = ALL) -> dict[str, str]:
    """Return the sources of a module by name.

    Those that share an internal header become one file, whose private functions are static.
    """
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
    """Return whether a text has more than comments and directives."""
    return any(line[:1].isalpha() for line in text.splitlines())


def _without_repeated_headers(text: str) -> str:
    """Remove repeated inclusions of headers of C."""
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
    """Return all files of the runtime by name."""
    return {path.name: path for path in sorted(template_folder().glob("runtime/*/*.[ch]"))}


@cache
def _read(name: str) -> str:
    try:
        return _paths()[name].read_text("ascii")
    except KeyError:
        raise CodegenError(f"the runtime has no file {name}: install cotree again") from None


@cache
def _sources(header: str) -> list[str]:
    """List the sources of a header; the one with its own name first."""
    own = header.removesuffix(".h")
    found = []
    for name in _paths():
        if name.endswith(".c") and includes(_read(name))[0] in (header, own + _INTERNAL):
            found.append(name)
    return sorted(found, key=lambda name: (name != f"{own}.c", name))


def _resolved(text: str, target: Target, features: Features) -> str:
    """Remove the parts that a type of numbers, or a model, does not use."""
    return resolve(text, {"COTREE_SINGLE": target.digits != DOUBLE.digits, **features.macros()})


def resolve(text: str, known: Mapping[str, bool]) -> str:
    """Evaluate conditions of the preprocessor on known macros, and drop text that is not compiled.

    Parameters
    ----------
    text : str
        C text. Conditions are written ``#if NAME`` or ``#if !NAME``, several joined by ``&&`` or by
        ``||``; a default between ``#ifndef NAME`` and ``#endif`` is dropped.
    known : mapping of str to bool
        Values of macros; other conditions stay.
    """
    if not any(name in text for name in known):
        return text
    lines: list[str] = []
    # For each open condition: whether it is decided here, and whether its lines are kept.
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
    """Return the value of a condition on known macros; None for other lines."""
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
