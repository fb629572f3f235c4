"""Names in the fields of a scene, and the nodes that they stand for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag.symbols import MEASURED
from cotree.errors import ExpressionError, nearest
from cotree.naming import owner_among

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.formulation.fields import Resolver
    from cotree.scene.description import SceneDescription


def resolver_of(
    known: Sequence[Mapping[str, Node]],
    allowed: str = "",
    refused: Collection[str] = (),
    advice: str = "",
) -> Resolver:
    """Make the function that gives the node of a name; ``allowed`` says what may be used.

    Parameters
    ----------
    known : sequence of mapping of str to Node
        The nodes of names; later mappings come first.
    allowed : str
        What may be used, for messages; empty where anything may.
    refused : collection of str
        Names that have a node elsewhere but may not be used here.
    advice : str
        What to write instead, for messages.
    """
    by_name = {name: node for mapping in known for name, node in mapping.items()}

    def resolve(name: str) -> Node:
        if name in by_name:
            return by_name[name]
        # Known elsewhere but not allowed here: that is another mistake than a misspelt name.
        if allowed and (name == "t" or "." in name or name in refused):
            told = f"uses '{name}', but may depend on {allowed} only"
            if name in refused:
                told += ": let an output depend on modes, which fields may name"
            elif advice:
                told += f": {advice}"
            raise ExpressionError(told)
        # Whoever writes T means a temperature or a torque, and hardly the time.
        hint = nearest(name, by_name.keys() - {"t"} if name == "T" else by_name)
        raise ExpressionError(f"uses the unknown name '{name}'{hint}")

    return resolve


class FieldNames:
    """Names that fields may use: parameters, inputs, states, outputs and across variables.

    Across variables follow from the motion, which is formed after the first fields are bound: each
    gets a symbol when a field names it. :meth:`gathered` ends that.

    Parameters
    ----------
    scene : SceneDescription
        Its outputs, nodes and edges have names.
    dag : Dag
        The arena.
    known : mapping of str to Node
        Nodes by name.
    others : collection of str
        Further nodes and edges, of the scalar networks.
    """

    def __init__(
        self,
        scene: SceneDescription,
        dag: Dag,
        known: Mapping[str, Node],
        others: Collection[str],
    ) -> None:
        self._scene, self._dag, self._known = scene, dag, known
        self._of_known = resolver_of([known])
        self._places = {*scene.nodes, *scene.edges, *others}
        self._pending: list[str] = []
        self._measured: dict[str, Node] = {}
        self._is_gathered = False

    def node(self, name: str, resolve: Resolver | None = None) -> Node:
        """Give the node of a name.

        Parameters
        ----------
        name : str
            The name.
        resolve : callable, optional
            Gives the nodes of the names that an output is made of; this method where absent.

        Raises
        ------
        ExpressionError
            If the name is unknown, or that of an output that is made of itself.
        """
        # Parameters hide outputs of the same name.
        if name in self._scene.outputs and name not in self._scene.parameters:
            return self._output(name, resolve or self.node)
        # States have dots in their names too: they are known, and need no symbol of a measure.
        is_across = bool(owner_among(name, self._places))
        if not is_across or name in self._known:
            return self._of_known(name)
        if name not in self._measured:
            assert not self._is_gathered  # nothing would say what it stands for
            self._measured[name] = self._dag.symbol(MEASURED, len(self._measured))
        return self._measured[name]

    def _output(self, name: str, resolve: Resolver) -> Node:
        if name in self._pending:
            raise ExpressionError(f"uses output '{name}', which is made of itself")
        # Outputs may name outputs; a name that is pending has led back to itself.
        self._pending.append(name)
        found = self._scene.outputs[name].lower(self._dag, resolve)
        self._pending.remove(name)
        return found

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the across variables that fields use so far, in the order of their use."""
        return tuple(self._measured)

    def gathered(self) -> dict[str, Node]:
        """Give the symbols of all across variables by name; no further ones may follow."""
        self._is_gathered = True
        return dict(self._measured)
