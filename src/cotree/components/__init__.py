"""Component types by name: terminal equations and what a scene may say of each."""

from __future__ import annotations

from cotree.components import forces, joints, rigid_body
from cotree.components.component import Component, Field, Freedom, Role, Shape
from cotree.components.law import Law

#: Every component type, by the name that scenes use.
COMPONENTS: dict[str, Component] = {
    row.name: row for family in (rigid_body, joints, forces) for row in family.COMPONENTS
}

__all__ = ["COMPONENTS", "Component", "Field", "Freedom", "Law", "Role", "Shape"]
