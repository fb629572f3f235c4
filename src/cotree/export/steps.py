"""Printed steps from a linear graph to its equations: the paper's Eq. (1) to (9) with all terms.

This module only prints: the trees define the topology, terms (`PrintedTerm`) are nodes of the
formulation's arena, and terms of a sensitivity graph are their derivatives.
"""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.components import Role, integral_of
from cotree.dag.derivative import tangents
from cotree.dag.nodes import reachable
from cotree.domains import DOMAINS
from cotree.export.spelling import joined, printer, real_symbol
from cotree.export.symbolic import SymbolTable, symbolic_equations, to_sympy
from cotree.formulation.networks.rules import FieldRule, Lawful
from cotree.graph import f_circuit, f_cutset

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.dag.vector import Matrix
    from cotree.equations import Equations
    from cotree.formulation.first_graph import FirstGraph
    from cotree.formulation.networks.network import Network
    from cotree.formulation.networks.rules import Variable
    from cotree.graph import TopologyMatrix, Tree

_OUTWARDS = (
    "(2) summed from the ground outwards, for the node that each moving branch leads to: its axes "
    "R, its position r from the node before, angular velocity ω and acceleration α, acceleration a "
    "less that of free fall"
)
_INWARDS = (
    "(1) summed from the tips inwards: force F and torque T that each moving branch transmits to "
    "its node. What it carries takes m a + α × h + ω × (ω × h) and h × a + J α + ω × (J ω), less "
    "what chords exert there"
)


@dataclass(frozen=True)
class PrintedTerm:
    """A quantity in the printed equations: its symbol, its expressions and its frame."""

    #: Symbol and owner: ``F`` and ``^k`` for edge k, ``F`` and ``(B)`` for cluster B.
    letter: str
    place: str
    #: Nodes of the components: one of a scalar, three of a vector, nine of a matrix by rows.
    nodes: tuple[Node, ...]
    note: str = ""  # frame of the components, if not the ground frame
    edge: str = ""  # edge of the terminal equation; empty for other terms
    is_held: bool = False  # whether the term is a constraint, printed as equal to zero


def _entries(matrix: Matrix) -> tuple[Node, ...]:
    return tuple(entry for row in matrix for entry in row)


def _axes(node: str) -> str:
    return "" if node == "ground" else f" in the axes of {node}"


def _clusters(first: FirstGraph) -> tuple[list[str], list[str]]:
    """Return the names of the clusters, and the names of the axes that resolve their vectors."""
    motion = first.motion
    # Cluster 0 is the ground; cluster i + 1 is at the outer end of branch i.
    names, bases = ["ground"], [""]
    branches = [geometry.branch for geometry in motion.geometry]
    for i, branch in enumerate(branches):
        edge = motion.system.edges[branch.edge]
        # A joint with several axes has a branch for each axis. Only the last one ends at a node.
        primes = "'" * sum(other.edge == branch.edge for other in branches[i + 1 :])
        # The sign is positive if the branch has the direction of the edge.
        names.append((edge.second if branch.sign > 0 else edge.first) + primes)
        # A cluster that does not rotate has its parent's axes.
        is_own = motion.frames.steps[branch.child] is not None
        bases.append(_axes(names[-1]) if is_own else bases[branch.parent])
    return names, bases


def edge_terms(
    first: FirstGraph, symbol_of: Callable[[Variable, str, str], Node]
) -> list[PrintedTerm]:
    """List the terms of the terminal equations, edge by edge in the scene's order.

    ``symbol_of`` returns the symbol of a network variable, given its letter and its owner.
    """
    # The sort is stable, so the terms of an edge keep their order.
    order = {name: i for i, name in enumerate(first.scene.edges)}
    terms = [*_of_bodies(first), *_of_joints(first), *_of_elements(first), *_of_constraints(first)]
    if first.network is not None:
        terms += _of_networks(first.network, symbol_of)
    gravity = PrintedTerm("γ", "", first.system.gravity)
    return [gravity, *sorted(terms, key=lambda term: order[term.edge])]


def _of_bodies(first: FirstGraph) -> Iterator[PrintedTerm]:
    """Yield the masses and inertias of the bodies, and the arm vectors."""
    for name, edge in first.system.edges.items():
        place, axes = f"^{name}", _axes(edge.first)
        if edge.component.role is Role.BODY:
            yield PrintedTerm("m", place, (edge.scalars["mass"],), "", name)
            if edge.inertia is not None:
                yield PrintedTerm("J", place, _entries(edge.inertia), _axes(edge.second), name)
        elif edge.component.role is Role.ARM:
            if "vector" in edge.vectors:
                yield PrintedTerm("r", place, edge.vectors["vector"], axes, name)
            if edge.rotation is not None:
                yield PrintedTerm("R", place, _entries(edge.rotation), axes, name)


def _of_joints(first: FirstGraph) -> Iterator[PrintedTerm]:
    _, bases = _clusters(first)
    for geometry in first.motion.geometry:
        axes = bases[geometry.branch.parent]
        for speed, axis in zip(geometry.branch.speeds, geometry.axes, strict=True):
            yield PrintedTerm("u", f"({speed.name})", axis, axes, speed.edge)
    for speed, effort in zip(first.system.speeds, first.loads.efforts, strict=True):
        about = speed.name if speed.coordinate is None else speed.coordinate.name
        yield PrintedTerm("Q", f"({about})", (effort.value,), "", speed.edge)


def _of_elements(first: FirstGraph) -> Iterator[PrintedTerm]:
    """Yield forces and torques of chords on their second nodes, and those along measures."""
    _, bases = _clusters(first)
    for action in first.loads.actions:
        name, axes = action.edge.name, bases[action.ancestor]
        yield PrintedTerm("F", f"^{name}", action.force, axes, name)
        yield PrintedTerm("T", f"^{name}", action.torque, axes, name)
    for row in first.applied:
        if row.formula is not None:
            yield PrintedTerm("Q", f"({row.name})", (row.magnitude,), "", row.edge)


def _of_constraints(first: FirstGraph) -> Iterator[PrintedTerm]:
    """Yield the constraints of chords, or their rates if only speeds are constrained."""
    held = first.constraints
    for row, value, rate in zip(held.rows, held.values, held.rates, strict=True):
        # A constraint on speeds only has a rate but no value.
        letter, node = ("c", value) if value is not None else ("c_dot", rate)
        yield PrintedTerm(letter, f"({row.name})", (node,), "", row.edge, is_held=True)


def cluster_terms(first: FirstGraph) -> list[tuple[str, list[PrintedTerm]]]:
    """List the terms of each traversal of the tree, with a title for each traversal."""
    names, bases = _clusters(first)
    used = set(reachable(first.balance.residual))
    inertias: list[PrintedTerm] = []
    across: list[PrintedTerm] = []
    through: list[PrintedTerm] = []
    for geometry in first.motion.geometry:
        branch = geometry.branch
        child, outer = branch.child, bases[branch.parent]
        # Offsets, forces and torques are in the parent's basis, other vectors in the cluster's.
        place, own = f"({names[child]})", bases[child]
        turned = first.motion.frames.steps[child]
        if branch.turns:
            axes = turned or first.motion.frames.rotations[child].matrix
            across.append(PrintedTerm("R", place, _entries(axes), outer))
        across += [
            PrintedTerm("r", place, geometry.offset, outer),
            PrintedTerm("ω", place, first.motion.omega[child], own),
            PrintedTerm("α", place, first.view.across.alpha[child], own),
            PrintedTerm("a", place, first.view.across.origin[child], own),
        ]
        inertia = first.loads.inertias[child]
        if inertia is not None:
            inertias += [
                PrintedTerm("m", place, (inertia.mass,)),
                PrintedTerm("h", place, inertia.moment, own),
                # Include only the entries that balances contain: one for a planar body.
                *(
                    PrintedTerm("J", f"{place}.{'xyz'[i]}{'xyz'[j]}", (inertia.tensor[i][j],), own)
                    for i in range(3)
                    for j in range(i + 1)
                    if inertia.tensor[i][j] in used
                ),
            ]
        beyond = first.balance.beyond[child - 1]
        # The inward traversal begins at the outermost branch.
        through[:0] = [
            PrintedTerm("F", place, beyond.force, outer),
            PrintedTerm("T", place, beyond.torque, outer),
        ]
    return [
        (_OUTWARDS, across),
        (
            "Mass m, first moment h and second moment J of all that a branch carries rigidly",
            inertias,
        ),
        (_INWARDS, through),
    ]


def _of_networks(
    network: Network, symbol_of: Callable[[Variable, str, str], Node]
) -> Iterator[PrintedTerm]:
    """Yield the network laws: first those that determine a variable, then residuals."""
    rules = network.solved.plan.rules

    def named(variable: Variable) -> Node:
        return symbol_of(variable, *_network_name(network, variable))

    def argument(variable: Variable) -> Node:
        rule = rules[variable]
        # Field values are not network variables.
        if not isinstance(rule, FieldRule) or not variable[0].startswith("field"):
            return named(variable)
        return rule.value(network.solved.dag, {v: named(v) for v in rule.needs})

    for variable, rule in rules.items():
        port = network.ports.get(variable[1])
        # Sums are f-circuit and f-cutset equations, which are printed separately.
        if port is None or not isinstance(rule, Lawful | FieldRule):
            continue
        own = {v: argument(v) for v in rule.needs}
        letter, place = _network_name(network, variable)
        is_held = variable[0].startswith("residual")
        value = rule.value(network.solved.dag, own)
        yield PrintedTerm(letter, place, (value,), "", port.edge.name, is_held)


def _network_name(network: Network, variable: Variable) -> tuple[str, str]:
    """Return a variable's letter and owner: ``v``, ``^R1`` (edge) or ``v``, ``(out)`` (node)."""
    quantity, name = variable
    base, _, rate = quantity.partition("_")
    if base == "residual":
        return "g", f"({name})"
    dot = "_dot" if rate else ""
    if base in ("potential", "path"):
        domain, start, node = name.split("|")
        at = node if base == "potential" else f"{start}, {node}"
        return f"{DOMAINS[domain].across_symbol}{dot}", f"({at})"
    port = network.ports.get(name)
    if port is None:
        edge, _, own = name.partition("|")
        return f"{own}{dot}", f"^{edge}"
    row = DOMAINS[port.terminal.domain]
    letters = {"across": row.across_symbol, "through": row.through_symbol}
    integral = integral_of(port.terminal)
    if integral is not None:
        letters["stretch"] = integral.name
    return f"{letters.get(base, base)}{dot}", f"^{name}"


_WIDTH = 98

#: Maximum number of operations in equations without common subexpressions.
_LARGEST_WRITTEN = 20_000
_HELD = "\N{NO-BREAK SPACE}"
_COMPONENTS = {1: ("",), 3: (".x", ".y", ".z"), 9: tuple(f".{i}{j}" for i in "xyz" for j in "xyz")}

#: Letters of the through and across variables of multibody graphs.
_LETTERS = {"translation": ("F", "r"), "rotation": ("T", "ω")}

_LIKEWISE = {"r": ", likewise v and a", "ω": ", likewise α; orientations follow one another"}


def formulation_steps(first: FirstGraph, equations: Equations) -> str:
    """Return the formulation steps of a scene ([1] eq. 1 to 9) as text.

    The first graph is the paper's G1; each sensitivity has a graph (G2, ...). Zero terms are
    omitted; components of terms that precede are written by name, such as ``F^k.x``.
    """
    names = SymbolTable.of(equations)
    speller = _Speller.of(first, equations, names)
    # The f-cutset equations of the branches, projected on their motion spaces.
    rows = zip(first.system.speeds, first.balance.residual, strict=True)
    balances = [PrintedTerm("", speed.name, (row,), is_held=True) for speed, row in rows]
    # Section numbers are numbers of equations in the paper.
    title = f"(3){', (4)' if equations.sensitivities else ''} terminal equations"
    sections = [
        _heading(first, speller, names),
        _topology(first),
        speller.section(title, edge_terms(first, speller.placeholder)),
        *(speller.section(title, terms) for title, terms in cluster_terms(first)),
        speller.section("(5) projection on the motion spaces", balances),
        _result(speller, equations),
    ]
    return "\n\n".join(section for section in sections if section) + "\n"


def _trees(first: FirstGraph) -> list[tuple[str, str, Tree, Tree]]:
    own = first.system.trees
    # A multibody system has one tree for both topology matrices. Networks may have two normal
    # trees, one for through and one for across variables.
    rows = [(*_LETTERS[tree.graph.domain], tree, tree) for tree in (own.translation, own.rotation)]
    for domain, normal in first.network.trees.items() if first.network else ():
        row = DOMAINS[domain]
        rows.append((row.through_symbol, row.across_symbol, normal.through, normal.across))
    # A domain without branches has no cutsets or circuits.
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
    filled = (textwrap.fill(line, _WIDTH, subsequent_indent="    ") for line in lines)
    return "\n".join([title, "=" * len(title), "", *filled])


def _topology(first: FirstGraph) -> str:
    """Write the f-cutset and f-circuit equations, which have the same form in all graphs."""
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
        # Sort the entry of the row's own edge to the front.
        entries = sorted(matrix.terms(row), key=lambda entry: entry[1] != row)
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
    """Count the operations of expressions without common subexpressions."""
    sizes: dict[Node, int] = {}
    for node in reachable(nodes):
        sizes[node] = 1 + sum(sizes[arg] for arg in node.args)
    return sum(sizes[node] for node in nodes)


def _wrapped(text: str, indent: int, hanging: int) -> str:
    """Wrap an equation before plus or minus signs, but not inside innermost parentheses."""
    # No-break spaces prevent line breaks within parentheses.
    kept = re.sub(r"\([^()]*\)", lambda group: group[0].replace(" ", _HELD), text)
    kept = re.sub(r"([+-]) ", rf"\1{_HELD}", kept)
    indents: dict[str, Any] = {"initial_indent": " " * indent, "subsequent_indent": " " * hanging}
    breaks: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
    return textwrap.fill(kept, _WIDTH, **indents, **breaks).replace(_HELD, " ")


@dataclass(frozen=True)
class _Graph:
    """G1 or a sensitivity graph: its name and the derivatives of the symbols in it."""

    label: str
    name: str | None
    subscript: str
    seed: dict[Node, Node]


@dataclass(frozen=True)
class _Speller:
    """A writer of expression nodes as text, which replaces nodes that have a name by it."""

    dag: Dag  # arena that holds the nodes
    graphs: tuple[_Graph, ...]  # G1 and the sensitivity graphs
    kinds: dict[str, str]  # component type of each edge, by name
    known: dict[Node, Any]  # names of symbols and of printed components
    placeholders: dict[Variable, Node]  # symbols of network variables
    spell: Callable[[Any], str]  # function that writes a SymPy expression

    @classmethod
    def of(cls, first: FirstGraph, equations: Equations, names: SymbolTable) -> _Speller:
        """Build the writer, with names for the symbols of the equations and of fields."""
        known = names.known(equations)
        graphs = [_Graph("G1", None, "", {})]
        unknowns = dict(zip(equations.unknowns, equations.unknown_tangents, strict=True))
        # The first sensitivity graph is G2 of the paper.
        for number, direction in enumerate(equations.sensitivities, start=2):
            known |= names.known_along(equations, direction)
            mark = names.subscripts[direction.name]
            # The seed has states, inputs and parameters; the derivative also needs the unknowns.
            seed = {**direction.seed, **unknowns}
            graphs.append(_Graph(f"G{number}", direction.name, mark, seed))
        kinds = {name: edge.component.name for name, edge in first.scene.edges.items()}
        speller = cls(first.system.dag, tuple(graphs), kinds, known, {}, printer("text", {}))
        for name, symbol in first.system.signals.gathered().items():
            speller._introduce(symbol, name, "")
        return speller

    def _introduce(self, symbol: Node, letter: str, place: str) -> None:
        """Store the name of a symbol, and of its derivative in each sensitivity graph."""
        self.known[symbol] = real_symbol(f"{letter}{place}")
        for graph in self.graphs[1:]:
            # The symbol is new in the arena, so no equation contains it.
            tangent = self.dag.symbol(f"steps {graph.label}", symbol.index)
            graph.seed[symbol] = tangent
            self.known[tangent] = real_symbol(f"{letter}{graph.subscript}{place}")

    def placeholder(self, variable: Variable, letter: str, place: str) -> Node:
        """Return the symbol that represents a network variable in terminal equations."""
        if variable not in self.placeholders:
            symbol = self.dag.symbol("steps", len(self.placeholders))
            self.placeholders[variable] = symbol
            self._introduce(symbol, letter, place)
        return self.placeholders[variable]

    def section(self, title: str, terms: Sequence[PrintedTerm]) -> str:
        """Write a section with the nonzero terms of each graph; empty if there are none."""
        lines = []
        for graph in self.graphs:
            own = list(self._lines(terms, graph))
            lines += ["", *([f"  {graph.label}"] if graph.name else []), *own] if own else []
        return "\n".join([textwrap.fill(title, _WIDTH), *lines]) if lines else ""

    def _lines(self, terms: Sequence[PrintedTerm], graph: _Graph) -> Iterator[str]:
        nodes = [node for term in terms for node in term.nodes]
        # Call once for all terms, because they share most of their derivatives.
        values = iter(nodes if graph.name is None else tangents(nodes, graph.seed))
        edges = {term.edge for term in terms if term.edge}
        width = max((len(f"{edge} ({self.kinds[edge]})  ") for edge in edges), default=0)
        before = ""
        for term in terms:
            own = [next(values) for _ in term.nodes]
            spelt = to_sympy(own, self.known)
            # SymPy may simplify the values to zero.
            if not any(spelt):
                continue
            name = f"{term.letter}{graph.subscript if term.letter else ''}{term.place}"
            label = "" if term.edge in ("", before) else f"{term.edge} ({self.kinds[term.edge]})"
            before = term.edge
            start = label.ljust(width) + f"{name}{' = ' if term.letter else ': '}"
            text = f"{self._entries(spelt)}{' = 0' if term.is_held else term.note}"
            yield _wrapped(start + text, 2, width + 6)
            if not term.is_held:
                self._remember(name, own, spelt)

    def _entries(self, values: Sequence[Any]) -> str:
        entries = [self.spell(value) for value in values]
        if len(entries) == 1:
            return entries[0]
        if len(entries) == 3:
            return f"[{', '.join(entries)}]"
        # Entries 0, 4 and 8 of nine are the diagonal.
        if not any(values[i] for i in range(9) if i % 4):
            return f"diag({', '.join(entries[::4])})"
        return f"[{'; '.join(', '.join(entries[i : i + 3]) for i in (0, 3, 6))}]"

    def _remember(self, name: str, nodes: Sequence[Node], values: Sequence[Any]) -> None:
        """Store names for components that are longer than their names, for use in later terms."""
        for suffix, node, value in zip(_COMPONENTS[len(nodes)], nodes, values, strict=True):
            # SymPy may simplify an expression to a number, such as sin^2 + cos^2.
            symbol = value if value.is_number else real_symbol(f"{name}{suffix}")
            # Name the positive value, because more terms contain it.
            if node.op == "neg":
                node, symbol = node.args[0], -symbol
            # A name only shortens operations whose operands are operations.
            if any(arg.args for arg in node.args):
                self.known.setdefault(node, symbol)
