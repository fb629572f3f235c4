"""Versions, in one place."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

#: Layout of the structure in ``cotree_abi.h``; a change there changes this number.
ABI_VERSION = 10

try:
    #: Version of the installed package.
    VERSION = version("cotree")
except PackageNotFoundError:  # cotree runs from a source tree that is not installed
    VERSION = "0.0.0"
