"""Readers: from files of other tools to scenes."""

from __future__ import annotations

from cotree.readers.source import is_urdf, load_source
from cotree.readers.urdf import UrdfOptions, read_urdf_scene

__all__ = ["UrdfOptions", "is_urdf", "load_source", "read_urdf_scene"]
