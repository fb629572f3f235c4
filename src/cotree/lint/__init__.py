"""The linter: findings that are suspicious in a scene, although it may run."""

from __future__ import annotations

from cotree.lint.linter import dangling_hint, lint
from cotree.lint.rules import Finding

__all__ = ["Finding", "dangling_hint", "lint"]
