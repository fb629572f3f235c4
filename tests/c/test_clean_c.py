"""The C of every shipped scene with every integrator gives no warning at any level.

What compilers warn of depends on what they inline: gcc 12 took the copies in a system that was
factorised without exchanges for uninitialised, from -O1 to -O3 only. Every text is compiled at the
level of the command that is printed, and at one of the others in turn.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
from concurrent.futures import ThreadPoolExecutor
from itertools import cycle
from pathlib import Path

import pytest
from c_programs import STRICT, need

import cotree
from cotree.codegen.fixed import FIXED
from cotree.codegen.integrators import INTEGRATORS
from cotree.errors import CodegenError
from cotree.export.c_project import write_c_project
from cotree.pipeline import formulate, generate

pytestmark = pytest.mark.slow

RUN = {"t_end": 1.0, "rtol": 1e-6, "atol": 1e-8}
SCENES = sorted(path.stem for path in (Path(cotree.__file__).parent / "scenes").glob("*.toml"))


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Write every project; give one place of each C text, since many share theirs."""
    found: dict[str, Path] = {}
    for name in SCENES:
        scene = cotree.load(name)
        program = generate(formulate(scene, list(scene.parameters)[:2], None)[1])[0]
        for integrator in (*INTEGRATORS, *FIXED):
            folder = tmp_path_factory.mktemp(f"{name}-{integrator}")
            step = 1e-3 if integrator in FIXED else None
            # Events or loops that an integrator does not take are refused with a sentence.
            with contextlib.suppress(CodegenError):
                made = write_c_project(program, folder, integrator, **RUN, step=step)
                for file in made.files:
                    if file.suffix == ".c":
                        found[file.name + file.read_text()] = file
    assert len({file.parent.name.rsplit("-", 1)[0] for file in found.values()}) == len(SCENES)
    return found


LEVELS = ("-O0", "-O1", "-O3", "-Os")


@pytest.mark.parametrize(
    ("compiler", "levels"),
    [
        pytest.param("gcc", ("-O2",), id="gcc -O2"),
        pytest.param("gcc", LEVELS, id="gcc, other levels"),
        # What clang warns of, it finds before it optimises.
        pytest.param("clang", ("-O0",), id="clang"),
    ],
)
def test_no_warning_at_any_level(
    sources: dict[str, Path], compiler: str, levels: tuple[str, ...]
) -> None:
    command = [need(compiler), "-std=c99", "-ffp-contract=off", *STRICT, "-S", "-o", "-"]

    def complaints(file: Path, level: str) -> str:
        done = subprocess.run(
            [*command, level, file.name],
            cwd=file.parent,
            capture_output=True,
            text=True,
            timeout=300,
        )
        return done.stderr

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # Texts of one kind lie in one place after sorting, and so meet every level.
        files = [sources[key] for key in sorted(sources)]
        texts = [text for text in pool.map(complaints, files, cycle(levels)) if text]
    assert not texts, "\n".join(texts)
