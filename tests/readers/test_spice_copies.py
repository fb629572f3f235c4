"""``m=`` of subcircuit instances, compared with as many copies."""

from __future__ import annotations

import numpy as np
import pytest

import cotree

_MODELS = """title
.param many=3
.model dm D(is=1e-14 rs=2 cjo=1p tt=1n bv=8 ibv=1m)
.model qm NPN(is=1e-15 bf=80 rb=10 rc=5 re=1 cje=1p cjc=1p tf=0.1n vaf=50)
.model mm NMOS(vto=0.7 kp=1e-4 rd=5 rs=5 cbd=1p cgso=1e-9 gamma=0.3 phi=0.6)
.model jm NJF(vto=-2 beta=1e-3 rd=5 cgs=1p)
.model sw SW(vt=2 vh=0.5 ron=10 roff=1meg)
.model cw CSW(it=1m ih=0.1m ron=10 roff=1meg)
.subckt inner a b
R1 a x 2k
C1 x b 1n
.ends
"""

_SOURCES = """I1 a b SIN(1m 0.5m 1k)
I2 a b PULSE(0 1m 1u 1u 1u 0.1m 0.3m)
I3 a b PWL(0 0 0.1m 1m 0.5m 2m)
I4 a b EXP(0 1m 0.1m 0.1m)
I5 b a 0.3m
I6 a b PWL(0 0 0.1m {many*1m})"""

_CONTROLLED = """V1 a x 0
R1 x b 1k
F1 a b V1 0.5
H1 h 0 V1 1k
Rh h b 1k
B1 a b I=I(V1)*0.25+V(a)*V(a)*1e-6
E1 z b a b 2
Rz z b 1k
F2 a b POLY(1) V1 0 0.1 0.2
G1 a b POLY(1) a b 0 1e-3 1e-5
G2 a b a b 1e-4
G3 a b VALUE={V(a)*1e-4}"""

_SWITCHES = """R1 a x 1k
S1 x b a b sw
V1 a w 0
R2 w ww 900
W1 ww b V1 cw
R3 ww b 1k"""

#: Subcircuits between the nodes a and b.
_CELLS = {
    "storages": "R1 a x 1k\nL1 x y 1m ic=1m\nC1 y b 1n ic=1",
    "coupled": "L1 a b 1m ic=1m\nL2 c b 4m\nK1 L1 L2 0.9\nR2 c b 1k",
    "one_flux": "L1 a b 1m ic=1m\nL2 c b 4m\nK1 L1 L2 1\nR2 c b 1k",
    "diodes": "R1 a x 100\nD1 x y dm\nD2 b y dm m=2",
    "bipolar": "R1 a c 1k\nRb a bb 100k\nQ1 c bb b qm",
    "mosfet": "R1 a dd 1k\nM1 dd g b b mm w=10u l=1u\nVg g b 2",
    "jfet": "R1 a dd 1k\nJ1 dd g b jm\nVg g b -0.5",
    "sources": _SOURCES,
    "controlled": _CONTROLLED,
    "switches": _SWITCHES,
    "law": "R1 a b {1k+V(a)*10}",
    "nested": "X1 a b inner m=2\nX2 a b inner",
}


def _voltages(cell, instances, folder):
    start = " uic" if cell in ("storages", "coupled", "one_flux") else ""
    source = "Vs s 0 SIN(3 2 2k)\nRs s p 200\nCp p 0 10n\n"
    text = f"{_MODELS}.subckt cell a b\n{_CELLS[cell]}\n.ends\n{source}{instances}\n"
    path = folder / "copies.cir"
    path.write_text(f"{text}.tran 1u 1m{start}\n.end\n")
    circuit = cotree.read_spice(path)
    circuit.output("p", "p.v")
    model = circuit.compile(tunable=[], optimize="-O0")
    return model.simulate(t_eval=np.linspace(0, 1e-3, 11), rtol=1e-9, atol=1e-12, throw=True)["p"]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("cell", _CELLS)
def test_an_instance_of_several_is_as_many_copies(cell, tmp_path):
    copies = _voltages(cell, "X1 p 0 cell\nX2 p 0 cell\nX3 p 0 cell", tmp_path)
    # Both runs keep a tolerance of 1e-9 of some volts; the laws are the same.
    for count in ("3", "{many}"):
        merged = _voltages(cell, f"X1 p 0 cell m={count}", tmp_path)
        np.testing.assert_allclose(merged, copies, rtol=0, atol=1e-9)


def test_a_declared_m_is_a_parameter(tmp_path):
    """ngspice 39 prints -1.66667e-03 and -5.00000e-03 for these currents."""
    path = tmp_path / "declared.cir"
    cell = ".subckt cell a b m=1\nR1 a b {1k*m}\n.ends\n"
    path.write_text(f"title\n{cell}V1 p 0 5\nX1 p 0 cell m=3\nV2 q 0 5\nX2 q 0 cell\n.end\n")
    circuit = cotree.read_spice(path)
    for name in ("V1", "V2"):
        circuit.output(f"{name}_current", f"{name}.i")
    found = circuit.compile().output_values(0.0, [])
    assert np.abs(found) == pytest.approx([5 / 3e3, 5e-3], rel=1e-12)


def test_a_number_of_copies_is_positive(tmp_path):
    path = tmp_path / "none.cir"
    cell = ".subckt cell a b\nR1 a b 1k\n.ends\n"
    path.write_text(f"title\n{cell}V1 p 0 5\nX1 p 0 cell m=0\n.end\n")
    with pytest.raises(cotree.SceneError, match=r"none\.cir:6: m must be positive"):
        cotree.read_spice(path)
