"""Files of animations: GIFs, suffixes, the command line, copies of results."""

from __future__ import annotations

import copy
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cotree import Scene, load
from cotree.cli import main
from cotree.errors import SceneError
from cotree.watch.picture import Painter


@pytest.fixture(scope="module")
def model():
    return load("slider-pendulum").compile()


@pytest.fixture(scope="module")
def animation(model):
    return model.simulate((0, 2)).animate()


def test_gif_has_the_frames_and_the_size_that_were_asked_for(animation, tmp_path):
    file = tmp_path / "a.gif"
    animation.save(file, width=160, height=120, max_frames=20)
    with Image.open(file) as image:
        assert image.size == (160, 120)
        assert image.n_frames == 17  # of 51 every third
        assert image.info["duration"] == 120
        assert image.info["loop"] == 0
    assert list(tmp_path.iterdir()) == [file]
    first = file.read_bytes()
    animation.save(file, width=160, height=120, max_frames=20)
    assert file.read_bytes() == first


def test_picture_shows_a_body_where_it_is(animation):
    """The rod is orange: the middle of its pixels is the middle of the rod."""
    painter = Painter(animation.drawing, 320, None)
    drawing = animation.drawing
    for frame in (0, 30):
        pixels = np.asarray(painter.paint(frame)).astype(int)
        # Where red is far above blue; the rod's own colour, lit from in front.
        rows, columns = np.nonzero(pixels[:, :, 0] - pixels[:, :, 2] > 90)
        (bar,) = [solid for solid in drawing.solids if solid.name == "r4"]
        axes, at = drawing.poses.axes[bar.track, frame], drawing.poses.positions[bar.track, frame]
        middle = axes @ bar.mesh.points.mean(axis=0) + at
        place = painter.camera.project(middle[None], frame)[0][0]
        expected = (place * [1, -1] + 1) * 0.5 * np.array(painter.size)
        # The pins at its ends cover an unequal part of it, a few of some hundred pixels.
        assert abs(columns.mean() - expected[0]) < 4
        assert abs(rows.mean() - expected[1]) < 8


def test_frames_are_pictures(animation):
    assert animation.frame(-1, width=100).width == 100
    with pytest.raises(SceneError, match="no frame 51"):
        animation.frame(51)
    assert "51 frames" in repr(animation)


@pytest.mark.parametrize(
    ("settings", "told"),
    [({"width": 1}, "width"), ({"height": 1e9}, "height"), ({"max_frames": 0}, "max_frames")],
)
def test_sizes_without_sense_are_refused(animation, tmp_path, settings, told):
    with pytest.raises(SceneError, match=told):
        animation.save(tmp_path / "a.gif", **settings)


def test_unknown_suffix_and_folder_are_told(animation, tmp_path):
    with pytest.raises(SceneError, match=r"'\.mp4'; the known ones are \.gif and \.html"):
        animation.save(tmp_path / "a.mp4")
    with pytest.raises(SceneError, match="cannot write the animation"):
        animation.save(tmp_path / "no" / "a.html")
    assert not list(tmp_path.iterdir())


def test_older_file_stays_where_writing_fails(animation, tmp_path, monkeypatch):
    file = tmp_path / "a.html"
    file.write_text("old")

    def refuse(self, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", refuse)
    with pytest.raises(SceneError, match="No space left"):
        animation.save(file)
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda r: pickle.loads(pickle.dumps(r))]
)
def test_copies_of_results_leave_the_model_behind(model, copied):
    result = model.simulate((0, 0.5), parameters={"L": 2.0})
    other = copied(result)
    np.testing.assert_array_equal(other.y, result.y)
    assert other.parameter_values["L"] == 2.0
    assert other.model is None
    with pytest.raises(SceneError, match=r"animate\(model="):
        other.animate()
    assert other.animate(model=model).html == result.animate().html


def test_model_of_another_scene_is_refused(model):
    result = load("spring-mass-damper").compile().simulate((0, 0.1))
    with pytest.raises(SceneError, match="states of this model differ"):
        result.animate(model=model)


def test_circuits_are_told_to_have_nothing_to_watch(tmp_path, capsys):
    result = load("battery-cell").compile().simulate((0, 1.0))
    with pytest.raises(SceneError, match="no bodies or joints"):
        result.animate()
    # The command draws curves instead, which any circuit has.
    for name, begin in (("a.gif", b"GIF8"), ("a.html", b"<!DOCTYPE html>")):
        assert main(["run", "battery-cell", "--animate", str(tmp_path / name)]) == 0
        assert (tmp_path / name).read_bytes().startswith(begin)
        assert f"{name}: nothing moves in space here" in capsys.readouterr().out


@pytest.mark.slow
def test_the_example_of_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (Path(__file__).parents[2] / "docs" / "watching.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(compile(block, "watching.md", "exec"), {})
    assert {file.name for file in tmp_path.iterdir()} == {
        "pendulum.html",
        "pendulum.gif",
        "end.png",
    }


@pytest.mark.slow
def test_command_writes_both_kinds(tmp_path, capsys):
    page = tmp_path / "a.html"
    assert main(["run", "slider-pendulum", "--t-end", "2", "--animate", str(page)]) == 0
    assert f"wrote {page}" in capsys.readouterr().out
    assert page.read_text().startswith("<!doctype html>")
    picture = tmp_path / "b.gif"
    assert main(["run", "slider-pendulum", "--t-end", "2", "--animate", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"GIF89a")


@pytest.mark.parametrize("name", ["a.avi", "missing/a.gif", "."])
def test_command_refuses_files_before_the_work(tmp_path, capsys, monkeypatch, name):
    monkeypatch.setattr("cotree.api.Scene.compile", None)
    assert main(["run", "slider-pendulum", "--animate", str(tmp_path / name)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_view_turns_a_plane_into_space(model):
    drawing = model.simulate((0, 1)).animate(view=(30, 45)).drawing
    assert not drawing.is_flat
    assert drawing.towards @ drawing.up == pytest.approx(np.sin(np.pi / 4))
    assert len(drawing.floor()) > 0


def test_what_flies_far_is_followed():
    scene = Scene("shot", gravity=[0, "-9.81", 0])
    scene.edge("p", "planar", "ground", "A", normal=[0, 0, 1], initial={"x_dot": 100.0})
    scene.edge("rod", "arm", "A", "B", vector=[0.2, 0, 0])
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0, inertia=0.01)
    animation = scene.compile(optimize="-O0").simulate((0, 3)).animate()
    painter = Painter(animation.drawing, 100, None)
    n = len(animation.drawing.frames.times)
    way = painter.camera.centres[n - 1] - painter.camera.centres[0]
    np.testing.assert_allclose(way[:2], [300, -0.5 * 9.81 * 9], atol=0.1)
    assert painter.camera.half[0] < 1.0
    assert 0 < len(animation.drawing.floor()) < 1000  # a grid behind it
    space = scene.compile(optimize="-O0").simulate((0, 3)).animate(view=(20, 20)).drawing
    dashes = space.floor()
    assert 100 < len(dashes) <= 300
    # Along its way, from where it began to where it got.
    np.testing.assert_allclose(dashes[-1, 1] - dashes[0, 0], way, atol=0.2)


def test_scene_whose_nodes_are_one_point_has_a_size():
    scene = Scene("point")
    scene.edge("f", "free", "ground", "A")
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0, inertia=[1e-3, 1e-3, 1e-3])
    animation = scene.compile(optimize="-O0").simulate((0, 1)).animate()
    pixels = np.asarray(animation.frame(0, width=100))
    assert 50 < np.count_nonzero(pixels.min(axis=2) < 130) < 9000
