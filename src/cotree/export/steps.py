"""The paper's derivation of the equations from a linear graph, printed step by step.

In: a scene, its graphs and trees, the first graph, and the parameter of the sensitivity graph.
Out: a text with the paper's Table 1 and Eq. (1) to (7), in the scene's own names.
"""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import ModelError, ParameterError, nearest
from cotree.export.balances import Balances, signed_sum
from cotree.export.coverage import chord_beyond, edge_beyond
from cotree.export.equations import symbolic_equations
from cotree.export.fields import FieldWriter
from cotree.export.spelling import spell_states, subscript
from cotree.export.terminal import Terminal
from cotree.export.terminal_rows import (
    across_rows,
    definitions,
    gathered,
    spaces_text,
    through_rows,
)
from cotree.scene.motion_spaces import motion_spaces
from cotree.sensitivity.graphs import form_equations

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cotree.components import Freedom
    from cotree.dag.several import Table
    from cotree.export.blackboard import Formula, Pair
    from cotree.formulation.first_graph import FirstGraph
    from cotree.graph import LinearGraph, Tree
    from cotree.scene.description import Edge, SceneDescription
    from cotree.scene.expressions import Expression

_WIDTH = 98
_HELD = "\N{NO-BREAK SPACE}"  # where a line must not be broken


def formulation_steps(
    scene: SceneDescription,
    graphs: Mapping[str, LinearGraph],
    trees: Mapping[str, Tree],
    first: FirstGraph | None,
    sensitivity: str | None = None,
) -> str:
    """Print the steps of the formulation of a multibody scene.

    Parameters
    ----------
    scene : SceneDescription
        The scene.
    graphs, trees : mapping of str to LinearGraph, Tree
        Its translation and rotation graphs, and the tree of each.
    first : FirstGraph or None
        The first graph, formed from the trees; None where they differ: the text then ends after
        the terminal equations.
    sensitivity : str, optional
        Parameter of the sensitivity graph, or a state whose initial value is meant; without it
        only the first graph is shown.

    Returns
    -------
    str
        The text, ending with a newline. Where an edge is beyond it, it ends before the first
        section that would need that edge, with a sentence that names it.

    Raises
    ------
    ParameterError
        If the sensitivity is to something that is neither a tunable parameter nor a state.
    ExpressionError
        If an expression of the scene has no value.
    ModelError
        If the scene has networks only.
    """
    board = _Board.of(scene, graphs, trees, sensitivity)
    sections = [
        _heading(board),
        _table(board),
        _cutsets(board),
        _circuits(board),
    ]
    limit = edge_beyond(scene, board.terminal.spaces, board.terminal.branches)
    if limit is None:
        sections += [_terminal_equations(board, number) for number in board.numbers]
        sections.append(_spaces(board))
        limit = chord_beyond(trees, first)
    if limit is not None:
        sections.append(_end(limit))
    elif first is not None:
        sections += [_projections(board), _eliminations(board), _result(board, first)]
    return "\n\n".join(sections) + "\n"


def _end(limit: str) -> str:
    return _wrapped(
        f"The steps end here: {limit}. scene.equations(), or 'cotree equations' without --steps, "
        "gives the equations of every scene that has any.",
        0,
        0,
    )


@dataclass(frozen=True)
class _Board:
    """The data that all sections share."""

    scene: SceneDescription
    graphs: Mapping[str, LinearGraph]
    trees: Mapping[str, Tree]
    name: str | None
    terminal: Terminal
    balances: Balances

    @classmethod
    def of(
        cls,
        scene: SceneDescription,
        graphs: Mapping[str, LinearGraph],
        trees: Mapping[str, Tree],
        name: str | None,
    ) -> _Board:
        """Choose the names of the variables."""
        if "rotation" not in trees:
            raise ModelError(
                "the steps are those of multibody scenes, and this one has networks only: 'cotree "
                "equations' without --steps gives its equations"
            )
        branches = frozenset().union(*(tree.branches for tree in trees.values()))
        spaces = motion_spaces(scene).of
        moving = [(e, step) for e in scene.edges if e in branches for step in spaces[e]]
        coordinates = [f"{e}.{name}" for e, step in moving for name, _ in step.coordinates]
        speeds = [f"{e}.{name}" for e, step in moving for name, _ in step.rates]
        states = [*coordinates, *speeds]
        tunable = [row.name for row in scene.parameters.values() if row.tunable]
        if name is not None and name not in tunable and name not in states:
            hint = nearest(name, [*tunable, *states])
            raise ParameterError(f"'{name}' is neither a tunable parameter nor a state{hint}")
        spelt = spell_states(coordinates, speeds, [*tunable, *scene.inputs])
        mark = subscript(name, spelt)
        driven = [row.name for row in scene.inputs.values() if _depends_on(row.value, name)]
        fields = FieldWriter(name, {moving: f"{moving}{mark}" for moving in (*states, *driven)})
        terminal = Terminal(scene, trees["rotation"], spaces, branches, spelt, mark, fields)
        return cls(scene, graphs, trees, name, terminal, Balances(trees, terminal))

    @property
    def numbers(self) -> tuple[int, ...]:
        """The graphs that are shown: 1, and 2 where there is a sensitivity."""
        return (1,) if self.name is None else (1, 2)

    @property
    def sources(self) -> str:
        """Name the terminal equations that are shown."""
        return " and ".join(f"({number + 2})" for number in self.numbers)

    def of_graph(self, pair: Pair, number: int) -> Formula:
        """Give the formula of one graph."""
        return pair.d if number == 2 else pair.value

    def freedoms(self) -> Iterator[tuple[Edge, Freedom]]:
        """Give the directions of the motion spaces of the branches."""
        for name in self.trees["translation"].branches:
            edge = self.scene.edges[name]
            for freedom in (*self.terminal.motion(edge, False), *self.terminal.motion(edge, True)):
                yield edge, freedom


def _depends_on(signal: Expression | Table, name: str | None) -> bool:
    """Whether an input changes with a parameter; a table does not."""
    return name is not None and name in getattr(signal, "names", ())


def _wrapped(text: str, indent: int, hanging: int) -> str:
    return textwrap.fill(
        text,
        _WIDTH,
        initial_indent=" " * indent,
        subsequent_indent=" " * hanging,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _equation(text: str, indent: int, hanging: int) -> str:
    """Wrap an equation before a plus or minus, but not inside the innermost parentheses."""
    kept = re.sub(r"\([^()]*\)", lambda group: group[0].replace(" ", _HELD), text)
    kept = re.sub(r" (?![+-] )", _HELD, kept)
    kept = re.sub(r"([+-]) ", rf"\1{_HELD}", kept)
    return _wrapped(kept, indent, hanging).replace(_HELD, " ")


def _listed(label: str, equations: Sequence[str], indent: int) -> list[str]:
    """Lay out equations behind a label, as many on a line as there is room for."""
    lines = [label.ljust(indent)]
    for i, equation in enumerate(equations):
        text = equation if i == len(equations) - 1 else f"{equation},"
        if len(lines[-1]) > indent and len(lines[-1]) + 1 + len(text) > _WIDTH:
            lines.append(" " * indent)
        lines[-1] += ("" if len(lines[-1]) == indent else " ") + text
    first, *others = lines
    return [
        _equation(first, 0, indent + 4),
        *(_equation(line.lstrip(), indent, indent + 4) for line in others),
    ]


def _heading(board: _Board) -> str:
    title = f"{board.scene.name}: from the linear graph to the equations"
    lines = [title, "=" * len(title), ""]
    if board.name is None:
        lines.append("G1 is the linear graph of the system. Superscripts name its edges.")
    else:
        kind = "initial value of" if "." in board.name else "parameter"
        text = (
            "Two linear graphs on the same nodes and edges: G1 is that of the system; the "
            f"variables of G2 are the derivatives of those of G1 with respect to the {kind} "
            f"{board.name}, marked by the subscript {board.terminal.subscript[1:]}. "
            "Superscripts name the edges."
        )
        lines.append(textwrap.fill(text, _WIDTH))
    lines += ["", *(_wrapped(tree.summary(), 0, 4) for tree in board.trees.values())]
    return "\n".join(lines)


def _table(board: _Board) -> str:
    mark = board.terminal.subscript
    lines = ["Table 1. Through and across variables", ""]
    for domain, through, across in (("translation", "F", "r"), ("rotation", "T", "R")):
        for number in board.numbers:
            # The derivative of an orientation is a rotation vector.
            second = "φ" if across == "R" else across
            letters = (through, across) if number == 1 else (through + mark, second + mark)
            for what, letter in zip(("through", "across"), letters, strict=True):
                label = f"{domain:<11}  G{number}  {what:<7}  "
                names = board.graphs[domain].edge_names
                lines.append(_wrapped(label + "  ".join(f"{letter}^{n}" for n in names), 2, 28))
    lines += [
        "",
        "  F force, T torque on the edge's second node; r position, v = dr/dt, a = dv/dt;",
        "  R orientation, ω angular velocity, α = dω/dt",
    ]
    if board.name is not None:
        lines[-1] += f"; φ{mark} rotation vector: the derivative of R is φ{mark} × R"
    return "\n".join(lines)


def _cutsets(board: _Board) -> str:
    lines = ["(1) f-cutset equations: through variables in the cut of each branch"]
    symbol = board.terminal.symbol
    for number in board.numbers:
        for domain, letter in (("translation", "F"), ("rotation", "T")):
            note = "" if domain == "translation" else ", about the second node of each branch"
            lines += ["", f"  G{number}, {domain}{note}"]
            cutset = board.balances.cutsets[domain]
            for branch in cutset.rows:
                total = signed_sum((sign, symbol(letter, e)) for sign, e in cutset.terms(branch))
                for sign, edge, path in board.balances.moments(branch) if letter == "T" else ():
                    force = symbol("F", edge)
                    total += board.balances.moment(sign, path, force, symbol)
                lines.append(_equation(f"{board.of_graph(total, number)} = 0", 4, 8))
    return "\n".join(lines)


def _circuits(board: _Board) -> str:
    lines = ["(2) f-circuit equations: across variables around the circuit of each chord"]
    mark = board.terminal.subscript
    for number in board.numbers:
        for domain, own, likewise in (("translation", "r", "va"), ("rotation", "ω", "α")):
            letter = own
            if number == 2:
                letter, likewise = ("φ", "ωα") if domain == "rotation" else (own, likewise)
            others = " and ".join(item + (mark if number == 2 else "") for item in likewise)
            note = "; orientations follow one another" if letter == "ω" else ""
            lines += ["", f"  G{number}, {domain} (likewise {others}{note})"]
            for chord in board.trees[domain].chords:
                around = board.balances.circuit(letter, chord)
                terms = [(1, chord), *((-sign, branch) for sign, branch in around)]
                pair = signed_sum((sign, board.terminal.symbol(letter, e)) for sign, e in terms)
                lines.append(_equation(f"{board.of_graph(pair, number)} = 0", 4, 8))
    return "\n".join(lines)


def _terminal_equations(board: _Board, number: int) -> str:
    title = f"({number + 2}) terminal equations of G{number}"
    lines = [title if number == 1 else f"{title}: those of (3) differentiated", ""]
    edges = board.scene.edges.values()
    width = max(len(edge.name) for edge in edges)
    kinds = max(len(edge.component.name) for edge in edges)
    for edge in edges:
        through, across = (
            [(board.of_graph(left, number), board.of_graph(right, number)) for left, right in rows]
            for rows in (through_rows(board.terminal, edge), across_rows(board.terminal, edge))
        )
        shown = [f"{left} = {right}" for left, right in through] + gathered(across)
        label = f"  {edge.name:<{width}}  {edge.component.name}"
        lines += _listed(label, shown, width + kinds + 6)
    notes = definitions(board.terminal, number == 2)
    if notes:
        lines += ["", *(_wrapped(note, 2, 6) for note in notes)]
    return "\n".join(lines)


def _spaces(board: _Board) -> str:
    lines = [
        "Motion and reaction spaces of the branches; an empty motion space gives no equation",
        "",
    ]
    names = list(dict.fromkeys(n for tree in board.trees.values() for n in tree.branches))
    width = max(len(name) for name in names)
    for name in names:
        text = spaces_text(board.terminal, board.scene.edges[name])
        lines.append(_wrapped(f"{name:<{width}}  {text}", 2, width + 6))
    return "\n".join(lines)


def _projections(board: _Board) -> str:
    lines = ["(5) terminal equations in the f-cutset equations, projected on the motion spaces", ""]
    return "\n".join([*lines, *_balance_lines(board, in_branches=False)])


def _eliminations(board: _Board) -> str:
    lines = [
        "(6) across variables of the chords replaced by those of the branches, from (2);",
        f"    those of the branches that are zero by {board.sources} are left out",
        "",
    ]
    return "\n".join([*lines, *_balance_lines(board, in_branches=True)])


def _balance_lines(board: _Board, in_branches: bool) -> Iterator[str]:
    across = board.balances.of_branches if in_branches else board.terminal.symbol
    for number in board.numbers:
        for edge, freedom in board.freedoms():
            pair = board.balances.projected(edge, freedom, across)
            label = f"G{number}, {board.terminal.spelt[f'{edge.name}.{freedom.name}'].text}:"
            yield _equation(f"{label} {board.of_graph(pair, number)} = 0", 2, 8)


def _result(board: _Board, first: FirstGraph) -> str:
    names = [] if board.name is None else [board.name]
    equations = symbolic_equations(form_equations(first, names))
    lines = [
        f"(7) the branches' own terminal equations inserted, from {board.sources}; signs turned",
        "",
    ]
    coordinates = [c.name for c in first.system.coordinates]
    for number, name in enumerate((None, *names), start=1):
        for coordinate, line in zip(coordinates, equations.lines(name), strict=True):
            label = board.terminal.spelt[coordinate].text
            lines.append(_equation(f"G{number}, {label}: {line}", 2, 8))
    return "\n".join(lines)
