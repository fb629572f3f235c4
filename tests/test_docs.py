"""The documents hold: their examples run, and their tables are complete."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import subprocess
import tomllib
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

import cotree
from cotree import Scene
from cotree.components import COMPONENTS, OWN, Role
from cotree.scene.checks import EDGE_VARIABLES, ENERGIES, NODE_VARIABLES
from cotree.scene.description import RULES
from cotree.scene.expressions import FUNCTIONS
from cotree.scene.toml_file import read_scene
from cotree.scene.usage_text import usage_of

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SCENES = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")
EVENTS = (ROOT / "docs" / "events.md").read_text(encoding="utf-8")
EXPRESSIONS = (ROOT / "docs" / "expressions.md").read_text(encoding="utf-8")
ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PAGES = ROOT / "docs" / "components"
SITE = ["index.md", "first_steps.md", "tour.md", "solvers.md", "coming_from.md", "theory.md"]
SITE += ["events.md"]
SITE += sorted(f"how_to/{page.name}" for page in (ROOT / "docs" / "how_to").glob("*.md"))
TOUR = (ROOT / "docs" / "tour.md").read_text(encoding="utf-8")
INDEX = (PAGES / "README.md").read_text(encoding="utf-8")
# A copy: tests elsewhere may register types of their own.
BUILT_IN = tuple(row for name, row in COMPONENTS.items() if name in OWN)


def blocks(text, language):
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def page(name):
    return (PAGES / f"{name}.md").read_text(encoding="utf-8")


def run_block(block, source, names):
    """Run an example; numbers in its comments are what the expressions before them give."""
    exec(compile(block, source, "exec"), names)
    for expression, number in re.findall(r"^(\S.*)  # (-?\d+\.\d+) ", block, re.MULTILINE):
        half_a_digit = 0.5 * 10.0 ** -len(number.partition(".")[2])
        assert abs(eval(expression, names) - float(number)) <= half_a_digit, expression


@pytest.fixture
def own_types():
    """Take back what an example registers."""
    with patch.dict(COMPONENTS):
        yield


def test_the_readme_example_runs(tmp_path, monkeypatch):
    """Files go where it runs."""
    monkeypatch.chdir(tmp_path)
    (block,) = blocks(README, "python")
    run_block(block, "README.md", {})
    assert (tmp_path / "slider_pendulum_c" / "main.c").is_file()


def test_the_readme_is_one_screen_whose_links_lead_somewhere():
    assert len(README.splitlines()) < 60
    for target in re.findall(r"\]\(([^)#]+)", README):
        assert (ROOT / target).exists(), target


def test_the_citation_has_what_its_schema_requires():
    """Valid by cffconvert when it was written; this holds what the schema requires to be there."""
    yaml = pytest.importorskip("yaml")
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors", "license"} <= set(cited)
    assert cited["version"] == cotree.__version__
    titles = [row["title"] for row in cited["references"] if row["authors"]]
    assert titles[0] == "Graph-Theoretic Modelling and Sensitivity Analysis of Dynamic Systems"


@pytest.mark.compiler
@pytest.mark.sampled(4)
@pytest.mark.usefixtures("own_types")
@pytest.mark.parametrize("source", SITE)
def test_the_code_of_a_page_runs(source, tmp_path, monkeypatch):
    """Blocks of one page share their names."""
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for block in blocks((ROOT / "docs" / source).read_text(encoding="utf-8"), "python"):
        run_block(block, source, names)


@pytest.mark.compiler
def test_every_stage_prints_what_the_architecture_shows():
    """Lines stand in the output in the order of the page; dots stand for any others."""
    names: dict = {}
    stages = re.findall(r"```python\n(.*?)```\n(?:\n```text\n(.*?)```)?", ARCHITECTURE, re.DOTALL)
    assert len(stages) >= 10
    for code, shown in stages:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(code, "architecture.md", "exec"), names)
        lines = iter(printed.getvalue().splitlines())
        for line in shown.splitlines():
            assert line.strip() == "..." or line in lines, line


def test_the_architecture_names_every_room_in_the_order_of_the_contract():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    (layers, *_) = (
        row["layers"] for row in contracts["tool"]["importlinter"]["contracts"] if "layers" in row
    )
    rooms = [room.strip().removeprefix("cotree.") for row in layers for room in row.split("|")]
    table = ARCHITECTURE.partition("## Packages")[2]
    first = re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE)
    assert [room for cell in first for room in re.findall(r"`(\w+)`", cell)] == rooms


@pytest.mark.parametrize("source", ["architecture", "contributing", "engine", "formulation"])
def test_files_that_a_page_names_exist(source):
    """Paths begin at the repository or the package, those of a file's name alone anywhere there."""
    page = "CONTRIBUTING.md" if source == "contributing" else f"docs/{source}.md"
    named = re.findall(r"`([a-z_./0-9]+)`", (ROOT / page).read_text(encoding="utf-8"))
    modules = {path.name for path in Path(cotree.__file__).parent.rglob("*.py")}
    for path in named:
        if "/" in path:
            assert any((ROOT / above / path).exists() for above in (".", "src/cotree")), path
        elif path.endswith(".py"):
            assert path in modules


def test_the_scene_page_says_the_same_in_toml_and_python():
    from_toml = read_scene(blocks(SCENES, "toml")[0], "pendulum.toml", Scene)
    names: dict = {}
    exec(compile(f"import cotree\n{blocks(SCENES, 'python')[0]}", "scenes.md", "exec"), names)
    from_python = names["scene"]
    states = [scene.compile().states for scene in (from_toml, from_python)]
    assert states[0] == states[1]
    first, second = (scene.compile() for scene in (from_toml, from_python))
    y = first.initial_state + 0.2
    assert (first.rhs(0.3, y) == second.rhs(0.3, y)).all()


def test_the_events_on_the_page_of_events_run():
    names: dict = {}
    exec(compile(blocks(EVENTS, "python")[0], "events.md", "exec"), names)
    result = names["result"]
    times = [np.sqrt(4 / 9.81), 2.6 * np.sqrt(4 / 9.81)]
    np.testing.assert_allclose(result.events["hit"].t, times, atol=1e-9)
    slopes = [0.0, 2 * np.sqrt(4 / 9.81)]
    np.testing.assert_allclose(result.event_sensitivity("hit", "e"), slopes, atol=1e-9)
    (table,) = blocks(EVENTS, "toml")
    head = 'name = "x"\n[parameters]\ne = 0.5\n[edges.b]\ntype = "rigid_body"\nmass = 1.0\n'
    body = 'nodes = ["ground", "B"]\n[edges.j]\ntype = "prismatic"\nnodes = ["ground", "B"]\n'
    scene = read_scene(f"{head}{body}axis = [0, 0, 1]\n{table}", "x.toml", Scene)
    assert scene.compile().states == ("j.s", "j.s_dot", "free")


@pytest.mark.parametrize("component", BUILT_IN, ids=lambda c: c.name)
def test_every_component_has_a_page_with_its_fields(component):
    text = page(component.name)
    for field in component.fields:
        row = re.search(rf"^\| `{field.name}` \| (.*?) \| .*$", text, re.MULTILINE)
        assert row is not None, f"{component.name}.md says nothing of {field.name}"
        # Where the registry leaves a choice of units, the page names the one that it is.
        assert row[1] in (field.unit or "any").split(" or ") or row[1] == field.unit
        given = "required" if field.required else "none"
        given = given if field.default is None else f"{field.default:g}"
        assert f"| {given} |" in row[0]
    for step in component.motion_space:
        for name, _ in (*step.coordinates, *step.rates):
            assert f"`{name}`" in text


@pytest.mark.parametrize("component", BUILT_IN, ids=lambda c: c.name)
def test_every_component_is_in_the_index_and_drawn(component):
    row = re.search(rf"^\| \[`{component.name}`\]\({component.name}\.md\) .*$", INDEX, re.MULTILINE)
    assert row is not None
    spaces = [cell.strip() for cell in row.group().split("|")[3:5]]
    if component.role in (Role.JOINT, Role.ARM):
        assert spaces == [str(component.n_freedoms), str(6 - component.n_freedoms)]
    assert f"components/{component.name}.md" in SCENES
    drawing = ROOT / "docs" / "images" / "components" / f"{component.name}.svg"
    assert drawing.stat().st_size < 30_000


@pytest.mark.parametrize("variable", [*NODE_VARIABLES, *EDGE_VARIABLES, *ENERGIES])
def test_every_name_that_outputs_may_use_is_documented(variable):
    last = "r11" if re.fullmatch(r"r\d\d", variable) else variable
    assert re.search(rf"[`.]{last}`", INDEX)


@pytest.mark.sampled(15)
@pytest.mark.parametrize("component", BUILT_IN, ids=lambda c: c.name)
def test_the_example_of_every_component_shows_its_closed_form(component):
    """An output ``y`` agrees with ``y_exact``, which the scene gives as a function of time."""
    for example in blocks(page(component.name), "toml"):
        check_example(component, read_scene(example, f"{component.name}.toml", Scene))


def check_example(component, scene):
    assert component.name in {edge.component.name for edge in scene.edges.values()}
    model = scene.compile(optimize="-O0")
    assert np.all(np.isfinite(model.start().y))
    result = model.simulate((0, 2), method="dop853", rtol=1e-10, atol=1e-12)
    assert result.success
    known = [name for name in model.outputs if f"{name}_exact" in model.outputs]
    assert known
    for name in known:
        exact = result[f"{name}_exact"]
        # Some tens of steps, each with an error of rtol at most: measured 7e-11 and less.
        assert np.max(np.abs(result[name] - exact)) <= 1e-8 * np.max(np.abs(exact))


ON_JOINTS = [row for row in BUILT_IN if any(e.name == "joint" for e in usage_of(row.name).entries)]


@pytest.mark.parametrize("component", ON_JOINTS, ids=lambda c: c.name)
def test_what_may_sit_on_a_joint_shows_it_on_its_page(component):
    scenes = (tomllib.loads(block) for block in blocks(page(component.name), "toml"))
    edges = [edge for scene in scenes for edge in scene["edges"].values()]
    assert any(edge["type"] == component.name and "joint" in edge for edge in edges)


@pytest.mark.usefixtures("own_types")
def test_the_example_of_an_own_component_runs():
    names: dict = {}
    exec(compile(blocks(INDEX, "python")[0], "components/README.md", "exec"), names)
    final = np.sqrt(0.5 * 9.81 / 0.02)
    exact = -final * np.tanh(9.81 * 3 / final)
    # The default tolerance is 1e-8; a few tens of steps.
    assert abs(names["result"]["speed"][-1] - exact) <= 1e-6 * abs(exact)


def test_the_example_of_an_own_scalar_component_runs():
    names: dict = {}
    try:
        exec(compile(blocks(INDEX, "python")[1], "components/README.md", "exec"), names)
    finally:
        COMPONENTS.pop("tunnel_diode", None)
    # The time constant is that of R and C, 0.05 s; the default tolerance is 1e-8.
    assert abs(names["result"]["C.v"][-1] - 0.5) <= 1e-6


@pytest.fixture
def check_links(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs")
    import check_links

    return check_links


def test_links_of_the_repository_lead_somewhere(check_links):
    assert list(check_links.wrong_links_of_repository(ROOT)) == []


def test_wrong_links_are_found(check_links, tmp_path):
    (tmp_path / "a.html").write_text(
        '<h1 id="here"></h1><a href="#here"></a><a href="b.html#there"></a><a href="#no"></a>'
        '<img src="c.png"><a href="b.html#gone"></a><a href="https://x y"></a>'
        '<a href="https://example.org/x#y"></a><a href="htp://example.org"></a>'
    )
    (tmp_path / "b.html").write_text('<p id="there"></p>')
    (tmp_path / "p.md").write_text("# A `b` c\n[x](#a-b-c) [y](#a-b) [z](gone.md)\n")
    found = [*check_links.wrong_links_of_site(tmp_path)]
    found += check_links.wrong_links_of_repository(tmp_path)
    links = [line.split("'")[1] for line in found]
    wrong = ["#no", "c.png", "b.html#gone", "https://x y", "htp://example.org", "#a-b", "gone.md"]
    assert links == wrong


def test_links_of_the_component_pages_lead_somewhere():
    for file in PAGES.glob("*.md"):
        for target in re.findall(r"\]\(([^)#]+)", file.read_text(encoding="utf-8")):
            assert (PAGES / target).exists(), f"{file.name} links to {target}"


def test_every_function_of_expressions_is_documented():
    for name in FUNCTIONS:
        assert re.search(rf"\b{name}\b", EXPRESSIONS)


def test_operation_counts_of_the_tour_are_those_of_the_model():
    from cotree import load

    operations = load("slider-pendulum").compile(["L"]).operations
    table = "\n".join(line for line in TOUR.splitlines() if line.startswith("| cotree"))
    expected = [
        operations["rhs"].total,
        operations["augmented_rhs"].total,
        operations["rhs"].kernel,
        operations["augmented_rhs"].kernel,
    ]
    assert [int(n) for n in re.findall(r"\| (\d+) ", table)] == expected


@pytest.mark.compiler
def test_the_program_around_a_single_file_runs(tmp_path):
    from cotree import load

    model = load("slider-pendulum").compile(["L"])
    model.write(tmp_path, single_file=True)
    text = blocks((ROOT / "docs" / "c.md").read_text(encoding="utf-8"), "c")[0]
    assert len(text.strip().splitlines()) <= 28
    (tmp_path / "own.c").write_text(text, encoding="utf-8")
    flags = "-std=c99 -O1 -Wall -Wextra -Wpedantic -Werror"
    command = f"cc {flags} -o own own.c slider_pendulum.c -lm"
    subprocess.run(shlex.split(command), cwd=tmp_path, check=True)
    done = subprocess.run(["./own"], cwd=tmp_path, capture_output=True, text=True, check=True)
    found = float(done.stdout.split("d(j1.s)/d(L) = ")[1])
    settings = {"parameters": {"L": 1.1}, "rtol": 1e-10, "atol": 1e-12}
    result = model.simulate((0, 2), method="dop853", **settings)
    # Six digits are printed, and the tolerances leave more.
    assert found == pytest.approx(result.sensitivity("j1.s", "L")[-1], abs=1e-6)


@pytest.mark.compiler
def test_the_c_example_compiles(tmp_path):
    from cotree import load

    load("slider-pendulum").compile().write(tmp_path)
    text = blocks((ROOT / "docs" / "c.md").read_text(encoding="utf-8"), "c")[1]
    include, _, body = text.partition("\n")
    lines = body.strip().splitlines()
    program = "\n".join(
        [include, "#include <stddef.h>", "int main(void)", "{", *lines, "return 0;", "}"]
    )
    (tmp_path / "example.c").write_text(program, encoding="utf-8")
    command = "cc -std=c99 -Wall -c example.c -o example.o"
    done = subprocess.run(
        shlex.split(command), cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_the_page_of_the_linter_lists_every_rule():
    text = (ROOT / "docs" / "how_to" / "lint.md").read_text(encoding="utf-8")
    table = "".join(re.findall(r"^\| (`.*?`) \|", text, re.MULTILINE))
    assert re.findall(r"`([a-z-]+)`", table) == list(RULES)


def test_no_module_is_documented_under_two_roots():
    """The source page of a module links to all its names under the root of the first one."""
    reference = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    homes = {f"cotree.{home}" for home in cotree._HOMES.values()}
    for module, name in re.findall(r"~([\w.]+)\.([A-Z]\w+)\n", reference):
        assert f"cotree.{module}" not in homes, f"export {name} from cotree, too"
