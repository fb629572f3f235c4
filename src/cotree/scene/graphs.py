"""The linear graphs of a scene, one for each domain, and their trees.

A body in the tree gives absolute coordinates. If joints, forces and gravity keep one line, it moves
along that line; if they keep one plane, in that plane; a body without inertia that nothing turns is
a particle; otherwise it is free.

Usually the trees have the same branches. If they differ, a joint may be a branch of one graph and a
chord of the other: it then has the coordinates of the first and the constraints of the second.
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

# Components that can keep all motion on a line. Revolute joints are excluded, since rotating bodies
# leave the line.
_LINE_TYPES = frozenset(
    {"rigid_body", "arm", "weld", "prismatic", "spring", "damper", "force", "gear", "constraint"}
)

_PLACES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class MotionSpaces:
    """Motion spaces by edge, and the common plane of motion."""

    plane: str  # normal of the plane, ``x``, ``y`` or ``z``; empty if there is no common plane
    of: Mapping[str, tuple[MotionStep, ...]]  # motion space of each edge, if it is a branch


def motion_spaces(scene: SceneDescription) -> MotionSpaces:
    """Find the motion space of every edge of a scene."""
    # A line is tested before a plane: it leaves a body one coordinate instead of three.
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
    """Return whether nothing constrains or acts on the rotation of the body's node."""
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
    """Return whether the edge has vectors in the axes of its first node."""
    return any(edge.component.field(name).shape is Shape.VECTOR for name in edge.fields)  # type: ignore[union-attr]


def _keeps_line(scene: SceneDescription, axis: str) -> bool:
    """Return whether guides, gravity and every edge keep the lines along an axis."""
    n = _PLACES[axis]
    edges = scene.edges.values()
    kinds = {edge.component.name for edge in edges}
    guides = [edge for edge in edges if edge.component.name == "prismatic"]
    # Without a guide, motion along a line would depend on the initial values.
    if not guides or not kinds <= _LINE_TYPES or not _is_normal(scene.gravity, n):
        return False
    # Initial values of other coordinates show that the body also moves in other directions.
    names = {axis, f"{axis}_dot"}
    for edge in edges:
        if edge.component.role is Role.BODY and not edge.initial.keys() <= names:
            return False
        for name in ("axis", "force", "vector"):
            value = edge.fields.get(name)
            if isinstance(value, tuple) and not _is_normal(_vector(edge, name), n):
                return False
        is_line = edge.component.role is Role.LINE
        # The force along the line of two nodes is not along the axis if the nodes are on different
        # lines.
        if "rotation" in edge.fields or (is_line and "axis" not in edge.fields):
            return False
    return True


def _keeps_plane(scene: SceneDescription, normal: str) -> bool:
    """Return whether gravity and every edge keep the plane of a normal."""
    n = _PLACES[normal]
    return _is_within(scene.gravity, n) and all(_keeps(edge, n) for edge in scene.edges.values())


def _keeps(edge: Edge, n: int) -> bool:
    """Return whether an edge moves its nodes, and exerts forces, within the plane only."""
    if edge.component.keeps_plane is None:
        return False
    if edge.component.role is Role.BODY and not edge.initial.keys() <= _PLANAR_NAMES:
        return False  # a free body starts out of the plane or has initial values
    for name in edge.component.keeps_plane.along:
        if name in edge.fields and not _is_normal(_vector(edge, name), n):
            return False
    for name in edge.component.keeps_plane.within:
        if name in edge.fields and not _is_within(_vector(edge, name), n):
            return False
    return _is_turned_within(edge, n) and _is_inertia_within(edge, n)


def _is_turned_within(edge: Edge, n: int) -> bool:
    """Return whether the rotation of an arm is about the normal."""
    if "rotation" not in edge.fields:
        return True
    rows = edge.fields["rotation"]
    if not isinstance(rows[0], tuple):  # type: ignore[index]
        return _is_normal(_vector(edge, "rotation"), n)
    # A rotation about axis n has zeros off the diagonal in row and column n.
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
    # Zero for all parameter values: the motion space must not depend on parameters.
    return components[n].is_zero


def _is_normal(components: Sequence[Expression], n: int) -> bool:
    # Parallel to axis n: the normal of the plane, or the direction of the line.
    return all(c.is_zero for i, c in enumerate(components) if i != n)


_GRAPHS = ("translation", "rotation")


@dataclass(frozen=True)
class Trees:
    """The trees of the translation and of the rotation graph."""

    #: Trees of the graphs of translation and rotation, which have the same nodes.
    translation: Tree
    rotation: Tree

    @cached_property
    def _branches(self) -> tuple[frozenset[str], frozenset[str]]:
        return frozenset(self.translation.branches), frozenset(self.rotation.branches)

    @cached_property
    def is_one(self) -> bool:
        """Return whether both trees have the same branches."""
        first, second = self._branches
        return first == second

    @cached_property
    def branches(self) -> tuple[str, ...]:
        """Names of the branches of either tree, in edge order."""
        either = self._branches[0] | self._branches[1]
        return tuple(name for name in self.translation.graph.edge_names if name in either)

    def is_branch(self, name: str, rotates: bool) -> bool:
        """Return whether an edge is a branch of the rotation or the translation tree."""
        # The pair is (translation, rotation), so that a boolean is its index.
        return name in self._branches[rotates]

    def listed(self) -> str:
        """Return the branches as text, by tree if the trees differ."""
        if self.is_one:
            return ", ".join(self.branches)
        return "; ".join(
            f"{tree.graph.domain}: {', '.join(tree.branches)}"
            for tree in (self.translation, self.rotation)
        )


def check_coupled(scene: SceneDescription, trees: Trees) -> None:
    """Raise if the trees separate a coupled translation and rotation."""
    for name in trees.branches:
        edge = scene.edges[name]
        if not _is_coupled(edge):
            continue
        # A part of the translation is determined by the rotation of the same edge, and cannot be a
        # coordinate without it.
        held = [d for d in _GRAPHS if trees.is_branch(name, d == "rotation")]
        if len(held) == 1:
            raise FormulationError(
                f"{edge.component.name} '{name}' is a branch of the {held[0]} tree only, but it "
                "couples translation to rotation: name it in both trees, or in neither"
            )


def _is_coupled(edge: Edge) -> bool:
    """Return whether the edge's translation follows from its rotation."""
    if edge.component.role is Role.ARM:
        return True
    # The pitch of a screw couples its translation to its angle.
    return any(isinstance(s, Freedom) and s.pitch for s in edge.component.motion_space)


# Maximum numbers of bodies, in open and closed chains, for which absolute coordinates are
# evaluated, too.
_FEW_OPEN, _FEW_CLOSED = 3, 8

#: Choice of the tree by the user: None, the branches of all graphs, or those of each graph.
TreeChoice = Sequence[str] | Mapping[str, Sequence[str]] | None


def linear_graphs(scene: SceneDescription) -> dict[str, LinearGraph]:
    """Form the linear graphs of the multibody part of a scene, on the same nodes."""
    # Each graph contains all nodes of the scene, even those without an edge in it, so that floating
    # nodes are found when the tree is chosen.
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
    """Choose the tree of every graph, or check those of the user.

    By default the branches are those that add the fewest equations. Raises TopologyError if a node
    is floating, or the named edges are not a tree.
    """
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
            # Across variables of branches become coordinates, those of chords follow by f-circuits
            # (paper, Eq. (2)). Weights count the equations that a branch adds, so that the lightest
            # spanning tree gives the fewest.
            trees[domain] = select_tree(graph, _weights(scene, graph))
        else:
            _check_branches(scene, names)
            trees[domain] = named_tree(graph, names)
    return trees


def _weights(
    scene: SceneDescription, graph: LinearGraph, prefers_bodies: bool = False
) -> dict[str, float]:
    """Weigh each edge by the equations that it would add, unless it cannot be a branch."""
    spaces = motion_spaces(scene).of
    weights = {}
    for name in graph.edge_names:
        component = scene.edges[name].component
        if component.tree_weight is not None:
            # Each direction of motion of a branch adds one equation.
            weights[name] = float(sum(len(step.rates) for step in spaces[name]))
            # Prefer it to a joint of one degree of freedom, but not to an arm, which adds no
            # coordinate.
            if component.role is Role.BODY and prefers_bodies:
                weights[name] = 0.5
            elif component.role is Role.BODY:
                weights[name] += 0.5  # a joint with as many degrees of freedom is preferred
    return weights


def candidate_trees(scene: SceneDescription) -> list[Trees]:
    """List the trees worth counting: of joints, with different cuts, and of bodies.

    Open chains of many bodies are not counted in absolute coordinates: each joint would add up to
    six equations that the tree of joints avoids.
    """
    joints = joint_branches(scene)
    n_bodies = sum(edge.component.role is Role.BODY for edge in scene.edges.values())
    is_open = not any(
        scene.edges[name].component.role in (Role.JOINT, Role.CONSTRAINT)
        for name in joints.translation.chords
    )
    # Counting forms the equations of each candidate, which takes time.
    if n_bodies > (_FEW_OPEN if is_open else _FEW_CLOSED):
        return [joints]
    graphs = linear_graphs(scene)
    trees = {
        domain: select_tree(graph, _weights(scene, graph, prefers_bodies=True))
        for domain, graph in graphs.items()
    }
    found = [joints] if is_open else [joints, _shallow_tree(scene, graphs)]
    found.append(joint_tree(scene, trees))
    # Equal trees are counted once; the first of them is kept.
    return list({frozenset(tree.branches): tree for tree in reversed(found)}.values())[::-1]


def separate_trees(scene: SceneDescription) -> list[Trees]:
    """List pairs of different trees for translation and rotation, to be counted, too.

    In a plane: positions along the joints, and absolute angles of the bodies, so that no angle
    depends on those before it. There are none if joints that hold a rotation close a loop, or if
    there are too many bodies to count.
    """
    n_bodies = sum(edge.component.role is Role.BODY for edge in scene.edges.values())
    if n_bodies > _FEW_CLOSED or not motion_spaces(scene).plane:
        return []
    graphs = linear_graphs(scene)
    found = {}
    for joints in (joint_branches(scene), _shallow_tree(scene, graphs)):
        rotation = _tree_of_angles(scene, graphs["rotation"], joints.translation)
        # A chord that fixes an angle would be a constraint on the angles of the bodies.
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
    """Return the rotation tree of edges that hold angles, with one body of each rigid part."""
    spaces = motion_spaces(scene).of
    order = {step.child: i for i, step in enumerate(tree_walk(translation))}
    weights = {}
    for name in graph.edge_names:
        component = scene.edges[name].component
        if component.role is Role.BODY:
            # Among bodies that rotate together, choose the first one in the translation tree.
            weights[name] = 0.5 + 0.4 * order[scene.edges[name].nodes[1]] / len(order)
        elif component.tree_weight is not None:
            # Edges that fix the angle have the smallest weight and become branches; revolute joints
            # have the largest, so that bodies replace them.
            weights[name] = 1.0 if _turns(spaces[name]) else 0.1 * bool(spaces[name])
    return select_tree(graph, weights)


def _shallow_tree(scene: SceneDescription, graphs: Mapping[str, LinearGraph]) -> Trees:
    """Return the tree of joints with short paths to the ground, which cuts loops far from it."""
    trees = {}
    for domain, graph in graphs.items():
        weights = _weights(scene, graph)
        # Breadth first: the depth of a node is its distance from the ground, in edges.
        depth = {"ground": 0}
        rest = [
            graph.edge(name)
            for name in weights
            if scene.edges[name].component.role is not Role.BODY
        ]
        # Edges with exactly one end reached lead to the next level.
        while reached := [e for e in rest if (e.tail in depth) != (e.head in depth)]:
            level = max(depth.values()) + 1
            depth |= {
                node: level for e in reached for node in (e.tail, e.head) if node not in depth
            }
        far = {e.name: min(depth.get(e.tail, 0), depth.get(e.head, 0)) for e in rest}
        # Too small to outweigh a direction of motion.
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
    """Return the trees that define the coordinates."""
    pair = Trees(trees["translation"], trees["rotation"])
    check_coupled(scene, pair)
    return pair


def joint_branches(scene: SceneDescription) -> Trees:
    """Return the trees that prefer joints and arms to bodies."""
    graphs = linear_graphs(scene)
    return joint_tree(scene, choose_trees(scene, graphs, None))
