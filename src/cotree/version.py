"""Versions of the package and of its C structures."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

#: Version of the structures in ``cotree_abi.h``, increased with each change of their layout.
ABI_VERSION = 10

try:
    #: Version of the installed package.
    VERSION = version("cotree")
except PackageNotFoundError:  # cotree runs from a source tree without installation
    VERSION = "0.0.0"
