"""Contexts into templates: the C files of a model."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from cotree.codegen.printing import wrapped
from cotree.codegen.targets import DOUBLE
from cotree.errors import CodegenError
from cotree.files import template_folder
from cotree.naming import c_comment, c_string

if TYPE_CHECKING:
    import jinja2

    from cotree.codegen.targets import Target

#: Bytes of C text beyond which no compiler is bothered.
LARGEST_FILE = 200_000_000


@cache
def environment(target: Target = DOUBLE, *, is_html: bool = False) -> jinja2.Environment:
    """Return the environment that fills templates; it escapes names and texts in HTML.

    Parameters
    ----------
    target : Target
        The type of numbers. Templates of C write ``{{ real }}`` for the type, ``{{ f }}`` behind
        each literal and each function of ``math.h``, ``{{ DBL }}`` for the beginning of the names
        in ``float.h``, and ask for tolerances and for the ends of the range. With doubles, ``f`` is
        empty and the others are what they are called. Filters write numbers and texts as literals,
        texts as comments, and items on lines of a readable length.
    is_html : bool
        Whether texts are HTML.
    """
    import jinja2

    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(template_folder()),
        # A name that a context lacks is an error, never an empty text in C.
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=is_html,  # untrusted texts in C have been escaped in naming.py
    )
    # In the environment, so that imported macros know them as well.
    made.globals |= {
        "real": target.scalar,
        "f": target.suffix,
        "DBL": target.limits,
        "HUGE_VAL": target.infinity,
        "strtod": target.reader,
        "share": target.share,
        "extreme": target.extreme,
    }
    made.filters |= {
        "constant": target.constant,
        "literal": target.literal,
        "c_string": c_string,
        "c_comment": c_comment,
        "filled": lambda items: wrapped(map(str, items)),
    }
    return made


def render(template: str, target: Target = DOUBLE, **context: object) -> str:
    """Fill one template.

    Parameters
    ----------
    template : str
        Path below the template folder.
    target : Target
        The type of numbers.
    **context
        Typed contexts, see :mod:`cotree.codegen.context`.

    Raises
    ------
    CodegenError
        If the text grows beyond reason, or a coefficient is beyond the range of the type.
    """
    text = environment(target).get_template(template).render(**context)
    if len(text) > LARGEST_FILE:
        raise CodegenError(
            f"the C text has {len(text)} characters: ask for fewer sensitivities or outputs"
        )
    return text
