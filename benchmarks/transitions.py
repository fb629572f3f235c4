"""Cost of mode changes: twelve dry frictions in a chain, compared with twelve events of a scene.

``python benchmarks/transitions.py`` counts the instructions that the C function
``cotree_events_apply`` executes per call, with callgrind. Counts are exact for a compiler.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path

from timing import heading, line

import cotree

_ELEMENTS = 12
_END = 5.0
_FUNCTION = "cotree_events_apply"


def chain(*, has_friction: bool) -> cotree.Scene:
    """Return driven inertias in a chain of springs, each with dry friction or with two events."""
    scene = cotree.Scene("chain")
    scene.parameter("A", 3.0)
    for i in range(_ELEMENTS):
        node, last = f"n{i}", f"n{i - 1}" if i > 0 else "ground"
        drive = f"A*sin({1.0 + 0.13 * i}*t)"
        scene.rotational_inertia(f"J{i}", "ground", node, inertia=1.0 + 0.1 * i, initial={"w": 0.3})
        scene.rotational_spring(f"k{i}", last, node, stiffness=50.0 + i)
        if has_friction:
            scene.rotational_dry_friction(f"f{i}", "ground", node, torque=0.5)
        else:
            scene.mode(f"m{i}", 1.0)
            scene.event(f"up{i}", f"J{i}.w", direction=1, set={f"m{i}": "1"})
            scene.event(f"down{i}", f"J{i}.w", direction=-1, set={f"m{i}": "-1"})
            drive += f" - 0.5*m{i}"
        scene.torque_source(f"T{i}", "ground", node, torque=drive)
    return scene


def counted(profile: str) -> tuple[int, int]:
    """Return the calls of the function and their instructions from a file of callgrind."""
    names: dict[str, str] = {}
    calls = instructions = 0
    called, is_cost = "", False
    for row in profile.splitlines():
        if name := re.match(r"c?fn=\((\d+)\)(?: (.+))?", row):
            names.setdefault(name[1], name[2] or "")
            if row.startswith("cfn="):
                called = names[name[1]]
        elif row.startswith("calls="):
            is_cost = called == _FUNCTION
            calls += is_cost * int(row[6:].split()[0])
        elif is_cost:
            instructions += int(row.split()[1])
            is_cost = False
    return calls, instructions


def measure(scene: cotree.Scene, by: list[str]) -> tuple[int, int]:
    """Return the numbers of mode changes or events and of their instructions in one run."""
    with tempfile.TemporaryDirectory() as folder:
        project = scene.compile(by).write(folder)
        subprocess.run(project.command, shell=True, cwd=folder, check=True)
        profile = Path(folder) / "profile"
        command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={profile}"]
        program = [str(Path(folder) / "chain"), str(_END)]
        subprocess.run([*command, *program], capture_output=True, check=True)
        return counted(profile.read_text())


def main() -> None:
    print(heading(["sensitivities", "mode change", "event", "ratio"]))
    for by in ([], ["A"]):
        each = []
        for has_friction in (True, False):
            calls, instructions = measure(chain(has_friction=has_friction), by)
            each.append(instructions / calls)
        print(line([len(by), *(f"{count:,.0f}" for count in each), f"{each[0] / each[1]:.2f}"]))


if __name__ == "__main__":
    main()
