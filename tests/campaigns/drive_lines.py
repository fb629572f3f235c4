"""Random drive lines and stacks of blocks, drawn with coincidences on purpose, and what must hold.

A structure is one scene whose numbers are all parameters. It is compiled once and run with many
sets of values, of which a part is made of zeros, ones and equal values, so that several elements
stick, slip or engage at one instant.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

import cotree

#: How long a run is, [s], and the tolerance of its steps. No drive jumps at the end of a run, where
#: the last point would have forces behind the jump and modes before it.
SPAN, RTOL = 6.2, 1e-9

#: Events of one run, beyond which it is said to chatter.
MOST_EVENTS = 1000

SETTINGS = {"method": "dop853", "rtol": RTOL, "max_events": MOST_EVENTS}


@dataclass
class Line:
    """A structure: a scene, and how its parameters are drawn.

    Attributes
    ----------
    scene : Scene
        The scene.
    kinds : dict of str to str
        By name of a parameter, what it is: decides its range.
    frictions : dict of str to dict
        By name of an edge with dry friction, the outputs that hold its ``force``, its ``speed`` and
        its limits, ``upper`` and ``lower``.
    energy : list of str
        Expressions of kinetic energies and of those in springs.
    is_driven : bool
        Whether anything does work on it.
    geared : dict of str to tuple of str
        By node behind a gear, the node before it and the parameter of its ratio.
    one_way : list of list of str
        Nodes of one-way clutches.
    """

    scene: cotree.Scene
    seed: int
    kinds: dict[str, str] = field(default_factory=dict)
    frictions: dict[str, dict[str, str]] = field(default_factory=dict)
    energy: list[str] = field(default_factory=list)
    is_driven: bool = False
    geared: dict[str, tuple[str, str]] = field(default_factory=dict)
    one_way: list[list[str]] = field(default_factory=list)

    def number(self, name, kind):
        """Add a parameter of a kind and return its name."""
        self.scene.parameter(name, 1.0)
        self.kinds[name] = kind
        return name

    def rub(self, edge, variables, own, has_lower=True):
        """Note an edge with dry friction, and put what is checked of it among the outputs."""
        wanted = {"force": own.through, "speed": own.speed, "upper": "upper"}
        if has_lower:
            wanted["lower"] = "lower"
        names = {short: f"{short}_{len(self.frictions)}" for short in wanted}
        for short, what in wanted.items():
            self.scene.output(names[short], f"{variables}.{what}")
        self.frictions[edge] = names

    def draw(self, rng):
        """Draw a value of each parameter."""
        style = rng.choice(["plain", "mixed", "equal"], p=[0.4, 0.35, 0.25])
        values = {name: _value(kind, style, rng) for name, kind in self.kinds.items()}
        self._turn_forwards(values)
        return values

    def _turn_forwards(self, values):
        """Change the start so that no one-way clutch begins in its locked direction."""

        def speed(node):
            if node == "ground":
                return 0.0
            if node not in self.geared:
                return values[f"w_{node}"]
            before, ratio = self.geared[node]
            return speed(before) / values[ratio]

        for _ in range(10):
            wrong = [pair for pair in self.one_way if speed(pair[1]) < speed(pair[0])]
            for first, second in wrong:
                if f"w_{second}" in values:
                    values[f"w_{second}"] = speed(first)
            if not wrong:
                return
        values.update({name: 0.0 for name in values if name.startswith("w_")})


#: By kind of a parameter: a range, and values that coincide on purpose.
_RANGES = {
    "inertia": ((0.1, 3.0), (1.0, 1.0, 2.0, 0.5)),
    "force": ((0.0, 4.0), (0.0, 1.0, 1.0, 2.0)),
    "raise": ((1.0, 1.6), (1.0, 1.0, 1.5)),
    "stribeck": ((0.05, 1.0), (1.0, 0.1)),
    "damping": ((0.01, 0.5), (0.5, 0.5, 0.1)),
    "stiffness": ((1.0, 50.0), (1.0, 10.0, 10.0, 40.0)),
    "stretch": ((-1.0, 1.0), (0.0, 0.0, 0.1, 1.0, -1.0)),
    "speed": ((-5.0, 5.0), (0.0, 0.0, 0.0, 1.0, -1.0, 5.0)),
    "drive": ((-8.0, 8.0), (0.0, 1.0, 2.0, -2.0, 4.0)),
    "rate": ((0.5, 6.0), (1.0, 1.0, 2.0, np.pi)),
    "phase": ((0.0, 6.0), (0.0, 0.0, np.pi / 2)),
    "time": ((0.0, SPAN), (0.0, 1.0, 1.0, 2.0, 3.0)),
    "ratio": ((0.4, 2.5), (1.0, 1.0, 2.0, -1.0, 0.5)),
    "efficiency": ((0.3, 1.0), (1.0, 1.0, 0.5)),
    "friction": ((0.1, 0.6), (0.5, 0.5, 0.0)),
}


def _value(kind, style, rng):
    (low, high), special = _RANGES[kind]
    if style == "plain" or (style == "mixed" and rng.random() < 0.5):
        value = float(rng.uniform(low, high))
        # Times of jumps have few bits: rounding of ``mod`` puts none before or behind its jump.
        return round(64 * value) / 64 if kind == "time" else value
    return float(special[0] if style == "equal" and rng.random() < 0.4 else rng.choice(special))


class _Domain:
    """The names of one domain."""

    def __init__(self, is_turning):
        self.is_turning = is_turning
        self.storage, self.amount = (
            ("rotational_inertia", "inertia") if is_turning else ("translational_mass", "mass")
        )
        self.speed, self.stretch = ("w", "theta") if is_turning else ("v", "s")
        self.free = "free_angle" if is_turning else "free_length"
        self.effort = "torque" if is_turning else "force"
        self.through = "tau" if is_turning else "f"
        self.prefix = "rotational" if is_turning else "translational"


def make_line(seed):
    """Build a structure: a drive line or a stack of blocks, with up to twelve friction elements."""
    rng = np.random.default_rng(seed)
    own = _Domain(bool(rng.random() < 0.65))
    line = Line(cotree.Scene("line"), seed)
    nodes = [f"n{i}" for i in range(int(rng.integers(1, 8)))]
    _gears(line, nodes, own, rng)
    _storages(line, nodes, own)
    _springs(line, nodes, own, rng)
    n = int(rng.integers(1, 13))
    while len(line.frictions) < n:
        _friction(line, _pair(nodes, own, rng), own, rng)
    line.is_driven = bool(rng.random() < 0.55)
    if line.is_driven:
        for i in range(int(rng.integers(1, 3))):
            _drive(line, f"T{i}", rng.choice(nodes), own, rng)
    line.scene.output("energy", " + ".join(line.energy))
    return line


def _pair(nodes, own, rng):
    """Choose two nodes: of a stack neighbours, of a line any two, or the ground and one."""
    if rng.random() < 0.3 or len(nodes) == 1:
        pair = ["ground", str(rng.choice(nodes))]
    elif rng.random() < 0.6 or not own.is_turning:
        i = int(rng.integers(len(nodes) - 1))
        pair = [nodes[i], nodes[i + 1]]
    else:
        pair = [str(x) for x in rng.choice(nodes, 2, replace=False)]
    return pair[::-1] if rng.random() < 0.3 else pair


def _gears(line, nodes, own, rng):
    """Lay gears along a line, at most one between neighbours."""
    for first, second in pairwise(nodes):
        if not own.is_turning or rng.random() >= 0.15 or len(line.frictions) >= 3:
            continue
        name, ratio = f"G{second}", line.number(f"r_{second}", "ratio")
        if rng.random() < 0.4:
            line.scene.edge(name, "ideal_gear", first, second, ratio=ratio)
        else:
            fields = {"ratio": ratio, "efficiency": line.number(f"e_{second}", "efficiency")}
            if rng.random() < 0.4:
                fields["back_efficiency"] = line.number(f"b_{second}", "efficiency")
            if rng.random() < 0.4:
                fields["torque"] = line.number(f"q_{second}", "force")
            line.scene.edge(name, "lossy_gear", first, second, **fields)
            line.rub(name, f"{name}.teeth", own)
        line.geared[second] = (first, ratio)


def _storages(line, nodes, own):
    speeds = {}
    for node in nodes:
        amount = line.number(f"J_{node}", "inertia")
        if node in line.geared:
            # The speed of a node behind a gear follows from that before it.
            before, ratio = line.geared[node]
            speeds[node] = f"({speeds[before]})/{ratio}"
        else:
            speeds[node] = line.number(f"w_{node}", "speed")
        fields = {own.amount: amount, "initial": {own.speed: speeds[node]}}
        line.scene.edge(f"J{node}", own.storage, "ground", node, **fields)
        line.energy.append(f"0.5*{amount}*{node}.{own.speed}**2")


def _springs(line, nodes, own, rng):
    for i in range(int(rng.integers(0, len(nodes) + 1))):
        pair, name = _pair(nodes, own, rng), f"K{i}"
        stiffness = line.number(f"k_{i}", "stiffness")
        # All positions begin at zero, as they do along any circuit.
        stretch = line.number(f"x_{i}", "stretch")
        spring = {"stiffness": stiffness, own.free: f"-{stretch}"}
        line.scene.edge(name, f"{own.prefix}_spring", *pair, **spring)
        line.energy.append(f"0.5*{stiffness}*({name}.{own.stretch} + {stretch})**2")
        if rng.random() < 0.3:
            damping = line.number(f"d_{i}", "damping")
            line.scene.edge(f"D{i}", f"{own.prefix}_damper", *pair, damping=damping)


def _friction(line, pair, own, rng):
    """Add one element of friction, of any kind of the domain."""
    n = len(line.frictions)
    name, choice = f"F{n}", rng.random()
    if choice < 0.45:
        force = line.number(f"F_{n}", "force")
        law = {own.effort: force}
        if rng.random() < 0.5:
            law["breakaway"] = f"{line.number(f'up_{n}', 'raise')}*{force}"
            if rng.random() < 0.5:
                law["stribeck_speed"] = line.number(f"vs_{n}", "stribeck")
        if rng.random() < 0.3:
            law["damping"] = line.number(f"c_{n}", "damping")
        line.scene.edge(name, f"{own.prefix}_dry_friction", *pair, **law)
        line.rub(name, name, own)
        return
    faces = {
        "normal_force": _pressing(line, n, rng),
        "friction": line.number(f"mu_{n}", "friction"),
    }
    if rng.random() < 0.5:
        faces["peak"] = line.number(f"up_{n}", "raise")
        if rng.random() < 0.4:
            faces["stribeck_speed"] = line.number(f"vs_{n}", "stribeck")
    if not own.is_turning:
        line.scene.edge(name, "translational_brake", *pair, **faces)
        line.rub(name, name, own)
        return
    faces["radius"] = 1.0
    kind = "one_way_clutch" if choice > 0.9 else "clutch" if choice > 0.6 else "brake"
    line.scene.edge(name, kind, *pair, **faces)
    line.rub(name, name, own, has_lower=kind != "one_way_clutch")
    if kind == "one_way_clutch":
        line.one_way.append(pair)


def _pressing(line, n, rng):
    """Press faces together: for good, by turns, from a time on, or in pulses."""
    force = line.number(f"N_{n}", "force")
    shape = rng.integers(5)
    if shape == 0:
        return f"4*{force}"
    if shape == 1:
        w, phase = line.number(f"a_{n}", "rate"), line.number(f"p_{n}", "phase")
        return f"4*{force}*sin({w}*t + {phase})"
    at = line.number(f"t_{n}", "time")
    if shape == 2:
        return f"where(t < {at}, 0, 4*{force})"
    if shape == 3:
        return f"4*{force}*(t - {at})"
    return f"where(mod(t - {at}, 1) < 0.5, 4*{force}, 0)"


def _drive(line, name, node, own, rng):
    """Drive a node by a function of time."""
    force, shape = line.number(f"A_{name}", "drive"), rng.integers(4)
    if shape == 0:
        w, phase = line.number(f"a_{name}", "rate"), line.number(f"p_{name}", "phase")
        text = f"{force}*sin({w}*t + {phase})"
    else:
        at = line.number(f"t_{name}", "time")
        text = (
            f"where(t < {at}, 0, {force})",
            f"0.3*{force}*(t - {at})",
            f"{force}*where(mod(t - {at}, 2) < 1, 1, -1)",
        )[shape - 1]
    line.scene.edge(name, f"{own.effort}_source", "ground", node, **{own.effort: text})


@dataclass
class Tally:
    """Sums and extremes over many runs.

    Attributes
    ----------
    runs, transitions : int
        Numbers of runs and of events of dry friction.
    stops : dict of str to list
        Runs that ended early, by sentence without its numbers.
    growth, excess, creep, backwards : tuple
        The largest of each, with the run: growth of the energy where nothing drives, as a share of
        the largest; what a force exceeds its limit by while it sticks, as a share of the largest
        limit and force; the speed while it sticks, and the speed against its mode, as shares of the
        largest speed.
    crowd : tuple
        The most transitions of one edge within a thousandth of a second.
    """

    runs: int = 0
    transitions: int = 0
    most: tuple = (0, None)
    stops: dict = field(default_factory=dict)
    growth: tuple = (0.0, None)
    excess: tuple = (0.0, None)
    creep: tuple = (0.0, None)
    backwards: tuple = (0.0, None)
    crowd: tuple = (0, None)

    def note(self, what, value, run):
        """Keep the largest value of an attribute."""
        if value > getattr(self, what)[0]:
            setattr(self, what, (float(value), run))

    def merge(self, other):
        """Add the runs of another one."""
        self.runs += other.runs
        self.transitions += other.transitions
        for sentence, runs in other.stops.items():
            self.stops.setdefault(sentence, []).extend(runs)
        for what in ("most", "growth", "excess", "creep", "backwards", "crowd"):
            self.note(what, *getattr(other, what))


def run_line(seed, n_runs):
    """Run a structure with many sets of values, and return a :class:`Tally` of what was seen."""
    line = make_line(seed)
    model = line.scene.compile(optimize="-O0")
    tally = Tally()
    for k in range(n_runs):
        run = (seed, k)
        values = line.draw(np.random.default_rng(run))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of runs that end early: they are counted
            result = model.simulate(
                (0, SPAN), parameters=values, method="dop853", rtol=RTOL, max_events=MOST_EVENTS
            )
        tally.runs += 1
        if not result.success:
            sentence = re.sub(r"'[^']*'(, '[^']*')*", "NAMES", result.message)
            sentence = re.sub(r"-?\d[\d.e+-]*", "#", sentence)
            tally.stops.setdefault(sentence, []).append(run)
        # Nothing can be evaluated at a start that is refused.
        if result.success or len(result.t) > 1:
            look_at(line, result, run, values, tally)
    return tally


def _is_at_jump(line, result, values):
    """Return which points lie at a jump of a given force, or one rounding before it.

    Outputs there are those on the side that rounding of the time says, and modes those behind it.
    """
    jumps = [
        values[name] + 0.5 * np.arange(-20, 20)
        for name, kind in line.kinds.items()
        if kind == "time"
    ]
    away = np.abs(np.subtract.outer(result.t, np.concatenate([[np.inf], *jumps])))
    return np.min(away, axis=1) <= 1e-9


def look_at(line, result, run, values, tally):
    """Note what was seen in one run."""
    if not line.is_driven:
        energy = result["energy"]
        growth = np.max(np.diff(energy), initial=0.0) / (np.max(energy) + 1.0)
        tally.note("growth", growth, run)
    n, jumps = 0, _is_at_jump(line, result, values)
    for edge, names in line.frictions.items():
        mode = np.rint(result[f"{edge}.mode"])
        force, speed, upper = (result[names[what]] for what in ("force", "speed", "upper"))
        lower = result[names["lower"]] if "lower" in names else np.full(len(force), -np.inf)
        is_stuck, slides = mode == 0.0, np.abs(mode) == 1.0
        size = np.max(np.abs(force)) + np.max(np.abs(upper)) + 1.0
        beyond = np.maximum(force - upper, lower - force)[is_stuck & ~jumps]
        tally.note("excess", np.max(beyond, initial=0.0) / size, run)
        fastest = np.max(np.abs(speed)) + 1.0
        tally.note("creep", np.max(np.abs(speed[is_stuck]), initial=0.0) / fastest, run)
        tally.note("backwards", np.max(-(mode * speed)[slides], initial=0.0) / fastest, run)
        own = [row.t for name, row in result.events.items() if name.startswith(f"{edge} ")]
        times = np.sort(np.concatenate(own))
        n += len(times)
        if len(times):
            together = np.searchsorted(times, times + 1e-3, side="right") - np.arange(len(times))
            tally.note("crowd", int(np.max(together)), run)
    tally.transitions += n
    tally.note("most", n, run)
