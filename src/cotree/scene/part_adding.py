"""Parts added to a scene: names checked, declarations made and put into its tables."""

from __future__ import annotations

from dataclasses import replace
from itertools import takewhile
from typing import TYPE_CHECKING, Any

from cotree.errors import ModelError, SceneError, brief, nearest
from cotree.naming import RESERVED, check_name, check_path
from cotree.scene.calls import knowing
from cotree.scene.parameters import check_cycle
from cotree.scene.part import TABLES, Part, owner_of
from cotree.scene.part_index import in_name, in_value
from cotree.scene.part_origin import told_origins
from cotree.scene.part_rows import Renaming, Rows
from cotree.scene.part_statement import make_part
from cotree.scene.statements import plain

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.scene.description import SceneDescription
    from cotree.scene.edge import Edge

#: Names before a dot that mean something else.
_TAKEN = frozenset({"ground", "energy", *RESERVED})


def add_part(
    scene: SceneDescription,
    name: str,
    template: SceneDescription,
    given: Mapping[str, Any],
    source: str,
) -> None:
    """Add a part to a scene; see :meth:`PartMethods.add`."""
    _check_part_name(scene, name)
    for port in template.ports:
        if port not in template.nodes:
            hint = nearest(port, template.nodes)
            raise SceneError(f"port '{port}' of scene '{template.name}' is no node of it{hint}")
    try:
        part = make_part(name, template, given, scene, source)
    except ModelError as error:
        raise type(error)(f"part '{name}': {error}") from None
    members = dict.fromkeys((member for member, _ in part.members()), part)
    _check_members(scene, name, members)
    rows = _rows_of(scene, part)
    scene.parts[name] = part
    scene.members.update(members)
    scene.connected.update(part.nodes.values())
    for table in TABLES:
        _put_first(getattr(scene, table), getattr(rows, table))


def _put_first(own: dict[str, Any], added: Mapping[str, Any]) -> None:
    """Put declarations of a part behind those of others and before the scene's own.

    Declarations of parts come first, as they do where the scene is read from a file.
    """
    # Only the scene's own are looked through: there may be thousands of parts.
    last = list(takewhile(lambda key: "." not in key, reversed(own)))
    kept = {key: own.pop(key) for key in reversed(last)}
    own.update(added)
    own.update(kept)


def _rows_of(scene: SceneDescription, part: Part) -> Rows:
    """Make the declarations of a part and its likes in an array."""
    # What is bound in the outer scene calls its tables.
    with knowing(scene.tables):
        return _made_rows(scene, part)


def _made_rows(scene: SceneDescription, part: Part) -> Rows:
    rows = Rows()
    for member, index in part.members():
        what = f"part '{member}'"
        try:
            nodes = {
                own: check_node(scene, in_name(outer, index, f"node '{own}'"))
                for own, outer in part.nodes_of(member).items()
            }
            rows.add(Renaming(f"{member}.", nodes, part.scene))
            for own, value in part.parameters.items():
                full = f"{member}.{own}"
                rows.bind_parameter(full, in_value(value, index, f"parameter '{full}'"))
            for own, value in part.inputs.items():
                full = f"{member}.{own}"
                rows.bind_input(full, in_value(value, index, f"input '{full}'"), scene)
        except ModelError as error:
            told = told_origins(str(error), {member: part})
            raise type(error)(f"{what}: {error}{told}") from None
    for full, value in part.set.items():
        try:
            if not part.is_node(full):
                _bind(rows, full, value, scene)
        except ModelError as error:
            raise type(error)(f"set of part '{part.name}': {error}") from None
    return rows


def _bind(rows: Rows, name: str, value: Any, scene: SceneDescription) -> None:
    """Give one parameter or input of one part another value."""
    if name in rows.parameters:
        rows.bind_parameter(name, value)
    elif name in rows.inputs or name in rows.outputs:
        rows.bind_input(name, value, scene)
    else:
        known = [*rows.parameters, *rows.inputs]
        raise SceneError(
            f"'{brief(name)}' is no port, parameter or input of it{nearest(name, known)}"
        )


def set_in_part(scene: SceneDescription, name: str, value: Any, unit: str = "") -> bool:
    """Give a parameter or an input of a part another value, and keep that in its statement.

    Returns
    -------
    bool
        Whether the name is one of a part.
    """
    found = owner_of(scene, name)
    if found is None or name not in {**scene.parameters, **scene.inputs}:
        return False
    part, value = found[0], plain(value)
    given = {"value": value, "unit": unit} if unit else value
    changed = replace(part, set={**part.set, name: given})
    rows = Rows(
        parameters={k: scene.parameters[k] for k in (name,) if k in scene.parameters},
        inputs={k: scene.inputs[k] for k in (name,) if k in scene.inputs},
    )
    _bind(rows, name, given, scene)
    if rows.parameters:
        check_cycle({**scene.parameters, **rows.parameters}, name)
    scene.parameters.update(rows.parameters)
    if name in rows.outputs:
        del scene.inputs[name]
        _put_first(scene.outputs, {name: rows.outputs[name]})
    scene.inputs.update(rows.inputs)
    scene.parts[part.name] = changed
    scene.members.update({m: changed for m, _ in changed.members()})
    return True


def check_node(scene: SceneDescription, name: object) -> str:
    """Accept the name of a node; one of a part must be there.

    Raises
    ------
    SceneError
        If the name is not allowed, or the part has no such node.
    """
    node = check_path("node", name)
    if node in scene.members:
        raise SceneError(f"'{node}' is a part, and no node: name one of its nodes, '{node}.node'")
    if "." not in node:
        return node
    found = owner_of(scene, node)
    if found is None:
        first = node.partition(".")[0]
        raise SceneError(f"node '{node}' is of a part '{first}'{_no_part(first, scene.members)}")
    part, member, local = found
    connected = part.nodes_of(member)
    if local in connected:
        index = next(index for name, index in part.members() if name == member)
        raise SceneError(
            f"node '{local}' of part '{member}' is connected, and is called as in this scene: name "
            f"'{in_name(connected[local], index, node)}' in its place"
        )
    if local not in part.node_names:
        hint = nearest(node, (f"{member}.{other}" for other in part.node_names))
        raise SceneError(f"part '{member}' has no node '{brief(local)}'{hint}")
    return node


def check_nodes(scene: SceneDescription, edge: Edge) -> None:
    """Check the nodes of an edge that stands beside parts.

    Raises
    ------
    SceneError
        If one is a part, or is none of a part.
    """
    along = [node for ends in edge.ports if len(ends.acts_on) == 2 for node in ends.acts_on]
    for node in (*edge.nodes, *along):
        if "." in node or node in scene.members:
            try:
                check_node(scene, node)
            except SceneError as error:
                raise SceneError(f"edge '{edge.name}': {error}") from None


def _no_part(name: str, members: Iterable[str]) -> str:
    return f", but there is none: declare it before what connects to it{nearest(name, members)}"


def _check_part_name(scene: SceneDescription, name: object) -> None:
    check_name("part", name)
    if name in _TAKEN:
        raise SceneError(f"part name '{name}' already means something in expressions: rename it")
    if name in scene.parts:
        raise SceneError(f"the name of part '{name}' is taken: every part needs its own")


def _check_members(scene: SceneDescription, name: str, members: Mapping[str, Part]) -> None:
    own_edges = takewhile(lambda key: "." not in key, reversed(scene.edges))
    own_nodes = {node for key in own_edges for node in scene.edges[key].nodes}
    for member in members:
        check_name("part", member)
        kind = (
            "edge"
            if member in scene.edges
            else "node"
            if member in own_nodes or member in scene.connected
            else "part"
            if member in scene.members
            else ""
        )
        if kind:
            array = "" if member == name else f" of the array '{name}'"
            raise SceneError(
                f"the name of part '{member}'{array} is that of a {kind}: names in expressions "
                "would have two meanings, rename one"
            )
