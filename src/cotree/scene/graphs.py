"""From a scene to its linear graphs, one for each domain, and their trees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.domains import DOMAINS
from cotree.errors import FormulationError, TopologyError
from cotree.graph import GraphEdge, LinearGraph, Tree, named_tree, select_tree

if TYPE_CHECKING:
    from cotree.scene.description import SceneDescription

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
            weights = {
                name: weight
                for name in graph.edge_names
                if (weight := scene.edges[name].component.tree_weight) is not None
            }
            trees[domain] = select_tree(graph, weights)
        else:
            _check_branches(scene, names)
            trees[domain] = named_tree(graph, names)
    return trees


def _check_branches(scene: SceneDescription, names: Sequence[str]) -> None:
    for name in names:
        edge = scene.edges.get(name)
        if edge is not None and edge.component.tree_weight is None:
            raise TopologyError(
                f"edge '{name}' of type '{edge.component.name}' cannot be a branch: it has no "
                "motion space; name joints, arms and bodies"
            )


def joint_tree(scene: SceneDescription, trees: Mapping[str, Tree]) -> Tree:
    """Give the one tree of joints and arms that joint coordinates are formed from.

    Raises
    ------
    FormulationError
        If the trees differ, hold a body, or leave a joint or an arm out.
    """
    tree = trees["translation"]
    if set(tree.branches) != set(trees["rotation"].branches):
        raise FormulationError(
            "translation and rotation have different trees: name the same joints and arms for both"
        )
    for name in tree.branches:
        if scene.edges[name].component.role is Role.BODY:
            raise FormulationError(
                f"the tree holds the body '{name}': equations in absolute coordinates are not "
                f"available yet; reach node '{scene.edges[name].nodes[1]}' by joints and arms"
            )
    for name in tree.chords:
        if scene.edges[name].component.role in (Role.ARM, Role.JOINT):
            raise FormulationError(
                f"edge '{name}' closes a loop with the tree ({', '.join(tree.branches)}): closed "
                "loops are not available yet; take it out or open the loop"
            )
    return tree
