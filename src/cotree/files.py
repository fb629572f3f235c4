"""Files: texts read within bounds, and files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import csv
import io
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

from cotree.errors import CodegenError, SceneError, brief

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from typing import TextIO


def template_folder() -> Path:
    """Find the templates: beside the installed package, or in the source tree."""
    # An installed package holds a copy of the templates; the source tree has them beside ``src``.
    package = Path(__file__).resolve().parent
    for folder in (package / "_templates", package.parents[1] / "templates"):
        if (folder / "c").is_dir():
            return folder
    raise CodegenError(f"the templates are missing from {package}: install cotree again")


def read_text(source: str | Path, largest: int) -> str:
    """Read a text file in UTF-8 of at most ``largest`` bytes; SceneError if it is none."""
    if not os.path.isfile(source):  # unlike Path.is_file, it takes names that are too long
        raise SceneError(f"'{brief(source, 200)}' is not a file: check its path")
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


def is_number(text: str) -> bool:
    """Return whether a cell of a table is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_rows(text: str, where: str) -> list[tuple[int, list[str]]]:
    """Read the rows of a table, with the number of the line that each row ends in.

    Commas, semicolons or tabs separate cells: the most frequent one in the first row. Blank lines,
    and comments that begin with ``#``, are skipped. If commas do not separate cells, they are
    decimal points.
    """
    lines = (line for line in text.splitlines() if line.strip() and line[0] != "#")
    separator = max(",;\t", key=next(lines, "").count)
    reader = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
    rows = []
    try:
        for row in reader:
            if any(item.strip() for item in row) and not row[0].startswith("#"):
                cells = row if separator == "," else [_with_point(item) for item in row]
                rows.append((reader.line_num, cells))
    except csv.Error as error:
        raise SceneError(f"{where} is no table of comma-separated values: {error}") from None
    return rows


def _with_point(cell: str) -> str:
    number = cell.replace(",", ".")
    return number if is_number(number) else cell


def write_rows(file: TextIO, rows: Iterable[Iterable[object]]) -> None:
    """Write rows of comma-separated values.

    Numbers have the fewest digits that read back equal; those that are not a number are empty.
    """
    writer = csv.writer(file, lineterminator="\n")
    writer.writerows(map(_cell, row) for row in rows)


def write_csv(path: str | os.PathLike[str], rows: Iterable[Iterable[object]]) -> None:
    """Write a table as a file, whole or not at all."""
    with written_whole(path) as draft, draft.open("w", newline="", encoding="utf-8") as file:
        write_rows(file, rows)


def _cell(value: object) -> object:
    if not isinstance(value, float):  # NumPy's doubles are floats
        return value
    return "" if math.isnan(value) else repr(float(value))


def check_suffix(path: Path, known: Sequence[str], act: str) -> str:
    """Return the suffix, in small letters, of a file to write; ``act`` begins the message."""
    suffix = path.suffix.lower()
    if suffix not in known:
        raise SceneError(
            f"cannot {act} '{path}': unknown suffix '{path.suffix}'; the known ones are "
            f"{', '.join(known[:-1])} and {known[-1]}"
        )
    return suffix


def check_parent(path: Path) -> None:
    """Refuse a file to write whose folder does not exist."""
    if not path.parent.is_dir():
        raise SceneError(
            f"cannot write '{path}': there is no folder '{path.parent}'; make it first"
        )


def target_path(path: str | os.PathLike[str], what: str = "the file") -> Path:
    """Return the path of what is to be written; SceneError if no file can have that name.

    Such a name holds a NUL, or characters that the system has none for.
    """
    target = Path(path)
    try:
        # The system would raise other errors for these, some only when the file is written.
        is_possible = b"\0" not in os.fsencode(target)
    except UnicodeEncodeError:
        is_possible = False
    if not is_possible:
        raise SceneError(f"cannot write {what} {str(target)!r}: no file has such a name")
    return target


@contextlib.contextmanager
def written_whole(path: str | os.PathLike[str], what: str = "the file") -> Iterator[Path]:
    """Return a draft to write, which takes a file's place once it is complete.

    A reader never sees a file half written, and what fails leaves an older file as it was.
    """
    target = target_path(path, what)
    # In the same folder, since a file takes another one's place at once only within a file system.
    draft = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        yield draft
        os.replace(draft, target)
    except OSError as error:
        raise SceneError(f"cannot write {what} '{target}': {error.strerror or error}") from None
    finally:
        # A draft that has taken the file's place is gone; one of a failed write must not stay.
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)
