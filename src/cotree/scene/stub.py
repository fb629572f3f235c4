"""The stub of the methods of components, for editors and type checkers.

The build writes it beside :mod:`cotree.scene.component_methods`, as ``src/build_hook.py`` says.
"""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from cotree.components import OWN
from cotree.scene.edge import usage_of
from cotree.scene.usage_text import docstring_of

if TYPE_CHECKING:
    from cotree.scene.edge import Entry

_TYPES = {
    "value": "_Value",
    "constant": "_Value",
    "vector": "_Vector",
    "expression": "_Scalar",
    "names": "Sequence[str]",
    "numbers": "Sequence[float] | npt.NDArray[Any]",
    "rotation": "_Rotation",
    "inertia": "_Inertia",
    "nodes": "_Nodes",
    "name": "str",
    "node or nodes": "str | _Nodes",
}

_HEAD = '''\
"""A method of scenes for each component that cotree comes with.

Generated from the table of components when the package is built or installed.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

_Scalar = float | str | np.floating[Any] | np.integer[Any]
_Table = Mapping[str, Any]  # over an expression, or a value with its unit
_Value = _Scalar | _Table
_Vector = Sequence[_Value] | npt.NDArray[Any] | _Table
_Rotation = _Vector | Sequence[Sequence[float]]
_Inertia = _Value | _Vector | Sequence[Sequence[_Value]]
_Nodes = tuple[str, str] | list[str]
_Initial = Mapping[str, _Value | _Rotation]

class ComponentMethod:
    """The method of one component, made when it is first used."""

    type: str
    def __init__(self, type: str) -> None: ...
    def __get__(self, scene: object, owner: object = None) -> Callable[..., None]: ...

class ComponentMethods:
    """Methods that add an edge of each component: ``scene.revolute("h", "D", "B", axis=...)``.

    Fields take numbers in SI, names of parameters, expressions in quotes, and values with a unit,
    ``{"value": 35, "unit": "mm"}``.
    """
'''


def stub_text() -> str:
    """Return the stub of all methods of components."""
    return "\n".join([_HEAD, *map(_method, sorted(OWN))]).rstrip() + "\n"


def _method(name: str) -> str:
    usage = usage_of(name)
    rows = ["self", "name: str", *(f"{node}: str" for node in usage.nodes[: usage.n_needed])]
    rows += [f"{node}: str = ..." for node in usage.nodes[usage.n_needed :]]
    keywords = [_keyword(entry) for entry in usage.entries]
    if usage.initial:
        keywords.append("initial: _Initial | None = None")
    rows.append("/")
    if usage.has_ports:
        rows.append("*nodes: str")
    elif keywords:
        rows.append("*")
    arguments = [f"        {row}," for row in (*rows, *keywords)]
    body = textwrap.indent(f'"""{docstring_of(usage)}\n"""', 8 * " ")
    return "\n".join([f"    def {name}(", *arguments, "    ) -> None:", body, ""])


def _keyword(entry: Entry) -> str:
    kind = _TYPES[entry.takes]
    if entry.required:
        return f"{entry.name}: {kind}"
    if entry.default is None:
        return f"{entry.name}: {kind} | None = None"
    # Formatters write exponents without a plus sign.
    return f"{entry.name}: {kind} = {entry.default!r}".replace("e+", "e")
