"""FMUs as importers see them: valid, simulated like the model, compiled from sources, refused."""

from __future__ import annotations

import csv
import io
import math
import shutil
import subprocess
import zipfile

import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from fmu_importer import UNITS, Unit, share, simulated

import cotree
from cotree.errors import BuildError, CodegenError, SceneError

QUICK = ("slider-pendulum", 3)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    made = {}

    def make(name, version=3):
        if (name, version) not in made:
            model = cotree.load(name).compile()
            path = tmp_path_factory.mktemp("fmu") / f"{name}-{version}.fmu"
            model.export_fmu(path, version)
            made[name, version] = model, path
        return made[name, version]

    return make


@pytest.mark.parametrize(("name", "version"), share(UNITS, UNITS[::2], QUICK))
def test_fmpy_finds_no_problems(exported, name, version):
    assert validate_fmu(str(exported(name, version)[1])) == []


@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
@pytest.mark.parametrize(("name", "version"), share(UNITS, UNITS[::2], QUICK))
def test_fmpy_simulates_what_the_model_does(exported, name, version, kind):
    model, path = exported(name, version)
    t_end = model.spec.scene.defaults.t_end
    names = [*model.states, *model.outputs]
    # CVode errs by thousands of its tolerance over many steps, and where that is below 1e-10 it
    # takes more than its 500 steps to the next point in scenes with fast decays.
    is_long = kind == "ModelExchange" and name in ("heated-room", "cart-pole")
    tolerance = 1e-12 if is_long else 1e-10
    found = simulated(path, kind, t_end, t_end / 100, names, tolerance)
    times = np.minimum(np.asarray(found["time"]), t_end)
    wanted = model.simulate((0.0, t_end), np.unique(times), rtol=1e-11, atol=1e-13)
    places = np.searchsorted(wanted.t, times - 1e-9 * t_end)
    for one in names:
        values = np.asarray(wanted[one])[places]
        scale = max(1.0, float(np.max(np.abs(values))))
        assert np.max(np.abs(np.asarray(found[one]) - values)) <= 1e-6 * scale, one


INTEGRATION = ["dopri5", "dopri5_stepper", "history", "integrator", "job"]
STEPS, EXCHANGE = ["CoSimulation"], ["ModelExchange"]


@pytest.mark.parametrize(
    ("name", "kinds", "modules", "absent"),
    [
        ("slider-pendulum", [*STEPS, *EXCHANGE], INTEGRATION, ["cotree_events", "assembly"]),
        ("slider-pendulum", EXCHANGE, [], ["cotree_job", "cotree_events", "assembly"]),
        ("bouncing-ball", STEPS, [*INTEGRATION, "events", "jumps"], ["assembly", "call_with_num"]),
        (
            "motor-linkage",
            EXCHANGE,
            ["assembly", "iteration", "least", "start"],
            ["cotree_job", "cotree_events"],
        ),
    ],
)
def test_sources_have_what_the_model_uses(tmp_path, name, kinds, modules, absent):
    model, path = cotree.load(name).compile(), tmp_path / "x.fmu"
    model.export_fmu(path, kinds=kinds, platforms=[])
    archive = zipfile.ZipFile(path)
    texts = {
        file: archive.read(file).decode()
        for file in archive.namelist()
        if file.startswith("sources/") and file.endswith((".c", ".h"))
    }
    found = {file.split("/")[1][7:-2] for file in texts if "/cotree_" in file and file[-1] == "c"}
    assert found == {*modules, "run", "fmu"}
    assert not any("COTREE_HAS_" in text for text in texts.values())
    assert [word for word in absent if word in texts["sources/cotree_fmu.c"]] == []


STRICT = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wshadow", "-Werror"]


HOW = [("gcc", "-O2"), ("clang", "-O0"), ("clang", "-O2"), ("gcc", "-O0")]
BUILDS = [(*unit, *how) for unit in UNITS for how in HOW]
SLOW_BUILDS = [(*unit, *HOW[i % len(HOW)]) for i, unit in enumerate(UNITS[::2])]


@pytest.mark.parametrize(
    ("name", "version", "compiler", "level"), share(BUILDS, SLOW_BUILDS, (*QUICK, "gcc", "-O2"))
)
def test_sources_compile_without_warnings(exported, tmp_path, name, version, compiler, level):
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    zipfile.ZipFile(exported(name, version)[1]).extractall(tmp_path)
    folder = tmp_path / "sources"
    sources = sorted(file.name for file in folder.glob("*.c"))
    command = [compiler, *STRICT, level, "-fPIC", "-shared", "-o", "unit.so", *sources, "-lm"]
    outcome = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr[:2000]


@pytest.mark.slow
@pytest.mark.parametrize("version", [3, 2])
@pytest.mark.skipif(shutil.which("cmake") is None, reason="cmake is not installed")
def test_fmpy_compiles_the_sources(tmp_path, version):
    from fmpy.build import build_platform_binary

    model = cotree.load("bouncing-ball").compile()
    path = tmp_path / "ball.fmu"
    model.export_fmu(path, version, platforms=[])
    folder = tmp_path / "unit"
    zipfile.ZipFile(path).extractall(folder)
    assert not (folder / "binaries").exists()
    build = tmp_path / "build"
    build.mkdir()
    flags = {"CMAKE_C_FLAGS:STRING": "-Werror"}
    build_platform_binary(folder, build, all_warnings=True, cmake_options=flags)
    own = {2: "linux64", 3: "x86_64-linux"}[version]
    assert (folder / "binaries" / own / "bouncing_ball.so").is_file()


def test_expected_results_and_icon_are_inside(exported):
    model, path = exported("slider-pendulum")
    archive = zipfile.ZipFile(path)
    folder = "extra/org.fmi-standard.fmi-ls-ref"
    text = archive.read(f"{folder}/slider_pendulum_out.csv").decode()
    rows = list(csv.reader(io.StringIO(text)))
    assert rows[0] == ["time", "rod_x"]
    assert float(rows[-1][0]) == 10.0
    result = model.simulate((0.0, 10.0))
    assert float(rows[-1][1]) == pytest.approx(result["rod_x"][-1], abs=1e-6)
    assert archive.read(f"{folder}/fmi-ls-manifest.xml").startswith(b"<?xml")
    assert archive.read("terminalsAndIcons/icon.png").startswith(b"\x89PNG")


def test_missing_expected_results_are_told(tmp_path):
    scene = cotree.Scene("falling")
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0, initial={"v": 1.0})
    scene.edge("F", "force_source", "ground", "A", force="sqrt(0.5 - t)")
    scene.output("speed", "A.v")
    with pytest.warns(RuntimeWarning, match="no expected results, since .* run fails: .*t = 0.5"):
        scene.compile().export_fmu(tmp_path / "x.fmu", platforms=[])
    names = zipfile.ZipFile(tmp_path / "x.fmu").namelist()
    assert not [name for name in names if "ls-ref" in name]


@pytest.mark.parametrize("version", [3, 2])
def test_names_of_parts_are_structured(tmp_path, version):
    part = cotree.Scene("rubbing")
    part.edge("M", "translational_mass", "ground", "A", mass=1.0)
    part.edge("R", "translational_dry_friction", "ground", "A", force=2.0)
    scene = cotree.Scene("outer")
    scene.add("block", part, A="B")
    scene.add("other", part)
    scene.edge("P", "force_source", "ground", "B", force="3*sin(t)")
    path = tmp_path / "x.fmu"
    scene.compile().export_fmu(path, version, platforms=[])
    description = read_model_description(str(path), validate_variable_names=True)
    assert description.variableNamingConvention == "structured"
    names = [variable.name for variable in description.modelVariables]
    assert {"block.M.v", "der(block.M.v)", "other.R.mode", "block.'R stops'.indicator"} <= {*names}


def test_the_same_model_gives_the_same_bytes(exported, tmp_path):
    model, path = exported("slider-pendulum")
    model.export_fmu(tmp_path / "again.fmu")
    assert (tmp_path / "again.fmu").read_bytes() == path.read_bytes()


def test_dependencies_follow_the_patterns(exported):
    _, path = exported("slider-pendulum")
    with Unit(path) as unit:
        rows = {u.variable.name: u for u in unit.description.derivatives}
        names = {v.name for v in rows["der(j1.s)"].dependencies}
        assert names == {"j1.s_dot"}
        names = {v.name for v in rows["der(j1.s_dot)"].dependencies}
        assert {"h2.theta", "L", "k", "s0"} <= names
        units = {u.name: u.baseUnit for u in unit.description.unitDefinitions}
        assert (units["N/m"].kg, units["N/m"].s, units["N/m"].m) == (1, -2, 0)
        assert unit.description.defaultExperiment.stopTime == "10"


def test_co_simulation_gives_sensitivities(tmp_path):
    model = cotree.load("bouncing-ball").compile(["e", "h"])
    path = tmp_path / "ball.fmu"
    model.export_fmu(path, kinds=["CoSimulation"])
    assert validate_fmu(str(path)) == []
    with Unit(path, "CoSimulation") as unit:
        assert "d(height)/d(e)" in unit.list("output")
        unit.initialize(1e-10)
        names = ["d(height)/d(e)", "d(height)/d(h)", "d(j.s_dot)/d(e)"]
        assert unit.get(*names).tolist() == [0.0, 1.0, 0.0]
        for k in range(15):
            unit.step(0.1 * k, 0.1)
        result = model.simulate((0.0, 1.5), rtol=1e-11, atol=1e-13)
        for name, (what, by) in zip(
            names, [("height", "e"), ("height", "h"), ("j.s_dot", "e")], strict=True
        ):
            wanted = result.sensitivity(what, by)[-1]
            assert unit.get(name)[0] == pytest.approx(wanted, rel=1e-7)


@pytest.mark.parametrize("name", ["resonant-circuit", "motor-linkage", "bridge-rectifier"])
@pytest.mark.slow
def test_sensitivities_of_other_scenes(tmp_path, name):
    scene = cotree.load(name)
    wanted = [*scene.parameters][:2]
    model = scene.compile(wanted)
    path = tmp_path / "unit.fmu"
    model.export_fmu(path, kinds=["CoSimulation"])
    t_end = 0.3 * model.spec.scene.defaults.t_end
    with Unit(path, "CoSimulation") as unit:
        unit.initialize(1e-10)
        for k in range(30):
            unit.step(k * t_end / 30, t_end / 30)
        result = model.simulate((0.0, t_end), rtol=1e-10, atol=1e-12)
        for by in wanted:
            for what in model.outputs:
                expected = result.sensitivity(what, by)
                scale = max(1.0, float(np.max(np.abs(expected))))
                found = unit.get(f"d({what})/d({by})")[0]
                assert abs(found - expected[-1]) <= 1e-6 * scale, (what, by)


def test_parameters_change_in_event_and_step_mode(exported):
    model, path = exported("slider-pendulum")
    with Unit(path) as unit:
        unit.initialize()
        unit.set(k=80.0)
        unit.update()
        unit.fmu.enterContinuousTimeMode()
        y = model.start().y
        np.testing.assert_allclose(
            unit.get(*unit.rates), model.rhs(0.0, y, {"k": 80.0}), rtol=1e-14, atol=1e-14
        )
        # CasADi sets parameters in Continuous-Time Mode.
        unit.set(k=50.0)
        np.testing.assert_allclose(unit.get(*unit.rates), model.rhs(0.0, y), rtol=1e-14, atol=1e-14)
    with Unit(path, "CoSimulation") as unit:
        unit.initialize(1e-9)
        unit.step(0.0, 0.5)
        unit.set(k=80.0)
        unit.step(0.5, 0.5)
        first = model.simulate((0.0, 0.5), rtol=1e-10)
        initial = dict(zip(model.states, first.y[:, -1], strict=True))
        rest = model.simulate((0.5, 1.0), rtol=1e-10, parameters={"k": 80.0}, initial=initial)
        np.testing.assert_allclose(unit.get(*model.states), rest.y[:, -1], atol=1e-7)


def test_inputs_are_held_between_points(exported):
    model, path = exported("two-tanks")
    with Unit(path, "CoSimulation") as unit:
        unit.initialize(1e-9)
        unit.step(0.0, 100.0)
        unit.set(opening=0.3)
        unit.step(100.0, 50.0)
        table = ([0.0, 100.0, 100.0000001, 150.0], [1.0, 1.0, 0.3, 0.3])
        wanted = model.simulate((0.0, 150.0), rtol=1e-9, inputs={"opening": table})
        # The table changes within 1e-7 s.
        np.testing.assert_allclose(unit.get(*model.states), wanted.y[:, -1], rtol=1e-7)


def test_inputs_that_are_functions_of_time_may_be_set_from_outside(tmp_path):
    model = cotree.load("heated-room").compile()
    model.export_fmu(tmp_path / "own.fmu")
    model.export_fmu(tmp_path / "outside.fmu", inputs=["outdoors"])
    with Unit(tmp_path / "own.fmu") as unit:
        assert unit.list("input") == []
        unit.initialize()
        assert unit.get("outdoors")[0] == pytest.approx(273.15)
    with Unit(tmp_path / "outside.fmu") as unit:
        assert unit.list("input") == ["outdoors"]
        unit.initialize(values={"outdoors": 280.0})
        assert unit.get("outdoors")[0] == 280.0


def test_doStep_returns_early_at_an_event(exported):
    _, path = exported("bouncing-ball")
    with Unit(path, "CoSimulation", earlyReturnAllowed=True) as unit:
        unit.initialize(1e-12)
        needs_event_mode, terminates, is_early, reached = unit.step(0.0, 1.0)
        assert (needs_event_mode, terminates, is_early) == (False, False, True)
        # The ball falls h = 2 m.
        assert reached == pytest.approx(math.sqrt(2 * 2.0 / 9.81), rel=1e-10)
        assert unit.get("bounces")[0] == 1.0
        assert unit.step(reached, 1.0 - reached)[2] is False
    with Unit(path, "CoSimulation") as unit:
        unit.initialize(1e-12)
        assert unit.step(0.0, 1.0)[3] == 1.0


@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
@pytest.mark.parametrize(
    ("name", "version"),
    [("bouncing-ball", 3), pytest.param("bridge-rectifier", 2, marks=pytest.mark.slow)],
)
def test_a_state_goes_on_bit_by_bit(exported, name, version, kind):
    model, path = exported(name, version)
    t_end = 0.4 * model.spec.scene.defaults.t_end
    names = [*model.states, *model.outputs]

    def go_on(unit, t):
        found = []
        for k in range(5):
            size = t_end / 10
            if kind == "CoSimulation":
                unit.step(t + k * size, size)
            else:
                x = unit.get(*unit.states) + 1e-3 * size * unit.get(*unit.rates)
                unit.go(t + k * 1e-3 * size, x)
            found.append(unit.get(*names))
        return np.array(found)

    with Unit(path, kind) as unit, Unit(path, kind) as other:
        unit.initialize(1e-8)
        if kind == "ModelExchange":
            unit.update()
            unit.fmu.enterContinuousTimeMode()
        go_on(unit, 0.0)
        t = t_end / 2 if kind == "CoSimulation" else 0.0
        state = unit.fmu.getFMUState() if version == 3 else unit.fmu.getFMUstate()
        size = unit.fmu
        data = size.serializeFMUState(state) if version == 3 else size.serializeFMUstate(state)
        first = go_on(unit, t)
        (unit.fmu.setFMUState if version == 3 else unit.fmu.setFMUstate)(state)
        assert np.array_equal(go_on(unit, t), first)
        # In another instance, from bytes.
        own = other.fmu
        copy = own.deserializeFMUState(data) if version == 3 else own.deSerializeFMUstate(data)
        (own.setFMUState if version == 3 else own.setFMUstate)(copy)
        assert np.array_equal(go_on(other, t), first)
        for one, kept in ((unit, state), (other, copy)):
            free = one.fmu.freeFMUState if version == 3 else one.fmu.freeFMUstate
            free(kept)


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"version": 4}, "FMI version 4 is not supported: give version 2 or 3"),
        (
            {"kinds": ["ModelExchang"]},
            "no kind of FMU 'ModelExchang'; did you mean 'ModelExchange'",
        ),
        ({"kinds": []}, "an FMU needs a kind"),
        ({"integrator": "rk4"}, "an FMU cannot have the integrator 'rk4'"),
        ({"platforms": ["linux"]}, "there is no platform 'linux'"),
        ({"version": 2, "platforms": ["aarch64-linux"]}, "FMI 2 has no platform 'aarch64-linux'"),
        ({"inputs": ["push"]}, "the scene has no input 'push'"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(exported, tmp_path, given, why):
    model, _ = exported("slider-pendulum")
    with pytest.raises(CodegenError, match=why):
        model.export_fmu(tmp_path / "x.fmu", **given)
    assert not list(tmp_path.iterdir())


def test_a_file_that_cannot_be_written(exported, tmp_path):
    model, _ = exported("slider-pendulum")
    with pytest.raises(SceneError, match="cannot write the FMU"):
        model.export_fmu(tmp_path / "nowhere" / "x.fmu")
    old = tmp_path / "x.fmu"
    old.write_bytes(b"older")
    with pytest.raises(CodegenError):
        model.export_fmu(old, 5)
    assert old.read_bytes() == b"older"


def test_without_a_compiler(exported, tmp_path, monkeypatch):
    model, _ = exported("slider-pendulum")
    monkeypatch.setenv("COTREE_COMPILER", "none")
    with pytest.raises(BuildError, match="install one, or give platforms"):
        model.export_fmu(tmp_path / "x.fmu")
    assert not list(tmp_path.iterdir())
