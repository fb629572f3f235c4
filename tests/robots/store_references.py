"""Write references.json: what Pinocchio says of the robots beside this file.

Run it where the extra ``robots`` is installed: ``python tests/robots/store_references.py``.
"""

from __future__ import annotations

import json

import numpy as np
import pinocchio
from pinocchio_states import Peer, inertial_columns
from robot_files import HERE, LINKS, STORED, inertia_of, read, stored_file

N_STATES = 4


def references(name):
    base = STORED[name][1]
    scene = read(stored_file(name), base)
    peer = Peer(stored_file(name), scene, base)
    rng = np.random.default_rng(20)
    cases = []
    for _ in range(N_STATES):
        state, inputs = peer.random(rng)
        rates = peer.forward(state, inputs)
        case = {"state": state, "inputs": inputs, "rates": rates}
        if base == "fixed":
            by_position, by_speed = peer.derivatives(state, inputs)
            case |= {"by_position": by_position.tolist(), "by_speed": by_speed.tolist()}
        columns = inertial_columns(*inertia_of(scene, LINKS[name]))
        case["by_inertia"] = peer.to_inertia(state, inputs, LINKS[name], columns)
        cases.append(case)
    return cases


def main():
    found = {name: references(name) for name in STORED}
    found["pinocchio"] = pinocchio.__version__
    text = json.dumps(found, indent=None, separators=(",", ":"))
    (HERE / "references.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
