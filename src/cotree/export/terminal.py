"""Terminal equations as formulas: what each component of a scene says of its edge.

In: a scene and the trees of its graphs. Out: through and across variables of each edge, written
with those of its graph, each with its derivative (paper, Eq. (3) and (4)).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.export.blackboard import NOTHING, ZERO, Pair, cross, dot, scalar, vector
from cotree.export.spelling import acceleration_name
from cotree.graph import tree_walk

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cotree.components import Freedom, MotionStep
    from cotree.export.fields import FieldWriter
    from cotree.export.spelling import Spelt
    from cotree.graph import Tree
    from cotree.scene.description import Edge, SceneDescription
    from cotree.scene.expressions import Expression

#: Gives the across variable of a kind (``r``, ``v``, ``a``, ``ω``, ``α``) of an edge.
Across = Callable[[str, str], Pair]

_UNIT_VECTORS = ("î", "ĵ", "k̂")
_PLACES = {"x": 0, "y": 1, "z": 2}
_TWO = Pair(scalar("2"))


@dataclass(frozen=True)
class Terminal:
    """Writes the terminal equations of a scene.

    Attributes
    ----------
    scene : SceneDescription
        The scene.
    rotation : Tree
        The tree of its rotation graph, which says which nodes turn.
    spaces : mapping of str to sequence of MotionStep
        The motion space of each edge, as it would be a branch.
    branches : collection of str
        The edges in a tree; the across variables of these follow their coordinates.
    spelt : mapping of str to Spelt
        Short names of states and accelerations.
    subscript : str
        Marks a derivative: ``_k``.
    fields : FieldWriter
        Writes fields.
    """

    scene: SceneDescription
    rotation: Tree
    spaces: Mapping[str, Sequence[MotionStep]]
    branches: Collection[str]
    spelt: Mapping[str, Spelt]
    subscript: str
    fields: FieldWriter

    @cached_property
    def turning(self) -> frozenset[str]:
        """Nodes whose axes may turn against those of the ground."""
        found: set[str] = set()
        for step in tree_walk(self.rotation):
            if any(f.rotates for f in self.spaces[step.edge]) or step.parent in found:
                found.add(step.child)
        return frozenset(found)

    def symbol(self, letter: str, edge: str) -> Pair:
        """Write a vector variable of an edge: ``F^k`` and ``F_k^k``."""
        return Pair(vector(f"{letter}^{edge}"), vector(f"{letter}{self.subscript}^{edge}"))

    def coordinate(self, edge: str, freedom: Freedom, suffix: str = "") -> Pair:
        """Write a coordinate, its rate or its acceleration."""
        coordinate = f"{edge}.{freedom.name}"
        (rate, _), *_ = freedom.rates
        names = {"": coordinate, "_dot": f"{edge}.{rate}"}
        names["_ddot"] = acceleration_name(names["_dot"], [coordinate])
        text = self.spelt[names[suffix]].text
        return Pair(scalar(text), scalar(f"{text}{self.subscript}"))

    def motion(self, edge: Edge, rotates: bool) -> list[Freedom]:
        """List the rotations or translations of an edge's motion space; all have one axis."""
        return [step for step in self.spaces[edge.name] if step.rotates is rotates]  # type: ignore[misc]

    def of_node(self, letter: str, node: str) -> Pair:
        """Write the angular velocity or acceleration of a node; zero if it does not turn."""
        if node not in self.turning:
            return NOTHING
        return Pair(vector(f"{letter}({node})"), vector(f"{letter}{self.subscript}({node})"))

    def _fixed(self, text: str, node: str) -> Pair:
        """Write a vector fixed in a node's axes."""
        value = vector(text)
        if node not in self.turning:
            return Pair(value)
        return Pair(value, cross(vector(f"φ{self.subscript}({node})"), value))

    def unit_vector(self, i: int, node: str) -> Pair:
        """Write a unit vector of a node's axes: ``î``, or ``î(B)`` where B turns."""
        suffix = f"({node})" if node in self.turning else ""
        return self._fixed(_UNIT_VECTORS[i] + suffix, node)

    def components(self, values: Sequence[Expression], node: str) -> Pair:
        """Write a vector by its components in a node's axes."""
        total = NOTHING
        for i, value in enumerate(values):
            total += self.fields.pair(value) * self.unit_vector(i, node)
        return total

    def axis_index(self, edge: Edge) -> int | None:
        """Say which unit vector an edge's axis is; None if it is another direction."""
        signs = [self.fields.pair(value).value for value in _vector_field(edge, "axis")]
        along = [i for i, value in enumerate(signs) if not value.is_zero]
        if len(along) != 1 or _vector_field(edge, "axis")[along[0]].names:
            return None
        return along[0] if signs[along[0]].terms[0].sign > 0 else None

    def axis(self, edge: Edge) -> Pair:
        """Write the unit vector of an edge's axis, fixed in its first node."""
        i = self.axis_index(edge)
        if i is not None:
            return self.unit_vector(i, edge.nodes[0])
        if any(not self.fields.pair(value).d.is_zero for value in _vector_field(edge, "axis")):
            return self.symbol("u", edge.name)
        return self._fixed(f"u^{edge.name}", edge.nodes[0])

    def direction(self, edge: Edge, freedom: Freedom) -> Pair:
        """Write the unit vector of one direction of an edge's motion space."""
        if freedom.axis in _PLACES:
            return self.unit_vector(_PLACES[freedom.axis], edge.nodes[0])
        return self.axis(edge)

    def gravity(self) -> Pair:
        """Write the acceleration of free fall; its derivative only if there is one."""
        value = self.components(self.scene.gravity, "ground")
        return Pair(
            ZERO if value.value.is_zero else vector("γ"),
            ZERO if value.d.is_zero else vector(f"γ{self.subscript}"),
        )

    def axis_components(self, edge: Edge) -> Pair:
        """Write the axis that the scene gives, of any length."""
        return self.components(_vector_field(edge, "axis"), edge.nodes[0])

    def tensor_entries(self, edge: Edge) -> list[Expression]:
        """List the entries of a body's inertia: three principal values, or nine."""
        entries: list[Expression] = []
        for row in edge.fields.get("inertia", ()):  # type: ignore[union-attr]
            entries += row if isinstance(row, tuple) else [row]
        return entries

    def tensor(self, edge: Edge) -> Pair:
        """Write the inertia tensor of a body, in ground axes."""
        symbol = self.symbol("J", edge.name)
        moves = edge.nodes[1] in self.turning or any(
            not self.fields.pair(value).d.is_zero for value in self.tensor_entries(edge)
        )
        return symbol if moves else Pair(symbol.value)

    def force(self, edge: Edge, across: Across) -> Pair:
        """Write the force of a chord or a body on its second node, but for reactions."""
        role, name = edge.component.role, edge.name
        if role is Role.BODY:
            mass = self.fields.pair(_scalar_field(edge, "mass"))
            return -(mass * (across("a", name) - self.gravity()))
        if role is Role.FORCE:
            return self.components(_vector_field(edge, "force"), edge.nodes[0])
        if role is Role.LINE:
            return self._line(edge, across)
        if role is Role.JOINT:
            efforts = [self._chord_effort(edge, f, across) for f in self.motion(edge, False)]
            return sum((e * self.axis(edge) for e in efforts), NOTHING)
        return NOTHING

    def torque(self, edge: Edge, across: Across) -> Pair:
        """Write the torque of a chord or a body on its second node, but for reactions."""
        role, name = edge.component.role, edge.name
        if role is Role.BODY and "inertia" in edge.fields:
            tensor, omega = self.tensor(edge), across("ω", name)
            return -(tensor.applied(across("α", name)) + omega.cross(tensor.applied(omega)))
        if role is Role.TORQUE:
            return self.components(_vector_field(edge, "torque"), edge.nodes[0])
        return NOTHING

    def _line(self, edge: Edge, across: Across) -> Pair:
        """Write a scalar law of length and rate, along an axis or the line of the nodes."""
        if "axis" in edge.fields:
            along = self.axis(edge)
            length, rate = self._along_axis(edge, across)
        else:
            reach, along = across("r", edge.name), self.symbol("e", edge.name)
            length = Pair(scalar(f"|{reach.value}|"), dot(reach.d, along.value))
            rate = across("v", edge.name).dot(along) if self._is_damped(edge) else NOTHING
        return self._law(edge, {"length": length, "rate": rate}) * along

    def _is_damped(self, edge: Edge) -> bool:
        return not self.fields.pair(_scalar_field(edge, "damping")).value.is_zero

    def _along_axis(self, edge: Edge, across: Across) -> tuple[Pair, Pair]:
        """Write how far apart the nodes are along an edge's axis, and the rate of that."""
        reach, along = across("r", edge.name), self.axis(edge)
        if not self._is_damped(edge):
            return reach.dot(along), NOTHING
        turning = self.of_node("ω", edge.nodes[0]).cross(along)
        return reach.dot(along), across("v", edge.name).dot(along) + reach.dot(turning)

    def effort(self, edge: Edge, freedom: Freedom) -> Pair:
        """Write what a joint's own law exerts along a direction of its motion space."""
        if edge.component.law is None:
            return NOTHING
        if edge.name not in self.branches:
            return self._chord_effort(edge, freedom, self.symbol)
        arguments = {
            f"{freedom.name}{suffix}": self.coordinate(edge.name, freedom, suffix)
            for suffix in ("", "_dot")
        }
        return self._law(edge, arguments)

    def _chord_effort(self, edge: Edge, freedom: Freedom, across: Across) -> Pair:
        """Write the same for a chord, which has no coordinate; a turning one has no law here."""
        if edge.component.law is None or freedom.rotates:
            return NOTHING
        length, rate = self._along_axis(edge, across)
        return self._law(edge, {freedom.name: length, f"{freedom.name}_dot": rate})

    def _law(self, edge: Edge, arguments: Mapping[str, Pair]) -> Pair:
        """Write a component's law, made of sums and products, with formulas in its arguments."""
        law = edge.component.law
        assert law is not None
        values = [
            arguments[name] if name in arguments else self.fields.pair(_scalar_field(edge, name))
            for name in law.arguments
        ]
        result: Pair = law.function(*values)
        return result

    def across(self, edge: Edge) -> dict[str, Pair]:
        """Write the across variables of an arm, or of a branch by its coordinates."""
        tail = edge.nodes[0]
        omega, alpha = self.of_node("ω", tail), self.of_node("α", tail)
        sliding, turning = self.motion(edge, False), self.motion(edge, True)
        reach = self._along(edge, sliding, "")
        if edge.component.role is Role.ARM:
            reach = self.components(_vector_field(edge, "vector"), tail)
        slide, spin = self._along(edge, sliding, "_dot"), self._along(edge, turning, "_dot")
        own = present(self.symbol("r", edge.name), reach)
        return {
            "r": reach,
            "v": slide + omega.cross(own),
            "a": self._along(edge, sliding, "_ddot")
            + _TWO * omega.cross(slide)
            + alpha.cross(own)
            + omega.cross(omega.cross(own)),
            "R": self._rotation(edge, turning),
            "ω": spin,
            "α": self._along(edge, turning, "_ddot") + omega.cross(spin),
        }

    def _along(self, edge: Edge, freedoms: Sequence[Freedom], suffix: str) -> Pair:
        """Sum coordinates, rates or accelerations along the axes of the motion space."""
        total = NOTHING
        for freedom in freedoms:
            total += self.coordinate(edge.name, freedom, suffix) * self.direction(edge, freedom)
        return total

    def _rotation(self, edge: Edge, freedoms: Sequence[Freedom]) -> Pair:
        """Write the orientation across a joint, and its rotation vector along the parameter."""
        if not freedoms:
            return NOTHING
        angle = self.coordinate(edge.name, freedoms[0])
        axis = self.direction(edge, freedoms[0])
        phi = angle.d * axis.value
        fields = _vector_field(edge, "axis")
        if any(not self.fields.pair(value).d.is_zero for value in fields):
            # The axis itself turns in its frame, by what is left of its derivative there.
            frame = self._fixed(str(axis.value), edge.nodes[0]).d
            own = axis.d - frame
            phi += scalar(f"sin({angle.value})") * own
            phi += scalar(f"(1 - cos({angle.value}))") * cross(axis.value, axis.d)
            if not frame.is_zero:
                phi -= scalar(f"(1 - cos({angle.value}))") * cross(axis.value, frame)
        return Pair(vector(f"Rot({axis.value}, {angle.value})"), phi)


def present(symbol: Pair, value: Pair) -> Pair:
    """Keep a symbol where its value is not zero, and its derivative likewise."""
    return Pair(
        ZERO if value.value.is_zero else symbol.value, ZERO if value.d.is_zero else symbol.d
    )


def _scalar_field(edge: Edge, name: str) -> Expression | None:
    value = edge.fields.get(name)
    assert not isinstance(value, tuple)  # the scene checks the shape of every field
    return value


def _vector_field(edge: Edge, name: str) -> tuple[Expression, ...]:
    """Give the components of a vector field; a weld has none."""
    return edge.fields.get(name, ())  # type: ignore[return-value]
