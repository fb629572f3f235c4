"""The HTML file: what is in it, what is not, and that its viewer puts things where they are."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shutil
import subprocess
from dataclasses import fields, replace
from pathlib import Path

import jinja2
import jointed_scenes
import numpy as np
import pytest
from jinja2 import meta
from page_data import Parts, data_of
from scipy.spatial.transform import Rotation

from cotree import load
from cotree.watch.animation import PageContext, page, page_data
from cotree.watch.drawing import Label

TEMPLATES = Path(__file__).parents[2] / "templates" / "html"
HOSTILE = "</script><img src=x onerror=alert(1)>&\u2028'\""


@pytest.fixture(scope="module")
def plane():
    return load("slider-pendulum").compile().simulate((0, 3)).animate()


@pytest.fixture(scope="module")
def space():
    scene = jointed_scenes.spatial_chain("distance")
    model = scene.compile(tree=jointed_scenes.CHAIN_TREE, optimize="-O0")
    return model.simulate((0, 2)).animate()


def summed(rows, n):
    return np.cumsum(np.reshape(rows, (-1, n)), axis=0)


def test_nothing_is_fetched_and_nothing_else_runs(plane):
    parts = Parts(plane.html)
    assert "http:" not in plane.html
    assert "https:" not in plane.html
    for tag, attributes in parts.elements:
        assert tag not in ("link", "img", "iframe", "object", "embed", "base", "form")
        assert not [name for name in attributes if name in ("src", "href", "style")]
        assert not [name for name in attributes if name.startswith("on")]
    (policy,) = [a["content"] for _, a in parts.elements if "http-equiv" in a]
    assert policy.startswith("default-src 'none'; ")
    for name in ("script", "style"):
        digest = hashlib.sha256(parts.texts[name].encode()).digest()
        assert f"{name}-src 'sha256-{base64.b64encode(digest).decode()}'" in policy


@pytest.mark.parametrize("which", ["plane", "space"])
def test_the_data_say_where_everything_is(which, request):
    drawing = request.getfixturevalue(which).drawing
    data = data_of(page(drawing))
    assert data["frames"] == len(drawing.frames.times)
    assert data["flat"] == (which == "plane")
    used = sorted({s.track for s in drawing.solids} | {t for s in drawing.struts for t in s.tracks})
    assert len(data["tracks"]) == len(used)
    for track, row in zip(used, data["tracks"], strict=True):
        p, q = summed(row["p"], 3) * data["unit"], summed(row["q"], 4) * data["turn"]
        # Half a unit, which is a 50,000th of the size; quaternions of half a 50,000th likewise.
        gap = np.abs(p - drawing.poses.positions[track]).max()
        assert gap <= 0.51 * data["unit"]
        turned = Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix()
        np.testing.assert_allclose(
            np.broadcast_to(turned, drawing.poses.axes[track].shape),
            drawing.poses.axes[track],
            atol=1e-4,
        )
        assert len(q) == 1 or np.linalg.norm(np.diff(q, axis=0), axis=1).max() < 1.0
    for solid, row in zip(drawing.solids, data["solids"], strict=True):
        mesh = row["mesh"]
        u = np.frombuffer(base64.b64decode(mesh["points"]), "<u2").reshape(-1, 3)
        points = np.array(mesh["low"]) + np.array(mesh["span"]) * u / 65535
        # Half a 65,535th of each side, from a corner that is given with six digits.
        assert np.abs(points - solid.mesh.points).max() <= 2e-5 * np.abs(solid.mesh.points).max()
        faces = np.frombuffer(base64.b64decode(mesh["faces"]), "<u2").reshape(-1, 3)
        np.testing.assert_array_equal(faces, solid.mesh.faces)


def test_hostile_names_stay_text(plane):
    drawing = plane.drawing
    labels = (Label(HOSTILE, 1, np.zeros(3)),)
    solids = tuple(replace(solid, name=HOSTILE) for solid in drawing.solids)
    drawing = replace(drawing, title=HOSTILE, note=HOSTILE, labels=labels, solids=solids)
    text = page(drawing)
    parts = Parts(text)
    assert [tag for tag, _ in parts.elements].count("script") == 2
    assert "img" not in [tag for tag, _ in parts.elements]
    assert parts.texts["title"] == HOSTILE
    assert data_of(text)["labels"][0]["text"] == HOSTILE


def test_same_run_gives_the_same_page():
    pages = [load("slider-pendulum").compile().simulate((0, 1)).animate().html for _ in range(2)]
    assert pages[0] == pages[1]


def test_page_stays_small(plane, space):
    assert len(plane.html) < 80_000
    assert len(space.html) < 200_000


def test_notebook_shows_the_page_shut_off(plane):
    (element,) = Parts(plane._repr_html_()).elements
    assert element[0] == "iframe"
    assert element[1]["sandbox"] == "allow-scripts"
    assert element[1]["srcdoc"] == plane.html


def test_template_uses_the_fields_of_its_context():
    text = (TEMPLATES / "page.html.jinja").read_text()
    tree = jinja2.Environment().parse(text)
    assert meta.find_undeclared_variables(tree) == {"page"}
    assert set(re.findall(r"page\.(\w+)", text)) == {row.name for row in fields(PageContext)}


# A page without a browser: elements that take anything, and a canvas that keeps the matrices.
STUB = """
const fs = require("fs"), vm = require("vm");
const [script, data, at] = process.argv.slice(2);
const seen = [], elements = {}, waiting = [], listeners = {};
const gl = new Proxy({}, { get: (_, name) => {
  if (name === "getUniformLocation") return (_, what) => what;
  if (name === "getAttribLocation") return () => 0;
  if (name === "uniformMatrix4fv") return (where, _, m) => seen.push([where, Array.from(m)]);
  return () => ({});
} });
const make = (id) => ({ id, style: {}, textContent: "", value: "0", options: [1], selectedIndex: 0,
  clientWidth: 640, clientHeight: 480, classList: { add() {}, toggle() {} }, setAttribute() {},
  replaceChildren() {}, getContext: () => gl, focus() {},
  addEventListener(kind, f) { listeners[id + " " + kind] = f; } });
const document = {
  getElementById: (id) => (elements[id] ??= make(id)), createElement: () => make("span"),
  addEventListener() {},
};
elements.data = { textContent: fs.readFileSync(data, "utf8") };
const window = { devicePixelRatio: 1, addEventListener() {},
  matchMedia: () => ({ matches: true }) };
const context = { document, window, performance: { now: () => 0 }, atob, console,
  requestAnimationFrame: (f) => waiting.push(f) };
vm.runInNewContext(fs.readFileSync(script, "utf8"), context);
while (waiting.length) waiting.shift()(0);
seen.length = 0;
elements.slider.value = at;
listeners["slider input"]();
while (waiting.length) waiting.shift()(0);
console.log(JSON.stringify({ seen, time: elements.time.textContent }));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
@pytest.mark.parametrize("which", ["plane", "space"])
def test_viewer_puts_bodies_where_they_are(which, request, tmp_path):
    drawing = request.getfixturevalue(which).drawing
    data = page_data(drawing)
    (tmp_path / "stub.js").write_text(STUB)
    script = [(TEMPLATES / name).read_text() for name in ("viewer.js", "animation.js")]
    (tmp_path / "script.js").write_text("".join(script))
    (tmp_path / "data.json").write_text(json.dumps(data))
    frame = len(drawing.frames.times) // 2
    files = [tmp_path / name for name in ("stub.js", "script.js", "data.json")]
    done = subprocess.run(
        ["node", *map(str, files), str(frame)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    matrices = [np.reshape(m, (4, 4)).T for where, m in found["seen"] if where == "body"]
    (view,) = [np.reshape(m, (4, 4)).T for where, m in found["seen"] if where == "view"]
    used = sorted({s.track for s in drawing.solids} | {t for s in drawing.struts for t in s.tracks})
    n = len(used)
    size = np.abs(drawing.poses.positions).max()
    for track, matrix in zip(used, matrices[1 : 1 + n], strict=True):  # the first is the floor's
        np.testing.assert_allclose(matrix[:3, :3], drawing.poses.axes[track, frame], atol=1e-4)
        gap = matrix[:3, 3] - drawing.poses.positions[track, frame]
        assert np.abs(gap).max() < 1e-4 * size
        # All is within the picture.
        seen = view @ np.append(drawing.poses.positions[track, frame], 1.0)
        assert np.abs(seen[:3] / seen[3]).max() < 1.0
    for strut, matrix in zip(drawing.struts, matrices[1 + n :], strict=True):
        ends = [
            drawing.poses.positions[t, frame] + drawing.poses.axes[t, frame] @ local
            for t, local in zip(strut.tracks, strut.ends, strict=True)
        ]
        np.testing.assert_allclose(matrix[:3, 3], ends[0], atol=1e-4 * size)
        np.testing.assert_allclose(matrix[:3, 3] + matrix[:3, 2], ends[1], atol=2e-4 * size)
        assert np.linalg.det(matrix[:3, :3]) > 0.0
    time = f"{drawing.frames.times[frame]:.2f} / {drawing.frames.times[-1]:.2f} s"
    assert found["time"] == time
