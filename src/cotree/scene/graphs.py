"""The linear graphs of a scene, one per domain, and their trees.

A body in the tree has absolute coordinates: along a line or in a plane that contains all motions
and forces, those of a particle if it has no rotational inertia and nothing acts on its rotation,
otherwise those of a free body. If the trees differ, a joint may be a branch of one graph and a
chord of the other: it has coordinates in the first graph and constraints in the second.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.components import Freedom, MotionStep, Role, Shape
from cotree.components.multibody import PLANE_AXES, body_space
from cotree.domains import DOMAINS
from cotree.errors import FormulationError, TopologyError
from cotree.graph import GraphEdge, LinearGraph, Tree, named_tree, select_tree, tree_walk

if TYPE_CHECKING:
    from cotree.scene.description import Edge, SceneDescription
    from cotree.scene.expressions import Expression


_PLANAR_NAMES = frozenset(
    name
    for step in body_space("z", is_particle=False)
    for name, _ in (*step.coordinates, *step.rates)
)

# Components that can restrict all motion to a line; bodies that rotate do not stay on a line.
_LINE_TYPES = frozenset(
    {"rigid_body", "arm", "weld", "prismatic", "spring", "damper", "force", "gear", "constraint"}
)

_PLACES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class MotionSpaces:
    """Motion spaces of the edges, and the common plane of motion."""

    plane: str  # normal of the plane, ``x``, ``y`` or ``z``; empty if there is no common plane
    of: Mapping[str, tuple[MotionStep, ...]]  # motion space that each edge has if it is a branch


def motion_spaces(scene: SceneDescription) -> MotionSpaces:
    """Determine the motion space of every edge in a scene."""
    # A line is tested before a plane, because a body then has one coordinate instead of three.
    line = next((axis for axis in "xyz" if _keeps_line(scene, axis)), "")
    plane = next((normal for normal in PLANE_AXES if _keeps_plane(scene, normal)), "")
    found = {}
    for edge in scene.edges.values():
        if edge.component.role is Role.BODY:
            found[edge.name] = body_space(plane, _is_particle(scene, edge), line)
        else:
            found[edge.name] = edge.component.motion_space
    return MotionSpaces(plane, found)


def _is_particle(scene: SceneDescription, body: Edge) -> bool:
    """Return whether nothing constrains or acts on the rotation of a body's node."""
    # A body with rotational inertia has an orientation.
    if "inertia" in body.fields:
        return False
    node = body.nodes[1]
    return not any(
        ("rotation" in edge.component.domains and node in edge.nodes)
        or (edge.nodes[:1] == (node,) and _needs_axes(edge))
        for edge in scene.edges.values()
        if edge is not body
    )


def _needs_axes(edge: Edge) -> bool:
    return any(edge.component.field(name).shape is Shape.VECTOR for name in edge.fields)  # type: ignore[union-attr]


def _keeps_line(scene: SceneDescription, axis: str) -> bool:
    """Return whether joints, gravity and all edges restrict motion to lines along an axis."""
    n = _PLACES[axis]
    edges = scene.edges.values()
    kinds = {edge.component.name for edge in edges}
    guides = [edge for edge in edges if edge.component.name == "prismatic"]
    # Without a sliding joint, the initial values would decide whether the motion is along a line.
    if not guides or not kinds <= _LINE_TYPES or not _is_normal(scene.gravity, n):
        return False
    # A body with initial values of other coordinates also moves in other directions.
    names = {axis, f"{axis}_dot"}
    for edge in edges:
        if edge.component.role is Role.BODY and not edge.initial.keys() <= names:
            return False
        for name in ("axis", "force", "vector"):
            value = edge.fields.get(name)
            if isinstance(value, tuple) and not _is_normal(_vector(edge, name), n):
                return False
        is_line = edge.component.role is Role.LINE
        # Without a stated axis, a force between two nodes may have any direction.
        if "rotation" in edge.fields or (is_line and "axis" not in edge.fields):
            return False
    return True


def _keeps_plane(scene: SceneDescription, normal: str) -> bool:
    """Return whether gravity and all edges restrict motion to the plane with the given normal."""
    n = _PLACES[normal]
    return _is_within(scene.gravity, n) and all(_keeps(edge, n) for edge in scene.edges.values())


def _keeps(edge: Edge, n: int) -> bool:
    """Return whether an edge moves its nodes, and exerts forces, only within the plane."""
    if edge.component.keeps_plane is None:
        return False
    if edge.component.role is Role.BODY and not edge.initial.keys() <= _PLANAR_NAMES:
        return False  # a free body may start or move out of the plane
    for name in edge.component.keeps_plane.along:
        if name in edge.fields and not _is_normal(_vector(edge, name), n):
            return False
    for name in edge.component.keeps_plane.within:
        if name in edge.fields and not _is_within(_vector(edge, name), n):
            return False
    return _is_turned_within(edge, n) and _is_inertia_within(edge, n)


def _is_turned_within(edge: Edge, n: int) -> bool:
    if "rotation" not in edge.fields:
        return True
    rows = edge.fields["rotation"]
    if not isinstance(rows[0], tuple):  # type: ignore[index]
        return _is_normal(_vector(edge, "rotation"), n)
    # If a rotation is about axis n, the off-diagonal entries in row and column n are zero.
    entries = [rows[i][j] for i, j in _off_plane(n)]  # type: ignore[index]
    return all(entry.is_zero for entry in entries)


def _is_inertia_within(edge: Edge, n: int) -> bool:
    """Return whether the normal is a principal axis of a body's inertia."""
    row = edge.component.field("inertia")
    if row is None or row.shape is not Shape.INERTIA or "inertia" not in edge.fields:
        return True
    rows = edge.fields["inertia"]
    if not isinstance(rows[0], tuple):  # type: ignore[index]
        return True
    return all(rows[i][j].is_zero for i, j in _off_plane(n))  # type: ignore[index]


def _off_plane(n: int) -> list[tuple[int, int]]:
    others = [i for i in range(3) if i != n]
    return [(n, i) for i in others] + [(i, n) for i in others]


def _vector(edge: Edge, name: str) -> Sequence[Expression]:
    return edge.fields[name]  # type: ignore[return-value]


def _is_within(components: Sequence[Expression], n: int) -> bool:
    # The component must be zero for all parameters, because motion spaces do not depend on them.
    return components[n].is_zero


def _is_normal(components: Sequence[Expression], n: int) -> bool:
    # The vector is parallel to axis n: the plane's normal, or the direction of the line.
    return all(c.is_zero for i, c in enumerate(components) if i != n)


_GRAPHS = ("translation", "rotation")


@dataclass(frozen=True)
class Trees:
    """The trees of the translation graph and of the rotation graph, which have the same nodes."""

    translation: Tree
    rotation: Tree

    @cached_property
    def _branches(self) -> tuple[frozenset[str], frozenset[str]]:
        return frozenset(self.translation.branches), frozenset(self.rotation.branches)

    @cached_property
    def is_one(self) -> bool:
        """Whether both trees have the same branches."""
        first, second = self._branches
        return first == second

    @cached_property
    def branches(self) -> tuple[str, ...]:
        """Names of the branches in either tree, in edge order."""
        either = self._branches[0] | self._branches[1]
        return tuple(name for name in self.translation.graph.edge_names if name in either)

    def is_branch(self, name: str, rotates: bool) -> bool:
        """Return whether an edge is a branch of the rotation tree or of the translation tree."""
        # The pair is (translation, rotation), so the boolean is its index.
        return name in self._branches[rotates]

    def listed(self) -> str:
        """Return the branches as text, separately for each tree if the trees differ."""
        if self.is_one:
            return ", ".join(self.branches)
        return "; ".join(
            f"{tree.graph.domain}: {', '.join(tree.branches)}"
            for tree in (self.translation, self.rotation)
        )


def check_coupled(scene: SceneDescription, trees: Trees) -> None:
    """Raise if the trees separate a translation from the rotation to which it is coupled."""
    for name in trees.branches:
        edge = scene.edges[name]
        if not _is_coupled(edge):
            continue
        # The edge's rotation partly determines its translation.
        held = [d for d in _GRAPHS if trees.is_branch(name, d == "rotation")]
        if len(held) == 1:
            raise FormulationError(
                f"{edge.component.name} '{name}' is a branch of the {held[0]} tree only, but it "
                "couples translation to rotation: name it in both trees, or in neither"
            )


def _is_coupled(edge: Edge) -> bool:
    if edge.component.role is Role.ARM:
        return True
    # The pitch of a screw couples its translation to its angle.
    return any(isinstance(s, Freedom) and s.pitch for s in edge.component.motion_space)


# Maximum number of bodies, in open and closed chains, for which absolute coordinates are compared.
_FEW_OPEN, _FEW_CLOSED = 3, 8

#: The user's choice of the tree: None, branches for all graphs, or branches for each graph.
TreeChoice = Sequence[str] | Mapping[str, Sequence[str]] | None


def linear_graphs(scene: SceneDescription) -> dict[str, LinearGraph]:
    """Return the linear graphs of the multibody part of a scene, which share their nodes."""
    # Each graph contains all nodes, so that the choice of the tree detects floating ones.
    graphs = {}
    for domain, row in DOMAINS.items():
        if row.is_scalar:
            continue
        edges = tuple(
            GraphEdge(edge.name, edge.nodes[0], edge.nodes[1], edge.component.name)
            for edge in scene.edges.values()
            if domain in edge.component.domains
        )
        graphs[domain] = LinearGraph(domain, scene.nodes, edges)
    return graphs


def choose_trees(
    scene: SceneDescription, graphs: Mapping[str, LinearGraph], choice: TreeChoice
) -> dict[str, Tree]:
    """Choose trees whose branches add the fewest equations, or check the user's choice."""
    if isinstance(choice, Mapping):
        for domain in choice:
            if domain not in graphs:
                raise TopologyError(
                    f"the tree names the unknown domain '{domain}': known are {', '.join(graphs)}"
                )
        wanted = {domain: choice.get(domain) for domain in graphs}
    elif choice is not None and not isinstance(choice, Sequence):
        raise TopologyError("the tree must be a list of edges, or a list for each domain")
    else:
        wanted = dict.fromkeys(graphs, choice)
    trees = {}
    for domain, graph in graphs.items():
        names = wanted[domain]
        if names is None:
            # Across variables of branches become coordinates; those of chords follow from
            # f-circuits (paper, Eq. (2)). The weight of an edge is the number of equations that it
            # adds as a branch, so the lightest spanning tree adds the fewest.
            trees[domain] = select_tree(graph, _weights(scene, graph))
        else:
            _check_branches(scene, names)
            trees[domain] = named_tree(graph, names)
    return trees


def _weights(
    scene: SceneDescription, graph: LinearGraph, prefers_bodies: bool = False
) -> dict[str, float]:
    """Return, for each possible branch, the number of equations that it would add."""
    spaces = motion_spaces(scene).of
    weights = {}
    for name in graph.edge_names:
        component = scene.edges[name].component
        if component.tree_weight is not None:
            # A branch adds one equation for each direction of motion.
            weights[name] = float(sum(len(step.rates) for step in spaces[name]))
            # Prefer the body to a joint with one degree of freedom, but not to an arm.
            if component.role is Role.BODY and prefers_bodies:
                weights[name] = 0.5
            elif component.role is Role.BODY:
                weights[name] += 0.5  # prefer a joint with the same number of degrees of freedom
    return weights


def candidate_trees(scene: SceneDescription) -> list[Trees]:
    """Return the trees to compare: trees of joints that cut loops differently, and trees of bodies.

    Trees of bodies are omitted for long open chains, in which joints need far fewer equations.
    """
    joints = joint_branches(scene)
    n_bodies = sum(edge.component.role is Role.BODY for edge in scene.edges.values())
    is_open = not any(
        scene.edges[name].component.role in (Role.JOINT, Role.CONSTRAINT)
        for name in joints.translation.chords
    )
    # The comparison forms the equations for each candidate, which takes time.
    if n_bodies > (_FEW_OPEN if is_open else _FEW_CLOSED):
        return [joints]
    graphs = linear_graphs(scene)
    trees = {
        domain: select_tree(graph, _weights(scene, graph, prefers_bodies=True))
        for domain, graph in graphs.items()
    }
    found = [joints] if is_open else [joints, _shallow_tree(scene, graphs)]
    found.append(joint_tree(scene, trees))
    # If trees are equal, only the first one is kept.
    return list({frozenset(tree.branches): tree for tree in reversed(found)}.values())[::-1]


def separate_trees(scene: SceneDescription) -> list[Trees]:
    """Return pairs of a translation tree of joints and a rotation tree of angles of planar bodies.

    No pairs exist if joints that constrain a rotation close a loop, or with too many bodies.
    """
    n_bodies = sum(edge.component.role is Role.BODY for edge in scene.edges.values())
    if n_bodies > _FEW_CLOSED or not motion_spaces(scene).plane:
        return []
    graphs = linear_graphs(scene)
    found = {}
    for joints in (joint_branches(scene), _shallow_tree(scene, graphs)):
        rotation = _tree_of_angles(scene, graphs["rotation"], joints.translation)
        # A chord that fixes an angle would constrain the angles of the bodies.
        held = (scene.edges[name].component for name in rotation.chords)
        if any(c.role in (Role.JOINT, Role.ARM) and not _turns(c.motion_space) for c in held):
            continue
        pair = joint_tree(scene, {"translation": joints.translation, "rotation": rotation})
        if not pair.is_one:
            found[pair.translation.branches] = pair
    return list(found.values())


def _turns(steps: Sequence[MotionStep]) -> bool:
    return any(step.rotates for step in steps)


def _tree_of_angles(scene: SceneDescription, graph: LinearGraph, translation: Tree) -> Tree:
    """Return the rotation tree of edges that fix angles, with one body for each rigid part."""
    spaces = motion_spaces(scene).of
    order = {step.child: i for i, step in enumerate(tree_walk(translation))}
    weights = {}
    for name in graph.edge_names:
        component = scene.edges[name].component
        if component.role is Role.BODY:
            # Of all bodies that rotate together, choose the first one in the translation tree.
            weights[name] = 0.5 + 0.4 * order[scene.edges[name].nodes[1]] / len(order)
        elif component.tree_weight is not None:
            # Edges that fix the angle are the lightest; bodies are preferred to revolute joints.
            weights[name] = 1.0 if _turns(spaces[name]) else 0.1 * bool(spaces[name])
    return select_tree(graph, weights)


def _shallow_tree(scene: SceneDescription, graphs: Mapping[str, LinearGraph]) -> Trees:
    """Return the joint tree with short paths to the ground, which cuts loops far from it."""
    trees = {}
    for domain, graph in graphs.items():
        weights = _weights(scene, graph)
        # Breadth-first search: the depth of a node is its distance from the ground in edges.
        depth = {"ground": 0}
        rest = [
            graph.edge(name)
            for name in weights
            if scene.edges[name].component.role is not Role.BODY
        ]
        # Edges with one end among the nodes reached so far lead to the next depth.
        while reached := [e for e in rest if (e.tail in depth) != (e.head in depth)]:
            level = max(depth.values()) + 1
            depth |= {
                node: level for e in reached for node in (e.tail, e.head) if node not in depth
            }
        far = {e.name: min(depth.get(e.tail, 0), depth.get(e.head, 0)) for e in rest}
        # The share is too small to outweigh a direction of motion.
        share = 0.4 / (1 + max(far.values(), default=0))
        trees[domain] = select_tree(
            graph, {name: weight + share * far.get(name, 0) for name, weight in weights.items()}
        )
    return joint_tree(scene, trees)


def _check_branches(scene: SceneDescription, names: Sequence[str]) -> None:
    for name in names:
        edge = scene.edges.get(name)
        if edge is not None and edge.component.tree_weight is None:
            raise TopologyError(
                f"edge '{name}' of type '{edge.component.name}' cannot be a branch: it has no "
                "motion space; name joints, arms and bodies"
            )


def joint_tree(scene: SceneDescription, trees: Mapping[str, Tree]) -> Trees:
    """Return the trees that define the coordinates, after a check of coupled motions."""
    pair = Trees(trees["translation"], trees["rotation"])
    check_coupled(scene, pair)
    return pair


def joint_branches(scene: SceneDescription) -> Trees:
    """Return the trees in which joints and arms are preferred to bodies."""
    graphs = linear_graphs(scene)
    return joint_tree(scene, choose_trees(scene, graphs, None))
