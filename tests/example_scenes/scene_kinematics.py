"""Places of a scene's nodes, differentiated numerically: nothing here is shared with cotree.

Partial velocities come of a complex step, accelerations of Cauchy's integral on a circle in the
complex plane of time, and what a chord forbids of gaps between the places of its two nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scene_values import constants

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

COORDINATES: dict[str, tuple[str, ...]] = {
    "arm": (),
    "weld": (),
    "revolute": ("theta",),
    "prismatic": ("s",),
    "cylindrical": ("s", "theta"),
    "universal": ("theta1", "theta2"),
    "spherical": ("q0", "q1", "q2", "q3"),
    "planar": ("x", "y", "theta"),
    "free": ("x", "y", "z", "q0", "q1", "q2", "q3"),
    "screw": ("theta",),
    # what bodies without inertia move along, where they are branches
    "particle": ("x", "y", "z"),
    "planar_particle": ("x", "y"),
}
_OWN_RATES = {
    "spherical": ("w1", "w2", "w3"),
    "free": ("vx", "vy", "vz", "w1", "w2", "w3"),
    "particle": ("vx", "vy", "vz"),
}
RATES: dict[str, tuple[str, ...]] = {
    kind: _OWN_RATES.get(kind, tuple(f"{name}_dot" for name in names))
    for kind, names in COORDINATES.items()
}

STEP = 1e-30  # of the complex step: no difference is taken, so nothing cancels
N_CIRCLE = 32  # points; the first coefficient they alias is that of h^34


def turn(axis: Any, angle: Any) -> Any:
    """Rotation matrices about an axis."""
    x, y, z = unit(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.asarray(angle)[..., None, None]
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def unit(vector: Any) -> Any:
    return np.asarray(vector) / np.linalg.norm(vector)


def turn_of_quaternion(q: Any) -> Any:
    q0, v = q[..., :1, None], q[..., 1:]
    outer = v[..., :, None] * v[..., None, :]
    vv = np.einsum("...ii", outer)[..., None, None]
    return ((q0 * q0 - vv) * np.eye(3) + 2 * outer + 2 * q0 * skew(v)) / (q0 * q0 + vv)


def skew(v: Any) -> Any:
    x, y, z = np.moveaxis(v, -1, 0)
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(*x.shape, 3, 3)


def vee(m: Any) -> Any:
    """The vector of the skew part of matrices."""
    pairs = ((2, 1), (0, 2), (1, 0))
    return np.stack([(m[..., i, j] - m[..., j, i]) / 2 for i, j in pairs], axis=-1)


def fixed_turn(fields: Mapping[str, Any]) -> Any:
    """The ``rotation`` of an arm or weld: a matrix, or roll, pitch, yaw about fixed axes."""
    given = fields.get("rotation")
    if given is None or given.shape == (3, 3):
        return np.eye(3) if given is None else given
    roll, pitch, yaw = (turn(axis, angle) for axis, angle in zip(np.eye(3), given, strict=True))
    return yaw @ pitch @ roll


def plane_axes(normal: Any) -> tuple[Any, Any]:
    """The two coordinate axes that follow a coordinate normal cyclically."""
    place = int(np.argmax(np.abs(normal)))
    if np.count_nonzero(normal) != 1 or normal[place] < 0:
        raise NotImplementedError("the two axes of a plane are known for normals x, y and z only")
    return np.eye(3)[(place + 1) % 3], np.eye(3)[(place + 2) % 3]


def placed(kind: str, fields: Mapping[str, Any], q: Any) -> tuple[Any, Any]:
    """Orientation and origin of a branch's second node in the first, for coordinates."""
    still, here = np.eye(3), np.zeros(3)
    column = [q[..., i] for i in range(q.shape[-1])]

    def along(axis: Any, distance: Any) -> Any:
        return np.asarray(distance)[..., None] * axis

    match kind:
        case "arm" | "weld":
            return fixed_turn(fields), fields.get("vector", here)
        case "revolute":
            return turn(fields["axis"], column[0]), here
        case "prismatic":
            return still, along(unit(fields["axis"]), column[0])
        case "cylindrical":
            return turn(fields["axis"], column[1]), along(unit(fields["axis"]), column[0])
        case "screw":
            shift = along(unit(fields["axis"]), fields["pitch"] * column[0])
            return turn(fields["axis"], column[0]), shift
        case "universal":
            return turn(fields["axis"], column[0]) @ turn(fields["axis2"], column[1]), here
        case "spherical":
            return turn_of_quaternion(q), here
        case "free":
            return turn_of_quaternion(q[..., 3:]), q[..., :3]
        case "particle":
            return still, q
        case "planar" | "planar_particle":
            one, two = plane_axes(fields["normal"])
            shift = along(one, column[0]) + along(two, column[1])
            return (turn(fields["normal"], column[2]) if kind == "planar" else still), shift
    raise NotImplementedError(f"the oracle cannot place nodes by a '{kind}'")


@dataclass(frozen=True)
class Places:
    """Orientations (..., n_nodes, 3, 3) and origins (..., n_nodes, 3) of nodes, ground axes."""

    turns: Any
    origins: Any

    def relative(self, one: int, two: int) -> tuple[Any, Any]:
        """Orientation and origin of a node in the frame of another."""
        back = np.swapaxes(self.turns[..., one, :, :], -1, -2)
        reach = self.origins[..., two, :] - self.origins[..., one, :]
        return back @ self.turns[..., two, :, :], (back @ reach[..., None])[..., 0]


class Kinematics:
    """Places, velocities and accelerations of a scene's nodes for given coordinates.

    Parameters
    ----------
    scene : SceneDescription
        Only its data are read.
    branches : sequence of str, optional
        The tree; the branches that the states belong to where absent.
    states : sequence of str, optional
        Names of a model's states; they tell which bodies are branches and how these move.
    plane : str
        Normal of the plane in which bodies that are branches move, where the scene is planar.
    parameters : mapping of str to float, optional
        Values in place of the scene's.
    """

    def __init__(
        self,
        scene: Any,
        branches: Sequence[str] | None = None,
        states: Sequence[str] | None = None,
        plane: str = "z",
        parameters: Mapping[str, float] | None = None,
    ) -> None:
        self.scene = scene
        self.parameters = {name: row.value for name, row in scene.parameters.items()}
        self.parameters |= parameters or {}
        self.fields = {
            name: constants(edge.fields, self.parameters) for name, edge in scene.edges.items()
        }
        self.place_of = {name: i for i, name in enumerate(scene.nodes)}
        self.branches = list(branches or branches_of(scene, states or ()))
        self.kinds = {name: self._kind(name, states, plane) for name in self.branches}
        self._number_states()
        self.walk = self._walk()

    def _kind(self, name: str, states: Sequence[str] | None, plane: str) -> str:
        edge = self.scene.edges[name]
        if edge.component.name != "rigid_body":
            return str(edge.component.name)
        self.fields[name] |= {"normal": np.eye(3)["xyz".index(plane)]}
        known = set(states or [f"{name}.{coordinate}" for coordinate in COORDINATES["free"]])
        for kind in ("free", "planar", "particle", "planar_particle"):
            if all(f"{name}.{coordinate}" in known for coordinate in COORDINATES[kind]):
                return kind
        raise ValueError(f"the states hold no coordinates of body '{name}'")

    def _number_states(self) -> None:
        """All coordinates in the order of the scene's edges, then all rates."""
        self.coordinates: list[str] = []
        self.rates: list[str] = []
        self.spans: dict[str, tuple[slice, slice]] = {}
        for name in [name for name in self.scene.edges if name in self.kinds]:
            first = len(self.coordinates), len(self.rates)
            self.coordinates += [f"{name}.{c}" for c in COORDINATES[self.kinds[name]]]
            self.rates += [f"{name}.{c}" for c in RATES[self.kinds[name]]]
            last = len(self.coordinates), len(self.rates)
            self.spans[name] = (slice(first[0], last[0]), slice(first[1], last[1]))
        self.states = (*self.coordinates, *self.rates)

    def _walk(self) -> list[tuple[str, int, int, bool]]:
        """Branches from the ground outwards: name, inner node, outer node, whether reversed."""
        found, reached, left = [], {0}, list(self.branches)
        while left:
            for name in left:
                one, two = (self.place_of[node] for node in self.scene.edges[name].nodes)
                if (one in reached) != (two in reached):
                    is_reversed = two in reached
                    inner, outer = (two, one) if is_reversed else (one, two)
                    found.append((name, inner, outer, is_reversed))
                    reached.add(outer)
                    left.remove(name)
                    break
            else:
                raise ValueError(f"branches {left} reach no new node: they are no tree")
        if missing := [node for node, i in self.place_of.items() if i not in reached]:
            raise ValueError(f"no branch reaches the nodes {missing}")
        return found

    @property
    def rest(self) -> Any:
        """The state with every coordinate and rate zero, but q0 = 1."""
        return np.array([float(name.endswith(".q0")) for name in self.states])

    @property
    def start(self) -> Any:
        """The initial state that the scene gives."""
        state = dict(zip(self.states, self.rest, strict=True))
        for name in self.kinds:
            given = constants(self.scene.edges[name].initial, self.parameters)
            state |= {f"{name}.{key}": value for key, value in given.items()}
        return np.array([state[name] for name in self.states])

    def split(self, x: Any) -> tuple[Any, Any]:
        """Coordinates and rates of a state."""
        n = len(self.coordinates)
        return np.asarray(x, dtype=float)[:n], np.asarray(x, dtype=float)[n:]

    def places(self, q: Any) -> Places:
        """Place every node for coordinates, shape (..., n_coordinates)."""
        batch, n = q.shape[:-1], len(self.place_of)
        turns = np.zeros((*batch, n, 3, 3), dtype=q.dtype)
        origins = np.zeros((*batch, n, 3), dtype=q.dtype)
        turns[..., 0, :, :] = np.eye(3)
        for name, inner, outer, is_reversed in self.walk:
            own = q[..., self.spans[name][0]]
            turned, reach = placed(self.kinds[name], self.fields[name], own)
            if is_reversed:
                turned = np.swapaxes(turned, -1, -2)
                reach = -(turned @ reach[..., None])[..., 0]
            base = turns[..., inner, :, :]
            turns[..., outer, :, :] = base @ turned
            origins[..., outer, :] = origins[..., inner, :] + (base @ reach[..., None])[..., 0]
        return Places(turns, origins)

    def coordinate_map(self, q: Any) -> Any:
        """The matrix S of q' = S u: ones, and 1/2 q*w of quaternions."""
        matrix = np.zeros((len(self.coordinates), len(self.rates)), dtype=q.dtype)
        for name, (of_q, of_u) in self.spans.items():
            plain = sum(not c.startswith("q") for c in COORDINATES[self.kinds[name]])
            matrix[of_q, of_u][:plain, :plain] = np.eye(plain)
            if "q0" in COORDINATES[self.kinds[name]]:
                scalar, v = q[of_q][plain], q[of_q][plain + 1 :]
                matrix[of_q, of_u][plain, plain:] = -v / 2
                matrix[of_q, of_u][plain + 1 :, plain:] = (scalar * np.eye(3) + skew(v)) / 2
        return matrix

    def nudged(self, q: Any) -> Places:
        """Places moved by an imaginary step along each rate: (n_rates, n_nodes, ...)."""
        return self.places(q + 1j * STEP * self.coordinate_map(q).T)

    def velocities(self, x: Any) -> tuple[Any, Any]:
        """Rates of turns and origins at a state."""
        path = self.path(x, 0 * self.split(x)[1], 0.0)
        return path.now(path.places.turns, 1), path.now(path.places.origins, 1)

    def accelerations(self, x: Any, dx: Any) -> tuple[Any, Any]:
        """Second derivatives of turns and origins at a state, for its rates."""
        path = self.path(x, dx[len(self.coordinates) :], 0.0)
        return path.now(path.places.turns, 2), path.now(path.places.origins, 2)

    def path(self, x: Any, accelerations: Any, t: float) -> Path:
        """The motion through a state, on a circle around the present in the plane of time.

        No coordinate changes by more than about a quarter on it: every place is analytic well
        beyond, and what a derivative divides by stays of the size of the rates themselves.
        """
        q, u = self.split(x)
        accelerations = np.asarray(accelerations, dtype=float)
        fast = max(1.0, np.abs(u).max(), np.sqrt(np.abs(accelerations).max()))
        h = 0.25 / fast * np.exp(2j * np.pi * np.arange(N_CIRCLE) / N_CIRCLE)
        rate = self.coordinate_map(q) @ u
        bend = self.coordinate_map(q) @ accelerations
        bend = bend + (self.coordinate_map(q + 1j * STEP * rate) @ u).imag / STEP
        around = q + h[:, None] * rate + h[:, None] ** 2 / 2 * bend
        return Path(h, t + h, around, self.places(around))


@dataclass(frozen=True)
class Path:
    """A motion at points ``h`` of a circle in the plane of time: coordinates and places."""

    h: Any
    times: Any
    coordinates: Any
    places: Places

    def now(self, values: Any, order: int) -> Any:
        """A derivative by time at the centre, by Cauchy's integral; of order one or two."""
        weights = order / self.h**order / len(self.h)  # order! is order
        return np.tensordot(weights, values, axes=1).real

    def rate(self, values: Any) -> Any:
        """The derivative by time at every point, by the power series about the centre."""
        powers = np.arange(len(self.h))
        series = np.fft.fft(values, axis=0) / len(self.h)  # coefficients times radius^k
        turns = np.exp(2j * np.pi * np.outer(powers, powers - 1) / len(self.h))
        return np.tensordot(turns * powers / abs(self.h[0]), series, axes=1)


def branches_of(scene: Any, states: Sequence[str]) -> list[str]:
    """The edges that own states, then the arms and welds that close no loop with them."""
    owners = {state.partition(".")[0] for state in states}
    group = {node: node for node in scene.nodes}

    def root(node: str) -> str:
        return node if group[node] == node else root(group[node])

    found = []
    rigid = [n for n, edge in scene.edges.items() if edge.component.name in ("arm", "weld")]
    for name in [*(n for n in scene.edges if n in owners), *rigid]:
        one, two = map(root, scene.edges[name].nodes)
        if one != two or name in owners:
            group[one] = two
            found.append(name)
    return found
