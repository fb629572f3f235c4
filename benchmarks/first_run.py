"""Times of the first run of a scene and of later runs, which use the cache.

Run it with ``python benchmarks/first_run.py [command] [ladder] [files] [--rounds N] [--stages N]
[--urdf FILE] [--json FILE]``; it prints Markdown, by default all tables. Every time is that of a
new process from start to end, as the median of rounds in which all cases run alternately.
``seconds`` is the elapsed time, and ``CPU`` is the processor time of the process and its compilers.
Python's bytecode exists beforehand, as after an installation.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from timing import about, keep, surroundings, table

import cotree

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

SCENE, OTHER = "slider-pendulum", "spring-mass-damper"
_FOLDER = Path(__file__).parents[1] / "tests" / "example_scenes"
#: A ladder from scene to result; a second argument forms it anew, though a program was kept.
LADDER = f"""
import sys
sys.path.insert(0, {str(_FOLDER)!r})
from network_scenes import rc_ladder
from cotree.build import cache
cache.KEEPS = sys.argv[2] == "kept"
rc_ladder(int(sys.argv[1])).compile().simulate((0.0, 10.0), throw=True)
"""
#: A robot with a free base from its file to the first right-hand side.
ROBOT = """
import sys
import cotree
model = cotree.read_urdf(sys.argv[1], "free", mimic=False).compile(tunable=[])
model.rhs(0.0, model.initial_state)
"""


def took(cache: Path, *arguments: str) -> tuple[float, float]:
    """Return elapsed and processor time of a new Python process with the given cache folder."""
    environment = {
        key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"
    }
    environment["COTREE_CACHE_DIR"] = str(cache)
    # Of the interpreter that runs this, cotree is taken from where it was found here.
    source = str(Path(cotree.__file__).parents[1])
    environment["PYTHONPATH"] = os.pathsep.join(
        filter(None, [source, os.environ.get("PYTHONPATH", "")])
    )
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [sys.executable, *arguments], env=environment, stdout=subprocess.DEVNULL, check=True
    )
    seconds, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return seconds, used


def command(cache: Path) -> dict[str, tuple[float, float]]:
    """Measure the command line with an empty cache and with caches of earlier runs."""
    run = ("-m", "cotree", "run")
    first = took(cache / "first", *run, SCENE)
    again = took(cache / "first", *run, SCENE)
    took(cache / "later", *run, OTHER)
    return {
        "`import cotree`": took(cache / "first", "-c", "import cotree"),
        f"`cotree run {SCENE}`, empty cache": first,
        "the same after a run of another scene": took(cache / "later", *run, SCENE),
        "the same again": again,
    }


def ladder(cache: Path, n: int) -> dict[str, tuple[float, float]]:
    """Measure a long ladder with an empty cache and with a filled cache."""
    script = ("-c", LADDER, str(n))
    return {
        f"ladder of {n} stages, empty cache": took(cache, *script, "kept"),
        "again, the library kept": took(cache, *script, "formed"),
        "again, program and library kept": took(cache, *script, "kept"),
    }


def files(cache: Path, robot: Path) -> dict[str, tuple[float, float]]:
    """Measure a robot and netlists from file to result, with an empty and with a filled cache."""
    found = {}
    cases = {f"`{robot.name}` to the first `rhs`": ("-c", ROBOT, str(robot))}
    for name in ("amplifier", "converter", "ttl"):
        file = _FOLDER.parent / "readers" / "netlists" / f"{name}.cir"
        cases[f"`cotree run {file.name}`"] = ("-m", "cotree", "run", str(file))
    for i, (name, arguments) in enumerate(cases.items()):
        for row in (f"{name}, empty cache", f"{name}, again"):
            found[row] = took(cache / str(i), *arguments)
    return found


def rounds(
    measure: Callable[[Path], dict[str, tuple[float, float]]], n: int
) -> dict[str, tuple[float, float]]:
    """Return medians over rounds, each of which uses its own cache."""
    found: dict[str, list[tuple[float, float]]] = {}
    for _ in range(n):
        with tempfile.TemporaryDirectory() as folder:
            for name, times in measure(Path(folder)).items():
                found.setdefault(name, []).append(times)
    return {
        name: (median(row[0] for row in rows), median(row[1] for row in rows))
        for name, rows in found.items()
    }


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", help="tables: command, ladder, files; default: all")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--stages", type=int, default=2000)
    parser.add_argument("--urdf", type=Path, default=_FOLDER.parent / "robots/urdf/solo12.urdf")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args(arguments)
    print(surroundings())
    kinds: dict[str, Callable[[Path], dict[str, tuple[float, float]]]] = {
        "command": command,
        "ladder": lambda cache: ladder(cache, given.stages),
        "files": lambda cache: files(cache, given.urdf),
    }
    if unknown := set(given.tables) - kinds.keys():
        parser.error(f"there is no table {', '.join(sorted(unknown))}: {', '.join(kinds)}")
    kept = {}
    for name in given.tables or kinds:
        rounds(kinds[name], 1)  # writes bytecode where there is none
        kept[name] = rounds(kinds[name], given.rounds)
        rows = [[what, f"{s:.2f}", f"{cpu:.2f}"] for what, (s, cpu) in kept[name].items()]
        print(table(["what", "seconds", "CPU"], rows), "\n", flush=True)
    keep(given.json, about("as a run chooses them"), kept)


if __name__ == "__main__":
    main()
