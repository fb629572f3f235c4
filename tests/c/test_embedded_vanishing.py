"""C programs that leave out what vanishes print the same as those that integrate it."""

from __future__ import annotations

import sys

import pytest
from c_programs import build, run
from cascades import ball_beside_pendulum, heater, pendulums, rectifier_with_heater, whole_pattern

from cotree.export.c_project import write_c_project
from cotree.program import lower as lowering

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX compiler"),
]


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("make", "names", "options"),
    [
        (heater, ("R", "Ca", "k"), {}),
        (pendulums, ("L1", "L2"), {"kit": "rodas5"}),
        (pendulums, ("L1", "L2"), {"kit": "rk4", "step": 1e-3}),
        (heater, ("R", "Ca"), {"kit": "euler", "step": 1e-3}),
        (rectifier_with_heater, ("R", "Ca"), {}),
        (rectifier_with_heater, ("R", "Ca"), {"kit": "rodas4"}),
        (ball_beside_pendulum, ("L1", "e"), {"kit": "dop853"}),
        (ball_beside_pendulum, ("L1", "e"), {"kit": "rodas5"}),
    ],
)
def test_same_columns_as_with_zeros(make, names, options, tmp_path, monkeypatch):
    lines = []
    for folder in ("packed", "whole"):
        if folder == "whole":
            monkeypatch.setattr(lowering, "reached_states", whole_pattern)
        program = make().compile(names).kernels.program
        given = {"rtol": 1e-9, "atol": 1e-11, "t_end": 0.5} | options
        project = write_c_project(program, tmp_path / folder, **given)
        lines.append(_values(run([build(project, "gcc")], tmp_path / folder)))
    packed, whole = lines
    assert list(packed) == list(whole)
    # Steps differ, being tested by the mean of what is integrated.
    assert packed == pytest.approx(whole, rel=1e-6, abs=1e-8)
    assert sum(value == 0.0 for value in packed.values()) >= 1


def _values(text: str) -> dict[str, float]:
    return {name: float(value) for name, value in (row.split(" = ") for row in text.splitlines())}
