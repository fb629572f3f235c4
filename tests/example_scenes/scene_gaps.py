"""Constraints of a scene's chords: gaps that stay zero, and slips, which are no gaps.

A gap is a function of places and time; its rate and second derivative are numerical. A slip is a
velocity that is zero without being the rate of anything (nonholonomic).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scene_kinematics import STEP, Kinematics, Places, fixed_turn, unit, vee
from scene_values import constants, value

if TYPE_CHECKING:
    from collections.abc import Mapping

_WITHOUT = ("free", "rigid_body", "spring", "damper", "force", "torque", "knife_edge")

#: Singular values of the gaps' Jacobian below this share of the largest are redundant gaps: they
#: are at round-off on closed chords, a good six decades below those of chords that do hold.
RANK = 1e-8


def directions_across(axis: Any) -> Any:
    """Two unit vectors across a constant axis, as columns."""
    return np.linalg.svd(unit(axis)[None, :])[2][1:].T


def angle_gap(turned: Any, axis: Any, angle: Any) -> Any:
    """The sine of a turn's angle about an axis less another angle: analytic for many turns."""
    cosine = (np.einsum("...ii", turned) - 1) / 2
    return vee(turned) @ unit(axis) * np.cos(angle) - cosine * np.sin(angle)


def chord_gaps(edge: Any, fields: Mapping[str, Any], turned: Any, reach: Any) -> list[Any]:
    """List the scalars and vectors that vanish where a chord is closed.

    ``turned`` and ``reach`` are the second node's orientation and origin in the first.
    """
    kind, axis = edge.component.name, fields.get("axis")

    def tilt(axis: Any) -> Any:
        return turned @ unit(axis) @ directions_across(axis)

    match kind:
        case "arm" | "weld":
            rest = vee(np.swapaxes(fixed_turn(fields), -1, -2) @ turned)
            return [reach - fields.get("vector", np.zeros(3)), rest]
        case "revolute":
            return [reach, tilt(axis)]
        case "prismatic":
            return [reach @ directions_across(axis), vee(turned)]
        case "cylindrical":
            return [reach @ directions_across(axis), tilt(axis)]
        case "screw":
            advance = reach @ unit(axis) / fields["pitch"]
            slip = fields["pitch"] * angle_gap(turned, axis, advance)
            return [reach @ directions_across(axis), tilt(axis), slip]
        case "universal":
            one, two = unit(axis), unit(fields["axis2"])
            return [reach, turned @ two @ one - one @ two]
        case "spherical":
            return [reach]
        case "planar":
            return [reach @ unit(fields["normal"]), tilt(fields["normal"])]
        case "distance":
            length = fields["length"]  # a polynomial in the reach, which has no branch point
            return [((reach * reach).sum(axis=-1) - length**2) / (2 * length)]
        case "slot":  # all three components, of which two are independent: the axis may turn
            length = np.sqrt((axis * axis).sum(axis=-1, keepdims=True))
            return [np.cross(axis / length, reach)]
        case "rolling_disc":
            height = reach @ unit(fields["normal"])
            return [height - fields["radius"] * _towards_contact(fields, turned)[1]]
    if kind not in _WITHOUT:
        raise NotImplementedError(f"the oracle knows no gap of edge '{edge.name}', a '{kind}'")
    return []


def chord_senses(edge: Any, fields: Mapping[str, Any], turned: Any, reach: Any) -> list[float]:
    """Return 1 on a closed chord, and -1 if its gaps vanish after half a turn."""
    kind = edge.component.name
    if kind in ("arm", "weld", "prismatic"):
        still = fixed_turn(fields) if kind != "prismatic" else np.eye(3)
        return [(np.sum(still * turned) - 1) / 2]
    if kind not in ("revolute", "cylindrical", "screw", "planar"):
        return []
    axis = unit(fields["normal" if kind == "planar" else "axis"])
    senses = [float(axis @ turned @ axis)]
    if kind == "screw":
        quarter = reach @ axis / fields["pitch"] - np.pi / 2
        senses.append(angle_gap(turned, axis, quarter))
    return senses


def chord_slips(
    edge: Any, fields: Mapping[str, Any], turned: Any, turning: Any, moving: Any
) -> list[Any]:
    """Velocities that vanish, for the rates of orientation and origin in the first node."""
    match edge.component.name:
        case "knife_edge":
            return [((turned @ unit(fields["axis"])) * moving).sum(axis=-1)]
        case "rolling_disc":
            part, length = _towards_contact(fields, turned)
            contact = -fields["radius"] * part / length[..., None]
            spun = turning @ np.swapaxes(turned, -1, -2) @ contact[..., None]
            return [(moving + spun[..., 0]) @ directions_across(fields["normal"])]
    return []


def _towards_contact(fields: Mapping[str, Any], turned: Any) -> tuple[Any, Any]:
    """The part of a plane's normal within a disc, and its length."""
    normal, axle = unit(fields["normal"]), turned @ unit(fields["axis"])
    part = normal - (axle @ normal)[..., None] * axle
    return part, np.sqrt((part * part).sum(axis=-1))


class Loops(Kinematics):
    """A scene's kinematics with what its chords hold."""

    @property
    def chords(self) -> list[Any]:
        """The edges that are not in the tree."""
        return [edge for name, edge in self.scene.edges.items() if name not in self.kinds]

    def gaps(self, q: Any, places: Places, t: Any) -> Any:
        """The gaps of every chord and prescribed motion, shape (..., n_gaps)."""
        known = self._names(q, places, t)
        rows = []
        for edge in self.scene.edges.values():
            fields = constants(edge.fields, known)
            if "motion" in fields:
                rows += self._motion_gap(edge, fields, q, places)
            if edge.component.name == "gear":
                held = fields["ratio"] * fields["coordinate2"] + fields["phase"]
                rows.append(fields["coordinate1"] - held)
            elif edge.component.name == "constraint":
                rows.append(value(edge.fields["expression"].tree, known))
            elif edge.name not in self.kinds:
                rows += chord_gaps(edge, fields, *self._relative(edge, places))
        return _joined(rows, q.shape[:-1])

    def _names(self, q: Any, places: Places, t: Any) -> dict[str, Any]:
        known = {**self.parameters, "t": t}
        known |= {name: q[..., i] for i, name in enumerate(self.coordinates)}
        for node, i in self.place_of.items():
            known |= {f"{node}.{c}": places.origins[..., i, k] for k, c in enumerate("xyz")}
        return known

    def _relative(self, edge: Any, places: Places) -> tuple[Any, Any]:
        return places.relative(*(self.place_of[node] for node in edge.nodes))

    def _motion_gap(self, edge: Any, fields: Mapping[str, Any], q: Any, places: Places) -> Any:
        """A joint's coordinate less its prescribed motion."""
        if edge.name in self.kinds:
            return [q[..., self.spans[edge.name][0].start] - fields["motion"]]
        turned, reach = self._relative(edge, places)
        if edge.component.name == "prismatic":
            return [reach @ unit(fields["axis"]) - fields["motion"]]
        return [angle_gap(turned, fields["axis"], fields["motion"])]

    def slips(self, places: Places, rates: Places) -> Any:
        """Nonholonomic velocities, for places and their rates, shape (..., n_slips)."""
        rows = []
        for edge in self.chords:
            one, two = (self.place_of[node] for node in edge.nodes)
            turned, _ = places.relative(one, two)
            turning, moving = _relative_rates(places, rates, one, two)
            rows += chord_slips(edge, self.fields[edge.name], turned, turning, moving)
        return _joined(rows, rates.origins.shape[:-2])

    def jacobian(self, q: Any, t: float) -> Any:
        """Rates of gaps, and slips, by rates of motion, shape (n_gaps + n_slips, n_rates)."""
        along = q + 1j * STEP * self.coordinate_map(q).T
        nudged = self.places(along)
        rates = Places(nudged.turns.imag / STEP, nudged.origins.imag / STEP)
        here = Places(nudged.turns.real, nudged.origins.real)
        gaps = self.gaps(along, nudged, t).imag / STEP
        return np.concatenate([gaps, self.slips(here, rates)], axis=-1).T

    def held_rates(self, x: Any, t: float) -> Any:
        """Rates of gaps, and slips, at a state: zero where chords stay closed."""
        path = self.path(x, 0 * self.split(x)[1], t)
        gaps = path.now(self.gaps(path.coordinates, path.places, path.times), 1)
        return np.concatenate(
            [gaps, self.jacobian(self.split(x)[0], t)[len(gaps) :] @ self.split(x)[1]]
        )

    def held_accelerations(self, x: Any, accelerations: Any, t: float) -> Any:
        """Second derivatives of gaps, and rates of slips, along the motion through a state."""
        path = self.path(x, accelerations, t)
        bends = path.now(self.gaps(path.coordinates, path.places, path.times), 2)
        rates = Places(path.rate(path.places.turns), path.rate(path.places.origins))
        return np.concatenate([bends, path.now(self.slips(path.places, rates), 1)])

    def free_motions(self, q: Any, t: float) -> Any:
        """Orthonormal columns: virtual rates that keep the chords closed."""
        _, sizes, rows = np.linalg.svd(self.jacobian(q, t))
        return rows[int((sizes > RANK * sizes.max(initial=0.0)).sum()) :].T

    def consistent(self, x: Any, t: float = 0.0, n_steps: int = 60) -> Any:
        """The state near ``x`` whose chords are closed and stay so: Newton's method."""
        q, u = self.split(x)
        for _ in range(n_steps):
            gaps = self.gaps(q, self.places(q), t)
            if np.abs(gaps).max(initial=0.0) < 5e-16:
                break
            slopes = self.jacobian(q, t)[: len(gaps)]
            q = self.moved(q, -np.linalg.pinv(slopes, rcond=RANK) @ gaps)
        places = self.places(q)
        # Ten roundings of positions of order one to ten.
        if np.abs(self.gaps(q, places, t)).max(initial=0.0) > 1e-13 or not self.is_upright(places):
            raise ValueError("Newton's method closes no chords from here")
        inverse = np.linalg.pinv(self.jacobian(q, t), rcond=RANK)
        for _ in range(2):  # the second takes away the roundings of the first
            u = u - inverse @ self.held_rates(np.concatenate([q, u]), t)
        return np.concatenate([q, u])

    def is_upright(self, places: Places) -> bool:
        """Whether no closed chord is half a turn off."""
        senses = [
            sense
            for edge in self.chords
            for sense in chord_senses(edge, self.fields[edge.name], *self._relative(edge, places))
        ]
        return all(sense > 0.0 for sense in senses)

    def moved(self, q: Any, step: Any) -> Any:
        """Coordinates moved along rates, by 0.3 at most, with quaternions of unit length."""
        largest = np.abs(step).max(initial=0.0)
        q = q + self.coordinate_map(q) @ (step * min(1.0, 0.3 / largest) if largest else step)
        for i, name in enumerate(self.coordinates):
            if name.endswith(".q0"):
                q[i : i + 4] = unit(q[i : i + 4])
        return q


def _relative_rates(places: Places, rates: Places, one: int, two: int) -> tuple[Any, Any]:
    """Rates of a node's orientation and origin in the frame of another, by the product rule."""
    back = np.swapaxes(places.turns[..., one, :, :], -1, -2)
    backing = np.swapaxes(rates.turns[..., one, :, :], -1, -2)
    turning = backing @ places.turns[..., two, :, :] + back @ rates.turns[..., two, :, :]
    reach = (places.origins[..., two, :] - places.origins[..., one, :])[..., None]
    moving = (rates.origins[..., two, :] - rates.origins[..., one, :])[..., None]
    return turning, (backing @ reach + back @ moving)[..., 0]


def _joined(rows: list[Any], batch: tuple[int, ...]) -> Any:
    """Scalars and vectors side by side on a last axis."""
    parts = [np.zeros((*batch, 0))]
    for row in rows:
        is_vector = np.ndim(row) > len(batch)
        parts.append(
            np.broadcast_to(row, (*batch, np.shape(row)[-1]))
            if is_vector
            else np.broadcast_to(row, batch)[..., None]
        )
    return np.concatenate(parts, axis=-1)
