"""From a scene to its linear graphs, one for each domain, and their trees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.domains import DOMAINS
from cotree.errors import TopologyError
from cotree.graph import GraphEdge, LinearGraph, Tree, named_tree, select_tree
from cotree.scene.motion_spaces import motion_spaces
from cotree.scene.trees import Trees, check_coupled

if TYPE_CHECKING:
    from cotree.scene.description import SceneDescription

# Bodies up to which a scene is counted in absolute coordinates too.
_FEW_OPEN, _FEW_CLOSED = 3, 8

#: What a user may say of the tree: nothing, the branches of every graph, or those of each.
TreeChoice = Sequence[str] | Mapping[str, Sequence[str]] | None


def linear_graphs(scene: SceneDescription) -> dict[str, LinearGraph]:
    """Draw the scene as linear graphs on the same nodes.

    Raises
    ------
    TopologyError
        If the scene has no edges.
    """
    if not scene.edges:
        raise TopologyError(f"scene '{scene.name}' has no edges: add components between nodes")
    graphs = {}
    for domain in DOMAINS:
        edges = tuple(
            GraphEdge(edge.name, *edge.nodes, kind=edge.component.name)
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
            trees[domain] = select_tree(graph, _weights(scene, graph))
        else:
            _check_branches(scene, names)
            trees[domain] = named_tree(graph, names)
    return trees


def _weights(
    scene: SceneDescription, graph: LinearGraph, prefers_bodies: bool = False
) -> dict[str, float]:
    """Give what each edge would add to the equations; what cannot be a branch is absent."""
    spaces = motion_spaces(scene).of
    weights = {}
    for name in graph.edge_names:
        component = scene.edges[name].component
        if component.tree_weight is not None:
            weights[name] = float(sum(len(step.rates) for step in spaces[name]))
            if component.role is Role.BODY and prefers_bodies:
                weights[name] = 0.5
            elif component.role is Role.BODY:
                weights[name] += 0.5  # a joint of the same freedom comes first
    return weights


def candidate_trees(scene: SceneDescription) -> list[Trees]:
    """List the trees worth counting: of the joints, cut here or there, and of the bodies.

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
    if n_bodies > (_FEW_OPEN if is_open else _FEW_CLOSED):
        return [joints]
    graphs = linear_graphs(scene)
    trees = {
        domain: select_tree(graph, _weights(scene, graph, prefers_bodies=True))
        for domain, graph in graphs.items()
    }
    found = [joints] if is_open else [joints, _shallow_tree(scene, graphs)]
    found.append(joint_tree(scene, trees))
    return list({frozenset(tree.branches): tree for tree in reversed(found)}.values())[::-1]


def _shallow_tree(scene: SceneDescription, graphs: Mapping[str, LinearGraph]) -> Trees:
    """Give the tree of joints that cuts loops far from the ground: what is short costs less."""
    trees = {}
    for domain, graph in graphs.items():
        weights = _weights(scene, graph)
        depth = {"ground": 0}
        rest = [
            graph.edge(name)
            for name in weights
            if scene.edges[name].component.role is not Role.BODY
        ]
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
