"""Readers of files of other tools, which become scenes."""

from __future__ import annotations

from cotree.readers.source import is_sbml, is_spice, is_urdf, load_source

__all__ = [
    "is_sbml",
    "is_spice",
    "is_urdf",
    "load_source",
]
