"""Names that no file can have are refused by everything that writes, before anything is written."""

from __future__ import annotations

import pytest

import cotree
from cotree.errors import Error


@pytest.mark.parametrize("name", ["a\0", "\ud800"])
def test_names_that_no_file_can_have(name, tmp_path):
    scene = cotree.load("slider-pendulum")
    model = scene.compile()
    result = model.simulate((0.0, 0.1))
    for write, suffix in (
        (model.write, ""),
        (scene.save, ".toml"),
        (scene.graph().save, ".svg"),
        (result.to_csv, ".csv"),
        (result.animate().save, ".html"),
    ):
        with pytest.raises(Error, match="no file has such a name"):
            write(str(tmp_path / (name + suffix)))
    assert not list(tmp_path.iterdir())
