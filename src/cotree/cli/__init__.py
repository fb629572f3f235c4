"""The command line: arguments in, text and files out; no mathematics."""

from __future__ import annotations

from cotree.cli.app import main

__all__ = ["main"]
