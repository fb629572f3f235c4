"""The C text of a model beside its program, and such pairs kept in the cache beside libraries.

Forming equations takes most of the time of a model whose library is in the cache. What is kept is
found by all that it follows from, so that nothing that was kept is ever out of date.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cotree.dag.stored  # noqa: F401 - lets arenas be pickled
from cotree.build.cache import PROGRAM, find_bytes, keep_bytes

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.program import Program


@dataclass(frozen=True)
class ModelText:
    """A program and its C text.

    Attributes
    ----------
    program : Program
        The program after its passes.
    files : mapping of str to str
        C text by file name.
    prefix : str
        Prefix of the names in it.
    n_written, n_written_in_all : int
        Operations of the longest C function, and of all.
    """

    program: Program
    files: Mapping[str, str]
    prefix: str
    n_written: int
    n_written_in_all: int


def find_text(key: str) -> ModelText | None:
    """Give what was kept by a key, or None; a cache that cannot be used counts as empty."""
    found = find_bytes(key, PROGRAM)
    if found is None:
        return None
    # The folder belongs to the user alone, and its libraries are run as they are.
    text = pickle.loads(found)
    assert isinstance(text, ModelText)
    return text


def keep_text(key: str, text: ModelText) -> None:
    """Keep a text by a key, if it can be kept."""
    data = pickled(text)
    if data is not None:
        keep_bytes(data, key, PROGRAM)


def pickled(value: object) -> bytes | None:
    """Pickle a value; None where something in it cannot be."""
    try:
        return pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError, RecursionError):
        # Results of external functions are found by a function of Python, which may be anyone's.
        return None
