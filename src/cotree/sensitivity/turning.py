"""Cluster axes that rotate along a seed, evaluated in dual numbers.

The derivative of a vector is taken in space and resolved in the vector's basis. The
rotational across variable of a sensitivity graph is the parametric rotation vector phi, with dR/dp
= [phi]x R, so that a vector fixed in a cluster changes by phi x vector. The product and sum rules
(:mod:`cotree.dag.dual`) yield all other derivatives. A seed contains the tangents of symbols.
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
    """Cluster axes that rotate along a seed, with dual numbers as values."""

    seed: Seed  # tangents of the symbols that change
    #: Clusters whose motion depends on the seed; all other clusters move as in the first graph.
    reached: frozenset[int]
    phi: tuple[Vector, ...]  # derivative of each cluster's rotation, in cluster axes
    phi_inwards: tuple[Vector, ...]  # the same vectors in the basis of the cluster's parent
    #: Parametric rotation vector of each cluster's basis, which may be that of its parent.
    phi_basis: tuple[Vector, ...]

    def is_kept(self, cluster: int) -> bool:
        """Return whether a cluster's motion is independent of the seed."""
        return cluster not in self.reached

    @property
    def turned(self) -> frozenset[int]:
        """Clusters whose bases rotate along the seed."""
        return frozenset(i for i, phi in enumerate(self.phi_basis) if not vector.is_zero(phi))

    def resolved(self, cluster: int, local: Vector) -> Vector:
        """Transform a vector field that rotates with the cluster and may change relative to it."""
        return self._turned(self.rotations[cluster].matrix, local, self.phi[cluster])

    def carried(self, branch: Branch, local: Vector) -> Vector:
        """Transform a vector field from the carrier's axes to the basis of the branch's parent."""
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
        """Return a vector with constant components in the basis of a cluster, which may rotate."""
        phi = self.phi_basis[cluster]
        return a if vector.is_zero(phi) else varied(a, vector.cross(phi, a))

    def tensor(self, cluster: int, local: Matrix) -> Matrix:
        """Transform a tensor field with its change relative to the cluster; see :meth:`within`."""
        axes = self.rotations[cluster].matrix
        value, d_local = formed(vector.congruence, axes, local), self.seed.matrix(local)
        # A tensor that is constant in the cluster stays a plain matrix; `within` adds the rotation.
        if all(vector.is_zero(row) for row in d_local):
            return value
        return varied(value, vector.congruence(axes, d_local))

    def seen(self, node: Node) -> Node:
        """Return a field, coordinate or speed as a dual number if it changes."""
        return varied(node, self.seed.of(node))

    def formula(self, node: Node, arguments: Mapping[Node, Node]) -> Node:
        """Substitute arguments, and differentiate with respect to the arguments and the seed."""
        return formula(node, arguments, self.seed.symbols)

    def within(self, cluster: int, form: Callable[..., Vector], *vectors: Vector) -> Vector:
        """Compute a vector from vectors and constant tensors that rotate with a cluster.

        ``form`` receives derivatives relative to the cluster. The result is rotated afterwards.
        """
        phi = self.phi[cluster]
        if vector.is_zero(phi):
            return form(*vectors)
        seen = []
        for a in vectors:
            value = value_of(a)
            # derivative relative to the cluster: da - phi x a
            seen.append(varied(value, vector.sub(tangent_of(a), vector.cross(phi, value))))
        # In space: d = phi x r + derivative relative to the cluster, with the result r. So the
        # rotation of the tensor, [phi]x J - J [phi]x, is not needed.
        result = form(*seen)
        value = value_of(result)
        return varied(value, vector.add(vector.cross(phi, value), tangent_of(result)))


@contextmanager
def derivatives_labelled(dag: Dag) -> Iterator[None]:
    """Label nodes formed in a ``with`` block as derivatives of the section in which they occur."""
    dag.suffix = ", derivative"
    try:
        yield
    finally:
        dag.suffix = ""


def view_along(first: FirstGraph, seed: Seed) -> View:
    """Compute the across variables of a sensitivity graph; accelerations are held constant."""
    motion, across = first.motion, first.view.across
    # Repeat the first graph's traversals in dual numbers. Accelerations are constant here, because
    # their tangents are unknowns on the left-hand side.
    moved = move(first.system, motion.clusters, turn_axes(motion, seed), motion)
    return View(moved, accelerate(moved, across.rates, across), first.view)


def turn_axes(first: Motion, seed: Seed) -> Turning:
    """Determine the clusters that depend on a seed, and their rotation along the seed."""
    frames, zero = first.frames, vector.zeros(first.system.dag)
    n = len(first.omega)
    # Parents come first, so dependence propagates to all clusters further out.
    reached: set[int] = set()
    phi, inwards, basis = [zero] * n, [zero] * n, [zero] * n
    for geometry in first.geometry:
        branch = geometry.branch
        if reached.isdisjoint((branch.parent, branch.turn_parent)) and not _is_seeded(branch, seed):
            continue
        reached.add(branch.child)
        with first.system.dag.labelled(f"f-circuits, geometry of {branch.edge}"):
            # Sum outwards along the rotation tree, as for angular velocities (Eq. (2)).
            turn = vector.add(phi[branch.turn_parent], _turn(frames, seed, geometry))
            inwards[branch.child] = turn
            phi[branch.child] = frames.down(branch.child, turn)
        is_own = frames.steps[branch.child] is not None
        basis[branch.child] = phi[branch.child] if is_own else basis[branch.parent]
    turns = (tuple(phi), tuple(inwards), tuple(basis))
    return Turning(frames.rotations, frames.steps, seed, frozenset(reached), *turns)


def _is_seeded(branch: Branch, seed: Seed) -> bool:
    symbols = [c.symbol for c in branch.coordinates] + [v.symbol for v in branch.speeds]
    if any(not seed.of(node).is_zero for node in (*symbols, *branch.slides)):
        return True
    # Arms and axes may depend on parameters even if coordinates do not.
    fields = (branch.anchor, *branch.axes, *(branch.mount or ()))
    return not all(vector.is_zero(seed.vector(local)) for local in fields)


def _turn(frames: Frames, seed: Seed, first: Geometry) -> Vector:
    """Return the contribution of a branch to phi, in the basis of its parent."""
    branch = first.branch
    if not branch.turns:
        return vector.zeros(seed.dag)
    if branch.quaternion is None:
        d_axis = frames.resolved(branch.turn_parent, seed.vector(branch.axes[0]))
        # A change of the angle rotates the child about the axis, as a speed does.
        own = vector.scale(seed.of(branch.position), first.turning[0])
        return vector.add(own, _tilt(first, d_axis))
    d = [seed.of(entry) for entry in branch.quaternion]
    own = vector.zeros(seed.dag)
    if any(not entry.is_zero for entry in d):
        # An edge that points inwards applies the inverse rotation: phi has the opposite sign.
        own = quaternion_turn(branch.quaternion, d, is_own=branch.sign < 0)
        own = vector.signed(branch.sign, own)
    if branch.mount is not None:
        own = vector.add(vector.times(branch.mount, own), _mounting(branch.mount, seed))
    return frames.resolved(branch.turn_parent, own)


def _mounting(mount: Matrix, seed: Seed) -> Vector:
    """Return the rotation vector of a change of the mounting axes: [phi]x = dT T^T."""
    spin = vector.matmul(seed.matrix(mount), vector.transpose(mount))
    return (spin[2][1], spin[0][2], spin[1][0])


def _tilt(first: Geometry, d_axis: Vector) -> Vector:
    """Return the contribution of a change of the rotation axis to phi.

    The derivative of the rotation vector theta e, times its left Jacobian, is
    sin(theta) e_p + (1 - cos(theta)) e x e_p.
    """
    if vector.is_zero(d_axis):
        return d_axis
    position = first.branch.position
    angle = position if first.branch.sign > 0 else -position
    # The edge's sign makes the angle positive outwards from the parent.
    sine, cosine = (position.dag.function(name, angle) for name in ("sin", "cos"))
    # The axis remains a unit vector: its change is perpendicular to the axis.
    across = vector.cross(first.axes[0], d_axis)
    return vector.add(vector.scale(sine, d_axis), vector.scale(1.0 - cosine, across))


@dataclass
class Support:
    """The symbols on which values depend, cached for each value."""

    _known: dict[Node, frozenset[Node]] = field(default_factory=dict)

    def of(self, node: Node) -> frozenset[Node]:
        """Return the symbols on which a value depends."""
        if node not in self._known:
            self._known[node] = frozenset(symbols_in([node]))
        return self._known[node]


@dataclass(frozen=True)
class Seed:
    """Tangents of the symbols that change, and of the fields that depend on these symbols."""

    dag: Dag  # arena of the nodes
    symbols: Mapping[Node, Node]  # nonzero tangents of the symbols that change
    support: Support  # symbols on which values depend; shared by all directions

    def of(self, node: Node) -> Node:
        """Differentiate a coordinate, or an expression in fields, along the direction."""
        if node.op == "symbol":
            return self.symbols.get(node, self.dag.zero)
        # Most fields depend on no changing symbol: this test avoids a traversal.
        if node.value is not None or self.support.of(node).isdisjoint(self.symbols):
            return self.dag.zero
        return tangents([node], self.symbols)[0]

    def vector(self, a: Vector) -> Vector:
        """Differentiate the components of a vector field."""
        return (self.of(a[0]), self.of(a[1]), self.of(a[2]))

    def matrix(self, m: Matrix) -> Matrix:
        """Differentiate the entries of a tensor field."""
        return (self.vector(m[0]), self.vector(m[1]), self.vector(m[2]))
