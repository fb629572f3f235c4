"""Findings of the linter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Finding:
    """One suspicious thing in a scene.

    Attributes
    ----------
    rule : str
        The rule that it breaks, a name in ``cotree.scene.allowances.RULES``.
    kind, name : str
        Its culprit: ``edge``, ``node``, ``parameter``, ``input``, ``output``, ``mode``, ``event``
        or ``scene``, and the name of that.
    message : str
        A sentence that says what is suspicious and what to do.
    severity : str
        ``error`` where the scene is refused, else ``warning``.
    line : int or None
        The line of the scene file where the culprit is stated; None where there is no file.
    """

    rule: str
    kind: str
    name: str
    message: str
    severity: str = "warning"
    line: int | None = None

    @property
    def allow(self) -> str:
        """The entry of ``allow`` that says it is on purpose; empty for errors."""
        return "" if self.severity == "error" else f"{self.rule}:{self.name}"

    def __str__(self) -> str:
        where = "" if self.line is None else f"line {self.line}: "
        return f"{where}{self.severity} [{self.allow or self.rule}] {self.message}"

    def to_dict(self) -> dict[str, Any]:
        """Give the finding as a table for JSON."""
        return {**vars(self), "allow": self.allow}
