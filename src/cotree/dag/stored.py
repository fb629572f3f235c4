"""Arenas as bytes: a node is pickled as its place in its arena, and an arena as a flat list.

Pickling nodes one by one would recurse as deep as the arena, beyond the limit of Python's stack.
"""

from __future__ import annotations

import copyreg
from typing import Any

from cotree.dag.nodes import Dag, Node


def _node_at(dag: Dag, index: int) -> Node:
    return dag.nodes[index]


def _reduced_node(node: Node) -> tuple[Any, ...]:
    return _node_at, (node.dag, node.index)


def _reduced_dag(dag: Dag) -> tuple[Any, ...]:
    rows = [
        (node.op, tuple(arg.index for arg in node.args), node.data, node.value, node.section)
        for node in dag.nodes
    ]
    origins = {node.index: origin for node, origin in dag.origins.items()}
    # Each node was interned when it was formed, so that the keys are in the order of the nodes. The
    # table ``formed`` is omitted, since it is only used while forming.
    return _dag_of, (rows, list(dag._interned), origins)


def _dag_of(rows: list[tuple[Any, ...]], keys: list[Any], origins: dict[int, str]) -> Dag:
    dag = Dag()
    zero, one = dag.zero, dag.one
    dag.nodes.clear()
    dag._interned.clear()
    for (op, args, data, value, section), key in zip(rows, keys, strict=True):
        # The first constants of an arena are attributes of it.
        if value in (0.0, 1.0):
            node = one if value else zero
            node.index = len(dag.nodes)
            dag.nodes.append(node)
        else:
            node = Node(dag, op, tuple(dag.nodes[arg] for arg in args), data, value)
        node.section = section
        dag._interned[key] = node
    dag.origins = {dag.nodes[index]: origin for index, origin in origins.items()}
    return dag


copyreg.pickle(Node, _reduced_node)
copyreg.pickle(Dag, _reduced_dag)
