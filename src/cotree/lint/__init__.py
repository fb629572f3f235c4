"""The linter: what is suspicious in a scene, though it may run."""

from __future__ import annotations

from cotree.lint.linter import dangling_hint, lint
from cotree.lint.rules import Finding

__all__ = ["Finding", "dangling_hint", "lint"]
