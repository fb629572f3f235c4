"""Netlists of rising difficulty beside ngspice: operating points, and voltages at the end."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import cotree

NETLISTS = Path(__file__).parent / "netlists"

#: What ngspice may be off at the end of a run, as a share of the largest voltage there. It takes
#: the trapezoidal rule with the longest step of each netlist; halving that quarters what is seen.
#: The converter and the rectifier switch often, so that errors of each edge add up.
OFF = {
    **{"divider": 1e-7, "transformer": 2e-6, "junction": 1e-9, "amplifier": 2e-6, "pnp": 5e-6},
    **{"waveforms": 1e-5, "inverter": 1e-7, "nand": 5e-6, "multivibrator": 1e-5, "mirror": 2e-6},
    **{"converter": 1e-4, "rectifier": 1e-5},
    **{"polynomials": 2e-5, "windings": 4e-5, "parallel": 8e-6, "modulated": 1e-5, "gates": 1e-8},
    **{"wilson": 1e-6, "ttl": 4e-5, "one_flux": 5e-6, "laws": 1e-5, "switches": 1e-5},
    **{"jfets": 1e-7},
}

#: Of operating points, [V]: ngspice stops at vntol, 1e-8 V here. Most agree to 1e-11 V.
OFF_AT_REST = 1e-7

OPTIONS = ".options reltol=1e-6 abstol=1e-13 vntol=1e-8 chgtol=1e-17"


def ngspice(path, nodes, folder):
    """Return the time and the voltages at the end of a run, and those of the operating point."""
    lines = [row for row in path.read_text().splitlines() if row.strip().lower() != ".end"]
    wanted = " ".join(f"v({node})" for node in nodes)
    commands = ["set numdgt=15", "set wr_singlescale", "op", f"wrdata {folder}/op.data {wanted}"]
    commands += ["run", f"wrdata {folder}/end.data {wanted}"]
    whole = [*lines, OPTIONS, ".control", *commands, ".endc", ".end", ""]
    (folder / "whole.cir").write_text("\n".join(whole))
    command = ["ngspice", "-b", str(folder / "whole.cir")]
    subprocess.run(command, capture_output=True, cwd=folder, timeout=60, check=False)
    end, rest = (
        [float(word) for word in (folder / f"{name}.data").read_text().split("\n")[-2].split()]
        for name in ("end", "op")
    )
    return end[0], np.array(end[1:]), np.array(rest[1:])


def observed(path):
    """Read a netlist, its nodes as outputs; give the scene and the nodes' names in the file."""
    scene = cotree.read_spice(path)
    given = {new: old for (kind, old), new in scene.origin.names.items() if kind == "node"}
    nodes = [node for node in scene.nodes if node != "ground" and "_" not in node[1:]]
    for node in nodes:
        scene.output(f"at_{node}", f"{node}.v")
    return scene, [given.get(node, node) for node in nodes]


@pytest.mark.sampled(1)
@pytest.mark.skipif(shutil.which("ngspice") is None, reason="ngspice is not installed")
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] * (n in ("ttl", "wilson"))) for n in sorted(OFF)],
)
def test_a_netlist_agrees_with_ngspice(name, tmp_path):
    scene, nodes = observed(NETLISTS / f"{name}.cir")
    model = scene.compile()
    t_end = scene.defaults.t_end
    result = model.simulate((0, t_end), [0, t_end], rtol=1e-8, atol=1e-10)
    assert result.success
    own = np.array([result[output][-1] for output in model.outputs])
    end, there, rest = ngspice(NETLISTS / f"{name}.cir", nodes, tmp_path)
    assert end == pytest.approx(t_end, rel=1e-9)
    np.testing.assert_allclose(own, there, rtol=0, atol=OFF[name] * np.max(np.abs(there)))
    if scene.defaults.start == "operating point":
        own = model.output_values(0.0, model.start().y)
        np.testing.assert_allclose(own, rest, rtol=0, atol=OFF_AT_REST)
