"""Readers of files of other tools, which become scenes."""

from __future__ import annotations

from cotree.readers.source import is_spice, is_urdf, load_source

__all__ = [
    "is_spice",
    "is_urdf",
    "load_source",
]
