"""Parsing of a netlist into statements by circuit: elements, models and parameters."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cotree.errors import brief, nearest
from cotree.readers.names import SourceLine

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


_LONGEST_LINE = 100_000  # maximum number of characters of a statement with its continuation lines
# A dollar sign may be part of a name, so it starts a comment only between spaces.
_COMMENT = re.compile(r";|//|(?:^|\s)\$(?:\s|$)")

#: A word of a statement: an expression in braces or quotes, an equals sign, or other text.
_WORD = re.compile(r"\{[^{}]*\}|'[^']*'|=|[^\s(),={}']+")
_ASSIGNMENT = re.compile(r"(?<![\w.])([A-Za-z_][\w.]*)\s*=(?!=)\s*", re.ASCII)
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_FUNCTION = re.compile(r"\S+\s+([A-Za-z_]\w*)\s*\(([^(){}]*)\)\s*=?\s*(\S.*)", re.ASCII)
_BETWEEN = re.compile(r"[\s(),]*")


@dataclass(frozen=True)
class Line:
    """A statement of a netlist."""

    at: SourceLine  # file and first line of the statement
    words: tuple[str, ...]  # words as written
    text: str = ""  # whole text, with continuation lines joined

    @property
    def key(self) -> str:
        """The first word in lower case."""
        return self.words[0].lower()

    @property
    def name(self) -> str:
        """The first word as written, in quotes for messages."""
        return f"'{brief(self.words[0])}'"


def read_lines(text: str, file: str) -> Iterator[Line]:
    """Yield the statements of a netlist, from the second line up to ``.end``."""
    at, whole = SourceLine(file, 0), ""
    is_skipped = False
    # The first line is the title.
    for number, raw in enumerate([*text.splitlines()[1:], ""], start=2):
        here = SourceLine(file, number)
        match = _COMMENT.search(raw)
        line = (raw[: match.start()] if match else raw).strip()
        if not line or line.startswith("*"):
            continue
        if line.startswith("+"):
            if not whole:
                raise here.error("'+' continues a line, but there is none before it")
            whole += " " + line[1:]
            if len(whole) > _LONGEST_LINE:
                raise here.error(f"longer than {_LONGEST_LINE} characters: split it")
            continue
        if whole:
            yield Line(at, _words(whole, at), whole)
        at, whole = here, ""
        first = line.split(None, 1)[0].lower()
        if first in (".control", ".endc"):  # these lines surround commands of the simulator
            is_skipped = first == ".control"
        elif first == ".end" and not is_skipped:
            return
        elif not is_skipped:
            whole = line
    if whole:
        yield Line(at, _words(whole, at), whole)


def _words(line: str, at: SourceLine) -> tuple[str, ...]:
    found, i = [], 0
    while True:
        # Parentheses and commas separate words, as spaces do.
        i = _BETWEEN.match(line, i).end()  # type: ignore[union-attr]
        if i == len(line):
            break
        match = _WORD.match(line, i)
        if match is None:
            raise at.error(f"{line[i]!r} is unbalanced: it opens or closes an expression")
        found.append(match.group())
        i = match.end()
    if not found:
        raise at.error(f"there is no word in '{brief(line)}'")
    return tuple(found)


def unquoted(text: str) -> str:
    """Return an expression without the braces or quotes around it."""
    text = text.strip()
    return text[1:-1] if text[:1] + text[-1:] in ("{}", "''") else text


def settings(words: tuple[str, ...], at: SourceLine) -> dict[str, str]:
    """Return values by name from words of the form ``name = value``; names become lower case."""
    found: dict[str, str] = {}
    for i in range(0, len(words), 3):
        triple = words[i : i + 3]
        if len(triple) < 3 or triple[1] != "=" or "=" in (triple[0], triple[2]):
            raise at.error(f"'{brief(words[i])}' should be followed by = and a value")
        name = triple[0].lower()
        if name in found:
            raise at.error(f"'{brief(name)}' is given twice")
        found[name] = triple[2]
    return found


def assignments(line: Line) -> dict[str, tuple[str, str]]:
    """Return assignments ``name = value`` after the first word; values may contain spaces."""
    text = line.text.split(None, 1)[1] if len(line.words) > 1 else ""
    marks = list(_ASSIGNMENT.finditer(text))
    found: dict[str, tuple[str, str]] = {}
    if not marks or text[: marks[0].start()].strip(" \t,"):
        raise line.at.error(f"{line.name} should be followed by names, each with = and a value")
    for mark, following in zip(marks, [*(m.start() for m in marks[1:]), len(text)], strict=True):
        name, value = mark[1], text[mark.end() : following].strip(" \t,")
        if name.lower() in found:
            raise line.at.error(f"'{brief(name)}' is given twice")
        if not value:
            raise line.at.error(f"'{brief(name)}' should be followed by = and a value")
        found[name.lower()] = name, value
    return found


def split_settings(words: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the words before the first ``name = value``, and the remaining words."""
    at = words.index("=") - 1 if "=" in words else len(words)
    return words[: max(at, 0)], words[max(at, 0) :]


_LARGEST = 100_000  # maximum number of statements
_DEEPEST = 20  # maximum nesting of subcircuits

#: Statements for analyses and output, which are ignored.
_PASSED_OVER = (
    frozenset((".print", ".plot", ".probe", ".save", ".op", ".ac", ".dc", ".noise", ".tf", ".four"))
    | {".nodeset", ".width", ".title", ".meas", ".measure", ".sens", ".pz", ".disto"}
    | {".backanno", ".wave"}
)
#: Unsupported statements, with alternatives for error messages.
_REMEDIES = {
    ".step": "give the values to 'ensemble', or to the command 'sweep'",
    ".if": "write the chosen branch only, or an expression with a ? b : c",
}
_ELEMENTS = frozenset("rlckviefghbswdqmjx")


@dataclass(frozen=True)
class ModelCard:
    """A ``.model`` statement, with name as written, type in lower case, and parameters."""

    name: str
    type: str
    given: dict[str, str]
    at: SourceLine


@dataclass(frozen=True)
class UserFunction:
    """A ``.func`` statement, with arguments in lower case and the expression as written."""

    arguments: tuple[str, ...]
    body: str


@dataclass
class Circuit:
    """The statements of the main circuit or of a subcircuit."""

    name: str  # name as written
    at: SourceLine  # file and first line
    pins: tuple[str, ...] = ()  # nodes that are connected outside
    #: Default values of parameters, as written.
    defaults: dict[str, str] = field(default_factory=dict)
    elements: list[Line] = field(default_factory=list)
    #: Models and subcircuits, by name in lower case.
    models: dict[str, ModelCard] = field(default_factory=dict)
    circuits: dict[str, Circuit] = field(default_factory=dict)
    #: Name and value as written, and line, of each parameter.
    parameters: list[tuple[str, str, SourceLine]] = field(default_factory=list)
    #: Functions by name in lower case.
    functions: dict[str, UserFunction] = field(default_factory=dict)


@dataclass
class Netlist:
    """All statements of a netlist."""

    circuit: Circuit  # main circuit
    transient: Line | None = None  # statement ``.tran``
    held: list[Line] = field(default_factory=list)  # statements ``.ic``
    options: list[Line] = field(default_factory=list)  # statements ``.options`` and ``.temp``
    shared: list[str] = field(default_factory=list)  # nodes of ``.global``, in lower case
    passed_over: list[str] = field(default_factory=list)  # descriptions of ignored statements


def parse_netlist(text: str, where: str) -> Netlist:
    """Parse the text of a netlist."""
    return _Parser(where).parse(text)


class _Parser:
    def __init__(self, where: str) -> None:
        self.where = where
        self.netlist = Netlist(Circuit("", SourceLine(where, 1)))
        # Circuits whose statements are being read, from the main circuit to the innermost.
        self.open = [self.netlist.circuit]
        self.commands: dict[str, Callable[[Line], None]] = {
            ".model": self._model,
            ".param": self._parameters,
            ".func": self._function,
            ".global": self._global,
            ".subckt": self._begin,
            ".ends": self._finish,
            ".tran": self._transient,
            ".ic": self.netlist.held.append,
            **dict.fromkeys((".options", ".option", ".opt", ".temp"), self.netlist.options.append),
        }

    def parse(self, text: str) -> Netlist:
        for count, line in enumerate(read_lines(text, self.where)):
            if count >= _LARGEST:
                raise line.at.error(f"more than {_LARGEST} statements")
            self._take(line)
        if len(self.open) > 1:
            inner = self.open[-1]
            raise inner.at.error(f".subckt {brief(inner.name)} has no .ends")
        return self.netlist

    def _take(self, line: Line) -> None:
        key = line.key
        if key in self.commands:
            self.commands[key](line)
        elif key in (".include", ".inc", ".lib"):
            # An untrusted netlist must not include other files.
            raise line.at.error(
                f"{key} would read another file, which is not supported: paste its contents here"
            )
        elif key in _PASSED_OVER:
            self.netlist.passed_over.append(key)
        elif key.startswith("."):
            instead = f": {_REMEDIES[key]}" if key in _REMEDIES else nearest(key, self.commands)
            raise line.at.error(f"unsupported statement '{brief(key)}'{instead}")
        elif key[0] not in _ELEMENTS:
            raise line.at.error(
                f"{line.name} delays signals, which is not supported: replace the line by sections "
                "of L and C"
                if key[0] in "tou"
                else f"{line.name} is not a supported element: names begin with R, L, C, K, V, I, "
                "E, F, G, H, B, S, W, D, Q, J, M or X"
            )
        else:
            self.open[-1].elements.append(line)

    def _model(self, line: Line) -> None:
        if len(line.words) < 3 or "=" in line.words[1:3]:
            raise line.at.error(".model needs a name and a type")
        name = line.words[1]
        if name.lower() in self.open[-1].models:
            raise line.at.error(f"there is a second .model '{brief(name)}'")
        given = settings(line.words[3:], line.at)
        card = ModelCard(name, line.words[2].lower(), given, line.at)
        self.open[-1].models[name.lower()] = card

    def _parameters(self, line: Line) -> None:
        rows = [(name, value, line.at) for name, value in assignments(line).values()]
        self.open[-1].parameters += rows

    def _function(self, line: Line) -> None:
        match = _FUNCTION.fullmatch(line.text)
        if match is None:
            raise line.at.error(".func is written as .func name(a, b) {expression of a and b}")
        name, arguments = match[1], tuple(match[2].lower().replace(",", " ").split())
        if name.lower() in self.open[-1].functions:
            raise line.at.error(f"there is a second .func '{brief(name)}'")
        if not all(_NAME.fullmatch(word) for word in arguments):
            raise line.at.error(f"arguments of .func '{brief(name)}' must be names")
        self.open[-1].functions[name.lower()] = UserFunction(arguments, unquoted(match[3]))

    def _global(self, line: Line) -> None:
        self.netlist.shared += [word.lower() for word in line.words[1:]]

    def _begin(self, line: Line) -> None:
        if len(self.open) > _DEEPEST:
            raise line.at.error(f".subckt is nested more than {_DEEPEST} levels deep")
        words, given = split_settings(line.words[1:])
        # In some simulators, ``params:`` precedes the parameters.
        words = tuple(word for word in words if word.lower() != "params:")
        if not words:
            raise line.at.error(".subckt needs a name")
        name, pins = words[0], words[1:]
        if name.lower() in self.open[-1].circuits:
            raise line.at.error(f"there is a second .subckt '{brief(name)}'")
        if len({pin.lower() for pin in pins}) < len(pins):
            raise line.at.error(f".subckt '{brief(name)}' has two pins with the same name")
        defaults = settings(given, line.at)
        inner = Circuit(name, line.at, pins, defaults)
        self.open[-1].circuits[name.lower()] = inner
        self.open.append(inner)

    def _finish(self, line: Line) -> None:
        if len(self.open) == 1:
            raise line.at.error(".ends without a .subckt")
        self.open.pop()

    def _transient(self, line: Line) -> None:
        if self.netlist.transient is not None:
            raise line.at.error("there is a second .tran")
        self.netlist.transient = line
