"""Linear networks solved a second way: all equations of all elements at once, dense, in NumPy.

Unknowns are the potentials of the nodes and the currents of all edges, with their rates: no tree,
no choice of states, no elimination. At given values of the states the equations and their
derivatives by time form one linear system, which says what every variable is where the network
determines it. With rates replaced by s times the variables, it gives the transfer functions, and
whether the network has one solution at all.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import numpy.typing as npt

    from cotree import Scene

# Singular values below this share of the largest are zero: values are between 0.5 and 2 and there
# are at most some forty equations, so that regular systems stay many orders above it.
RANK = 1e-10

_TYPES = {
    "R": ("resistor", "resistance"),
    "C": ("capacitor", "capacitance"),
    "L": ("inductor", "inductance"),
    "V": ("voltage_source", "voltage"),
    "I": ("current_source", "current"),
    "T": ("transformer", "ratio"),
    "G": ("gyrator", "conductance"),
    "E": ("vcvs", "gain"),
    "Y": ("vccs", "transconductance"),
    "H": ("ccvs", "transresistance"),
    "F": ("cccs", "gain"),
}

#: The ports of elements with two.
_PORTS = dict.fromkeys("TG", ("primary", "secondary")) | dict.fromkeys(
    "EYHF", ("control", "output")
)


@dataclass(frozen=True)
class Element:
    """An element: kind, ports as (plus, minus), and its value; of a source what it gives.

    A source gives ``offset + value * sin(omega * t)``, or an input of its own name.
    """

    name: str
    ports: tuple[tuple[str, str], ...]
    value: float
    offset: float = 0.0
    omega: float = 1.0

    @property
    def kind(self) -> str:
        """The first letter of its name."""
        return self.name[0]

    def given(self, t: float) -> tuple[float, float]:
        """Return the value of a source, and its rate."""
        at = self.omega * t
        return self.offset + self.value * np.sin(at), self.value * self.omega * np.cos(at)


@dataclass(frozen=True)
class LinearNetwork:
    """Elements between nodes; ``ground`` has the potential zero."""

    elements: tuple[Element, ...]
    edges: dict[str, tuple[str, str]] = field(init=False)

    def __post_init__(self) -> None:
        edges = {}
        for element in self.elements:
            for name, pair in zip(edge_names(element), element.ports, strict=True):
                edges[name] = pair
        object.__setattr__(self, "edges", edges)

    @property
    def nodes(self) -> list[str]:
        """The nodes but for the ground."""
        nodes = dict.fromkeys(node for pair in self.edges.values() for node in pair)
        return [node for node in nodes if node != "ground"]

    @property
    def sources(self) -> list[str]:
        """Names of the sources."""
        return [e.name for e in self.elements if e.kind in "VI"]

    @property
    def outputs(self) -> list[str]:
        """Names of all variables: potentials, then currents of the edges."""
        return [*(f"{node}.v" for node in self.nodes), *(f"{name}.i" for name in self.edges)]

    def scene(self, inputs: bool = False) -> Scene:
        """Write the network as a scene whose outputs are all potentials and currents."""
        from cotree import Scene

        scene = Scene("network")
        for e in self.elements:
            kind, key = _TYPES[e.kind]
            value = f"p_{e.name}"
            if e.kind in "VI" and inputs:
                value = f"u_{e.name}"
                scene.input(value, 0.0)
            else:
                scene.parameter(value, e.value)
                if e.kind in "VI":
                    value = f"{e.offset!r} + {value} * sin({e.omega!r} * t)"
            if len(e.ports) == 1:
                scene.edge(e.name, kind, *e.ports[0], **{key: value})
            else:
                both = dict(zip(_PORTS[e.kind], map(list, e.ports), strict=True))
                scene.edge(e.name, kind, **both, **{key: value})
        for name in self.outputs:
            scene.output(name.replace(".", "_"), name)
        return scene


def edge_names(element: Element) -> list[str]:
    """Names of an element's edges."""
    if len(element.ports) == 1:
        return [element.name]
    return [f"{element.name}.{port}" for port in _PORTS[element.kind]]


@dataclass(frozen=True, eq=False)
class Tableau:
    """All equations of a network: ``(static + s * dynamic) w = sources @ given``.

    Attributes
    ----------
    static, dynamic : ndarray, shape (n, n)
        Of the unknowns w and of their rates.
    sources : ndarray, shape (n, n_sources)
        Where what the sources give enters.
    """

    static: npt.NDArray[np.float64]
    dynamic: npt.NDArray[np.float64]
    sources: npt.NDArray[np.float64]

    @classmethod
    def of(cls, network: LinearNetwork) -> Tableau:
        """Write the currents' sums, then the elements' equations."""
        nodes, edges = network.nodes, list(network.edges)
        n = len(nodes) + len(edges)
        static, dynamic = np.zeros((n, n)), np.zeros((n, n))
        sources = np.zeros((n, len(network.sources)))
        across, through = {}, {}
        for j, (name, (plus, minus)) in enumerate(network.edges.items()):
            through[name] = np.eye(n)[len(nodes) + j]
            across[name] = np.zeros(n)
            for node, sign in ((plus, 1.0), (minus, -1.0)):
                if node != "ground":
                    across[name][nodes.index(node)] += sign
                    static[nodes.index(node)] += sign * through[name]
        row = len(nodes)
        for e in network.elements:
            first, *others = edge_names(e)
            v, i = across[first], through[first]
            if e.kind == "R":
                static[row] = v - e.value * i
            elif e.kind == "C":
                static[row], dynamic[row] = -i, e.value * v
            elif e.kind == "L":
                static[row], dynamic[row] = -v, e.value * i
            elif e.kind == "G":
                (second,) = others
                static[row] = i - e.value * across[second]
                row += 1
                static[row] = through[second] + e.value * v
            elif e.kind == "T":
                (second,) = others
                static[row] = v - e.value * across[second]
                row += 1
                static[row] = e.value * i + through[second]
            elif e.kind in "EYHF":
                (second,) = others
                static[row] = i if e.kind in "EY" else v
                row += 1
                gives = across if e.kind in "EH" else through
                static[row] = gives[second] - e.value * (v if e.kind in "EY" else i)
            else:
                static[row] = v if e.kind == "V" else i
                sources[row, network.sources.index(e.name)] = 1.0
            row += 1
        return cls(static, dynamic, sources)

    @property
    def is_regular(self) -> bool:
        """Whether the network has one solution for given sources and initial values."""
        sizes = np.linalg.svd(self.static + (0.7 + 0.4j) * self.dynamic, compute_uv=False)
        return bool(sizes[-1] > RANK * sizes[0])

    @property
    def index(self) -> int:
        """Differentiation index: how often equations are differentiated to give all rates."""
        # The inverse grows as s to the power of the index less one.
        sizes = [
            np.abs(np.linalg.inv(self.static + s * self.dynamic)).max()
            for s in (2e3 + 1e3j, 2e4 + 1e4j)
        ]
        return 1 + round(np.log10(sizes[1] / sizes[0]))

    def transfer(self, s: complex) -> npt.NDArray[np.complex128]:
        """Transfer functions from the sources to all variables."""
        return np.linalg.solve(self.static + s * self.dynamic, self.sources)


def instant(
    network: LinearNetwork, states: Mapping[str, float], t: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Solve the equations and their derivatives by time at given states.

    Returns
    -------
    values, rates : ndarray
        Of all variables, in the order of ``network.outputs``.
    determined : ndarray of bool
        Which of the values, then of the rates, follow.
    """
    matrix, right = _instant(network, states, t)
    found, determined = _solve(matrix, right)
    n = len(network.outputs)
    return found[:n], found[n:], determined


def condition(network: LinearNetwork, states: Iterable[str]) -> float:
    """Condition number of the equations at given states: of random values, few draws are bad."""
    sizes = np.linalg.svd(_instant(network, dict.fromkeys(states, 0.0), 0.0)[0], compute_uv=False)
    return float(sizes[0] / sizes[-1])


def instant_along(
    network: LinearNetwork,
    states: Mapping[str, float],
    d_states: Mapping[str, float],
    t: float,
    name: str,
) -> npt.NDArray[np.float64]:
    """Differentiate the values and rates by an element's value, the states moving too."""
    matrix, right = _instant(network, states, t)
    found, _ = _solve(matrix, right)
    # Every equation is linear in each value and in the states.
    moved = {key: value + d_states[key] for key, value in states.items()}
    shifted = [_plus_one(e) if e.name == name else e for e in network.elements]
    other, other_right = _instant(LinearNetwork(tuple(shifted)), moved, t)
    return _solve(matrix, (other_right - right) - (other - matrix) @ found)[0]


def _plus_one(e: Element) -> Element:
    return Element(e.name, e.ports, e.value + 1.0, e.offset, e.omega)


def _instant(
    network: LinearNetwork, states: Mapping[str, float], t: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Write equations, their derivatives, and the values of the states."""
    tableau = Tableau.of(network)
    n = len(tableau.static)
    given = {e.name: e.given(t) for e in network.elements if e.kind in "VI"}
    e = np.array([given[name] for name in network.sources]).reshape(-1, 2)
    is_static = ~np.any(tableau.dynamic, axis=1)
    rows = [
        np.hstack([tableau.static, tableau.dynamic]),
        np.hstack([np.zeros((is_static.sum(), n)), tableau.static[is_static]]),
    ]
    right = [tableau.sources @ e[:, 0], (tableau.sources @ e[:, 1])[is_static]]
    outputs = network.outputs
    for name, value in states.items():
        edge, _, symbol = name.rpartition(".")
        row = np.zeros(2 * n)
        if symbol == "i":
            row[outputs.index(name)] = 1.0
        else:
            for node, sign in zip(network.edges[edge], (1.0, -1.0), strict=True):
                if node != "ground":
                    row[outputs.index(f"{node}.v")] += sign
        rows.append(row[None, :])
        right.append(np.array([value]))
    return np.vstack(rows), np.concatenate(right)


def _solve(
    matrix: npt.NDArray[np.float64], right: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Solve, and say what is determined.

    Raises
    ------
    ValueError
        If the equations contradict: the states are not independent.
    """
    u, sizes, vt = np.linalg.svd(matrix)
    rank = int((sizes > RANK * sizes[0]).sum())
    found = vt[:rank].T @ ((u[:, :rank].T @ right) / sizes[:rank])
    if np.abs(matrix @ found - right).max() > 1e-8 * (1.0 + np.abs(found).max()):
        raise ValueError("the states contradict the network's equations")
    free = np.abs(vt[rank:]).max(axis=0, initial=0.0)
    return found, free < 1e-8


def random_network(seed: int, *, is_silly: bool = False) -> LinearNetwork:
    """Draw a network: by turns small and large, with and without ideal couplings.

    Unless it is to be silly, every node is reached, and sources are few.
    """
    rng = np.random.default_rng(seed)
    nodes = ["ground", *(f"n{i}" for i in range(int(rng.integers(1, 8))))]
    weights = {"R": 4.0, "C": 3.0, "L": 3.0, "V": 1.0, "I": 0.7, "T": 1.0 if seed % 2 else 0.0}
    if is_silly:
        weights = dict.fromkeys(weights, 1.0)
    p = np.array(list(weights.values())) / sum(weights.values())
    pairs = []
    if not is_silly:
        pairs = [(node, nodes[int(rng.integers(i))]) for i, node in enumerate(nodes) if i]
    n_more = int(rng.integers(1 if is_silly else 0, len(nodes) + 4))
    pairs += [_pair(rng, nodes) for _ in range(n_more)]
    elements = []
    for i, pair in enumerate(pairs):
        kind = str(rng.choice(list(weights), p=p))
        ports = [pair] if rng.random() < 0.5 else [pair[::-1]]
        if kind == "T":
            ports.append(_pair(rng, nodes))
        value, offset, omega = (float(x) for x in rng.uniform(0.5, 2.0, 3))
        elements.append(Element(f"{kind}{i}", tuple(ports), round(value, 3), offset, omega))
    return LinearNetwork(tuple(elements))


def random_controlled(seed: int) -> LinearNetwork:
    """Draw a network with controlled sources, of which storages and sources are in loops and cuts.

    Nodes of the tree that is drawn first are in a row as often as not, so that cutsets are small.
    """
    rng = np.random.default_rng(seed)
    nodes = ["ground", *(f"n{i}" for i in range(1, int(rng.integers(3, 9))))]
    in_a_row = rng.random() < 0.5
    kinds, p = list("RCLVIEYHF"), np.array([5.0, 3.0, 3.0, 1.0, 0.4, 1.2, 1.2, 1.2, 1.2])
    pairs = [
        (node, nodes[i - 1 if in_a_row else int(rng.integers(i))])
        for i, node in enumerate(nodes)
        if i
    ]
    pairs += [_pair(rng, nodes) for _ in range(int(rng.integers(0, len(nodes))))]
    elements = []
    for i, pair in enumerate(pairs):
        kind = str(rng.choice(kinds, p=p / p.sum()))
        ports = [pair] if rng.random() < 0.5 else [pair[::-1]]
        if kind in "EYHF":
            ports.insert(0, _pair(rng, nodes))
        value, offset, omega = (float(x) for x in rng.uniform(0.5, 2.0, 3))
        if kind in "EYHF" and rng.random() < 0.3:
            value = -value
        elements.append(Element(f"{kind}{i}", tuple(ports), round(value, 3), offset, omega))
    return LinearNetwork(tuple(elements))


def random_couplings(
    seed: int, n_nodes: int, n_transformers: int, n_gyrators: int, n_more: int
) -> LinearNetwork:
    """Draw a network of many ideal couplings between any nodes, and some other elements."""
    rng = np.random.default_rng(seed)
    nodes = ["ground", *(f"n{i}" for i in range(1, n_nodes))]
    kinds = "T" * n_transformers + "G" * n_gyrators
    kinds += "".join(rng.choice(list("RCLV"), p=[0.45, 0.25, 0.25, 0.05]) for _ in range(n_more))
    elements = []
    for i, kind in enumerate(kinds):
        ports = tuple(_pair(rng, nodes) for _ in range(2 if kind in "TG" else 1))
        value, offset, omega = (float(x) for x in rng.uniform(0.5, 2.0, 3))
        elements.append(Element(f"{kind}{i}", ports, round(value, 3), offset, omega))
    return LinearNetwork(tuple(elements))


def _pair(rng: np.random.Generator, nodes: Sequence[str]) -> tuple[str, str]:
    a, b = rng.choice(len(nodes), 2, replace=False)
    return nodes[a], nodes[b]


def step_response(network: LinearNetwork, t: float) -> npt.NDArray[np.float64]:
    """Values at a time after all sources jump to one, from rest: Talbot's inversion of the
    Laplace transform, with the contour of J. Abate and W. Whitt (2006)."""
    tableau, n = Tableau.of(network), 24
    angles = np.arange(1, n) * np.pi / n
    cot = 1.0 / np.tan(angles)
    points = [0.4 * n, *(0.4 * angles * n * (cot + 1j))]
    weights = [
        0.5 * np.exp(points[0]),
        *(
            (1.0 + 1j * angles * (1.0 + cot**2) - 1j * cot)
            * np.exp(np.array(points[1:], dtype=complex))
        ),
    ]
    total = np.zeros(len(network.outputs))
    for delta, gamma in zip(points, weights, strict=True):
        s = delta / t
        total += (gamma * tableau.transfer(s).sum(axis=1) / s).real
    return total * 0.4 / t
