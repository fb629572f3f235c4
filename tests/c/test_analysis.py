"""clang-tidy and cppcheck find nothing in the runtime and in projects of shipped scenes."""

from __future__ import annotations

import os
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from c_programs import need

import cotree
from cotree.codegen.render import ALL, header_text
from cotree.export.c_project import Kit, write_c_project
from cotree.files import template_folder
from cotree.pipeline import formulate, generate

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

pytestmark = [pytest.mark.slow, pytest.mark.compiler]

RUNTIME = template_folder() / "runtime"
SCENES = sorted(path.stem for path in (Path(cotree.__file__).parent / "scenes").glob("*.toml"))
#: Macros of the runtime that sources are read with.
VARIANTS = {
    "default": [],
    "single": ["-DCOTREE_SINGLE=1"],
    "ida": ["-DCOTREE_IDA=1"],
    "cvodes": ["-DCOTREE_SENSITIVITIES=1"],
    "idas": ["-DCOTREE_IDA=1", "-DCOTREE_SENSITIVITIES=1"],
}
CPPCHECK = ["cppcheck", "--quiet", "--std=c99", "--enable=warning,performance,portability"]
CPPCHECK += ["--inline-suppr", "--error-exitcode=1", "--suppress=missingIncludeSystem"]
#: One configuration: cppcheck tries twelve combinations of the macros of conditions otherwise.
CPPCHECK += [f"-D{name}=1" for name in ALL.macros()]


def runtime_flags(folder: Path) -> list[str]:
    """Write the generated header, and return the folders of all headers as flags."""
    (folder / "cotree_abi.h").write_text(header_text("cotree_abi.h"))
    return [f"-I{path}" for path in (folder, *sorted({p.parent for p in RUNTIME.rglob("*.h")}))]


def changed_folders(variant: str) -> list[str]:
    """Return the folders of the runtime whose sources a macro changes; by default all."""
    if variant == "default":
        return sorted(
            {path.parent.relative_to(RUNTIME).as_posix() for path in RUNTIME.rglob("*.c")}
        )
    return ["hybrid", "job", "run"] if variant == "single" else ["sundials"]


def followed(folder: str) -> tuple[str, ...]:
    """Return the variants whose branches the analyser, which takes most of the time, follows.

    Branches are the same for both number types. Each line of the adapters of SUNDIALS is compiled
    for IDA without sensitivities or for CVODE with them.
    """
    return ("ida", "cvodes") if folder == "sundials" else ("default",)


def runtime_sources(folder: str) -> list[Path]:
    """Return the sources of a folder of the runtime."""
    return sorted((RUNTIME / folder).glob("*.c"))


def tidy(sources: Iterable[Path], flags: Sequence[str], options: Sequence[str] = ()) -> str:
    """Run clang-tidy on each source alone: it takes a ``va_list`` for another one's otherwise."""
    config = f"--config-file={RUNTIME / '.clang-tidy'}"

    def found(source: Path) -> str:
        command = [need("clang-tidy"), "--quiet", config, *options, str(source), "--", "-std=c99"]
        command += flags
        done = subprocess.run(command, capture_output=True, text=True, cwd=source.parent)
        return done.stdout + done.stderr if done.returncode else ""

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return "\n".join(filter(None, pool.map(found, sources)))


@pytest.mark.parametrize(
    ("variant", "folder"), [(name, folder) for name in VARIANTS for folder in changed_folders(name)]
)
def test_clang_tidy_finds_nothing_in_the_runtime(
    variant: str, folder: str, tmp_path: Path, pytestconfig: pytest.Config
) -> None:
    need("clang-tidy")
    flags = [*runtime_flags(tmp_path), *VARIANTS[variant]]
    own = []
    if variant not in followed(folder) and not pytestconfig.getoption("--campaign"):
        own = ["--checks=-clang-analyzer-*"]
    assert not tidy(runtime_sources(folder), flags, own)


@pytest.mark.parametrize("variant", VARIANTS)
def test_cppcheck_finds_nothing_in_the_runtime(variant: str, tmp_path: Path) -> None:
    need("cppcheck")
    flags = [*runtime_flags(tmp_path), *VARIANTS[variant]]
    sources = [path for folder in changed_folders(variant) for path in runtime_sources(folder)]
    command = [*CPPCHECK, *flags, *map(str, sources)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", SCENES)
def test_nothing_is_found_in_the_project_of_a_shipped_scene(name: str, tmp_path: Path) -> None:
    """With an explicit and with an implicit method, and sensitivities to all parameters."""
    need("clang-tidy")
    need("cppcheck")
    scene = cotree.load(name)
    program = generate(formulate(scene, tuple(scene.parameters), None)[1])[0]
    write_c_project(program, tmp_path, Kit("dopri5,rodas5"), t_end=1.0, rtol=1e-6, atol=1e-8)
    # Files of the runtime are analysed on their own, and the methods' with the first scene.
    own = [
        path
        for path in sorted(tmp_path.glob("*.c"))
        if not path.name.startswith("cotree_") or name == SCENES[0]
    ]
    assert own
    assert not tidy(own, [])
    command = [*CPPCHECK, *(path.name for path in own)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
