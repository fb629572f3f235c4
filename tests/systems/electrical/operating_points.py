"""Circuits of diodes and transistors with hard operating points, and their nodal equations.

In: a list of elements between nodes. Out: a scene, and an independent solution: potentials of nodes
and currents of sources by Newton's method with limited junctions and conductances beside these that
are lowered step by step, as circuit simulators do.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree import Scene

if TYPE_CHECKING:
    from collections.abc import Iterator

Array = npt.NDArray[np.float64]

#: Of all junctions.
THERMAL = 0.02585

#: Name, type, nodes, and what the type takes: a value, or a saturation current and a gain.
Row = tuple[str, str, tuple[str, ...], tuple[float, ...]]


class Circuit:
    """Elements of a circuit; laws are those of ``semiconductors.py``."""

    def __init__(self, name: str, *rows: Row) -> None:
        self.name = name
        self.rows = list(rows)

    def add(self, kind: str, *nodes: str, values: tuple[float, ...]) -> None:
        """Add an element, named after its kind and place."""
        self.rows.append((f"{kind}{len(self.rows)}", kind, nodes, values))

    def voltage(self, plus: str, minus: str, value: float) -> None:
        """Add a voltage source."""
        self.add("V", plus, minus, values=(value,))

    def current(self, plus: str, minus: str, value: float) -> None:
        """Add a current source, whose current flows from plus to minus inside."""
        self.add("I", plus, minus, values=(value,))

    def resistor(self, plus: str, minus: str, value: float) -> None:
        """Add a resistor."""
        self.add("R", plus, minus, values=(value,))

    def diode(self, plus: str, minus: str, saturation: float = 1e-14) -> None:
        """Add a diode."""
        self.add("D", plus, minus, values=(saturation,))

    def npn(self, c: str, b: str, e: str, saturation: float = 1e-15, gain: float = 200.0) -> None:
        """Add a transistor."""
        self.add("N", c, b, e, values=(saturation, gain))

    def pnp(self, c: str, b: str, e: str, saturation: float = 1e-15, gain: float = 50.0) -> None:
        """Add a transistor of the other kind."""
        self.add("P", c, b, e, values=(saturation, gain))

    def scene(self) -> Scene:
        """Build the scene, with the potentials of all nodes as outputs."""
        scene = Scene(self.name)
        for name, kind, nodes, values in self.rows:
            scene.edge(name, _TYPES[kind], *nodes, **_fields(kind, values))
        for node in self.nodes:
            scene.output(f"at_{node}", f"{node}.v")
        return scene

    @property
    def nodes(self) -> list[str]:
        """Names of the nodes but the ground."""
        found = {node for _, _, nodes, _ in self.rows for node in nodes}
        return sorted(found - {"ground"})


_TYPES = {
    "V": "voltage_source",
    "I": "current_source",
    "R": "resistor",
    "D": "diode",
    "N": "bjt_npn",
    "P": "bjt_pnp",
}


def _fields(kind: str, values: tuple[float, ...]) -> dict[str, Any]:
    names = {
        "V": ("voltage",),
        "I": ("current",),
        "R": ("resistance",),
        "D": ("saturation_current",),
        "N": ("saturation_current", "forward_gain"),
        "P": ("saturation_current", "forward_gain"),
    }[kind]
    return dict(zip(names, values, strict=True))


@dataclass(frozen=True)
class Junction:
    """An exponential: what flows through it, between nodes, and how that is amplified."""

    plus: int
    minus: int
    saturation: float
    #: Nodes that its current leaves (+) and enters (-), with shares.
    taps: tuple[tuple[int, float], ...]


class Nodal:
    """Kirchhoff's current law at the nodes; the unknowns are potentials, then source currents."""

    def __init__(self, circuit: Circuit) -> None:
        self.places = {node: i for i, node in enumerate(circuit.nodes)}
        self.n_nodes = len(self.places)
        sources = [row for row in circuit.rows if row[1] == "V"]
        self.size = self.n_nodes + len(sources)
        n = self.size + 1  # the last one is the ground
        self.places["ground"] = self.size
        self.matrix, self.source = np.zeros((n, n)), np.zeros(n)
        self.junctions: list[Junction] = []
        place = self.n_nodes
        for _, kind, nodes, values in circuit.rows:
            ends = [self.places[node] for node in nodes]
            if kind == "R":
                self._stamp(ends[0], ends[1], 1.0 / values[0])
            elif kind == "I":
                self.source[ends[0]] += values[0]
                self.source[ends[1]] -= values[0]
            elif kind == "V":
                for end, sign in zip(ends, (1.0, -1.0), strict=True):
                    self.matrix[end, place] += sign
                    self.matrix[place, end] += sign
                self.source[place] -= values[0]
                place += 1
            else:
                self.junctions += _junctions(kind, ends, values)
        self.laws = (
            np.array([j.plus for j in self.junctions], dtype=int),
            np.array([j.minus for j in self.junctions], dtype=int),
            np.array([j.saturation for j in self.junctions]),
        )
        self.taps = np.zeros((n, len(self.junctions)))
        for k, junction in enumerate(self.junctions):
            for end, share in junction.taps:
                self.taps[end, k] += share

    def _stamp(self, a: int, b: int, conductance: float) -> None:
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
            self.matrix[i, j] += sign * conductance

    def balance(self, x: Array) -> tuple[Array, Array]:
        """Return the residual of the equations, and the size of their terms."""
        plus, minus, saturation = self.laws
        full = np.append(x, 0.0)
        current = saturation * np.expm1((full[plus] - full[minus]) / THERMAL)
        linear, taps = self.matrix * full, self.taps * current
        left = linear.sum(axis=1) + self.source + taps.sum(axis=1)
        size = np.abs(linear).sum(axis=1) + np.abs(self.source) + np.abs(taps).sum(axis=1)
        return left[:-1], size[:-1]

    def solve(self) -> Array:
        """Lower conductances beside all junctions step by step, and leave them out at last."""
        x = np.zeros(self.size)
        conductance, factor = 1.0, 10.0
        while conductance > 0.0:
            lower = conductance / factor if conductance > 1e-17 else 0.0
            found = self._newton(x, lower)
            if found is None:
                factor **= 0.5
                assert factor > 1.0001, "the independent method fails"
                continue
            x, conductance, factor = found, lower, min(factor**2, 100.0)
        return x

    def voltages(self, x: Array) -> Array:
        """Return the voltages of the junctions."""
        plus, minus, _ = self.laws
        full = np.append(x, 0.0)
        return full[plus] - full[minus]

    def _newton(self, x: Array, conductance: float) -> Array | None:
        """Iterate as SPICE does, on the voltages of junctions as they were limited."""
        v = self.voltages(x)
        plus, minus, saturation = self.laws
        critical = THERMAL * np.log(THERMAL / (np.sqrt(2.0) * saturation))
        for _ in range(200):
            slope = saturation / THERMAL * np.exp(v / THERMAL)
            current = saturation * np.expm1(v / THERMAL)
            matrix, rhs = self.matrix.copy(), -self.source
            for k in range(len(v)):
                matrix[:, plus[k]] += self.taps[:, k] * slope[k]
                matrix[:, minus[k]] -= self.taps[:, k] * slope[k]
                for end, sign in ((plus[k], 1.0), (minus[k], -1.0)):
                    matrix[end, plus[k]] += sign * conductance
                    matrix[end, minus[k]] -= sign * conductance
            rhs = rhs - self.taps @ (current - slope * v)
            try:
                new = np.linalg.solve(matrix[:-1, :-1], rhs[:-1])
            except np.linalg.LinAlgError:
                return None
            wanted = self.voltages(new)
            limited = _limited(wanted, v, critical)
            is_done = bool(np.all(np.abs(limited - wanted) < 1e-12)) and np.allclose(
                new, x, rtol=1e-13, atol=1e-13
            )
            x, v = new, limited
            if not np.all(np.isfinite(x)):
                return None
            if is_done:
                return x
        return None


def _limited(wanted: Array, old: Array, critical: Array) -> Array:
    """Limit the rise of junctions' voltages: pnjlim of SPICE."""
    result = wanted.copy()
    for k in np.flatnonzero((wanted > critical) & (np.abs(wanted - old) > 2.0 * THERMAL)):
        if old[k] > 0.0:
            argument = 1.0 + (wanted[k] - old[k]) / THERMAL
            result[k] = old[k] + THERMAL * np.log(argument) if argument > 0.0 else critical[k]
        else:
            result[k] = THERMAL * np.log(wanted[k] / THERMAL)
    return result


def _junctions(kind: str, ends: list[int], values: tuple[float, ...]) -> Iterator[Junction]:
    """Return the exponentials of an element and where their currents flow."""
    if kind == "D":
        a, b = ends
        yield Junction(a, b, values[0], ((a, 1.0), (b, -1.0)))
        return
    saturation, gain = values
    c, b, e = ends
    sign = 1.0 if kind == "N" else -1.0
    # Forward: If/gain into the base, If from collector to emitter; and the other way, of gain 1.
    for end, other, by in ((e, c, gain), (c, e, 1.0)):
        pair = (b, end) if sign > 0 else (end, b)
        taps = ((b, sign / by), (other, sign), (end, -sign * (1.0 + 1.0 / by)))
        yield Junction(*pair, saturation, taps)


def chain(n: int, voltage: float, saturation: float, resistance: float) -> Circuit:
    """Build a chain of diodes on a source with a resistor."""
    made = Circuit("chain")
    made.voltage("n0", "ground", voltage)
    made.resistor("n0", "n1", resistance)
    for i in range(1, n + 1):
        made.diode(f"n{i}", f"n{i + 1}" if i < n else "ground", saturation)
    return made


def bridge(voltage: float, saturation: float, resistance: float) -> Circuit:
    """Build a full bridge with a load; its source is tied to the ground by a leak."""
    made = Circuit("bridge")
    made.voltage("a", "b", voltage)
    made.resistor("a", "c", 0.5)
    for plus, minus in (("c", "out"), ("b", "out"), ("ground", "c"), ("ground", "b")):
        made.diode(plus, minus, saturation)
    made.resistor("out", "ground", resistance)
    made.resistor("b", "ground", 1e6)
    return made


def clippers(n: int, voltage: float, resistance: float) -> Circuit:
    """Build a chain of anti-parallel pairs of unequal diodes."""
    made = Circuit("clippers")
    made.voltage("n0", "ground", voltage)
    made.resistor("n0", "n1", resistance)
    for i in range(1, n + 1):
        end = f"n{i + 1}" if i < n else "ground"
        made.diode(f"n{i}", end, 1e-16 * 10.0**i)
        made.diode(end, f"n{i}", 1e-10 / 10.0**i)
    return made


def regulators(n: int, voltage: float) -> Circuit:
    """Build stages that each cut their voltage down by a chain of diodes, as Zener diodes would."""
    made = Circuit("regulators")
    made.voltage("s0", "ground", voltage)
    for i in range(1, n + 1):
        made.resistor(f"s{i - 1}", f"s{i}", 10.0 * i)
        links = [f"s{i}", *(f"s{i}l{k}" for k in range(1, 2 * (n - i) + 2)), "ground"]
        for plus, minus in pairwise(links):
            made.diode(plus, minus, 1e-14)
    return made


def darlington() -> Circuit:
    """Build a pair of transistors as one, with a load at the collectors."""
    made = Circuit("darlington")
    made.voltage("vcc", "ground", 12.0)
    made.resistor("vcc", "b", 1e6)
    made.resistor("vcc", "c", 1e3)
    made.npn("c", "b", "m")
    made.npn("c", "m", "e")
    made.resistor("e", "ground", 100.0)
    return made


def wilson() -> Circuit:
    """Build Wilson's mirror."""
    made = Circuit("wilson")
    made.voltage("vcc", "ground", 15.0)
    made.resistor("vcc", "ref", 14e3)
    made.resistor("vcc", "out", 5e3)
    made.npn("ref", "m", "ground")
    made.npn("m", "m", "ground")
    made.npn("out", "ref", "m")
    return made


def schmitt(voltage: float) -> Circuit:
    """Build Schmitt's trigger."""
    made = Circuit("schmitt")
    made.voltage("vcc", "ground", 10.0)
    made.voltage("input", "ground", voltage)
    made.resistor("input", "b1", 1e3)
    made.resistor("vcc", "c1", 4.7e3)
    made.resistor("vcc", "c2", 2.2e3)
    made.resistor("c1", "b2", 10e3)
    made.resistor("b2", "ground", 22e3)
    made.npn("c1", "b1", "e")
    made.npn("c2", "b2", "e")
    made.resistor("e", "ground", 470.0)
    return made


def flip_flop(imbalance: float) -> Circuit:
    """Build two transistors that hold each other off."""
    made = Circuit("flip_flop")
    made.voltage("vcc", "ground", 5.0)
    for own, other, load in (("1", "2", 1e3), ("2", "1", 1e3 * (1.0 + imbalance))):
        made.resistor("vcc", f"c{own}", load)
        made.resistor(f"c{own}", f"b{other}", 10e3)
        made.npn(f"c{own}", f"b{own}", "ground")
    return made


def cascode() -> Circuit:
    """Build a cascode with a divider of three resistors."""
    made = Circuit("cascode")
    made.voltage("vcc", "ground", 18.0)
    for plus, minus, value in (
        ("vcc", "b2", 6.8e3),
        ("b2", "b1", 5.6e3),
        ("b1", "ground", 4.7e3),
        ("vcc", "c2", 1.8e3),
        ("e1", "ground", 1.1e3),
    ):
        made.resistor(plus, minus, value)
    made.npn("c2", "b2", "m")
    made.npn("m", "b1", "e1")
    return made


def class_ab(drive: float) -> Circuit:
    """Build complementary followers, their bias by two diodes, and a load."""
    made = Circuit("class_ab")
    made.voltage("vp", "ground", 15.0)
    made.voltage("vn", "ground", -15.0)
    made.voltage("input", "ground", drive)
    made.resistor("vp", "bp", 2.2e3)
    made.diode("bp", "input", 1e-14)
    made.diode("input", "bn", 1e-14)
    made.resistor("bn", "vn", 2.2e3)
    made.npn("vp", "bp", "ep", 1e-14, 80.0)
    made.pnp("vn", "bn", "en", 1e-14, 80.0)
    made.resistor("ep", "out", 0.5)
    made.resistor("out", "en", 0.5)
    made.resistor("out", "ground", 8.0)
    return made


def amplifier(signal: float) -> Circuit:
    """Build an operational amplifier of twenty transistors, after the 741, with feedback of 10."""
    made = Circuit("amplifier")
    made.voltage("vp", "ground", 15.0)
    made.voltage("vn", "ground", -15.0)
    made.voltage("input", "ground", signal)
    made.resistor("out", "inv", 9e3)
    made.resistor("inv", "ground", 1e3)
    # The input: followers, common bases, and the mirror that loads them.
    made.npn("m1", "input", "e1")
    made.npn("m1", "inv", "e2")
    made.pnp("c3", "base", "e1")
    made.pnp("c4", "base", "e2")
    made.npn("c3", "b5", "r5")
    made.npn("c4", "b5", "r6")
    made.npn("vp", "c3", "b5")
    made.resistor("r5", "vn", 1e3)
    made.resistor("r6", "vn", 1e3)
    made.resistor("b5", "vn", 50e3)
    # Its currents.
    made.pnp("m1", "m1", "vp")
    made.pnp("base", "m1", "vp")
    made.npn("base", "b11", "r10")
    made.resistor("r10", "vn", 5e3)
    made.npn("b11", "b11", "vn")
    made.resistor("b12", "b11", 39e3)
    made.pnp("b12", "b12", "vp")
    made.pnp("c13", "b12", "vp", 0.75e-15)
    made.pnp("c14", "b12", "vp", 0.25e-15)
    # The second stage.
    made.npn("vp", "c4", "e16")
    made.resistor("e16", "vn", 50e3)
    made.npn("c13", "e16", "r17")
    made.resistor("r17", "vn", 100.0)
    # The output: its bias, and complementary followers.
    made.npn("c14", "c14", "b18")
    made.npn("c14", "b18", "e18")
    made.resistor("b18", "e18", 40e3)
    made.pnp("vn", "c13", "e18")
    made.npn("vp", "c14", "e14", 3e-15)
    made.pnp("vn", "e18", "e20", 3e-15)
    made.resistor("e14", "out", 27.0)
    made.resistor("out", "e20", 27.0)
    made.resistor("out", "ground", 2e3)
    return made
