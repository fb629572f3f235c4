"""Compilation of C text to shared libraries, which are cached by content and loaded."""

from __future__ import annotations

from cotree.build.cache import cache_directory, cache_key, clear_cache
from cotree.build.compile import (
    BuildOptions,
    BuiltLibrary,
    LoadedLibrary,
    build_library,
    compiler_flags,
    load_library,
    loop_flags,
    obtain_library,
)
from cotree.build.toolchain import Toolchain, abandon, find_toolchain

__all__ = [
    "BuildOptions",
    "BuiltLibrary",
    "LoadedLibrary",
    "Toolchain",
    "abandon",
    "build_library",
    "cache_directory",
    "cache_key",
    "clear_cache",
    "compiler_flags",
    "find_toolchain",
    "load_library",
    "loop_flags",
    "obtain_library",
]
