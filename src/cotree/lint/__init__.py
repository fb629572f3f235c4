"""The linter: findings that are suspicious in a scene, although it may run."""

from __future__ import annotations

from cotree.lint.rules import Finding, dangling_hint, lint

__all__ = ["Finding", "dangling_hint", "lint"]
