"""Files that cannot be written, and targets that are no files."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

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


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
def test_pipes_devices_and_links_are_written_and_not_replaced(tmp_path):
    pipe, link = tmp_path / "pipe", tmp_path / "link.csv"
    os.mkfifo(pipe)
    (tmp_path / "real.csv").write_text("old")
    link.symlink_to("real.csv")
    result = cotree.load("slider-pendulum").compile().simulate((0, 0.1), [0, 0.1])
    with ThreadPoolExecutor(1) as pool:
        read = pool.submit(pipe.read_text)
        result.to_csv(pipe)
        text = read.result(10)
    result.to_csv(link)
    assert link.is_symlink()
    assert link.read_text() == text
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert len(text.splitlines()) == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device without space")
@pytest.mark.parametrize("command", [["scenes"], ["equations", "slider-pendulum"]])
def test_an_output_without_space_is_named(command):
    with open("/dev/full", "w") as full:
        ran = subprocess.run(
            [sys.executable, "-m", "cotree", *command],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert ran.returncode == 2
    assert ran.stderr == "cotree: the output cannot be written: No space left on device\n"
