"""Interactive pages of models: one HTML file that contains the program as WebAssembly."""

from __future__ import annotations

from cotree.web.page import export_web

__all__ = ["export_web"]
