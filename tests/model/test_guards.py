"""``prepare`` refuses parameters that must be positive, in every domain, in C and Python."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from evaluated_kernels import EvaluatedKernels

from cotree import Scene
from cotree.components import COMPONENTS, OWN
from cotree.errors import ParameterError
from cotree.pipeline import formulate, generate
from cotree.scene.expressions import Expression, parse
from cotree.scene.toml_file import read_scene

PAGES = Path(__file__).parents[2] / "docs" / "components"
SIGNED = tuple(
    row
    for name, row in COMPONENTS.items()
    if name in OWN and any(field.sign for field in row.fields)
)
#: One of each domain, and one beside joints.
OF_DOMAINS = (
    "resistor",
    "hydraulic_resistor",
    "thermal_resistor",
    "translational_mass",
    "rotational_inertia",
    "species",
    "dc_motor",
    "rigid_body",
)


def _scene(component):
    """Read the example of a component's page."""
    text = (PAGES / f"{component.name}.md").read_text(encoding="utf-8")
    block = re.search(r"```toml\n(.*?)```", text, re.DOTALL).group(1)
    return read_scene(block, f"{component.name}.toml", Scene)


def _tried(value):
    """Return a field times a parameter, or the parameter if the field varies or is zero."""
    if not isinstance(value, Expression):
        return tuple(map(_tried, value))
    varies = any(name == "t" or "." in name for name in value.names)
    return parse("tried" if varies or value.number == 0.0 else f"({value.text})*tried", value.where)


def _cases(component):
    """Return the scene of a component with one of its fields depending on a parameter, in turn."""
    for field in (row for row in component.fields if row.sign):
        scene = _scene(component)
        edge = next(e for e in scene.edges.values() if e.component.name == component.name)
        if field.name in edge.fields:
            scene.parameter("tried", 1.0)
            fields = {**edge.fields, field.name: _tried(edge.fields[field.name])}
            scene.edges[edge.name] = dataclasses.replace(edge, fields=fields)
            yield field, edge.name, scene


@pytest.mark.sampled(6)
@pytest.mark.parametrize("component", SIGNED, ids=lambda c: c.name)
def test_every_field_with_a_sign_is_guarded(component):
    cases = list(_cases(component))
    assert cases
    for field, edge, scene in cases:
        program = generate(formulate(scene, [], None)[1])[0]
        place = [row.name for row in program.layout.parameters].index("tried")
        p = np.array(program.layout.parameter_values)
        kernels = EvaluatedKernels(program)
        kernels.prepare(p)
        for value in (-1.0, 0.0) if field.sign == "positive" else (-1.0,):
            p[place] = value
            with pytest.raises(ParameterError, match=rf"{field.name} of edge '{edge}'.*'tried'"):
                kernels.prepare(p)


@pytest.mark.sampled(2)
@pytest.mark.compiler
@pytest.mark.parametrize("name", OF_DOMAINS)
def test_a_compiled_model_refuses_the_same(name):
    field, edge, scene = next(_cases(COMPONENTS[name]))
    message = rf"{field.name} of edge '{edge}' is -.*: it must .* \(parameters? .*'tried'\)"
    model = scene.compile()
    p = model.kernels.parameter_array({"tried": -1.0})
    with pytest.raises(ParameterError, match=message):
        model.rhs(0.0, model.initial_state, p)
