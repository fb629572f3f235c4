"""From a scene to its linear graphs, one for each domain, and their trees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.domains import DOMAINS
from cotree.errors import TopologyError
from cotree.graph import GraphEdge, LinearGraph, Tree, named_tree, select_tree, tree_walk
from cotree.scene.motion_spaces import motion_spaces
from cotree.scene.trees import Trees, check_coupled

if TYPE_CHECKING:
    from cotree.components import MotionStep
    from cotree.scene.description import SceneDescription

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

    Parameters
    ----------
    scene : SceneDescription
        The scene.
    graphs : mapping of str to LinearGraph
        Its graphs, from :func:`linear_graphs`.
    choice : None, sequence of str, or mapping of domain to sequence of str
        None takes the branches that add least to the equations; names are taken as they are.

    Raises
    ------
    TopologyError
        If a node is floating, or the named edges are not a tree.
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

    Raises
    ------
    TopologyError
        If the scene has no edges, or a node is floating.
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

    Raises
    ------
    TopologyError
        If the scene has no edges, or a node is floating.
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
    """Give the rotation tree of edges that hold angles and of one body for each part that turns."""
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
    """Give the tree of joints that cuts loops far from the ground, which keeps its paths short."""
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
    """Give the trees that coordinates are formed from.

    Raises
    ------
    FormulationError
        If they part an arm's translation from its rotation, or a screw's.
    """
    pair = Trees(trees["translation"], trees["rotation"])
    check_coupled(scene, pair)
    return pair


def joint_branches(scene: SceneDescription) -> Trees:
    """Give the trees that reach bodies by joints and arms wherever there are any."""
    graphs = linear_graphs(scene)
    return joint_tree(scene, choose_trees(scene, graphs, None))
