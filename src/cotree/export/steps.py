"""The way from a linear graph to its equations, printed with the terms that were really formed.

In: the first graph and its equations. Out: a text with the paper's Eq. (1) to (9), in the scene's
own names. Nothing is derived here: topology comes from the trees, every term is a node of the
formulation's arena (:mod:`cotree.export.terms`), and the terms of a sensitivity graph are the
derivatives of these nodes along its direction.
"""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.dag.derivative import tangents
from cotree.dag.traverse import reachable
from cotree.domains import DOMAINS
from cotree.export.equations import SymbolTable, symbolic_equations
from cotree.export.spelling import joined, printer
from cotree.export.terms import balance_terms, cluster_terms, edge_terms
from cotree.export.to_sympy import to_sympy
from cotree.export.variable_names import real_symbol
from cotree.graph import f_circuit, f_cutset

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.equations import Equations
    from cotree.export.terms import Term
    from cotree.formulation.first_graph import FirstGraph
    from cotree.formulation.networks.rules import Variable
    from cotree.graph import TopologyMatrix, Tree

_WIDTH = 98

#: Operations beyond which equations without common subexpressions say nothing to a reader.
_LARGEST_WRITTEN = 20_000
_HELD = "\N{NO-BREAK SPACE}"  # where a line must not be broken
_COMPONENTS = {1: ("",), 3: (".x", ".y", ".z"), 9: tuple(f".{i}{j}" for i in "xyz" for j in "xyz")}

#: Through and across letters of the graphs of multibody systems.
_LETTERS = {"translation": ("F", "r"), "rotation": ("T", "ω")}

_LIKEWISE = {"r": ", likewise v and a", "ω": ", likewise α; orientations follow one another"}


def formulation_steps(first: FirstGraph, equations: Equations) -> str:
    """Print the steps of the formulation of a scene.

    Parameters
    ----------
    first : FirstGraph
        The first graph (the paper's G1).
    equations : Equations
        The equations formed from it, with one sensitivity graph (G2, ...) for each direction in
        ``equations.sensitivities``.

    Returns
    -------
    str
        The text, ending with a newline. Terms that are zero are left out; a component of a term
        that was printed before goes by its name, such as ``F^k.x``.

    References
    ----------
    [1] eq. 1 to 9.
    """
    names = SymbolTable.of(equations)
    speller = _Speller.of(first, equations, names)
    # Sections are numbered as the paper's equations are.
    title = f"(3){', (4)' if equations.sensitivities else ''} terminal equations"
    sections = [
        _heading(first, speller, names),
        _topology(first),
        speller.section(title, edge_terms(first, speller.stand_in)),
        *(speller.section(title, terms) for title, terms in cluster_terms(first)),
        speller.section("(5) projection on the motion spaces", balance_terms(first)),
        _result(speller, equations),
    ]
    return "\n\n".join(section for section in sections if section) + "\n"


def _trees(first: FirstGraph) -> list[tuple[str, str, Tree, Tree]]:
    """List letters of through and across variables with the trees of f-cutsets and f-circuits."""
    own = first.system.trees
    # A multibody system has one tree for both topology matrices. Networks take normal trees, which
    # may differ for through and across variables.
    rows = [(*_LETTERS[tree.graph.domain], tree, tree) for tree in (own.translation, own.rotation)]
    for domain, normal in first.network.trees.items() if first.network else ():
        row = DOMAINS[domain]
        rows.append((row.through_symbol, row.across_symbol, normal.through, normal.across))
    # A domain without branches has no cuts and no circuits.
    return [row for row in rows if row[-1].branches]


def _heading(first: FirstGraph, speller: _Speller, names: SymbolTable) -> str:
    title = f"{first.scene.name}: from the linear graph to the equations"
    lines = ["G1 is the linear graph of the system; superscripts name its edges."]
    for graph in speller.graphs[1:]:
        lines.append(
            f"{graph.label} has the same nodes, edges and trees; its variables, marked by "
            f"{graph.subscript}, are the derivatives of those of G1 with respect to {graph.name}."
        )
    lines.append("Terms that are zero are left out; .x marks a component of a term shown before.")
    spelt = {name: str(names.symbols[name]) for name in names.states}
    short = [f"{text} is {name}" for name, text in spelt.items() if text != name]
    lines += [f"States: {', '.join(short)}."] if short else []
    for _, _, through, across in _trees(first):
        lines.append(across.summary())
        if through is not across:
            lines.append(f"{through.summary()}, for f-cutsets; the one above is for f-circuits")
    # Only the lines of prose are filled: equations have breaks of their own.
    filled = (textwrap.fill(line, _WIDTH, subsequent_indent="    ") for line in lines)
    return "\n".join([title, "=" * len(title), "", *filled])


def _topology(first: FirstGraph) -> str:
    """Write the f-cutset and the f-circuit equations of G1; those of the others read the same."""
    lines = ["(1) f-cutset equations: through variables in the cut of each branch"]
    for letter, _, tree, _ in _trees(first):
        note = "; forces in the cut add their moments" if letter == "T" else ""
        lines += ["", f"  {tree.graph.domain}{note}"]
        lines += _sums(f_cutset(tree), letter)
    lines += ["", "(2) f-circuit equations: across variables around the circuit of each chord"]
    for _, letter, _, tree in _trees(first):
        lines += ["", f"  {tree.graph.domain}{_LIKEWISE.get(letter, '')}"]
        lines += _sums(f_circuit(tree), letter)
    return "\n".join(lines)


def _sums(matrix: TopologyMatrix, letter: str) -> Iterator[str]:
    for row in matrix.rows:
        entries = sorted(matrix.terms(row), key=lambda entry: entry[1] != row)  # its own edge first
        terms = [f"{'-' if sign < 0 else ''}{letter}^{edge}" for sign, edge in entries]
        yield _wrapped(f"{joined(terms)} = 0", 4, 10)


def _result(speller: _Speller, equations: Equations) -> str:
    title = "(7) the equations in states and unknowns, signs turned"
    rows = [*equations.matrix, equations.forcing, equations.rates]
    rows += [(*row.forcing, *row.rates.values()) for row in equations.sensitivities]
    if _written_size([node for row in rows for node in row]) > _LARGEST_WRITTEN:
        note = "Written out they are long: 'cotree equations' without --steps prints them."
        return f"{title}\n\n  {note}"
    symbolic = symbolic_equations(equations)
    lines = [
        _wrapped(f"{graph.label}: {line}", 2, 8)
        for graph in speller.graphs
        for line in symbolic.lines(graph.name)
    ]
    lines += [_wrapped(line, 2, 8) for line in symbolic.event_lines()]
    return "\n".join([title, "", *lines])


def _written_size(nodes: Sequence[Node]) -> int:
    """Count the operations of expressions that share nothing."""
    sizes: dict[Node, int] = {}
    # Text repeats a shared value wherever it is read, so sizes add up over all readers.
    for node in reachable(nodes):
        sizes[node] = 1 + sum(sizes[arg] for arg in node.args)
    return sum(sizes[node] for node in nodes)


def _wrapped(text: str, indent: int, hanging: int) -> str:
    """Wrap an equation before a plus or minus, but not inside the innermost parentheses."""
    # Spaces that must not break become no-break spaces, which the wrapping leaves alone.
    kept = re.sub(r"\([^()]*\)", lambda group: group[0].replace(" ", _HELD), text)
    kept = re.sub(r"([+-]) ", rf"\1{_HELD}", kept)
    return textwrap.fill(
        kept,
        _WIDTH,
        initial_indent=" " * indent,
        subsequent_indent=" " * hanging,
        break_long_words=False,
        break_on_hyphens=False,
    ).replace(_HELD, " ")


@dataclass(frozen=True)
class _Graph:
    """G1, or a sensitivity graph: its direction, and the tangents of the symbols along it."""

    label: str
    name: str | None
    subscript: str
    seed: dict[Node, Node]


@dataclass(frozen=True)
class _Speller:
    """Spells nodes; those that have a name are spelt by it.

    Attributes
    ----------
    dag : Dag
        The arena of the nodes.
    graphs : tuple of _Graph
        G1 and its sensitivity graphs.
    kinds : mapping of str to str
        Component names of the edges.
    known : dict of Node to sympy.Expr
        Symbols, and the components of the terms that were printed.
    stand_ins : dict of Variable to Node
        Symbols for variables of networks.
    spell : callable
        Writes a SymPy expression.
    """

    dag: Dag
    graphs: tuple[_Graph, ...]
    kinds: dict[str, str]
    known: dict[Node, Any]
    stand_ins: dict[Variable, Node]
    spell: Callable[[Any], str]

    @classmethod
    def of(cls, first: FirstGraph, equations: Equations, names: SymbolTable) -> _Speller:
        """Name the symbols of the equations, and those of across variables in fields.

        Parameters
        ----------
        first : FirstGraph
            The first graph.
        equations : Equations
            The equations formed from it.
        names : SymbolTable
            Names of the states, unknowns, parameters and inputs of the equations.
        """
        known = names.known(equations)
        graphs = [_Graph("G1", None, "", {})]
        unknowns = dict(zip(equations.unknowns, equations.unknown_tangents, strict=True))
        # The paper's G2 is the first sensitivity graph.
        for number, direction in enumerate(equations.sensitivities, start=2):
            known |= names.known_along(equations, direction)
            mark = names.subscripts[direction.name]
            # The direction's own seed has states, inputs and parameters; unknowns change, too.
            seed = {**direction.seed, **unknowns}
            graphs.append(_Graph(f"G{number}", direction.name, mark, seed))
        kinds = {name: edge.component.name for name, edge in first.scene.edges.items()}
        speller = cls(first.system.dag, tuple(graphs), kinds, known, {}, printer("text", {}))
        for name, symbol in first.system.signals.gathered().items():
            speller._introduce(symbol, name, "")
        return speller

    def _introduce(self, symbol: Node, letter: str, place: str) -> None:
        """Name a symbol that stands for a variable, and its derivative in each other graph."""
        self.known[symbol] = real_symbol(f"{letter}{place}")
        for graph in self.graphs[1:]:
            # A symbol that is new in the arena: the equations never see it.
            tangent = self.dag.symbol(f"steps {graph.label}", symbol.index)
            graph.seed[symbol] = tangent
            self.known[tangent] = real_symbol(f"{letter}{graph.subscript}{place}")

    def stand_in(self, variable: Variable, letter: str, place: str) -> Node:
        """Give the symbol that stands for a variable of a network in terminal equations.

        Parameters
        ----------
        variable : Variable
            The variable.
        letter, place : str
            Its name, and what it belongs to; see :class:`cotree.export.terms.Term`.
        """
        if variable not in self.stand_ins:
            symbol = self.dag.symbol("steps", len(self.stand_ins))
            self.stand_ins[variable] = symbol
            self._introduce(symbol, letter, place)
        return self.stand_ins[variable]

    def section(self, title: str, terms: Sequence[Term]) -> str:
        """Write the terms that are not zero, graph by graph; nothing where there are none."""
        lines = []
        for graph in self.graphs:
            own = list(self._lines(terms, graph))
            lines += ["", *([f"  {graph.label}"] if graph.name else []), *own] if own else []
        return "\n".join([textwrap.fill(title, _WIDTH), *lines]) if lines else ""

    def _lines(self, terms: Sequence[Term], graph: _Graph) -> Iterator[str]:
        nodes = [node for term in terms for node in term.nodes]
        # All at once: terms share most of their tangents.
        values = iter(nodes if graph.name is None else tangents(nodes, graph.seed))
        edges = {term.edge for term in terms if term.edge}
        width = max((len(f"{edge} ({self.kinds[edge]})  ") for edge in edges), default=0)
        before = ""
        for term in terms:
            own = [next(values) for _ in term.nodes]
            spelt = to_sympy(own, self.known)
            # Zero to SymPy, even where the nodes did not fold.
            if not any(spelt):
                continue
            name = f"{term.letter}{graph.subscript if term.letter else ''}{term.place}"
            label = "" if term.edge in ("", before) else f"{term.edge} ({self.kinds[term.edge]})"
            # The edge is named once, at the first of its terms.
            before = term.edge
            start = label.ljust(width) + f"{name}{' = ' if term.letter else ': '}"
            text = f"{self._entries(spelt)}{' = 0' if term.is_held else term.note}"
            yield _wrapped(start + text, 2, width + 6)
            if not term.is_held:
                self._remember(name, own, spelt)

    def _entries(self, values: Sequence[Any]) -> str:
        """Write a number, a vector or a matrix by its entries."""
        entries = [self.spell(value) for value in values]
        if len(entries) == 1:
            return entries[0]
        if len(entries) == 3:
            return f"[{', '.join(entries)}]"
        # The places 0, 4 and 8 of nine are the diagonal.
        if not any(values[i] for i in range(9) if i % 4):
            return f"diag({', '.join(entries[::4])})"
        return f"[{'; '.join(', '.join(entries[i : i + 3]) for i in (0, 3, 6))}]"

    def _remember(self, name: str, nodes: Sequence[Node], values: Sequence[Any]) -> None:
        """Let later terms refer to the components by name, where these are longer than names."""
        for suffix, node, value in zip(_COMPONENTS[len(nodes)], nodes, values, strict=True):
            # SymPy may find a number where the nodes are an expression, as sin^2 + cos^2.
            symbol = value if value.is_number else real_symbol(f"{name}{suffix}")
            # The name then serves the positive value, which more terms read.
            if node.op == "neg":
                node, symbol = node.args[0], -symbol
            # An operation on symbols alone is as short as its name.
            if any(arg.args for arg in node.args):
                self.known.setdefault(node, symbol)
