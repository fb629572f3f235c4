"""The text of a page: what is in it, what is not, and that names cannot act."""

from __future__ import annotations

import base64
import hashlib
import re
import subprocess
import sys
from dataclasses import fields
from typing import TYPE_CHECKING

import pytest
import tomlkit
from page_data import Parts, data_of

from cotree import Scene, load
from cotree.cli import main
from cotree.errors import BuildError, SceneError
from cotree.export.spelling import mathml_of_latex
from cotree.files import template_folder
from cotree.web import export_web
from cotree.web import page as page_module
from cotree.web.page import ModelPageContext

if TYPE_CHECKING:
    from pathlib import Path

HOSTILE = "</script><img src=x onerror=alert(1)>&'\""


@pytest.fixture(autouse=True)
def _without_compilation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not compile: these tests read only the rest of a page."""
    monkeypatch.setattr("cotree.web.wasm.check_zig", lambda: None)
    monkeypatch.setattr(page_module, "check_zig", lambda: None)
    monkeypatch.setattr(page_module, "build_wasm", lambda files: b"")


def hostile_scene(folder: Path) -> Scene:
    """Return a scene whose texts and comments contain markup; its names cannot."""
    scene = Scene("hostile")
    scene.parameter("m", 1.0, doc=HOSTILE)
    scene.parameter("k", 10.0)
    scene.edge("body", "rigid_body", "ground", "A", mass="m")
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], stiffness="k", initial={"s": 0.5})
    scene.save(folder / "hostile.toml")
    with (folder / "hostile.toml").open("a") as file:
        file.write(f"# {HOSTILE}\n")
    return load(folder / "hostile.toml")


def written(scene: Scene, path: Path, sensitivities: tuple[str, ...] = (), **options) -> str:
    return export_web(scene.compile(sensitivities), path, **options).read_text(encoding="utf-8")


@pytest.fixture
def pendulum(tmp_path: Path) -> str:
    return written(load("slider-pendulum"), tmp_path / "page.html", ("L",))


def test_texts_of_a_scene_are_no_markup(tmp_path: Path) -> None:
    text = written(hostile_scene(tmp_path), tmp_path / "page.html", ("k",))
    parts = Parts(text)
    tags = [tag for tag, _ in parts.elements]
    assert tags.count("script") == 2
    assert "img" not in tags
    data = data_of(text)
    assert f"# {HOSTILE}" in data["scene"][-1]
    assert data["parameters"][0]["doc"] == HOSTILE


def test_policy_permits_only_the_script_of_the_page(pendulum: str) -> None:
    parts = Parts(pendulum)
    policy = next(
        attributes["content"]
        for tag, attributes in parts.elements
        if tag == "meta" and attributes.get("http-equiv") == "Content-Security-Policy"
    )
    for name in ("script", "style"):
        digest = hashlib.sha256(parts.texts[name].encode()).digest()
        assert f"'sha256-{base64.b64encode(digest).decode()}'" in policy
    assert policy.startswith("default-src 'none';")
    assert "unsafe-inline" not in policy
    assert "'unsafe-eval'" not in policy


def test_page_refers_to_nothing_outside(pendulum: str) -> None:
    # The only addresses are names of XML languages.
    addresses = set(re.findall(r"[a-z]+://[^\s\"'`]+", pendulum))
    assert addresses <= {"http://www.w3.org/2000/svg"}
    for tag, attributes in Parts(pendulum).elements:
        assert not {"src", "href", "action", "srcset", "onclick"} & attributes.keys(), tag
    assert not re.search(r"\b(fetch|XMLHttpRequest|WebSocket|importScripts|eval)\(", pendulum)


def test_template_uses_its_variables() -> None:
    text = (template_folder() / "html" / "model.html.jinja").read_text()
    assert set(re.findall(r"page\.(\w+)", text)) == {row.name for row in fields(ModelPageContext)}


def test_controls_have_labels(pendulum: str) -> None:
    labelled = set(re.findall(r'<label for="(\w+)"', pendulum))
    for tag, attributes in Parts(pendulum).elements:
        if tag in ("input", "select", "canvas") and "id" in attributes:
            is_within = attributes["id"] == "quantity"  # inside its label
            assert "aria-label" in attributes or attributes["id"] in labelled or is_within


def test_equations_are_mathml(pendulum: str) -> None:
    assert pendulum.count('<math display="block">') == 4  # two governing equations, two for L
    assert "Sensitivity to L" in pendulum
    assert "<mover><mi>s</mi><mo>&#168;</mo></mover>" in pendulum


@pytest.mark.parametrize(
    ("latex", "mathml"),
    [
        ("m_{1}", "<msub><mi>m</mi><mn>1</mn></msub>"),
        (r"\theta", "<mi>θ</mi>"),
        (
            r"\dot{x}_{a<b}",
            "<msub><mover><mi>x</mi><mo>&#729;</mo></mover>"
            "<mrow><mi>a</mi><mo>&lt;</mo><mi>b</mi></mrow></msub>",
        ),
        ("mass", "<mi>mass</mi>"),
    ],
)
def test_names_in_latex_become_mathml(latex: str, mathml: str) -> None:
    assert mathml_of_latex(latex) == mathml


def test_scene_in_the_page_is_the_scene(pendulum: str) -> None:
    data = data_of(pendulum)
    values = {"p": data["parameters"], "x": data["states"]}
    parts = [
        part
        if isinstance(part, str)
        else repr(next(values[kind][i]["value"] for kind, i in part.items()))
        for part in data["scene"]
    ]
    places = [part for part in data["scene"] if not isinstance(part, str)]
    # All eight parameters, and the two stated initial values.
    assert len(places) == 10
    read = tomlkit.parse("".join(parts)).unwrap()
    assert read["parameters"]["L"] == {"value": 1.0, "unit": "m", "doc": "length of the rod"}
    assert read["edges"]["j1"]["initial"] == {"s": 0.5, "s_dot": 1.0}


def test_comments_of_a_scene_cannot_move_its_values(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    text = 'name = "own"\n# value0 "value1"\n[parameters]\nk = { value = 3.0, doc = "value0" }\n'
    text += '[edges.m]\ntype = "rigid_body"\nnodes = ["ground", "A"]\nmass = 1.0\n'
    text += '[edges.j]\ntype = "prismatic"\nnodes = ["ground", "A"]\naxis = [1, 0, 0]\n'
    file.write_text(text + 'stiffness = "k"\n')
    data = data_of(written(load(file), tmp_path / "page.html"))
    assert "".join(p if isinstance(p, str) else "3.0" for p in data["scene"]) == file.read_text()


def test_parameters_of_constants_in_the_program_cannot_change(tmp_path: Path) -> None:
    data = data_of(written(load("bridge-rectifier"), tmp_path / "page.html"))
    assert [row["name"] for row in data["parameters"] if row["held"]] == ["f"]


def test_ranges_of_sliders(tmp_path: Path) -> None:
    ranges = {"L": (0.5, 2.0), "h2.theta": (-3.0, 3.0)}
    data = data_of(written(load("slider-pendulum"), tmp_path / "page.html", ranges=ranges))
    found = {row["name"]: row["range"] for row in (*data["parameters"], *data["states"])}
    assert found["L"] == [0.5, 2.0]
    assert found["h2.theta"] == [-3.0, 3.0]
    assert found["k"] == [0.0, 100.0]


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"x": (0, 1)}, "no parameter or state 'x'"),
        ({"L": (2, 1)}, "give the lower end first"),
        ({"L": (1,)}, "must be a pair of numbers"),
    ],
)
def test_wrong_ranges_are_refused(ranges, message: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=message):
        export_web(load("slider-pendulum").compile(), tmp_path / "page.html", ranges=ranges)


def test_other_suffixes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"\.html"):
        export_web(load("slider-pendulum").compile(), tmp_path / "page.pdf")


def test_missing_zig_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(BuildError, match=r'run `pip install "cotree\[web\]"`$'):
        export_web(load("slider-pendulum").compile(), tmp_path / "page.html")


def test_command_writes_a_page_with_sensitivities(tmp_path: Path) -> None:
    file = tmp_path / "page.html"
    assert main(["export", "slider-pendulum", "--web", str(file), "--range", "L=0.5:2"]) == 0
    data = data_of(file.read_text(encoding="utf-8"))
    # By default to the first parameters, all eight of this scene.
    assert " ".join(row["name"] for row in data["sensitivities"]) == "m1 m2 L r zeta k s0 g"
    assert data["parameters"][2]["range"] == [0.5, 2.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give --output FILE for an FMU, or --web FILE for a page"),
        (["--web", "a.html", "-o", "a.fmu"], "give --output FILE for an FMU"),
        (["--web", "a.html", "--range", "L=2"], "--range L=2 is not of the form NAME=LOW:HIGH"),
    ],
)
def test_wrong_arguments_of_the_command(arguments, message: str, capsys) -> None:
    assert main(["export", "slider-pendulum", *arguments]) == 2
    # Click wraps its messages.
    assert message in " ".join(capsys.readouterr().err.split())


def test_ordinary_runs_import_nothing_of_it() -> None:
    code = (
        "import sys, cotree; cotree.load('slider-pendulum').compile().simulate((0, 1)); "
        "print([name for name in sys.modules if name.startswith('cotree.web')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
