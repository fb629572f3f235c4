"""Settings of runs: one declaration, from which calls, scenes and documentation follow."""

from __future__ import annotations

import inspect
import math
from dataclasses import fields
from typing import get_type_hints

import numpy as np
import pytest

import cotree
from cotree.scene.settings import OF_SCENES, ROWS, SHARED, OtherSettings, SettingsDict


def test_editors_know_every_setting():
    named = set(inspect.signature(cotree.Model.simulate).parameters) - {"self", "settings"}
    # Those that simulate does not name, in their order.
    others = [name for name in ROWS if name not in named]
    assert list(OtherSettings.__annotations__) == others
    assert set(SettingsDict.__annotations__) == {"rtol", "atol", *others}
    assert set(SHARED) == {"method", *SettingsDict.__annotations__}
    kinds = get_type_hints(cotree.Settings, vars(cotree.scene.settings))
    for name, kind in get_type_hints(SettingsDict).items():
        assert set(_parts(kinds[name])) <= {*_parts(kind), int}, name


def _parts(kind):
    return getattr(kind, "__args__", (kind,)) if "|" in str(kind) else (kind,)


def test_documentation_has_every_setting_once():
    for described in (cotree.Settings, cotree.Model.simulate):
        lines = [line.strip() for line in described.__doc__.splitlines()]
        for item in fields(cotree.Settings):
            assert lines.count(f"{item.name} : {item.type}") == 1


def test_settings_are_passed_on():
    tight = cotree.Settings(rtol=1e-11, max_steps=np.int64(7))
    assert dict(**tight)["rtol"] == 1e-11
    model = cotree.load("spring-mass-damper").compile()
    with pytest.warns(RuntimeWarning, match="7 steps"):
        found = model.simulate((0.0, 1.0), **tight)
    assert (found.settings.rtol, found.settings.max_steps) == (1e-11, 7)
    with pytest.raises(KeyError):
        tight["tolerance"]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("t_span", 3.0),
        ("t_span", (1.0, 1.0)),
        ("t_eval", [0.0, 99.0]),
        ("t_eval", [1.0, 0.5]),
        ("t_eval", 0.5),
        ("t_eval", 1),
        ("t_eval", True),
        ("method", 4),
        ("rtol", 2.0),
        ("rtol", True),
        ("atol", 0.0),
        ("inputs", [1.0]),
        ("sensitivities", ["L"]),
        ("throw", 1),
        ("max_step", 0.0),
        ("max_steps", 1.5),
        ("max_events", 0),
        ("time_limit", math.nan),
        ("project", "yes"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(name, value):
    with pytest.raises(
        (cotree.ModelError, cotree.SolveError), match=name.replace("t_span", "span")
    ):
        cotree.Settings(**{name: value})


def test_times_may_be_a_number_of_points():
    assert cotree.Settings((0.0, 2.0), np.int64(5)).t_eval.tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]


def test_none_and_infinity_are_no_budget():
    found = cotree.Settings(
        max_steps=None, max_events=math.inf, time_limit=math.inf, max_step=math.inf
    )
    assert (found.max_steps, found.max_events, found.time_limit) == (None, None, None)
    assert found.max_step == math.inf


def test_scenes_give_settings_of_their_runs(tmp_path):
    scene = cotree.load("spring-mass-damper")
    scene.simulation(t_end=0.5, max_step=0.01, max_steps=100, project=False)
    assert {"t_end", "max_step", "max_steps", "project"} <= set(OF_SCENES)
    assert "parameters" not in OF_SCENES
    scene.save(tmp_path / "own.toml")
    model = cotree.load(tmp_path / "own.toml").compile()
    found = model.simulate().settings
    assert (found.t_span, found.max_step, found.max_steps, found.project) == (
        (0, 0.5),
        0.01,
        100,
        False,
    )
    # A call goes before the scene.
    assert model.simulate(max_steps=200).settings.max_steps == 200


def test_studies_take_every_shared_setting():
    for study in (cotree.Model.ensemble, cotree.fit, cotree.optimise, cotree.bench):
        assert "settings" in inspect.signature(study).parameters
