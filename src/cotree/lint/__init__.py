"""The linter: what is suspicious in a scene, though it may run."""

from __future__ import annotations

from cotree.lint.findings import Finding
from cotree.lint.linter import dangling_hint, lint

__all__ = ["Finding", "dangling_hint", "lint"]
