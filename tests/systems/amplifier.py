"""The transistor amplifier of the Bari test set, with rates for its capacitors' voltages alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from hand_made import Made

_FILE = Path(__file__).resolve().parents[1] / "references" / "ivp_transistor_amplifier.json"
DATA = json.loads(_FILE.read_text())

NODES = [f"v{i}" for i in range(1, 9)]


def _potentials(v):
    """Return v1 to v8; voltages tied by a capacitor are sums."""
    return {
        "v1": v["v2"] + v["u1"],
        "v2": v["v2"],
        "v3": v["v3"],
        "v4": v["v5"] + v["u3"],
        "v5": v["v5"],
        "v6": v["v6"],
        "v7": v["v8"] + v["u5"],
        "v8": v["v8"],
    }


def _transistor(v, over):
    return v["beta"] * (over.dag.function("exp", over / v["UF"]) - 1.0)


def _rates(v):
    e = _potentials(v)
    first, second = _transistor(v, e["v2"] - e["v3"]), _transistor(v, e["v5"] - e["v6"])
    alpha, ub = v["alpha"], v["Ub"]
    source = 0.1 * v["t"].dag.function("sin", 200.0 * np.pi * v["t"])
    through = {
        1: (source - e["v1"]) / v["R0"],
        3: (ub - e["v4"]) / v["R4"] - alpha * first,
        5: e["v8"] / v["R9"],
    }
    base2 = e["v2"] / v["R1"] + (e["v2"] - ub) / v["R2"] + (1.0 - alpha) * first
    base5 = e["v5"] / v["R5"] + (e["v5"] - ub) / v["R6"] + (1.0 - alpha) * second
    return [
        through[1] / v["C1"],
        (first - e["v3"] / v["R3"]) / v["C2"],
        through[3] / v["C3"],
        (second - e["v6"] / v["R7"]) / v["C4"],
        through[5] / v["C5"],
        through[1] - base2,
        through[3] - base5,
        (ub - e["v7"]) / v["R8"] - alpha * second - through[5],
    ]


AMPLIFIER = Made(
    "amplifier",
    {"u1": -3.0, "v3": 3.0, "u3": 3.0, "v6": 3.0, "u5": 6.0},
    {"v2": 0.0, "v5": 0.0, "v8": 0.0},
    DATA["parameters"],
    _rates,
    lambda v: {f"out{name}": value for name, value in _potentials(v).items()},
)

TIMES = np.array([row["t"] for row in DATA["reference"]])


def _table(rows):
    return np.array([[row["values"][f"v({i})"] for row in rows] for i in range(1, 9)])


#: Shape (8, n_t), and by parameter.
POTENTIALS = _table(DATA["reference"])
SENSITIVITIES = {name: _table(rows) for name, rows in DATA["sensitivities"]["values"].items()}
