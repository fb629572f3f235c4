"""Findings of the linter that a scene has on purpose, and the names of its rules."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.errors import SceneError, brief, nearest

if TYPE_CHECKING:
    from collections.abc import Iterable

#: The rules by name, with what each finds. One that is refused cannot be meant on purpose.
RULES: dict[str, str] = {
    "refused": "the scene cannot be formed, or has no consistent start",
    "unused-parameter": "no expression of the scene uses a parameter",
    "unused-input": "no expression of the scene uses an input",
    "similar-names": "two names differ in the case of their letters only",
    "dangling-node": "one edge alone touches a node, and no expression looks at it",
    "shorted": "both ends of an edge are at one node",
    "inertia": "a body has no inertia, or one that no body can have",
    "magnitude": "a value is far from what is usual in its unit",
    "dimension": "units in an expression contradict each other, or that of the field",
    "constant": "an expression does not depend on the names in it",
    "no-effect": "a source gives nothing, or a mode is never set",
    "unused-allow": "an entry of allow matches no finding",
}


def check_allowed(entries: object) -> tuple[str, ...]:
    """Check a list of findings that are meant: ``rule`` or ``rule:name``.

    Raises
    ------
    SceneError
        If it is no list of texts, or one does not begin with the name of a rule.
    """
    if not isinstance(entries, (list, tuple)) or not all(isinstance(e, str) for e in entries):
        raise SceneError("allow must be a list of texts: ['unused-parameter:L']")
    for entry in entries:
        rule, colon, name = entry.partition(":")
        if rule not in RULES or (colon and not name):
            hint = nearest(rule, RULES)
            raise SceneError(f"allow holds '{brief(entry)}': give 'rule' or 'rule:name'{hint}")
        if rule == "refused":
            raise SceneError("allow holds 'refused': what cannot be formed is no purpose")
    return tuple(entries)


def is_allowed(rule: str, name: str, entries: Iterable[str]) -> bool:
    """Whether a finding is meant."""
    return any(entry in (rule, f"{rule}:{name}") for entry in entries)
