"""Attributes of a URDF file: names, numbers, vectors and poses, or a sentence with the line."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import brief

if TYPE_CHECKING:
    from cotree.readers.xml_tree import Element

Vector = tuple[float, float, float]

# Narrower than float(), which takes nan, inf, underscores and digits of other scripts.
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?\Z")
_LARGEST = 1e15  # metres, kilograms: beyond it products overflow, and nothing is built of it
_LONGEST_NAME = 500
_ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Pose:
    """A place, [m], and roll, pitch and yaw about fixed axes, [rad]."""

    xyz: Vector = _ZERO
    rpy: Vector = _ZERO


def child_of(element: Element, tag: str, what: str) -> Element:
    """Give a child element that must exist.

    Parameters
    ----------
    element : Element
        The parent.
    tag : str
        Tag of the child.
    what : str
        The robot's part that it describes, for messages.

    Raises
    ------
    SceneError
        If there is none.
    """
    found = element.first(tag)
    if found is None:
        raise element.at.error(f"<{element.tag}> of {what} has no <{tag}>")
    return found


def name_of(element: Element, what: str, attribute: str = "name") -> str:
    """Give a name that must exist.

    Parameters
    ----------
    element : Element
        The element.
    what : str
        The part that it names, for messages.
    attribute : str
        The attribute that holds it.

    Raises
    ------
    SceneError
        If it is missing, empty or too long.
    """
    found = element.attributes.get(attribute, "").strip()
    if not found:
        raise element.at.error(f'the {what} has no name: write {attribute}="..."')
    if len(found) > _LONGEST_NAME:
        raise element.at.error(f"the name of the {what} has more than {_LONGEST_NAME} characters")
    return found


def number_of(element: Element, name: str, what: str, default: float | None = None) -> float:
    """Give a number, which must exist where there is no default.

    Parameters
    ----------
    element : Element
        The element.
    name : str
        Its attribute.
    what : str
        The robot's part that it describes, for messages.
    default : float, optional
        Value where the attribute is missing.

    Raises
    ------
    SceneError
        If it is missing, or no finite number.
    """
    if name not in element.attributes and default is not None:
        return default
    return _number(element, name, _text(element, name, what).strip(), what)


def vector_of(element: Element, name: str, what: str, default: Vector | None = _ZERO) -> Vector:
    """Give three numbers.

    Parameters
    ----------
    element : Element
        The element.
    name : str
        Its attribute.
    what : str
        The robot's part that it describes, for messages.
    default : tuple of three float or None
        Value where the attribute is missing; None where it must exist.

    Raises
    ------
    SceneError
        If there are not three finite numbers.
    """
    if name not in element.attributes and default is not None:
        return default
    # URDF writes vectors as words in one attribute.
    parts = _text(element, name, what).split()
    if len(parts) != 3:
        raise element.at.error(
            f"{name} of <{element.tag}> of {what} has {len(parts)} parts: give three numbers"
        )
    x, y, z = (_number(element, name, part, what) for part in parts)
    return (x, y, z)


def pose_of(element: Element, what: str) -> Pose:
    """Give the pose in an element's <origin>; without one it is zero."""
    origin = element.first("origin")
    if origin is None:
        return Pose()
    return Pose(vector_of(origin, "xyz", what), vector_of(origin, "rpy", what))


def _text(element: Element, name: str, what: str) -> str:
    text = element.attributes.get(name)
    if text is None:
        raise element.at.error(f'<{element.tag}> of {what} has no {name}="..."')
    return text


def _number(element: Element, name: str, text: str, what: str) -> float:
    where = f"{name} of <{element.tag}> of {what} is"
    if not _NUMBER.match(text):
        hint = ": run xacro on the file first" if "${" in text else ""
        raise element.at.error(f"{where} '{brief(text)}', not a number{hint}")
    value = float(text)
    if not math.isfinite(value) or abs(value) > _LARGEST:
        raise element.at.error(f"{where} {brief(text)}: too large")
    return value
