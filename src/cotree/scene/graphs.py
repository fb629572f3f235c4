"""From a scene to its linear graphs, one for each domain, and their trees.

A body in the tree gives absolute coordinates. Where joints, forces and gravity keep one line, it
moves along that line; where they keep one plane, in that plane; a body without inertia that
nothing turns is a particle; else it is free.

Mostly they have the same branches. Where they differ a joint may be a branch of one graph and a
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

# Components that can keep a line; joints that turn are absent, since whatever turns leaves it.
_LINE_TYPES = frozenset(
    {"rigid_body", "arm", "weld", "prismatic", "spring", "damper", "force", "gear", "constraint"}
)

_PLACES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class MotionSpaces:
    """Motion spaces by edge, and the plane that everything moves in."""

    plane: str  # the plane's normal, ``x``, ``y`` or ``z``; empty where there is none
    of: Mapping[str, tuple[MotionStep, ...]]  # the motion space of each edge, were it a branch


def motion_spaces(scene: SceneDescription) -> MotionSpaces:
    """Find the motion space of every edge of a scene."""
    # A line is tried before a plane, since it leaves a body one coordinate in place of three.
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
    """Whether nothing constrains or acts on the rotation of the body's node."""
    # A body with inertia to rotation has an orientation.
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
    """Whether the edge has vectors in the axes of its first node."""
    return any(edge.component.field(name).shape is Shape.VECTOR for name in edge.fields)  # type: ignore[union-attr]


def _keeps_line(scene: SceneDescription, axis: str) -> bool:
    """Whether guides, gravity and every edge keep the lines along an axis."""
    n = _PLACES[axis]
    edges = scene.edges.values()
    kinds = {edge.component.name for edge in edges}
    guides = [edge for edge in edges if edge.component.name == "prismatic"]
    # Without a guide, motion along one line would be a coincidence of the initial values.
    if not guides or not kinds <= _LINE_TYPES or not _is_normal(scene.gravity, n):
        return False
    # Initial values under other names say that the body is meant to move otherwise.
    names = {axis, f"{axis}_dot"}
    for edge in edges:
        if edge.component.role is Role.BODY and not edge.initial.keys() <= names:
            return False
        for name in ("axis", "force", "vector"):
            value = edge.fields.get(name)
            if isinstance(value, tuple) and not _is_normal(_vector(edge, name), n):
                return False
        is_line = edge.component.role is Role.LINE
        # An element along the line of its nodes pulls off the axis where the lines of the nodes
        # differ.
        if "rotation" in edge.fields or (is_line and "axis" not in edge.fields):
            return False
    return True


def _keeps_plane(scene: SceneDescription, normal: str) -> bool:
    """Whether gravity and every edge keep the plane of a normal."""
    n = _PLACES[normal]
    return _is_within(scene.gravity, n) and all(_keeps(edge, n) for edge in scene.edges.values())


def _keeps(edge: Edge, n: int) -> bool:
    """Whether an edge moves and pulls its nodes within the plane only."""
    if edge.component.keeps_plane is None:
        return False
    if edge.component.role is Role.BODY and not edge.initial.keys() <= _PLANAR_NAMES:
        return False  # it starts out of the plane, or is told of as free
    for name in edge.component.keeps_plane.along:
        if name in edge.fields and not _is_normal(_vector(edge, name), n):
            return False
    for name in edge.component.keeps_plane.within:
        if name in edge.fields and not _is_within(_vector(edge, name), n):
            return False
    return _is_turned_within(edge, n) and _is_inertia_within(edge, n)


def _is_turned_within(edge: Edge, n: int) -> bool:
    """Whether the rotation of an arm is about the normal."""
    if "rotation" not in edge.fields:
        return True
    rows = edge.fields["rotation"]
    if not isinstance(rows[0], tuple):  # type: ignore[index]
        return _is_normal(_vector(edge, "rotation"), n)
    # A turn about axis n has zeros beside the diagonal in row and column n.
    entries = [rows[i][j] for i, j in _off_plane(n)]  # type: ignore[index]
    return all(entry.is_zero for entry in entries)


def _is_inertia_within(edge: Edge, n: int) -> bool:
    """Whether the normal is a principal axis of a body's inertia."""
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
    # Zero for all values of the parameters: the motion space stays the same when they change.
    return components[n].is_zero


def _is_normal(components: Sequence[Expression], n: int) -> bool:
    # Parallel to axis n, which is the normal of the plane or the direction of the line.
    return all(c.is_zero for i, c in enumerate(components) if i != n)


_GRAPHS = ("translation", "rotation")


@dataclass(frozen=True)
class Trees:
    """The trees of the translation and of the rotation graph."""

    #: Of graphs on the same nodes.
    translation: Tree
    rotation: Tree

    @cached_property
    def _branches(self) -> tuple[frozenset[str], frozenset[str]]:
        return frozenset(self.translation.branches), frozenset(self.rotation.branches)

    @cached_property
    def is_one(self) -> bool:
        """Whether both have the same branches."""
        first, second = self._branches
        return first == second

    @cached_property
    def branches(self) -> tuple[str, ...]:
        """Names of the branches of either, in edge order."""
        either = self._branches[0] | self._branches[1]
        return tuple(name for name in self.translation.graph.edge_names if name in either)

    def is_branch(self, name: str, rotates: bool) -> bool:
        """Return whether an edge is a branch of the rotation tree, or of that of translation."""
        # The pair is of translation and rotation, so that false and true are its places.
        return name in self._branches[rotates]

    def listed(self) -> str:
        """List the branches, those of each tree where they differ."""
        if self.is_one:
            return ", ".join(self.branches)
        return "; ".join(
            f"{tree.graph.domain}: {', '.join(tree.branches)}"
            for tree in (self.translation, self.rotation)
        )


def check_coupled(scene: SceneDescription, trees: Trees) -> None:
    """Refuse trees that separate a coupled translation and rotation."""
    for name in trees.branches:
        edge = scene.edges[name]
        if not _is_coupled(edge):
            continue
        # A part of the translation follows from the rotation of the same edge: one is no coordinate
        # without the other.
        held = [d for d in _GRAPHS if trees.is_branch(name, d == "rotation")]
        if len(held) == 1:
            raise FormulationError(
                f"{edge.component.name} '{name}' is a branch of the {held[0]} tree only, but it "
                "couples translation to rotation: name it in both trees, or in neither"
            )


def _is_coupled(edge: Edge) -> bool:
    """Whether the edge's translation follows from its rotation."""
    if edge.component.role is Role.ARM:
        return True
    # The pitch of a screw ties its translation to its angle.
    return any(isinstance(s, Freedom) and s.pitch for s in edge.component.motion_space)


# Bodies up to which a scene is counted in absolute coordinates too.
_FEW_OPEN, _FEW_CLOSED = 3, 8

#: A user's choice of the tree: none, the branches of every graph, or those of each graph.
TreeChoice = Sequence[str] | Mapping[str, Sequence[str]] | None


def linear_graphs(scene: SceneDescription) -> dict[str, LinearGraph]:
    """Form the linear graphs of the multibody part of a scene, on the same nodes."""
    # Each graph has all nodes of the scene, also those that none of its edges reaches: a floating
    # node is then found when the tree is chosen.
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
    """Choose the tree of every graph, or make those that the user names.

    Without a choice these are the branches that add least to the equations. Raises TopologyError if
    a node is floating, or the named edges are not a tree.
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
            # Lighter than a joint of one freedom, heavier than an arm, which adds no coordinate.
            if component.role is Role.BODY and prefers_bodies:
                weights[name] = 0.5
            elif component.role is Role.BODY:
                weights[name] += 0.5  # a joint of the same freedom comes first
    return weights


def candidate_trees(scene: SceneDescription) -> list[Trees]:
    """List the trees worth counting: of the joints, with different cuts, and of the bodies.

    Open chains of many bodies are not counted in absolute coordinates: each joint would add up to
    six equations that the joints' tree has not.
    """
    joints = joint_branches(scene)
    n_bodies = sum(edge.component.role is Role.BODY for edge in scene.edges.values())
    is_open = not any(
        scene.edges[name].component.role in (Role.JOINT, Role.CONSTRAINT)
        for name in joints.translation.chords
    )
    # Counting itself forms the equations for each candidate, which takes time.
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
    """List pairs of different trees for translation and rotation, counted beside the others.

    In a plane: positions along the joints, angles of the bodies themselves, so that no angle
    depends on those before it. Where joints that hold a rotation close a loop, or many bodies
    make the counting long, there are none.
    """
    n_bodies = sum(edge.component.role is Role.BODY for edge in scene.edges.values())
    if n_bodies > _FEW_CLOSED or not motion_spaces(scene).plane:
        return []
    graphs = linear_graphs(scene)
    found = {}
    for joints in (joint_branches(scene), _shallow_tree(scene, graphs)):
        rotation = _tree_of_angles(scene, graphs["rotation"], joints.translation)
        # A chord that holds an angle would be a constraint on the angles of the bodies.
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
    """Return the rotation tree of edges that hold angles, with a body for each part that turns."""
    spaces = motion_spaces(scene).of
    order = {step.child: i for i, step in enumerate(tree_walk(translation))}
    weights = {}
    for name in graph.edge_names:
        component = scene.edges[name].component
        if component.role is Role.BODY:
            # Of the bodies that turn together that which the translation tree reaches first.
            weights[name] = 0.5 + 0.4 * order[scene.edges[name].nodes[1]] / len(order)
        elif component.tree_weight is not None:
            # Edges that hold the angle weigh least and are branches; joints that turn weigh most,
            # so that bodies take their place.
            weights[name] = 1.0 if _turns(spaces[name]) else 0.1 * bool(spaces[name])
    return select_tree(graph, weights)


def _shallow_tree(scene: SceneDescription, graphs: Mapping[str, LinearGraph]) -> Trees:
    """Return the tree of joints that cuts loops far from the ground: its paths are short."""
    trees = {}
    for domain, graph in graphs.items():
        weights = _weights(scene, graph)
        # Breadth first: the depth of a node is the number of edges on its shortest way to the
        # ground.
        depth = {"ground": 0}
        rest = [
            graph.edge(name)
            for name in weights
            if scene.edges[name].component.role is not Role.BODY
        ]
        # Edges with exactly one end that was reached lead to the next level.
        while reached := [e for e in rest if (e.tail in depth) != (e.head in depth)]:
            level = max(depth.values()) + 1
            depth |= {
                node: level for e in reached for node in (e.tail, e.head) if node not in depth
            }
        far = {e.name: min(depth.get(e.tail, 0), depth.get(e.head, 0)) for e in rest}
        # A share that never outweighs a direction of motion.
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
    """Return the trees that coordinates are formed from."""
    pair = Trees(trees["translation"], trees["rotation"])
    check_coupled(scene, pair)
    return pair


def joint_branches(scene: SceneDescription) -> Trees:
    """Return the trees that reach bodies by joints and arms wherever there are any."""
    graphs = linear_graphs(scene)
    return joint_tree(scene, choose_trees(scene, graphs, None))
