"""Readers of files of other tools, which become scenes."""

from __future__ import annotations

from cotree.readers.source import is_spice, is_urdf, load_source
from cotree.readers.spice import read_spice_scene
from cotree.readers.urdf import UrdfOptions, read_urdf_scene

__all__ = [
    "UrdfOptions",
    "is_spice",
    "is_urdf",
    "load_source",
    "read_spice_scene",
    "read_urdf_scene",
]
