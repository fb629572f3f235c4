"""Reading of text files of limited size, and writing of files completely or not at all."""

from __future__ import annotations

import contextlib
import csv
import io
import math
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from cotree.errors import CodegenError, SceneError, brief

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from typing import TextIO


def template_folder() -> Path:
    """Return the template folder, of the installed package or of the source tree."""
    # An installed package contains the templates; in the source tree they are next to ``src``.
    package = Path(__file__).resolve().parent
    for folder in (package / "_templates", package.parents[1] / "templates"):
        if (folder / "c").is_dir():
            return folder
    raise CodegenError(f"the templates are missing from {package}: install cotree again")


def included(line: str) -> str | None:
    """Return the header that a line includes in quotes, or None."""
    begin = '#include "'
    return line.rstrip()[len(begin) : -1] if line.startswith(begin) else None


def includes(text: str) -> list[str]:
    """Return the headers that a text includes in quotes."""
    return [name for name in map(included, text.splitlines()) if name is not None]


def read_text(source: str | Path, largest: int) -> str:
    """Read a UTF-8 text file; raise SceneError if that fails or it has over ``largest`` bytes."""
    if not os.path.isfile(source):  # Path.is_file would raise an error for a name that is too long
        raise SceneError(f"'{brief(source, 200)}' is not a file: check its path")
    try:
        with Path(source).open("rb") as file:
            data = file.read(largest + 1)  # the size that the system reports may be wrong
    except OSError as error:
        raise SceneError(f"{source} cannot be read: {error.strerror}") from None
    if len(data) > largest:
        raise SceneError(f"{source} is larger than {largest} bytes")
    try:
        # Some editors write a byte order mark.
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise SceneError(f"{source}:{line}: not a text in UTF-8") from None


def number_or_text(text: float | str) -> float | str:
    """Convert a text to a number if it is one, otherwise return it unchanged."""
    try:
        return float(text)
    except ValueError:
        return text


def is_number(text: str) -> bool:
    """Return whether the text of a table cell is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_rows(text: str, where: str) -> list[tuple[int, list[str]]]:
    """Read a table; return its rows, each after the number of its last line.

    Cells are separated by commas, semicolons or tabs, whichever is most frequent in the first row.
    Blank lines and comments that begin with ``#`` are skipped. If another character separates
    cells, commas are decimal points.
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
    """Write comma-separated rows: nan is an empty cell; numbers read back unchanged."""
    writer = csv.writer(file, lineterminator="\n")
    writer.writerows(map(_cell, row) for row in rows)


def write_csv(path: str | os.PathLike[str], rows: Iterable[Iterable[object]]) -> None:
    """Write a table to a file, completely or not at all."""
    with atomic_write(path) as draft, draft.open("w", newline="", encoding="utf-8") as file:
        write_rows(file, rows)


def _cell(value: object) -> object:
    if not isinstance(value, float):  # numpy.float64 is a subclass of float
        return value
    return "" if math.isnan(value) else repr(float(value))


def check_suffix(path: Path, known: Sequence[str], act: str) -> str:
    """Return a file's lower-case suffix; raise SceneError if it is not ``known``."""
    suffix = path.suffix.lower()
    if suffix not in known:
        raise SceneError(
            f"cannot {act} '{path}': unknown suffix '{path.suffix}'; the known ones are "
            f"{', '.join(known[:-1])} and {known[-1]}"
        )
    return suffix


def check_parent(path: Path) -> None:
    """Raise an error if the folder of an output file does not exist."""
    if not path.parent.is_dir():
        raise SceneError(
            f"cannot write '{path}': there is no folder '{path.parent}'; make it first"
        )


def target_path(path: str | os.PathLike[str], what: str = "the file") -> Path:
    """Return the path of an output file; raise SceneError for a name that no file can have."""
    target = Path(path)
    try:
        # For such names, the system would raise other errors, some only on writing.
        is_possible = b"\0" not in os.fsencode(target)
    except UnicodeEncodeError:
        is_possible = False
    if not is_possible:
        raise SceneError(f"cannot write {what} {str(target)!r}: no file has such a name")
    return target


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str], what: str = "the file") -> Iterator[Path]:
    """Return a temporary file that replaces a file once it is complete.

    After an error the old file is unchanged. Devices, pipes and links are written to directly.
    """
    target = target_path(path, what)
    is_other = target.is_symlink() or (target.exists() and not target.is_file())
    # Files can only be replaced atomically within a file system, so use the same folder.
    folder = Path(tempfile.gettempdir()) if is_other else target.parent
    draft = folder / f".{target.name}.{os.getpid()}.tmp"
    try:
        yield draft
        if is_other:
            target.write_bytes(draft.read_bytes())
        else:
            os.replace(draft, target)
    except OSError as error:
        raise SceneError(f"cannot write {what} '{target}': {error.strerror or error}") from None
    finally:
        # The temporary file has been renamed after success; remove it after an error.
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)
