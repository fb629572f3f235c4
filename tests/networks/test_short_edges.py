"""Edges whose ends are one node: across is zero there, and what flows is definite."""

import numpy as np
import pytest

import cotree
from cotree.readers.spice.scene import read_spice_text

MODELS = (
    ".model qn NPN(IS=1f BF=80 CJE=2p CJC=1p TF=0.3n TR=5n VAF=50 RB=20 RC=2 RE=1)\n"
    ".model qp PNP(IS=1f BF=80 CJE=2p CJC=1p TF=0.3n TR=5n)\n"
    ".model qs NPN(IS=1f TF=0.3n)\n"
    ".model mn NMOS(VTO=1 KP=1m CBD=1p CBS=1p CGSO=1u CGDO=1u CGBO=1u GAMMA=0.5 LAMBDA=0.02)\n"
    ".model mp PMOS(VTO=-1 KP=1m CBD=1p RD=5 RS=5)\n"
    ".model dd D(IS=1f CJO=2p TT=1n RS=1)\n.model ds D(IS=1f)\n"
)
SOURCES = f"title\n{MODELS}Vs s 0 SIN(1 2 20MEG)\nVd d 0 3\n"
#: Around each device, whose nodes a and b have its number.
AROUND = "Ra{k} s a{k} 1k\nRb{k} d b{k} 2k\nCa{k} a{k} 0 5p\nCb{k} b{k} 0 5p\n"
RIG = SOURCES + AROUND.format(k="") + "{rows}\n.tran 1n 100n\n"
WAYS_OF_THREE = ["a a 0", "a 0 a", "0 a a", "a a b", "a b a", "b a a", "0 0 a", "0 a 0", "a 0 0"]
WAYS_OF_FOUR = ["a a 0 0", "a 0 a 0", "0 a a b", "a b b a", "a a b a", "b b 0 a", "0 0 0 a"]
WAYS = [
    *((f"Q1 {nodes} {model}", 3) for model in ("qn", "qp") for nodes in (*WAYS_OF_THREE, "a a a")),
    *((f"Q1 {nodes} qs", 3) for nodes in ("a a 0", "0 a a", "a a a")),
    *((f"M1 {nodes} {model}", 4) for model in ("mn", "mp") for nodes in (*WAYS_OF_FOUR, "a a a a")),
    *((f"D1 a a {model}", 2) for model in ("dd", "ds")),
    ("Q1 0 0 0 qn", 3),
    ("M1 0 0 0 0 mn", 4),
]


def read(text):
    return read_spice_text(text, "a.cir", cotree.Scene)


def ends(text, wanted):
    scene = read(text)
    for i, name in enumerate(wanted):
        scene.output(f"o{i}", name)
    result = scene.compile().simulate((0, 1e-7), [0, 3e-8, 1e-7], rtol=1e-11, atol=1e-14)
    assert result.success
    return np.array([result[name] for name in scene.outputs])


def tied(k, row, n):
    """Return device k with terminals on one node, then with ammeters, and variables to compare."""
    name, *words = row.split()
    nodes = [node if node == "0" else f"{node}{k}" for node in words[:n]]
    own = [f"{node}_{i}_{k}" for i, node in enumerate(nodes)]
    meters = [f"V{i}_{k} {a} {b} 0" for i, (a, b) in enumerate(zip(nodes, own, strict=True))]
    around = AROUND.format(k=k)
    together = around + " ".join([f"{name}{k}", *nodes, *words[n:]])
    apart = around + "\n".join([" ".join([f"{name}{k}", *own, *words[n:]]), *meters])
    currents = {"Q": ("ib", "ic"), "M": ("id",), "D": ("i",)}[name[0]]
    return together, apart, [f"a{k}.v", f"b{k}.v", *(f"{name}{k}.{i}" for i in currents)]


#: Every 14th device is alone in its circuit, and the others share circuits of eight.
_OTHERS = [way for i, way in enumerate(WAYS) if i % 14]
GROUPS = [[way] for way in WAYS[::14]]
GROUPS += [_OTHERS[i : i + 8] for i in range(0, len(_OTHERS), 8)]


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    "ways",
    [
        pytest.param(ways, marks=pytest.mark.slow if len(ways) > 1 else [], id=ways[0][0])
        for ways in GROUPS
    ],
)
def test_tied_terminals_are_those_that_sources_of_no_voltage_tie(ways):
    """Terminals on one node, and on nodes of their own that ammeters join."""
    together, apart, wanted = zip(*(tied(k, *way) for k, way in enumerate(ways)), strict=True)
    names = [name for own in wanted for name in own]
    found, expected = (
        ends("\n".join([SOURCES, *rows, ".tran 1n 100n\n"]), names) for rows in (together, apart)
    )
    # Errors of two runs of a hundred steps at 3 V and some milliamperes: where a junction passes
    # the share of its potential from which its capacitance goes on straight, steps are worse.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_what_an_edge_from_a_node_to_itself_carries():
    rows = (
        "R1 a a 10\nC1 a a 1u\nI1 a a 3\nI2 0 0 4\nL1 b b 1m\nE1 e 0 a a 5\nRe e 0 1\n"
        "G1 a a b 0 1m\nG2 b 0 a a 1\nF1 a a Vd 2"
    )
    wanted = ["R1.i", "C1.i", "I1.i", "I2.i", "L1.i", "e.v", "G2.output.i"]
    found = ends(RIG.format(rows=rows), wanted)
    expected = np.array([0, 0, 3, 4, 0, 0, 0])[:, None] * np.ones(3)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)
    # What controlled sources drive around goes nowhere else.
    rest = ends(RIG.format(rows=""), ["a.v", "b.v"])
    both = ends(RIG.format(rows=rows), ["a.v", "b.v", "F1.i", "Vd.i", "G1.output.i", "b.v"])
    np.testing.assert_allclose(both[:2], rest, rtol=0, atol=1e-9)
    np.testing.assert_allclose(both[2], 2 * both[3], rtol=1e-13)
    np.testing.assert_allclose(both[4], 1e-3 * both[5], rtol=1e-13)


def test_an_inductor_from_a_node_to_itself_keeps_its_current():
    scene = read("title\nV1 a 0 1\nR1 a b 1\nL1 b b 1m ic=2\nC1 b 0 1u\n.tran 1u 5u uic\n")
    result = scene.compile(["R1"]).simulate()
    np.testing.assert_array_equal(result["L1.i"], 2.0)
    np.testing.assert_array_equal(result.sensitivity("L1.i", "R1"), 0.0)


def test_a_short_winding_shields_the_other():
    """Its flux stays: the other winding has the inductance L (1 - k^2)."""
    scene = read("title\nR1 b 0 1\nL1 b b 1m\nL2 a 0 4m\nK1 L1 L2 0.6\nV1 a 0 1\n.tran 1u 1m uic\n")
    result = scene.compile().simulate((0, 1e-3), [0, 1e-3], rtol=1e-10)
    assert result["K1.secondary.i"][-1] == pytest.approx(1e-3 / (4e-3 * 0.64), rel=1e-9)
    # 0 = L1 i1 + M i2
    expected = -0.6 * np.sqrt(4e-3 / 1e-3) * result["K1.secondary.i"][-1]
    assert result["K1.primary.i"][-1] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("type", ["transformer", "gyrator"])
def test_a_short_port_shorts_or_opens_the_other(type):
    scene = cotree.Scene("short")
    scene.edge("V", "voltage_source", "a", "ground", voltage=2.0)
    scene.edge("R", "resistor", "a", "b", resistance=4.0)
    scene.edge("r", "resistor", "b", "ground", resistance=4.0)
    field = {"transformer": {"ratio": 3.0}, "gyrator": {"conductance": 0.5}}[type]
    scene.edge("T", type, primary=["c", "c"], secondary=["b", "ground"], **field)
    scene.edge("rc", "resistor", "c", "ground", resistance=1.0)
    for name in ("b.v", "T.primary.i", "T.secondary.i"):
        scene.output(name.replace(".", "_"), name)
    found = scene.compile().output_values(0.0, [])
    # The short winding carries -1/3 of the other's current; a gyrator's takes g times its voltage.
    expected = {"transformer": [0, -0.5 / 3, 0.5], "gyrator": [1, 0.5, 0]}[type]
    np.testing.assert_allclose(found, expected, atol=1e-15)


def test_springs_and_dampers_may_be_short_too():
    scene = cotree.Scene("short")
    scene.edge("m", "translational_mass", "ground", "x", mass=2.0, initial={"v": 3.0})
    scene.edge("c", "translational_damper", "x", "x", damping=5.0)
    scene.edge("k", "translational_spring", "x", "x", stiffness=7.0, free_length=-0.25)
    scene.output("F", "k.f")
    result = scene.compile().simulate((0, 1))
    np.testing.assert_allclose(result["m.v"], 3.0)
    np.testing.assert_allclose(result["F"], 7.0 * 0.25)
    scene.edge("long", "translational_spring", "x", "x", stiffness=7.0, initial={"s": 0.25})
    with pytest.raises(cotree.ParameterError, match=r"'long.s' is given as 0.25 but is 0"):
        scene.compile()


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("V1 a a 1", "'V1' begins and ends at node 'a'"),
        ("V1 a a 0", "the voltage is zero"),
        ("E1 a a b 0 2", "'E1.output' begins and ends at node 'a'"),
        ("H1 a a Vd 2", "'H1' begins and ends at node 'a'"),
    ],
)
def test_voltages_given_between_a_node_and_itself_are_refused(row, message):
    with pytest.raises(cotree.TopologyError, match=message):
        ends(RIG.format(rows=row), [])


def test_amplifiers_without_an_input_or_an_output_are_refused():
    four = {"input": ["a", "b"], "output": ["b", "b"]}
    for nodes, fields, what in ((["b", "b", "a"], {}, "U.input"), ([], four, "U.output")):
        scene = cotree.Scene("short")
        scene.edge("V", "voltage_source", "a", "ground", voltage=2.0)
        scene.edge("R", "resistor", "a", "b", resistance=4.0)
        scene.edge("r", "resistor", "b", "ground", resistance=4.0)
        scene.edge("U", "ideal_op_amp" if nodes else "nullor", *nodes, **fields)
        with pytest.raises(cotree.TopologyError, match=f"'{what}' begins and ends at node"):
            scene.compile()


def test_initial_values_of_short_capacitors_are_refused():
    with pytest.raises(cotree.ParameterError, match=r"'C1.v' is given as 1 but is 0"):
        read("title\nV1 a 0 1\nC1 a a 1u ic=1\n.tran 1u 1u uic\n").compile()


def test_short_edges_are_saved_drawn_and_explained(tmp_path):
    scene = read(RIG.format(rows="Q1 a a 0 qn\nR1 a a 10"))
    assert scene.graph().graphs["electrical"].n_edges > 5
    scene.save(tmp_path / "short.toml")
    again = cotree.load(tmp_path / "short.toml")
    assert again.edges["Q1"].ports == scene.edges["Q1"].ports
    assert again.edges["R1"].ports == scene.edges["R1"].ports
    assert "Q1.be.v" in {str(state) for state in scene.equations().states}
