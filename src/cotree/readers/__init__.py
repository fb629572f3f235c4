"""Readers: from files of other tools to scenes."""

from __future__ import annotations

from cotree.readers.source import load_source
from cotree.readers.urdf import UrdfOptions, read_urdf_scene

__all__ = ["UrdfOptions", "load_source", "read_urdf_scene"]
