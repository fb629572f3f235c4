"""The C files of a model as text, and the declarations in them for cffi."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.codegen.c_text import exported
from cotree.codegen.render import render
from cotree.codegen.runtime import ALL, Features, with_runtime
from cotree.quiet import without_collection

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cotree.codegen.context import ModelContext


@without_collection()
def render_model(model: ModelContext, features: Features = ALL) -> Mapping[str, str]:
    """Write the C files of a model.

    Parameters
    ----------
    model : ModelContext
        From :func:`cotree.codegen.context.model_context`.
    features : Features
        What is compiled.

    Returns
    -------
    mapping of str to str
        Text by file name: ``<model>.h``, ``<model>.c``, the headers that these include; and
        ``<model>_vectors.h`` where C does something with several numbers at a time.
    """
    vectors, target = {}, model.target
    if model.uses_vectors:
        vectors[f"{model.prefix}_vectors.h"] = render("c/vectors.h.jinja", target, model=model)
    files = {
        f"{model.prefix}.h": render("c/model.h.jinja", target, model=model),
        f"{model.prefix}.c": render("c/model.c.jinja", target, model=model),
        **vectors,
    }
    return with_runtime(files, target, features=features, has_sources=False)


def cdef(header: str, prefix: str) -> str:
    """Return the declarations that cffi reads, for one model.

    Parameters
    ----------
    header : str
        Text of ``cotree_abi.h``.
    prefix : str
        Prefix of the model's names.
    """
    return f"{declarations([header], ['cotree_model'])}const cotree_model *{prefix}_abi(void);\n"


def declarations(texts: Iterable[str], types: Sequence[str] = ()) -> str:
    """Return the exported functions of headers, and types, for cffi; numbers are doubles.

    Parameters
    ----------
    texts : iterable of str
        Headers, in an order in which each follows those that it includes.
    types : sequence of str
        Names of types besides those that functions have.
    """
    return f"typedef double cotree_real;\n{exported(texts, types)}"
