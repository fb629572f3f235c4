"""Folders of published problems beside the repository, which are not part of it."""

from __future__ import annotations

from pathlib import Path

import pytest

_SHARED = Path(__file__).parents[2] / "shared"


def shared_folder(name: str) -> Path:
    """Return a folder of published problems, or skip the test.

    Parameters
    ----------
    name : str
        Its name in the folder ``shared`` beside the repository.
    """
    folder = _SHARED / name
    if not folder.is_dir():
        pytest.skip(f"the published problems of {folder} are not there", allow_module_level=True)
    return folder
