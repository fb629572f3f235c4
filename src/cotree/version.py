"""Versions of the package and of its C structures."""

from __future__ import annotations

#: Version of the structures in ``cotree_abi.h``, increased with each change of their layout.
ABI_VERSION = 10

#: Version of the package, from which the build takes it.
VERSION = "0.1.0"
