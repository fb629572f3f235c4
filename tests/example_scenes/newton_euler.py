"""D'Alembert's principle on a scene, by a route that shares nothing with the formulation.

A body is a cloud of mass with the second moments E = tr(I)/2 - I, whose inertia forces do the
work m r''.dr + tr(R'' E dR^T) in a virtual motion: neither angular velocities nor Euler's
equations appear. A force element does the work of its law on the change of its own length. The
accelerations are right where the work of inertia forces and applied forces is the same in every
virtual motion that keeps the chords closed, and where the chords stay closed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scene_gaps import RANK, Loops
from scene_kinematics import STEP, Places, unit, vee
from scene_values import numbers, signal, value

if TYPE_CHECKING:
    from collections.abc import Iterator

_DRIVES = {"revolute": "torque", "prismatic": "force", "screw": "torque"}
_AT_REST = {"revolute": "free_angle", "prismatic": "free_length", "screw": "free_angle"}
_NO_LAW = ("rigid_body", "distance", "slot", "knife_edge", "rolling_disc", "gear", "constraint")
_EFFORTS = ("stiffness", "damping", "torque", "force")


@dataclass(frozen=True)
class Load:
    """Work of one element on unit virtual motions, shape (n_rates,), and what it stores."""

    name: str
    elastic: Any
    other: Any
    stored: float = 0.0


@dataclass(frozen=True)
class Check:
    """A residual that vanishes, and the size of the terms that cancel in it."""

    residual: Any
    scale: float

    @property
    def relative(self) -> float:
        """The largest residual as a share of its terms."""
        worst = float(np.abs(self.residual).max(initial=0.0))
        return worst / self.scale if worst else 0.0


class NewtonEuler(Loops):
    """A scene's equations of motion, to check those that cotree forms; see Kinematics."""

    def names(self, t: float, x: Any, u: Any = None) -> dict[str, float]:
        """Values of every name that a law may hold."""
        known = {**self.parameters, "t": t}
        given = dict(zip(self.scene.inputs, () if u is None else u, strict=u is not None))
        for name, row in self.scene.inputs.items():
            known[name] = given[name] if name in given else signal(row.value, known)
        return {**known, **dict(zip(self.states, map(float, x), strict=True))}

    def outputs(self, t: float, x: Any) -> Any:
        """The scene's outputs."""
        q, u = self.split(x)
        here, rates = self.places(q).origins, u @ self._slopes(q).origins.reshape(len(u), -1)
        rates = rates.reshape(here.shape)
        known = self.names(t, x)
        for node, i in self.place_of.items():
            for k, axis in enumerate("xyz"):
                known[f"{node}.{axis}"], known[f"{node}.v{axis}"] = here[i, k], rates[i, k]
        return np.array([value(row.tree, known) for row in self.scene.outputs.values()])

    def _slopes(self, q: Any) -> Places:
        """Derivatives of places along each rate: (n_rates, n_nodes, ...)."""
        nudged = self.nudged(q)
        return Places(nudged.turns.imag / STEP, nudged.origins.imag / STEP)

    # ---- what acts

    def loads(self, t: float, x: Any, u: Any = None) -> Iterator[Load]:
        """Sum the wrenches of force elements, joint laws and gravity."""
        q, rates = self.split(x)
        known, nudged = self.names(t, x, u), self.nudged(q)
        yield from self._weights(q)
        for name, edge in self.scene.edges.items():
            kind = edge.component.name
            if kind in _NO_LAW:
                continue
            law = {key: numbers(f, known) for key, f in edge.fields.items() if key != "motion"}
            turned, reach = nudged.relative(*(self.place_of[node] for node in edge.nodes))
            if kind in ("spring", "damper"):
                length = np.sqrt((reach * reach).sum(axis=-1))
                if "axis" in law:
                    length = reach @ unit(law["axis"])
                slope = length.imag / STEP
                yield _act(name, law, float(length[0].real), slope, rates, law.get("free_length"))
            elif kind == "force":
                work = reach.imag / STEP @ law["force"]
                yield Load(name, 0 * work, work)
            elif kind == "torque":
                work = _spin(turned) @ law["torque"]
                yield Load(name, 0 * work, work)
            elif any(np.any(law.get(effort, 0.0)) for effort in _EFFORTS):
                yield self._joint_load(name, kind, law, rates, turned, reach, known)

    def _weights(self, q: Any) -> Iterator[Load]:
        gravity = numbers(self.scene.gravity, self.parameters)
        here, slopes = self.places(q), self._slopes(q)
        for name, i, mass, _ in self._bodies():
            work = mass * slopes.origins[:, i] @ gravity
            yield Load(name, work, 0 * work, -mass * float(here.origins[i] @ gravity))

    def _joint_load(
        self, name: str, kind: str, law: Any, rates: Any, turned: Any, reach: Any, known: Any
    ) -> Load:
        """The law along a joint's one coordinate, be the joint a branch or a chord."""
        if kind not in _DRIVES:
            raise NotImplementedError(f"the oracle knows no law of edge '{name}', a '{kind}'")
        if name in self.kinds:
            coordinate = known[self.coordinates[self.spans[name][0].start]]
            slope = np.eye(len(rates))[self.spans[name][1].start]
        elif kind == "prismatic":
            lengths = reach @ unit(law["axis"])
            coordinate, slope = float(lengths[0].real), lengths.imag / STEP
        else:
            matrix = turned[0].real
            coordinate = np.arctan2(vee(matrix) @ unit(law["axis"]), (np.trace(matrix) - 1) / 2)
            slope = _spin(turned) @ unit(law["axis"])
        drive = law.get(_DRIVES[kind], 0.0)
        return _act(name, law, coordinate, slope, rates, law.get(_AT_REST[kind]), drive)

    def _bodies(self) -> Iterator[tuple[str, int, float, Any]]:
        """Every body: its node, mass and second moments."""
        for name, edge in self.scene.edges.items():
            if edge.component.name == "rigid_body":
                fields = self.fields[name]
                inertia = np.asarray(fields.get("inertia", np.zeros(3)))
                tensor = inertia if inertia.ndim == 2 else np.diag(inertia)
                moments = np.trace(tensor) / 2 * np.eye(3) - tensor
                yield name, self.place_of[edge.nodes[1]], fields["mass"], moments

    # ---- the principle

    def kinematic(self, x: Any, dx: Any) -> Check:
        """Rates of coordinates that a model gives, less those that follow from the speeds."""
        q, u = self.split(x)
        matrix = self.coordinate_map(q)
        return Check(np.asarray(dx)[: len(q)] - matrix @ u, float((abs(matrix) @ abs(u)).max()))

    def virtual_work(self, t: float, x: Any, dx: Any, u: Any = None) -> Check:
        """Work of inertia forces less applied forces, in virtual motions that chords allow."""
        q, _ = self.split(x)
        accelerations = np.asarray(dx, dtype=float)[len(q) :]
        slopes, terms = self._slopes(q), []
        path = self.path(x, accelerations, t)
        bends, pulls = path.now(path.places.turns, 2), path.now(path.places.origins, 2)
        for _, i, mass, moments in self._bodies():
            terms.append(mass * slopes.origins[:, i] * pulls[i])
            terms.append(((bends[i] @ moments) * slopes.turns[:, i]).reshape(len(slopes.turns), -1))
        for load in self.loads(t, x, u):
            terms += [-load.elastic[:, None], -load.other[:, None]]
        every = np.concatenate(terms, axis=1)
        free = self.free_motions(q, t)
        return Check(free.T @ every.sum(axis=1), float(np.abs(every).sum(axis=1).max()))

    def closing(self, t: float, x: Any, dx: Any) -> Check:
        """Second derivatives of the gaps: zero where accelerations keep the chords closed."""
        q, _ = self.split(x)
        accelerations = np.asarray(dx, dtype=float)[len(q) :]
        drift = self.held_accelerations(x, 0 * accelerations, t)
        terms = np.abs(self.jacobian(q, t)) @ np.abs(accelerations) + np.abs(drift)
        held = self.held_accelerations(x, accelerations, t)
        return Check(held, float(terms.max(initial=0.0)))

    # ---- balances of the whole

    def energy(self, t: float, x: Any) -> tuple[float, float]:
        """Kinetic and potential energy."""
        turns, origins = self.velocities(x)
        kinetic = 0.0
        for _, i, mass, moments in self._bodies():
            kinetic += mass * origins[i] @ origins[i] / 2
            kinetic += np.trace(turns[i] @ moments @ turns[i].T) / 2
        return float(kinetic), float(sum(load.stored for load in self.loads(t, x)))

    def power(self, t: float, x: Any) -> float:
        """Power of everything that has no potential."""
        _, u = self.split(x)
        return float(sum(load.other @ u for load in self.loads(t, x)))

    # ---- what follows from the principle

    def mass_matrix(self, q: Any) -> Any:
        """Kinetic energy's second derivatives by rates."""
        slopes = self._slopes(q)
        total = np.zeros((len(self.rates),) * 2)
        for _, i, mass, moments in self._bodies():
            turns = slopes.turns[:, i]
            total += mass * slopes.origins[:, i] @ slopes.origins[:, i].T
            total += np.einsum("aij,jk,bik->ab", turns, moments, turns)
        return total

    def rhs(self, t: float, x: Any, u: Any = None) -> Any:
        """Rates of the states, by minimal accelerations along the free motions."""
        q, rates = self.split(x)
        still = np.zeros(len(x))
        matrix, free = self.mass_matrix(q), self.free_motions(q, t)
        drift = self.held_accelerations(x, 0 * rates, t)
        kept = -np.linalg.pinv(self.jacobian(q, t), rcond=RANK) @ drift
        lacking = -self.virtual_work(t, x, still, u).residual - free.T @ matrix @ kept
        found = kept + free @ np.linalg.solve(free.T @ matrix @ free, lacking)
        return np.concatenate([self.coordinate_map(q) @ rates, found])

    def state_like(self, other: NewtonEuler, x: Any, n_steps: int = 60) -> Any:
        """The state of this tree that places and moves the nodes as ``x`` does another's."""
        goal = _flat(other.places(other.split(x)[0]))
        shared = dict(zip(other.states, x, strict=True))
        start = [shared.get(name, rest) for name, rest in zip(self.states, self.rest, strict=True)]
        q, _ = self.split(start)
        for _ in range(n_steps):
            slopes = _flat(self.nudged(q)).imag.T / STEP
            q = self.moved(q, np.linalg.lstsq(slopes, goal - _flat(self.places(q)))[0])
        if np.abs(_flat(self.places(q)) - goal).max() > 1e-12:
            raise ValueError("Newton's method finds no such state")
        slopes, wanted = _flat(self._slopes(q)).T, _flat(Places(*other.velocities(x)))
        return np.concatenate([q, np.linalg.lstsq(slopes, wanted)[0]])


def _flat(places: Places) -> Any:
    """All of turns and origins on one axis.

    Whole matrices: unlike rotation vectors their misfit never pulls a frame to the half turn
    from its goal.
    """
    batch = places.origins.shape[:-2]
    return np.concatenate(
        [places.turns.reshape(*batch, -1), places.origins.reshape(*batch, -1)], -1
    )


def _spin(turned: Any) -> Any:
    """Rotation vectors, in the first node's axes, of turns moved by imaginary steps."""
    return vee(turned.imag / STEP @ np.swapaxes(turned.real, -1, -2))


def _act(
    name: str, law: Any, length: float, slope: Any, rates: Any, free: float | None, drive: float = 0
) -> Load:
    """A spring and a damper side by side on a length, with a drive."""
    stretch = length - (free or 0.0)
    stiffness, damping = law.get("stiffness", 0.0), law.get("damping", 0.0)
    other = (drive - damping * (slope @ rates)) * slope
    return Load(name, -stiffness * stretch * slope, other, stiffness * stretch**2 / 2)
