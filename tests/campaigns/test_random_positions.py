"""Random rows of masses, springs, dampers and gears, of which some positions are given.

Positions and velocities of all nodes follow from matrices of the network as one exponential, to
which runs are compared: each edge has the position of its nodes, whatever is given and wherever
the tree of positions runs. What contradicts that is refused. As a campaign:
``pytest --slow --campaign tests/campaigns/test_random_positions.py``, 2000 networks.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
import scipy.linalg

import cotree
from cotree import Scene

N_QUICK, N_SLOW, N_ALL, BLOCK = 4, 60, 2000, 100

WORDS = {
    "translational": ("s", "translational_mass", "mass", "free_length", "force_source", "force"),
    "rotational": (
        "theta",
        "rotational_inertia",
        "inertia",
        "free_angle",
        "torque_source",
        "torque",
    ),
}


@dataclass
class Network:
    """The edges of a random network, and what they make of the positions x of its nodes."""

    domain: str
    masses: np.ndarray
    springs: list[tuple[int, int, float, float]] = field(default_factory=list)
    dampers: list[tuple[int, int, float]] = field(default_factory=list)
    gears: list[tuple[int, int, float]] = field(default_factory=list)
    forces: list[tuple[int, float]] = field(default_factory=list)

    @property
    def n(self) -> int:
        return len(self.masses)

    def matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sum stiffness, damping and constant forces over the edges; node -1 is the ground."""
        k, c, f = np.zeros((self.n, self.n)), np.zeros((self.n, self.n)), np.zeros(self.n)
        for a, b, stiffness, free in self.springs:
            e = self.difference(a, b)
            k += stiffness * np.outer(e, e)
            f += stiffness * free * e
        for a, b, damping in self.dampers:
            e = self.difference(a, b)
            c += damping * np.outer(e, e)
        for a, force in self.forces:
            f[a] += force
        return k, c, f

    def difference(self, a: int, b: int) -> np.ndarray:
        e = np.zeros(self.n)
        for node, sign in ((b, 1.0), (a, -1.0)):
            if node >= 0:
                e[node] += sign
        return e

    def balanced(self, x: np.ndarray) -> np.ndarray:
        """Move the nodes that springs alone hold to where these balance."""
        (held, _, _), (k, _, f) = self.parts(), self.matrices()
        if held.size:
            x = x + held @ np.linalg.solve(held.T @ k @ held, held.T @ (f - k @ x))
        return x

    def parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Span what springs alone hold, what dampers hold, and what has mass and gears."""
        _, c, _ = self.matrices()
        bare = np.flatnonzero(self.masses == 0)
        unit = np.eye(self.n)
        own = unit[:, bare]
        values, vectors = np.linalg.eigh(own.T @ c @ own) if bare.size else (bare, own.T @ own)
        is_damped = np.asarray(values) > 1e-12
        ties = np.array([unit[a] - r * unit[b] for a, b, r in self.gears]).reshape(-1, self.n)
        heavy = unit[:, np.flatnonzero(self.masses)]
        moving = heavy @ scipy.linalg.null_space(ties @ heavy) if len(ties) else heavy
        return own @ vectors[:, ~is_damped], own @ vectors[:, is_damped], moving

    def motion(self, x0: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Return the positions of all nodes from rest at x0, which springs balance."""
        k, c, f = self.matrices()
        held, damped, moving = self.parts()
        n, m = self.n, moving.shape[1]
        inertia = moving.T @ np.diag(self.masses) @ moving
        # Of z = (x, w, 1): x' = moving w + damped a + held b. The damped part balances forces, the
        # held one keeps the balance of springs.
        on_x, on_w, on_1 = -k, -c @ moving, f
        slow = [np.zeros((n, cols)) for cols in (n, m, 1)]
        if damped.size:
            inverse = damped @ np.linalg.inv(damped.T @ c @ damped) @ damped.T
            slow = [inverse @ part.reshape(n, -1) for part in (on_x, on_w, on_1)]
        rate = [slow[0], slow[1] + moving, slow[2]]
        if held.size:
            keep = np.eye(n) - held @ np.linalg.inv(held.T @ k @ held) @ held.T @ k
            rate = [keep @ part for part in rate]
        # Dampers feel the velocities of all nodes.
        force = [
            (-k - c @ rate[0]),
            -c @ rate[1],
            f.reshape(-1, 1) - c @ rate[2],
        ]
        matrix = np.zeros((n + m + 1, n + m + 1))
        matrix[:n] = np.hstack(rate)
        matrix[n : n + m] = np.linalg.solve(inertia, moving.T @ np.hstack(force))
        start = np.concatenate([x0, np.zeros(m), [1.0]])
        return np.array([(scipy.linalg.expm(matrix * time) @ start)[:n] for time in t])


def random_network(rng: np.random.Generator) -> Network:
    n = int(rng.integers(1, 6))
    masses = np.where(rng.random(n) < 0.7, rng.uniform(0.5, 2.0, n), 0.0)
    net = Network(str(rng.choice(list(WORDS))), masses)

    def pick() -> tuple[int, int]:
        a, b = rng.choice(np.arange(-1, n), 2, replace=False)
        return int(a), int(b)

    def spring(a: int, b: int) -> None:
        free = float(rng.choice([0.0, rng.normal()]))
        net.springs.append((a, b, float(rng.uniform(5, 30)), free))

    for node in range(n):  # each is reached, from the ground or from one before
        a = int(rng.integers(-1, node)) if node else -1
        spring(*((a, node) if rng.random() < 0.5 else (node, a)))
    for _ in range(int(rng.integers(0, 4))):
        spring(*pick())
    for _ in range(int(rng.integers(0, 4))):
        net.dampers.append((*pick(), float(rng.uniform(0.3, 3.0))))
    heavy = np.flatnonzero(masses)
    if net.domain == "rotational" and heavy.size > 1 and rng.random() < 0.5:
        a, b = rng.choice(heavy, 2, replace=False)
        net.gears.append((int(a), int(b), float(rng.choice([-2.0, 0.5, 3.0]))))
    if rng.random() < 0.5:
        net.forces.append((int(rng.integers(0, n)), float(rng.normal())))
    return net


def rows_of(net: Network) -> dict[str, tuple[str, tuple[int, int], dict[str, float]]]:
    """List the edges of a network by name: type, ends and fields."""
    _, mass, m, free, source, f = WORDS[net.domain]
    rows: dict[str, tuple[str, tuple[int, int], dict[str, float]]] = {}
    for i, value in enumerate(net.masses):
        if value:
            rows[f"m{i}"] = mass, (-1, i), {m: float(value)}
    for i, (a, b, stiffness, length) in enumerate(net.springs):
        own = {"stiffness": stiffness, free: length}
        rows[f"k{i}"] = f"{net.domain}_spring", (a, b), own
    for i, (a, b, damping) in enumerate(net.dampers):
        rows[f"d{i}"] = f"{net.domain}_damper", (a, b), {"damping": damping}
    for i, (a, force) in enumerate(net.forces):
        rows[f"f{i}"] = source, (-1, a), {f: force}
    for i, (a, b, ratio) in enumerate(net.gears):
        rows[f"g{i}"] = "ideal_gear", (a, b), {"ratio": ratio}
    return rows


def scene_of(rows: dict, initial: dict[str, float], symbol: str) -> Scene:
    """Draw a network in which some edges are given their positions; name all of them."""
    scene = Scene("network")
    for name, (kind, ends, fields) in rows.items():
        nodes = ["ground" if end < 0 else f"n{end}" for end in ends]
        own = {symbol: initial[name]} if name in initial else {}
        scene.edge(name, kind, *nodes, initial=own, **fields)
        if kind != "ideal_gear":
            scene.output(f"x_{name}", f"{name}.{symbol}")
    return scene


def check(seed: int) -> None:
    rng = np.random.default_rng(seed)
    net = random_network(rng)
    symbol = WORDS[net.domain][0]
    rows = rows_of(net)
    rows = {str(name): rows[name] for name in rng.permutation(list(rows))}
    ends = {name: own for name, (kind, own, _) in rows.items() if kind != "ideal_gear"}
    x0 = net.balanced(rng.normal(size=net.n))
    at_start = {name: float(net.difference(*own) @ x0) for name, own in ends.items()}
    # Nodes that springs alone hold begin where these balance: values there are not free.
    loose = np.any(net.parts()[0], axis=1)
    free = [name for name, own in ends.items() if not any(i >= 0 and loose[i] for i in own)]
    chosen = [name for name in free if rng.random() < rng.random()]
    scene = scene_of(rows, {name: at_start[name] for name in chosen}, symbol)
    t = np.linspace(0.0, 1.5, 7)
    model = scene.compile(optimize="-O0")
    result = model.simulate((0, 1.5), t, "dopri5", rtol=1e-9, atol=1e-11)
    # What was given holds; what was not is whatever fits, and one position for each node.
    found = np.array([result[f"x_{name}"] for name in ends])
    sums = np.array([net.difference(*own) for own in ends.values()])
    begins = np.linalg.lstsq(sums, found[:, 0], rcond=None)[0]
    np.testing.assert_allclose(sums @ begins, found[:, 0], atol=1e-12)
    for name in chosen:
        assert result[f"x_{name}"][0] == pytest.approx(at_start[name], abs=1e-12)
    # A hundred tolerances of a step, for some tens of them; positions are some metres.
    expected = sums @ net.motion(begins, t).T
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    # No more positions than nodes, and none of those that springs alone hold.
    n_positions = sum(name.endswith(f".{symbol}") for name in model.states)
    assert n_positions <= net.n - net.parts()[0].shape[1]
    # One of several values along a circuit is wrong: the others say so.
    beside = [name for name in chosen if _follows(name, chosen, ends, net)]
    if beside:
        wrong = str(rng.choice(beside))
        initial = {name: at_start[name] + (name == wrong) for name in chosen}
        with pytest.raises(cotree.ParameterError, match="contradict each other"):
            scene_of(rows, initial, symbol).compile(optimize="-O0")


def _follows(name: str, chosen: list[str], ends: dict[str, tuple[int, int]], net: Network) -> bool:
    """Whether the position of an edge follows from those of the others that are given."""
    rows = np.array([net.difference(*ends[other]) for other in chosen if other != name])
    own = net.difference(*ends[name])
    if not rows.size:
        return False
    return np.linalg.matrix_rank(rows) == np.linalg.matrix_rank(np.vstack([rows, own]))


@pytest.mark.compiler
@pytest.mark.parametrize(
    "seed",
    [pytest.param(i, marks=[pytest.mark.slow] if i >= N_QUICK else []) for i in range(N_SLOW)],
)
def test_random_networks_have_one_position_for_each_node(seed):
    check(seed)


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.compiler
@pytest.mark.parametrize("first", range(0, N_ALL, BLOCK))
def test_all_random_networks_have_one_position_for_each_node(first):
    for seed in range(first, first + BLOCK):
        check(seed)
