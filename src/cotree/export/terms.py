"""The terms that a formulation formed, with names: what each edge and each cluster contributes.

In: the first graph. Out: lists of :class:`Term`, whose nodes are those of the formulation itself.
A cluster goes by the node at its origin, a branch by the cluster that it carries.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Role, integral_of
from cotree.dag.traverse import reachable
from cotree.domains import DOMAINS
from cotree.formulation.networks.rules import FieldRule, Lawful

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix
    from cotree.formulation.first_graph import FirstGraph
    from cotree.formulation.networks.network import Network
    from cotree.formulation.networks.rules import Variable


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
class Term:
    """A value that the formulation formed.

    Attributes
    ----------
    letter, place : str
        Its name, and what it belongs to: ``F`` and ``^k`` of an edge, ``F`` and ``(B)`` of a
        cluster.
    nodes : tuple of Node
        One entry of a scalar, three of a vector, nine of a matrix, row by row.
    note : str
        The axes that it is resolved in, where these are not the ground's.
    edge : str
        The edge whose terminal equation it is part of; empty where it is of none.
    is_held : bool
        Whether the equations keep it at zero.
    """

    letter: str
    place: str
    nodes: tuple[Node, ...]
    note: str = ""
    edge: str = ""
    is_held: bool = False


def _entries(matrix: Matrix) -> tuple[Node, ...]:
    return tuple(entry for row in matrix for entry in row)


def _axes(node: str) -> str:
    return "" if node == "ground" else f" in the axes of {node}"


def _clusters(first: FirstGraph) -> tuple[list[str], list[str]]:
    """Name the clusters, and the axes that the vectors of each are resolved in."""
    motion = first.motion
    # Cluster 0 is the ground, and cluster i + 1 the outer end of branch i.
    names, bases = ["ground"], [""]
    branches = [geometry.branch for geometry in motion.geometry]
    for i, branch in enumerate(branches):
        edge = motion.system.edges[branch.edge]
        # Several branches make up a joint of several axes; those before the last end at no node.
        primes = "'" * sum(other.edge == branch.edge for other in branches[i + 1 :])
        # The sign tells which way along the edge the tree leads outwards.
        names.append((edge.second if branch.sign > 0 else edge.first) + primes)
        # Without a step of its own a cluster has the axes of the one before it.
        is_own = motion.frames.steps[branch.child] is not None
        bases.append(_axes(names[-1]) if is_own else bases[branch.parent])
    return names, bases


def edge_terms(first: FirstGraph, symbol_of: Callable[[Variable, str, str], Node]) -> list[Term]:
    """List the terms of the terminal equations, in the scene's order.

    Parameters
    ----------
    first : FirstGraph
        The first graph.
    symbol_of : callable
        Gives a symbol for a variable of a network, from its name without and with what it
        belongs to.
    """
    # The sort is stable: the terms of an edge keep the order in which they were gathered.
    order = {name: i for i, name in enumerate(first.scene.edges)}
    terms = [*_of_bodies(first), *_of_joints(first), *_of_elements(first), *_of_constraints(first)]
    if first.network is not None:
        terms += _of_networks(first.network, symbol_of)
    gravity = Term("γ", "", first.system.gravity)
    return [gravity, *sorted(terms, key=lambda term: order[term.edge])]


def _of_bodies(first: FirstGraph) -> Iterator[Term]:
    """Give mass and inertia of bodies, and the vectors of arms."""
    for name, edge in first.system.edges.items():
        place, axes = f"^{name}", _axes(edge.first)
        # The inertia is resolved in the body's axes, an arm in those of its first node.
        if edge.component.role is Role.BODY:
            yield Term("m", place, (edge.scalars["mass"],), "", name)
            if edge.inertia is not None:
                yield Term("J", place, _entries(edge.inertia), _axes(edge.second), name)
        elif edge.component.role is Role.ARM:
            if "vector" in edge.vectors:
                yield Term("r", place, edge.vectors["vector"], axes, name)
            if edge.rotation is not None:
                yield Term("R", place, _entries(edge.rotation), axes, name)


def _of_joints(first: FirstGraph) -> Iterator[Term]:
    """Give the motion space of each branch, and the effort of its own law along a coordinate."""
    _, bases = _clusters(first)
    for geometry in first.motion.geometry:
        axes = bases[geometry.branch.parent]
        for speed, axis in zip(geometry.branch.speeds, geometry.axes, strict=True):
            yield Term("u", f"({speed.name})", axis, axes, speed.edge)
    for speed, effort in zip(first.system.speeds, first.loads.efforts, strict=True):
        about = speed.name if speed.coordinate is None else speed.coordinate.name
        yield Term("Q", f"({about})", (effort.value,), "", speed.edge)


def _of_elements(first: FirstGraph) -> Iterator[Term]:
    """Give forces and torques of chords on their second nodes, and those along measures."""
    _, bases = _clusters(first)
    for action in first.loads.actions:
        name, axes = action.edge.name, bases[action.ancestor]
        yield Term("F", f"^{name}", action.force, axes, name)
        yield Term("T", f"^{name}", action.torque, axes, name)
    for row in first.applied:
        if row.formula is not None:
            yield Term("Q", f"({row.name})", (row.magnitude,), "", row.edge)


def _of_constraints(first: FirstGraph) -> Iterator[Term]:
    """Give the constraints of chords: a measure, or a rate that is not the rate of a measure."""
    held = first.constraints
    for row, value, rate in zip(held.rows, held.values, held.rates, strict=True):
        # A constraint on speeds alone has no measure whose rate it would be.
        letter, node = ("c", value) if value is not None else ("c_dot", rate)
        yield Term(letter, f"({row.name})", (node,), "", row.edge, is_held=True)


def cluster_terms(first: FirstGraph) -> list[tuple[str, list[Term]]]:
    """List the terms of the walks over the tree, under a title for each walk."""
    names, bases = _clusters(first)
    # Most entries of the second moments of a planar scene enter no equation.
    used = set(reachable(first.balance.residual))
    inertias: list[Term] = []
    across: list[Term] = []
    through: list[Term] = []
    for geometry in first.motion.geometry:
        branch = geometry.branch
        child, outer = branch.child, bases[branch.parent]
        # Offsets, forces and torques are resolved in the parent's basis, all else in the cluster's
        # own.
        place, own = f"({names[child]})", bases[child]
        turned = first.motion.frames.steps[child]
        if branch.turns:
            # Without a step between the bases the rotation is within the common basis.
            axes = turned or first.motion.frames.rotations[child].matrix
            across.append(Term("R", place, _entries(axes), outer))
        across += [
            Term("r", place, geometry.offset, outer),
            Term("ω", place, first.motion.omega[child], own),
            Term("α", place, first.view.across.alpha[child], own),
            Term("a", place, first.view.across.origin[child], own),
        ]
        inertia = first.loads.inertias[child]
        if inertia is not None:
            inertias += [
                Term("m", place, (inertia.mass,)),
                Term("h", place, inertia.moment, own),
                # The matrix is symmetric, and only entries that balances use are shown: one of a
                # planar body.
                *(
                    Term("J", f"{place}.{'xyz'[i]}{'xyz'[j]}", (inertia.tensor[i][j],), own)
                    for i in range(3)
                    for j in range(i + 1)
                    if inertia.tensor[i][j] in used
                ),
            ]
        # One for each branch; cluster 0 is the ground.
        beyond = first.balance.beyond[child - 1]
        # Inwards: the branch that is furthest out comes first.
        through[:0] = [
            Term("F", place, beyond.force, outer),
            Term("T", place, beyond.torque, outer),
        ]
    return [
        (_OUTWARDS, across),
        (
            "Mass m, first moment h and second moment J of all that a branch carries rigidly",
            inertias,
        ),
        (_INWARDS, through),
    ]


def balance_terms(first: FirstGraph) -> list[Term]:
    """List the f-cutset equations of the branches, projected on their motion spaces."""
    rows = zip(first.system.speeds, first.balance.residual, strict=True)
    return [Term("", speed.name, (row,), is_held=True) for speed, row in rows]


def _of_networks(
    network: Network, symbol_of: Callable[[Variable, str, str], Node]
) -> Iterator[Term]:
    """Give the laws by which variables of networks are determined, and laws that must vanish."""
    rules = network.solved.plan.rules

    def named(variable: Variable) -> Node:
        return symbol_of(variable, *_network_name(network, variable))

    def argument(variable: Variable) -> Node:
        rule = rules[variable]
        # A value of a field is put in place, since it is no variable of the network.
        if not isinstance(rule, FieldRule) or not variable[0].startswith("field"):
            return named(variable)
        return rule.value(network.solved.dag, {v: named(v) for v in rule.needs})

    for variable, rule in rules.items():
        port = network.ports.get(variable[1])
        # Sums are f-circuits and f-cutsets, which are printed as such.
        if port is None or not isinstance(rule, Lawful | FieldRule):
            continue
        own = {v: argument(v) for v in rule.needs}
        letter, place = _network_name(network, variable)
        is_held = variable[0].startswith("residual")
        value = rule.value(network.solved.dag, own)
        yield Term(letter, place, (value,), "", port.edge.name, is_held)


def _network_name(network: Network, variable: Variable) -> tuple[str, str]:
    """Name a variable as in scenes: ``v`` and ``^R1``, ``v`` and ``(out)``."""
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
