"""The C of every shipped scene with every integrator gives no warning at any level.

What compilers warn of depends on what they inline: gcc 12 took the copies in a system that was
factorised without exchanges for uninitialised, from -O1 to -O3 only.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from c_programs import STRICT, need

import cotree
from cotree.codegen.fixed import FIXED
from cotree.codegen.integrators import INTEGRATORS
from cotree.errors import CodegenError

pytestmark = pytest.mark.slow

SCENES = sorted(path.stem for path in (Path(cotree.__file__).parent / "scenes").glob("*.toml"))


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Write every project; give one place of each C text, since many share theirs."""
    found: dict[str, Path] = {}
    for name in SCENES:
        scene = cotree.load(name)
        model = scene.compile(list(scene.parameters)[:2])
        for integrator in (*INTEGRATORS, *FIXED):
            folder = tmp_path_factory.mktemp(f"{name}-{integrator}")
            step = 1e-3 if integrator in FIXED else None
            # Events or loops that an integrator does not take are refused with a sentence.
            with contextlib.suppress(CodegenError):
                for file in model.write(folder, integrator, step).files:
                    if file.suffix == ".c":
                        found[file.name + file.read_text()] = file
    assert len({file.parent.name.rsplit("-", 1)[0] for file in found.values()}) == len(SCENES)
    return found


# What clang warns of, it finds before it optimises.
@pytest.mark.parametrize(
    ("compiler", "level"),
    [*(("gcc", level) for level in ("-O0", "-O1", "-O2", "-O3", "-Os")), ("clang", "-O2")],
)
def test_no_warning_at_any_level(sources: dict[str, Path], compiler: str, level: str) -> None:
    command = [need(compiler), "-std=c99", "-ffp-contract=off", level, *STRICT, "-S", "-o", "-"]

    def complaints(file: Path) -> str:
        done = subprocess.run(
            [*command, file.name], cwd=file.parent, capture_output=True, text=True, timeout=300
        )
        return done.stderr

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        texts = [text for text in pool.map(complaints, sources.values()) if text]
    assert not texts, "\n".join(texts)
