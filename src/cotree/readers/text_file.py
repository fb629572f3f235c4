"""Reading of untrusted text files within bounds, with one sentence for each refusal."""

from __future__ import annotations

import os
from pathlib import Path

from cotree.errors import SceneError


def read_text(source: str | Path, largest: int) -> str:
    """Read a text file in UTF-8.

    Parameters
    ----------
    source : str or Path
        Its path.
    largest : int
        Bytes that it may have.

    Raises
    ------
    SceneError
        If it is no file, is too large, cannot be read, or is not a text in UTF-8.
    """
    if not os.path.isfile(source):  # unlike Path.is_file, it takes names that are too long
        raise SceneError(f"'{str(source)[:200]}' is not a file: check its path")
    try:
        with Path(source).open("rb") as file:
            data = file.read(largest + 1)  # whatever its size was said to be
    except OSError as error:
        raise SceneError(f"{source} cannot be read: {error.strerror}") from None
    if len(data) > largest:
        raise SceneError(f"{source} is larger than {largest} bytes")
    try:
        # Some editors begin a file with a byte order mark.
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise SceneError(f"{source}:{line}: not a text in UTF-8") from None
