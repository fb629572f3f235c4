"""Commands for those who begin: components, and new scenes."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import cotree
from cotree.cli import main
from cotree.cli.guide import TEMPLATES
from cotree.components import COMPONENTS, OWN
from cotree.scene.toml_file import shipped_scenes


def test_components_are_listed(capsys):
    assert main(["components"]) == 0
    lines = capsys.readouterr().out.splitlines()
    listed = [line.split()[0] for line in lines[1 : 1 + len(COMPONENTS)]]
    assert listed == list(COMPONENTS)
    assert "rotational" in next(line for line in lines if line.startswith("shaft "))


def test_a_component_is_shown_with_fields_and_examples(capsys):
    for name in sorted(OWN):
        assert main(["components", name]) == 0
        text = capsys.readouterr().out
        for field in COMPONENTS[name].fields:
            (row,) = [line for line in text.splitlines() if line.startswith(f"{field.name} ")]
            assert field.doc in row
            assert field.unit in ("1", "") or f" {field.unit} " in row
        in_file, _, in_python = text.partition("in a scene file:")[2].partition("in Python:")
        (table,) = tomllib.loads(in_file)["edges"].values()
        assert table["type"] == name
        assert f"scene.{name}(" in in_python


def test_a_misspelt_component_is_proposed(capsys):
    assert main(["components", "revolut"]) == 2
    assert "there is no component 'revolut'; did you mean 'revolute'?" in capsys.readouterr().err


@pytest.mark.parametrize("template", TEMPLATES)
def test_a_new_scene_loads(template, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine", "--like", template]) == 0
    out = capsys.readouterr().out
    assert "next: cotree run mine.toml --plot mine.svg" in out
    scene, shipped = cotree.load("mine.toml"), cotree.load(TEMPLATES[template])
    assert scene.name == "mine"
    assert scene.edges == shipped.edges
    assert scene.parameters == shipped.parameters
    assert main(["new", template]) == 0
    assert cotree.load(f"{template}.toml").edges == shipped.edges


def test_what_exists_is_never_overwritten(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text("kept", encoding="utf-8")
    assert main(["new", "mine"]) == 2
    assert "'mine.toml' exists already: choose another name" in capsys.readouterr().err
    assert (tmp_path / "mine.toml").read_text(encoding="utf-8") == "kept"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ["new", "arm", "--like", "robo"],
            "--like 'robo' is not a template; did you mean 'robot'?",
        ),
        (["new", "two words"], "scene name 'two words' is not allowed"),
        (["new", "nowhere/arm"], "there is no folder 'nowhere'"),
        (["new"], "name the scene"),
    ],
)
def test_new_scenes_are_refused_in_a_sentence(arguments, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_templates_are_listed(capsys):
    assert main(["new", "--list"]) == 0
    out = capsys.readouterr().out
    for short, scene in TEMPLATES.items():
        assert scene in shipped_scenes()
        assert f"\n{short} " in out


def test_the_resonant_circuit_reaches_its_steady_state():
    result = cotree.load("resonant-circuit").compile(optimize="-O0").simulate((0, 4e-3))
    t, (V, R, L, C) = result.t[-1], (1.0, 10.0, 1e-3, 1e-6)
    # At resonance the current is V/R sin(w t); what the start adds decays as exp(-R t / (2 L)),
    # 2e-9 at the end, and the tolerance of the run is 1e-8.
    w = 1 / np.sqrt(L * C)
    exact = -V / R * np.sqrt(L / C) * np.cos(w * t)
    assert abs(result["out"][-1] - exact) < 1e-6 * V / R * np.sqrt(L / C)


def test_the_tanks_fill_to_the_levels_of_torricelli():
    result = cotree.load("two-tanks").compile(optimize="-O0").simulate((0, 5000))
    second = (2e-3 / (0.6 * 1e-3)) ** 2 / (2 * 9.81)
    first = second + (2e-3 / (0.6 * 8e-4)) ** 2 / (2 * 9.81)
    # The law is smoothed below 1 Pa of more than 5000, which changes it by less than 1e-7.
    assert abs(result["level2"][-1] / second - 1) < 1e-6
    assert abs(result["level1"][-1] / first - 1) < 1e-6


def test_the_thermostat_turns_the_heater_off_when_the_room_is_warm():
    result = cotree.load("heated-room").compile(optimize="-O0").simulate((0, 7200))

    def rates(t, T):
        outdoors = 278.15 - 5 * np.cos(2 * np.pi * t / 86400)
        inner = (T[0] - T[1]) / 0.01
        return [(2000 - inner) / 8e4, (inner - (T[1] - outdoors) / 0.012) / 4e6]

    def warm(t, T):
        return T[0] - 294.15

    warm.terminal = True
    own = solve_ivp(rates, (0, 7200), [291.15, 288.15], events=warm, rtol=1e-10, atol=1e-10)
    # Both integrate to 1e-8 or better; the room warms by 1e-3 K/s or more.
    assert abs(result.events["off"].t[0] - own.t_events[0][0]) < 1e-3
    assert np.all(result["room_C"][result.t > own.t[-1]] < 21 + 1e-6)


def test_the_robot_arm_reaches_its_target():
    result = cotree.load("robot-arm").compile(optimize="-O0").simulate((0, 12))
    # With the weight made up for, nothing but the target balances; the slowest decay, kp/kd, takes
    # 12 s to below 1e-12.
    assert np.allclose(
        [result["shoulder.theta"][-1], result["elbow.theta"][-1]], [0.6, 0.8], atol=1e-7
    )
    x = 0.4 * np.cos(0.6) + 0.3 * np.cos(1.4)
    assert abs(result["hand_x"][-1] - x) < 1e-7
