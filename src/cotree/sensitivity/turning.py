"""Axes that turn along a seed: the rule that lets the formulation run over duals.

The derivative of a vector is that of the arrow in space, resolved in the same basis as the vector.
The rotational across variable of a sensitivity graph is the parametric rotation vector phi, with
dR/dp = [phi]x R, so that a vector fixed in a cluster changes by phi x vector. All other rules are
those of products and sums (:mod:`cotree.dag.dual`).

A parameter, a coordinate, a rate, an initial value and a whole direction are the same to a
sensitivity graph: a tangent for each symbol that changes.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cotree.dag import vector
from cotree.dag.derivative import tangents
from cotree.dag.dual import formed, formula, tangent_of, value_of, varied
from cotree.dag.nodes import Dag, Node, symbols_in
from cotree.dag.vector import Matrix, Vector, quaternion_turn
from cotree.formulation.across import Motion, View, accelerate, move
from cotree.formulation.frames import Frames, Geometry

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from cotree.formulation.clusters import Branch
    from cotree.formulation.first_graph import FirstGraph


@dataclass(frozen=True)
class Turning(Frames):
    """Axes of the clusters as they turn along a seed, in which all is seen as duals."""

    seed: Seed  # what is differentiated by
    #: The clusters that the seed moves; the others move as in the first graph.
    reached: frozenset[int]
    phi: tuple[Vector, ...]  # parametric rotation vector of each cluster, in its basis
    phi_inwards: tuple[Vector, ...]  # the same, in the basis of the parent
    #: Parametric rotation vector of each cluster's basis, which may be that of a parent.
    phi_basis: tuple[Vector, ...]

    def is_kept(self, cluster: int) -> bool:
        """Whether the seed does not reach a cluster."""
        return cluster not in self.reached

    @property
    def turned(self) -> frozenset[int]:
        """The clusters whose bases the seed turns."""
        return frozenset(i for i, phi in enumerate(self.phi_basis) if not vector.is_zero(phi))

    def resolved(self, cluster: int, local: Vector) -> Vector:
        """Resolve a vector field: it turns with the cluster, and changes by itself."""
        return self._turned(self.rotations[cluster].matrix, local, self.phi[cluster])

    def carried(self, branch: Branch, local: Vector) -> Vector:
        """Resolve a vector field of a branch's carrier in the basis of the branch's parent."""
        is_childs = branch.carrier == branch.child
        phi = self.phi_inwards[branch.child] if is_childs else self.phi[branch.carrier]
        return self._turned(self.carrier_axes(branch), local, phi)

    def _turned(self, axes: Matrix, local: Vector, phi: Vector) -> Vector:
        value = formed(vector.times, axes, local)
        d_local = self.seed.vector(local)
        # d(R a) = phi x (R a) + R da, since dR = [phi]x R.
        d = phi if vector.is_zero(phi) else vector.cross(phi, value)
        if not vector.is_zero(d_local):
            d = vector.add(d, vector.times(axes, d_local))
        return varied(value, d)

    def constant(self, cluster: int, a: Vector) -> Vector:
        """See a vector whose components in the cluster's basis are constant: it turns with that."""
        phi = self.phi_basis[cluster]
        return a if vector.is_zero(phi) else varied(a, vector.cross(phi, a))

    def tensor(self, cluster: int, local: Matrix) -> Matrix:
        """Resolve a tensor field, as seen from the turning cluster; see :meth:`within`."""
        axes = self.rotations[cluster].matrix
        value, d_local = formed(vector.congruence, axes, local), self.seed.matrix(local)
        # A tensor that is constant in the cluster is no dual: `within` supplies its turn.
        if all(vector.is_zero(row) for row in d_local):
            return value
        return varied(value, vector.congruence(axes, d_local))

    def seen(self, node: Node) -> Node:
        """See a field, a coordinate or a speed."""
        return varied(node, self.seed.of(node))

    def formula(self, node: Node, arguments: Mapping[Node, Node]) -> Node:
        """Substitute, and differentiate by the arguments and by the seed itself."""
        return formula(node, arguments, self.seed.symbols)

    def within(self, cluster: int, form: Callable[..., Vector], *vectors: Vector) -> Vector:
        """Form a vector of others with tensors that turn with a cluster.

        As seen from the cluster such tensors do not turn: the others change by what remains of
        their derivatives, and the result turns with the cluster.
        """
        phi = self.phi[cluster]
        if vector.is_zero(phi):
            return form(*vectors)
        seen = []
        for a in vectors:
            value = value_of(a)
            # Derivative as seen from the cluster: da - phi x a.
            seen.append(varied(value, vector.sub(tangent_of(a), vector.cross(phi, value))))
        # Seen from outside the result turns along: d = phi x r + what changes within. The turn of
        # the tensor itself, [phi]x J - J [phi]x, is never formed.
        result = form(*seen)
        value = value_of(result)
        return varied(value, vector.add(vector.cross(phi, value), tangent_of(result)))


@contextmanager
def derivatives_labelled(dag: Dag) -> Iterator[None]:
    """Label the nodes made inside the ``with`` block as derivatives of what they belong to."""
    dag.suffix = ", derivative"
    try:
        yield
    finally:
        dag.suffix = ""


def view_along(first: FirstGraph, seed: Seed) -> View:
    """Form the across variables of a sensitivity graph, accelerations of coordinates held fixed."""
    motion, across = first.motion, first.view.across
    # The walks of the first graph, over duals. Tangents of accelerations are unknowns on the
    # left-hand side, so that the accelerations themselves are held fixed.
    moved = move(first.system, motion.clusters, turn_axes(motion, seed), motion)
    return View(moved, accelerate(moved, across.rates, across), first.view)


def turn_axes(first: Motion, seed: Seed) -> Turning:
    """Find the clusters that a seed reaches, and how it turns them."""
    frames, zero = first.frames, vector.zeros(first.system.dag)
    n = len(first.omega)
    # Parents come first, so that what a seed reaches grows outwards: all that a reached cluster
    # carries or turns is reached too.
    reached: set[int] = set()
    phi, inwards, basis = [zero] * n, [zero] * n, [zero] * n
    for geometry in first.geometry:
        branch = geometry.branch
        if reached.isdisjoint((branch.parent, branch.turn_parent)) and not _is_seeded(branch, seed):
            continue
        reached.add(branch.child)
        with first.system.dag.labelled(f"f-circuits, geometry of {branch.edge}"):
            # Prefix sums along the rotation tree, as those of angular velocities (Eq. (2)).
            turn = vector.add(phi[branch.turn_parent], _turn(frames, seed, geometry))
            inwards[branch.child] = turn
            phi[branch.child] = frames.down(branch.child, turn)
        is_own = frames.steps[branch.child] is not None
        basis[branch.child] = phi[branch.child] if is_own else basis[branch.parent]
    turns = (tuple(phi), tuple(inwards), tuple(basis))
    return Turning(frames.rotations, frames.steps, seed, frozenset(reached), *turns)


def _is_seeded(branch: Branch, seed: Seed) -> bool:
    """Whether anything of the branch itself depends on the seed."""
    symbols = [c.symbol for c in branch.coordinates] + [v.symbol for v in branch.speeds]
    if any(not seed.of(node).is_zero for node in (*symbols, *branch.slides)):
        return True
    # Arms and axes may depend on parameters, whatever the coordinates do.
    fields = (branch.anchor, *branch.axes, *(branch.mount or ()))
    return not all(vector.is_zero(seed.vector(local)) for local in fields)


def _turn(frames: Frames, seed: Seed, first: Geometry) -> Vector:
    """Form what a branch itself adds to phi, in the basis of its parent."""
    branch = first.branch
    if not branch.turns:
        return vector.zeros(seed.dag)
    if branch.quaternion is None:
        d_axis = frames.resolved(branch.turn_parent, seed.vector(branch.axes[0]))
        # A turn about the axis by the tangent of the angle, as a speed turns the child by omega.
        own = vector.scale(seed.of(branch.position), first.turning[0])
        return vector.add(own, _tilt(first, d_axis))
    d = [seed.of(entry) for entry in branch.quaternion]
    own = vector.zeros(seed.dag)
    if any(not entry.is_zero for entry in d):
        # An edge that points inwards turns by the inverse rotation: resolved in its own axes, and
        # with the opposite sign.
        own = quaternion_turn(branch.quaternion, d, is_own=branch.sign < 0)
        own = vector.signed(branch.sign, own)
    if branch.mount is not None:
        own = vector.add(vector.times(branch.mount, own), _mounting(branch.mount, seed))
    return frames.resolved(branch.turn_parent, own)


def _mounting(mount: Matrix, seed: Seed) -> Vector:
    """Form the rotation vector of a change of constant axes: [phi]x = dT T^T."""
    spin = vector.matmul(seed.matrix(mount), vector.transpose(mount))
    return (spin[2][1], spin[0][2], spin[1][0])


def _tilt(first: Geometry, d_axis: Vector) -> Vector:
    """Form what a change of the axis itself adds to phi.

    From the derivative of the rotation vector theta e by its left Jacobian:
    sin(theta) e_p + (1 - cos(theta)) e x e_p.
    """
    if vector.is_zero(d_axis):
        return d_axis
    position = first.branch.position
    angle = position if first.branch.sign > 0 else -position
    # The angle counts from the parent outwards, hence the sign of the edge.
    sine, cosine = (position.dag.function(name, angle) for name in ("sin", "cos"))
    # The axis keeps its length one, so that its change is across it.
    across = vector.cross(first.axes[0], d_axis)
    return vector.add(vector.scale(sine, d_axis), vector.scale(1.0 - cosine, across))


@dataclass
class Support:
    """The symbols that values depend on, found once for each value."""

    _known: dict[Node, frozenset[Node]] = field(default_factory=dict)

    def of(self, node: Node) -> frozenset[Node]:
        """Return the symbols that a value depends on."""
        if node not in self._known:
            self._known[node] = frozenset(symbols_in([node]))
        return self._known[node]


@dataclass(frozen=True)
class Seed:
    """Tangents of symbols, and of the fields that depend on them."""

    dag: Dag  # the arena
    symbols: Mapping[Node, Node]  # tangent of each symbol that changes; none of them zero
    support: Support  # shared by all seeds of one system

    def of(self, node: Node) -> Node:
        """Differentiate a coordinate, or an expression of fields."""
        if node.op == "symbol":
            return self.symbols.get(node, self.dag.zero)
        # Most fields depend on no symbol of the seed: two sets tell, without a walk over the field.
        if node.value is not None or self.support.of(node).isdisjoint(self.symbols):
            return self.dag.zero
        return tangents([node], self.symbols)[0]

    def vector(self, a: Vector) -> Vector:
        """Differentiate the components of a vector field."""
        return (self.of(a[0]), self.of(a[1]), self.of(a[2]))

    def matrix(self, m: Matrix) -> Matrix:
        """Differentiate the entries of a tensor field."""
        return (self.vector(m[0]), self.vector(m[1]), self.vector(m[2]))
