"""Shared libraries of an FMU: for this machine, and through zig for others."""

from __future__ import annotations

import importlib.util
import platform
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cotree.build import BuildOptions, find_toolchain
from cotree.build.cache import write_files
from cotree.build.compile import compiler_flags
from cotree.build.toolchain import Toolchain, run_limited
from cotree.errors import BuildError, CodegenError, check_known

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


@dataclass(frozen=True)
class Platform:
    """A platform."""

    name: str  # as folders of FMI 3 are called
    old_name: str  # the name in FMI 2; empty if it has none
    target: str  # as zig calls it
    suffix: str  # of libraries

    def folder(self, version: int) -> str:
        """Return the folder of its library."""
        return self.name if version == 3 else self.old_name


#: Platforms by name. Linux uses glibc 2.26 of 2017, which all maintained distributions have.
PLATFORMS: dict[str, Platform] = {
    row.name: row
    for row in (
        Platform("x86_64-linux", "linux64", "x86_64-linux-gnu.2.26", ".so"),
        Platform("aarch64-linux", "", "aarch64-linux-gnu.2.26", ".so"),
        Platform("x86_64-windows", "win64", "x86_64-windows-gnu", ".dll"),
        Platform("x86_64-darwin", "darwin64", "x86_64-macos", ".dylib"),
        Platform("aarch64-darwin", "", "aarch64-macos", ".dylib"),
    )
}

_TIME_LIMIT = 600.0


def this_platform() -> str | None:
    """Return the platform of this process; None if it is not in ``PLATFORMS``."""
    system = {"linux": "linux", "win32": "windows", "darwin": "darwin"}.get(sys.platform, "")
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    name = f"{machine}-{system}"
    return name if name in PLATFORMS else None


def wanted_platforms(names: Sequence[str] | None, version: int) -> list[Platform]:
    """Return platforms by name.

    Parameters
    ----------
    names : sequence of str or None
        The names; None for this machine.
    version : int
        Version of the interface.

    Raises
    ------
    CodegenError
        If a name is unknown, or the version has no such platform.
    """
    if names is None:
        own = this_platform()
        if own is None or not PLATFORMS[own].folder(version):
            raise CodegenError(
                f"FMI {version} has no name for this machine: give platforms=[] for an FMU of "
                "sources, or name others"
            )
        names = [own]
    if isinstance(names, str):
        names = [names]
    for name in names:
        check_known([name], PLATFORMS, "there is no platform", error=CodegenError)
        if not PLATFORMS[name].folder(version):
            raise CodegenError(f"FMI {version} has no platform '{name}': leave it out")
    return [PLATFORMS[name] for name in dict.fromkeys(names)]


def build_libraries(
    files: Mapping[str, str], platforms: Sequence[Platform], n_operations: int, n_all: int
) -> dict[str, bytes]:
    """Compile the sources for platforms.

    Parameters
    ----------
    files : mapping of str to str
        C text by file name.
    platforms : sequence of Platform
        The platforms.
    n_operations, n_all : int
        Operations of the longest function, and of all, for the choice of the compiler's level.

    Returns
    -------
    dict of str to bytes
        The library by the name of its platform.

    Raises
    ------
    BuildError
        If there is no compiler, or it fails.
    """
    own, libraries = this_platform(), {}
    for row in platforms:
        toolchain = _toolchain(row, is_own=row.name == own)
        flags = [*compiler_flags(toolchain, BuildOptions(), n_operations, n_all)]
        flags += ["-fvisibility=hidden"]
        if row.suffix == ".dll":
            flags = [flag for flag in flags if flag != "-fPIC"]
        libraries[row.name] = _built(files, row, toolchain, flags)
    return libraries


def _toolchain(row: Platform, *, is_own: bool) -> Toolchain:
    if is_own:
        found = find_toolchain()
        if found is None:
            raise BuildError(
                "an FMU for this machine needs a C compiler: install one, or give platforms=[] for "
                "an FMU of sources"
            )
        return found
    if importlib.util.find_spec("ziglang") is None:
        raise BuildError(
            f"a library for {row.name} is made by zig: install it with pip install 'cotree[zig]'"
        )
    command = (sys.executable, "-m", "ziglang", "cc", "-target", row.target)
    return Toolchain(command, "zig", "zig")


def _built(
    files: Mapping[str, str], row: Platform, toolchain: Toolchain, flags: Sequence[str]
) -> bytes:
    with tempfile.TemporaryDirectory(prefix="cotree-fmu-") as folder:
        directory = Path(folder)
        write_files(files, directory)
        output = f"library{row.suffix}"
        sources = sorted(name for name in files if name.endswith(".c"))
        libraries = [] if row.suffix == ".dll" else ["-lm"]
        command = [*toolchain.command, *flags, "-o", output, *sources, *libraries]
        outcome = run_limited(command, directory, _TIME_LIMIT)
        if outcome.status != 0:
            why = "takes too long" if outcome.status is None else "fails"
            raise BuildError(
                f"The C compiler {why} at the library for {row.name}: "
                f"{outcome.output.strip()[:2000]}"
            )
        return (directory / output).read_bytes()
