"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING

from cotree.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextlib.contextmanager
def written_whole(path: str | os.PathLike[str], what: str = "the file") -> Iterator[Path]:
    """Give a draft to write, which takes a file's place once it is complete.

    A reader never sees a file half written, and what fails leaves an older file as it was.

    Parameters
    ----------
    path : path
        The file.
    what : str
        What it is, for messages.

    Raises
    ------
    SceneError
        If it cannot be written.
    """
    target = Path(path)
    if "\0" in str(target):
        raise SceneError(f"cannot write {what} {str(target)!r}: no file has such a name")
    draft = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        yield draft
        os.replace(draft, target)
    except OSError as error:
        raise SceneError(f"cannot write {what} '{target}': {error.strerror or error}") from None
    finally:
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)
