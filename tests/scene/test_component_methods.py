"""Every component is a method of scenes, which says the same as the generic call."""

from __future__ import annotations

import inspect
from importlib import import_module
from unittest.mock import patch

import numpy as np
import pytest

import cotree
from cotree import Scene, SceneError
from cotree.components import COMPONENTS, FAMILIES, OWN
from cotree.scene.component_methods import ComponentMethods
from cotree.scene.description import SceneDescription
from cotree.scene.usage_text import edge_call, examples, usage_of


def added(name, statement):
    """Add an edge by the generic call."""
    scene = Scene("generic")
    rest = {key: item for key, item in statement.items() if key not in ("type", "nodes")}
    scene.edge(name, statement["type"], *statement.get("nodes", ()), **rest)
    return scene


def test_every_method_says_the_same_as_the_generic_call():
    for type in sorted(OWN):
        name, statement = examples()[type]
        scene = Scene("method")
        exec(edge_call(name, statement), {"scene": scene})
        assert scene.edges == added(name, statement).edges


def test_signatures_and_docstrings_follow_from_the_table():
    for type in sorted(OWN):
        method = getattr(Scene, type)
        parameters = inspect.signature(method).parameters
        for field in COMPONENTS[type].fields:
            own = parameters[field.name]
            assert own.kind is inspect.Parameter.KEYWORD_ONLY
            assert own.default is (inspect.Parameter.empty if field.required else own.default)
            assert field.required or own.default == field.default
            assert f"\n{field.name} : " in inspect.getdoc(method)
    assert (
        str(inspect.signature(Scene("s").arm))
        == "(name, first, second, /, *, vector, rotation=None)"
    )


def test_no_component_hides_a_method_of_scenes():
    hidden = set(dir(SceneDescription)) | (vars(Scene).keys() - {"__doc__", "__module__"})
    assert not OWN & hidden
    assert set(vars(ComponentMethods)) >= OWN


def test_a_scene_may_be_written_with_methods_alone():
    scene = Scene("pendulum", gravity=[0, -9.81, 0])
    scene.revolute("h", "ground", "A", axis=np.array([0, 0, 1]), initial={"theta": 0.1})
    scene.arm("rod", "A", "B", vector=[0, "-2.0", 0])
    scene.rigid_body("bob", "ground", "B", mass=np.float64(1.0))
    model = scene.compile(optimize="-O0")
    # Half a small swing takes pi sqrt(L/g) (1 + 0.1**2 / 16 + ...), 1.419 s; at it the angle is
    # -0.1 less what the series of the period leaves, 1e-7 or so.
    half = np.pi * np.sqrt(2.0 / 9.81) * (1 + 0.1**2 / 16 + 11 * 0.1**4 / 3072)
    result = model.simulate((0, half), rtol=1e-10, atol=1e-12)
    assert abs(result["h.theta"][-1] + 0.1) < 1e-6


def test_none_leaves_a_field_out():
    scene, wanted = Scene("s"), Scene("s")
    scene.dc_motor(
        "M", electrical=["a", "ground"], joint="h", shaft=None, resistance=1.0, constant=1.0
    )
    wanted.edge(
        "M", "dc_motor", electrical=["a", "ground"], joint="h", resistance=1.0, constant=1.0
    )
    assert scene.edges == wanted.edges


def test_registered_components_are_added_by_the_generic_call():
    with patch.dict(COMPONENTS):
        cotree.register_component(
            "lamp_of_test", lambda across, k: k * across**3, domain="electrical"
        )
        scene = Scene("s")
        scene.edge("E", "lamp_of_test", "a", "ground", k=2.0)
        assert not hasattr(scene, "lamp_of_test")
        assert [entry.name for entry in usage_of("lamp_of_test").entries] == ["k", "heat"]


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("hinge", "'revolute'"),
        ("Resistor", "'resistor'"),
        ("revolut", "'revolute'"),
        ("frction", "'translational_friction' or 'rotational_friction'"),
        ("motor", "'dc_motor'"),
        ("dc-motor", "'dc_motor'"),
        ("transistor", "'bjt_npn'"),
        ("limits", "'translational_stop' or 'rotational_stop'"),
    ],
)
def test_unknown_types_are_proposed_for(word, meant):
    with pytest.raises(SceneError, match=f"unknown type '{word}'; did you mean .*{meant}"):
        Scene("s").edge("x", word, "a", "b")


def test_what_is_like_nothing_lists_all():
    with pytest.raises(SceneError, match="known: rigid_body, arm, "):
        usage_of("qqqq")


def test_each_module_has_the_types_of_its_row():
    for family, names in FAMILIES.items():
        rows = import_module(f"cotree.components.{family}").COMPONENTS
        assert names.split() == [row.name for row in rows]
