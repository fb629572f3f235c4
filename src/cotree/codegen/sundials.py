"""SUNDIALS for C without its headers: libraries, the functions called of them, and their version.

CVODES and IDAS are CVODE and IDA with sensitivities, which have vectors of their own. The functions
stand in ``templates/runtime/sundials/cotree_sundials.h``, a conditional part for each library.
"""

from __future__ import annotations

import re
from functools import cache
from typing import TYPE_CHECKING

from cotree.codegen.runtime import header_text, resolve, source_texts

if TYPE_CHECKING:
    from collections.abc import Mapping

#: Major and minor version whose structures ``cotree_sundials.c`` fills.
SUNDIALS_VERSION = (7, 9)

#: Libraries with sensitivities, and their counterparts without, whose names functions have.
WITH_SENSITIVITIES: Mapping[str, str] = {"cvodes": "cvode", "idas": "ida"}

#: Libraries by name.
SUNDIALS = ("cvode", "ida", "cvodes", "idas")

#: Returns the version, before anything else is called.
VERSION_FUNCTION: Mapping[str, tuple[str, str]] = {
    "SUNDIALSGetVersionNumber": (
        "int",
        "int *major, int *minor, int *patch, char *label, int length",
    ),
}

_HEADER = "cotree_sundials.h"
_FUNCTION = re.compile(r"^    (\w+ \*?)\(\*(\w+)\)\(([^)]*)\);", re.MULTILINE)


def sundials_files(library: str) -> dict[str, str]:
    """Write the stepper that calls a library, by name of the file.

    Parameters
    ----------
    library : str
        A name in ``SUNDIALS``.
    """
    is_ida = "ida" in library
    has_sensitivities = library in WITH_SENSITIVITIES
    known = {
        "COTREE_IDA": is_ida,
        "COTREE_SENSITIVITIES": has_sensitivities,
        "COTREE_SIMULTANEOUS": has_sensitivities and not is_ida,
    }
    texts = {_HEADER: header_text(_HEADER), **source_texts(_HEADER)}
    return {name: resolve(text, known) for name, text in texts.items()}


@cache
def sundials_functions(library: str) -> dict[str, tuple[str, str]]:
    """Return result and arguments of each function that is called of a library, by name."""
    text = sundials_files(library)[_HEADER]
    rows = _FUNCTION.findall(text[text.index("typedef struct cotree_sundials {") :])
    return {name: (result.strip(), " ".join(arguments.split())) for result, name, arguments in rows}
