"""SPICE netlists: what is read, what is refused, and references that they reach."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import cotree
from cotree.api import Scene
from cotree.cli import main
from cotree.dag.nodes import Dag
from cotree.readers.spice.scene import read_spice_text
from cotree.readers.spice.values import Scope, read_number

HERE = Path(__file__).parent
REFERENCES = HERE.parent / "references"


def read(text):
    return read_spice_text(text, "a.cir", Scene)


def reference(name):
    return json.loads((REFERENCES / f"{name}.json").read_text())


def test_the_rectifier_reaches_its_reference():
    known = reference("spice_rectifier")
    scene = cotree.load(HERE / "netlists" / "rectifier.cir")
    for node in ("p", "a1", "b"):
        scene.output(f"v({node})".replace("(", "_").rstrip(")"), f"{node}.v")
    times = [row["t"] for row in known["reference"]]
    result = scene.compile().simulate((0, 0.04), [0, *times], rtol=1e-11, atol=1e-13)
    for i, row in enumerate(known["reference"], start=1):
        for name, value in row["values"].items():
            own = result[name.replace("(", "_").rstrip(")")][i]
            # Some thousand steps of rtol 1e-11 at 8 V; the file's gmin of 1e-18 S moves less.
            assert own == pytest.approx(value, abs=1e-8), (row["t"], name)


def ladder():
    rows = ["a lossy ladder", ".param Rs=50 RL=50 C=1n", "Vs s 0 1", "Rs s n0 {Rs}"]
    rows += [
        ".subckt section in out",
        "R in mid 1",
        "L mid out 1u",
        "C out 0 {C}",
        ".ends section",
    ]
    rows += [f"X{k} n{k - 1} n{k} section" for k in range(1, 51)]
    return "\n".join([*rows, "Rload n50 0 {RL}", ".tran 1n 5u uic", ".end"])


def test_the_ladder_reaches_its_reference_with_sensitivities():
    known = reference("spice_rlc_ladder50")
    scene = read(ladder())
    nodes = ("n1", "n25", "n50")
    for node in nodes:
        scene.output(f"v_{node}", f"{node}.v")
    model = scene.compile(["RL", "Rs"])
    assert len(model.states) == 100
    times = [row["t"] for row in known["reference"]]
    result = model.simulate((0, 5e-6), [0, *times], rtol=1e-10, atol=1e-13)
    for i, row in enumerate(known["reference"], start=1):
        for node in nodes:
            # A thousand steps of rtol 1e-10 at 1 V.
            value = row["values"][f"v({node})"]
            assert result[f"v_{node}"][i] == pytest.approx(value, abs=1e-8)
    for name, rows in known["sensitivities"]["values"].items():
        for i, row in enumerate(rows, start=1):
            for node in nodes:
                own = result.sensitivity(f"v_{node}", name)[i]
                assert own == pytest.approx(row["values"][f"v({node})"], abs=1e-9)


@pytest.mark.parametrize(
    ("word", "value"),
    [
        *[("1", 1.0), ("1k", 1e3), ("2.5MEG", 2.5e6), ("3m", 3e-3), ("10uF", 1e-5)],
        *[("1mil", 25.4e-6), ("5V", 5.0), (".5n", 5e-10), ("-1e3k", -1e6), ("1.1u", 1.1e-6)],
        *[("1f", 1e-15), ("2g", 2e9), ("7t", 7e12), ("4aF", 4e-18), ("1e999", None)],
        *[("1A", 1.0), ("4a", 4.0), ("2.5Amps", 2.5), ("3mA", 3e-3)],
        *[("abc", None), ("1_0", None), ("0x10", None), ("", None), ("1k2", None)],
    ],
)
def test_numbers_have_suffixes(word, value):
    assert read_number(word) == value


def test_expressions_are_of_the_scenes_grammar():
    scope = Scope({"a": 2.0, "b": "R1"})
    assert scope.value("{3*A^2 + sqrt(16)}", "x") == 16.0
    assert scope.value("{2*1k}", "x") == 2000.0
    assert scope.value("'b + 1'", "x") == "R1 + 1.0"


def test_a_netlist_becomes_a_scene():
    scene = read(
        "R9 a 0 1 the title\n"
        ".param r=2k half={r/2}\n"
        "* a comment\n"
        "V1 in 0 dc 5 ac 1 ; another\n"
        "R1 IN 2\n"
        "+ {half} $ and another\n"
        "C1 2 gnd 1u ic=1\n"
        "I1 0 2 1m\n"
        ".tran 1u 2m uic\n"
        ".print v(2)\n"
        ".options reltol=1e-5 gmin=1e-13\n"
        ".control\nrun\n.endc\n"
        ".end\n"
        "what comes after is not read\n"
    )
    assert set(scene.edges) == {"C1", "I1", "R1", "V1"}
    assert {n: p.value for n, p in scene.parameters.items()} == {
        **{"r": 2e3, "V1": 5.0, "C1": 1e-6, "I1": 1e-3}
    }
    assert scene.defaults.t_end == 2e-3
    assert scene.defaults.start == "initial values"
    assert set(scene.nodes) == {"ground", "in_", "_2"}
    assert scene.origin.names[("node", "2")] == "_2"
    assert any(".print" in note for note in scene.origin.notes)
    # From 1 V to the 5 V and the 1 V across R1 of a milliampere.
    model = scene.compile(["r"])
    end = model.simulate((0, 2e-3), rtol=1e-9)["C1.v"][-1]
    assert end == pytest.approx(6 - 5 * np.exp(-2), rel=1e-7)


def test_subcircuits_nest_and_take_parameters():
    scene = read(
        "nested\nV1 a 0 6\n"
        ".subckt outer x y r=1k\n"
        ".subckt inner p q params: r=5\nR1 p q {r}\n.ends\n"
        "X1 x m inner r={2*r}\nX2 m y inner r={r}\n.ends outer\n"
        "X1 a 0 outer r=3k\nX2 a b outer\nRb b 0 1k\n.end\n"
    )
    scene.output("m", "X1_m.v")
    scene.output("b", "b.v")
    model = scene.compile()
    np.testing.assert_allclose(model.output_values(0.0, []), [2.0, 1.5], rtol=1e-13)


#: Resistance of a subcircuit by what it, its instance and the netlist say, of ngspice 39.
RESISTANCES = {
    "an instance before .param": ("r=3", "r=1", ".param r=5", "{r}", 3.0),
    "an instance before .param alone": ("r=3", "", ".param r=5", "{r}", 3.0),
    ".param before a default": ("", "r=1", ".param r=5", "{r}", 5.0),
    "a default of what is given": ("r=3", "r=1 s={2*r}", ".param r=5\n.param w={r+s}", "{w}", 9.0),
    "in any order": ("", "", ".param q={2*r}\n.param r=5", "{q}", 10.0),
    "the last of two": ("", "", ".param r=5\n.param r=6", "{r}", 6.0),
}


@pytest.mark.parametrize("case", RESISTANCES)
def test_what_an_instance_gives_goes_first(case):
    given, defaults, lines, value, expected = RESISTANCES[case]
    scene = read(
        f"title\n.param r=7\nV1 a 0 1\nX1 a 0 sub {given}\n"
        f".subckt sub p n {defaults}\n{lines}\nR1 p n {value}\n.ends\n"
    )
    scene.output("i", "-V1.i")
    assert scene.compile().output_values(0.0, [])[0] == pytest.approx(1.0 / expected)


def test_parameters_of_a_netlist_stand_in_any_order():
    scene = read("title\n.param b={2*a}\n.param a=3\nV1 x 0 1\nR1 x 0 {b}\n")
    scene.output("i", "-V1.i")
    assert scene.compile().output_values(0.0, [])[0] == pytest.approx(1.0 / 6.0)
    with pytest.raises(cotree.SceneError, match="names 'c', which is not a parameter"):
        read("title\n.param c={2*b}\n.param b={c}\nV1 x 0 1\nR1 x 0 {b}\n")


SEVEN = " ".join(f"L{i}" for i in range(7))


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("R1 a 0", 2, "needs one value"),
        ("R1 a 0 {x}", 2, "names 'x', which is not a parameter"),
        ("R1 a 0 {1/0}", 2, "has no value"),
        ("R1 a 0 {foo(1)}", 2, "not a function here"),
        ("R1 a 0 1 tc3=1", 2, "no supported setting 'tc3'"),
        ("R1 a 0 4k7", 2, "4.7k in some simulators"),
        ("L1 a 0 0\nL2 b 0 1\nK1 L1 L2 .5", 2, "no inductance, so it cannot be coupled"),
        ("R1 a 0 1\n.param x", 3, "each with = and a value"),
        ("R1 a 0 {1", 2, "is unbalanced"),
        ("R1 a 0 1\nR1 a 0 1", 3, "a second 'R1'"),
        ("R1 a a", 2, "needs one value"),
        ("T1 a 0 b 0 z0=50", 2, "delays signals"),
        ("Y1 a 0 b", 2, "is not a supported element"),
        ("J1 a b 0 m\n.model m NJF(B=0.5)", 3, "'b' of model 'm' is not supported"),
        ("B1 a 0 p=1", 2, "needs two nodes, and V= or I="),
        ("B1 a 0 V=", 2, "ends where a value is expected"),
        ("B1 a 0 V=V(q)\nR1 a 0 1", 2, "'q' is not a node"),
        ("B1 a 0 V=V(a,)\nR1 a 0 1", 2, "takes a name in parentheses"),
        ("B1 a 0 V=I(R1)\nR1 a 0 1", 2, "not a voltage source of this circuit"),
        ("B1 a 0 V=ddt(V(a))\nR1 a 0 1", 2, "calls 'ddt'"),
        ("B1 a 0 V=V(a) ? 1 : 2\nR1 a 0 1", 2, "not a comparison"),
        ("B1 a 0 V=V(a) == 1 ? 1 : 2\nR1 a 0 1", 2, "compare by <"),
        ("B1 a 0 V=min(V(a))\nR1 a 0 1", 2, "gives min 1 arguments, not 2"),
        ("B1 a 0 V=if(V(a))\nR1 a 0 1", 2, "arguments, not 3"),
        ("B1 a 0 V=" + "(" * 999 + "1" + ")" * 999, 2, "is not an expression"),
        ("S1 a 0 b 0 m", 2, "no .model 'm'"),
        ("S1 a 0 b m", 2, "needs two nodes, two that control it"),
        ("R2 b 0 1\nS1 a 0 b 0 m\n.model m csw", 3, "is not for elements S"),
        ("R2 b 0 1\nS1 a 0 b 0 m\n.model m sw(ron=-1)", 3, "ron"),
        ("R2 b 0 1\nS1 a 0 b 0 m\n.model m sw(vh=-1)", 3, "vh"),
        ("D1 a 0 m", 2, "no .model 'm'"),
        ("D1 a 0 m\n.model m D(IS=1 XYZ=2)", 3, "'xyz' of model 'm' is not supported"),
        ("M1 a b 0 0 m\n.model m NMOS(TOX=1n)", 3, "'tox' of model 'm' is not supported"),
        ("M1 a b 0 0 m\n.model m NMOS(LEVEL=3)", 3, "only field-effect transistors of level 1"),
        ("D1 a 0 m\n.model m NPN", 2, "is not for elements D"),
        ("R1 a 0 1\n.step param r 1 2 1", 3, "unsupported statement '.step': give the values to"),
        ("R1 a 0 1\n.stop", 3, "unsupported statement '.stop'"),
        ("R1 a 0 1\n.include x.lib", 3, "would read another file"),
        ("R1 a 0 1\n.lib x.lib", 3, "would read another file"),
        ("R1 a 0 1\n.func f(x)", 3, ".func is written as"),
        ("R1 a 0 1\n.func f(2) {1}", 3, "must be names"),
        ("R1 a 0 1\n.func f(x) {x}\n.func F(y) {y}", 4, "a second .func 'F'"),
        (".func f(x) {f(x)}\nR1 a 0 {f(1)}", 3, "nested more than 20 levels"),
        (".func f(x) {x}\nR1 a 0 {f(1, 2)}", 3, "gives f 2 arguments, not 1"),
        ("V1 a 0 PWL(0 0 1 1 0.5 2 0.5 3)", 2, "must not decrease"),
        ("X1 a 0 s", 2, "no subcircuit 's'"),
        ("X1 a s\n.subckt s a b\nR1 a b 1\n.ends", 2, "has 1 nodes, and subcircuit 's' 2 pins"),
        (".subckt s a b\nR1 a b 1", 2, "has no .ends"),
        (".subckt s a b\nX1 a b s\n.ends\nX1 1 0 s", 3, "nested more than 20 levels"),
        ("F1 a 0 V9 2\nR1 a 0 1", 2, "not a voltage source of this circuit"),
        ("V1 a 0 NOISE(1 2)", 2, "not a supported waveform"),
        ("V1 a 0 PWL(0 0 1 1) r=0", 2, "'r' of 'V1' is not supported"),
        ("E1 a 0 TABLE {V(b)} = (0,0) (1,2)\nR1 b 0 1", 2, "'E1' has a TABLE, which is"),
        ("V1 a 0 PWL(0 1 2)", 2, "pairs of a time and a value"),
        ("V1 a 0 PULSE(0 1)", 2, "there is no .tran"),
        ("V1 a 0 AM(1 0 1k)", 2, "AM needs two numbers"),
        ("L1 a 0 1\nL2 b 0 1\nK1 L1 L2 .5\nK2 L2 L1 .5", 5, "'l2' is coupled twice to 'l1'"),
        ("L1 a 0 1\nL2 b 0 1\nK1 L1 L1 .5", 4, "'l1' is coupled twice to 'l1'"),
        ("L1 a 0 1\nK1 L1 .5", 3, "needs two inductors or more"),
        ("\n".join([*(f"L{i} {i} 0 1" for i in range(7)), f"K1 {SEVEN} .1"]), 9, "more than 6"),
        ("M1 a b 0 0 m m=0\n.model m NMOS", 2, "m must be positive"),
        ("R1 a 0 1 m={-2}", 2, "m must be positive"),
        ("E1 a 0 POLY(x) b 0 1 2", 2, "POLY needs the number of its arguments"),
        ("E1 a 0 POLY(99) b 0 1 2", 2, "POLY needs the number of its arguments"),
        ("E1 a 0 POLY(2) b 0 c 0", 2, "has 0 coefficients after its POLY"),
        ("E1 a 0 POLY(1) b 0 3", 2, "give both"),
        ("E1 a 0 POLY", 2, "POLY needs the number of its arguments"),
        ("F1 a 0 POLY(1) R1 0 3\nR1 a 0 1", 2, "takes the current of 'R1', which is not a voltage"),
        ("R1 a 0 1\n.temp 50", 3, "must be 27"),
        ("R1 a 0 1\n.tran 1", 3, "needs a step and an end time"),
        ("R1 a 0 1\n.ic v(q)=1", 3, "not a node"),
        ("", 1, "no elements"),
    ],
)
def test_what_is_not_known_is_refused_with_its_line(text, line, message):
    with pytest.raises(cotree.SceneError) as caught:
        read(f"title\n{text}\n")
    told = str(caught.value)
    assert told.startswith(f"a.cir:{line}: ")
    assert message in told
    assert "\n" not in told


def test_polynomials_have_the_order_of_spice():
    """Of voltages 2 V and 3 V and currents -2 mA and -3 mA, each coefficient in turn."""
    sources = "Va a 0 2\nRa a 0 1k\nVb b 0 3\nRb b 0 1k\n"
    rows = {"E1 e 0 POLY(2) a 0 b 0": 1.0, "H1 e 0 POLY(2) Va Vb": -1e-3}
    rows |= {"G1 0 e POLY(2) (a,0) (b,0)": 1.0, "F1 0 e POLY(2) Va Vb": -1e-3}
    powers = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)]
    for row, unit in rows.items():
        braced = " ".join(f"{{p{i}}}" for i in range(10))
        zeros = " ".join(f"p{i}=0" for i in range(10))
        scene = read(f"title\n{sources}{row} {braced}\nRe e 0 1\n.param {zeros}")
        scene.output("e", "e.v")
        model = scene.compile([f"p{i}" for i in range(10)])
        start = model.start()
        for i, (m, n) in enumerate(powers):
            p = model.kernels.parameter_array({f"p{i}": 7.0})
            expected = (2 * unit) ** m * (3 * unit) ** n
            found = model.output_values(0.0, model.start(0.0, p).y, p)
            assert found == pytest.approx([7.0 * expected], rel=1e-12), (row, i)
            slopes = model.output_sensitivity(0.0, start.y, start.s)
            assert slopes[0, i] == pytest.approx(expected, rel=1e-12)


def test_coefficients_are_parameters():
    scene = read("title\nVa a 0 2\nE1 e 0 POLY(1) a 0 0 3 0 4\nR1 e 0 1\n")
    assert {n: p.value for n, p in scene.parameters.items()} == {
        **{"Va": 2.0, "E1_p1": 3.0, "E1_p3": 4.0, "R1": 1.0}
    }


SIDE_BY_SIDE = {
    "R1 a 0 1k m=2": "R1 a 0 500",
    "C1 a 0 1u m=2": "C1 a 0 2u",
    "L1 a 0 1m m=2": "L1 a 0 500u",
    "D1 a 0 d area=3 m=2": "D1 a 0 d area=6",
    "D1 a 0 d 3 m={n}": "D1 a 0 d {3*n}",
    "Q1 a b 0 q m={n}": "Q1 a b 0 q {n}",
    "M1 a b 0 0 n w=2u l=1u m=2": "M1 a b 0 0 n2 w=4u l=1u",
}


def values_of(scene):
    """Return type, nodes and numbers of each edge, with the values of the parameters."""
    dag = Dag()

    def number(expression):
        named = expression.lower(dag, lambda name: dag.constant(scene.parameters[name].value))
        return named.value

    return {
        edge.name: (edge.component.name, edge.nodes, {k: number(v) for k, v in edge.fields.items()})
        for edge in scene.edges.values()
    }


@pytest.mark.parametrize("row", SIDE_BY_SIDE)
def test_elements_side_by_side_are_one_of_the_whole_size(row):
    """Two transistors have twice the charge, and half the resistance."""
    text = (
        "title\n.options gmin=0\n.param n=3\n.model d D(RS=5 CJO=1p TT=1n)\n"
        ".model q NPN(RB=10 CJE=1p TF=1n)\n"
        ".model n NMOS(KP=1m RD=9 RS=5 CBD=1p CBS=1p CGSO=1n CGDO=1n CGBO=2n IS=1f)\n"
        ".model n2 NMOS(KP=1m RD=4.5 RS=2.5 CBD=2p CBS=2p CGSO=1n CGDO=1n CGBO=4n IS=2f)\n"
    )
    several, whole = (values_of(read(f"{text}{line}\n")) for line in (row, SIDE_BY_SIDE[row]))
    assert several.keys() == whole.keys()
    for name, (type, nodes, numbers) in several.items():
        assert (type, nodes) == whole[name][:2]
        assert numbers == pytest.approx(whole[name][2], rel=1e-14, abs=0)


def test_several_couplings_make_one_edge():
    """K of three inductors couples each pair; those that share none stay apart."""
    rows = "".join(f"L{i} {i} 0 {i}m\nR{i} {i} 0 1\n" for i in range(1, 6))
    scene = read(f"title\n{rows}K1 L1 L2 L3 0.4\nKx L4 L5 0.5\n.tran 1u 1m uic\n")
    assert {"L1", "L2", "L3", "L4", "L5"}.isdisjoint(scene.edges)
    fields = scene.edges["K1"].fields
    assert [fields[name].text for name in ("coupling", "coupling13", "coupling23")] == ["K1"] * 3
    assert scene.edges["Kx"].ports[1].head == scene.nodes[5]
    chain = read(f"title\n{rows}K1 L1 L2 0.4\nK2 L2 L3 0.5\nK3 L4 L5 0.5\nK4 L5 L1 0.1\n")
    (edge,) = (e for e in chain.edges.values() if e.component.name == "coupled_inductors")
    given = {name: value.text for name, value in edge.fields.items() if "coupling" in name}
    assert sorted(value for value in given.values() if value != "0.0") == ["K1", "K2", "K3", "K4"]


def test_temperatures_of_27_degrees_say_nothing():
    scene = read(
        "title\nR1 a 0 1\nD1 a 0 d\n.model d D(TNOM=27)\n.temp 27.0\n.options temp=27 tnom=27\n"
    )
    assert scene.origin.notes == ()


def test_the_operating_point_and_its_sensitivities():
    """Voltage divider before a diode: the start agrees with differences of itself."""
    scene = cotree.load(HERE / "netlists" / "amplifier.cir")
    model = scene.compile(["R1", "q1_bf", "Re"])
    start = model.start()
    # Nothing moves: currents of some picoampere through a picofarad of the junctions at most.
    rates = model.rhs(0.0, start.y)
    own = model.jacobian(0.0, start.y)
    assert np.max(np.abs(np.linalg.solve(own, rates))) < 1e-9
    for j, name in enumerate(model.sensitivities):
        i = model.parameters.index(name)
        step = 1e-3 * model.default_parameters[i]
        ends = []
        for sign in (1, -1):
            p = model.default_parameters
            p[i] += sign * step
            ends.append(model.start(0.0, p).y)
        difference = (ends[0] - ends[1]) / (2 * step)
        # Differences of this step have errors of some 1e-6 of their size, of a step a tenth as
        # long 1e-8 and the noise of the solutions.
        np.testing.assert_allclose(start.s[:, j], difference, rtol=3e-6, atol=1e-14)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ["amplifier", "junction", "nand"])
def test_sensitivities_agree_with_differences(name):
    scene = cotree.load(HERE / "netlists" / f"{name}.cir")
    wanted = {"amplifier": "q1_cjc", "junction": "fast_tt", "nand": "mn_gamma"}[name]
    state = {"amplifier": "Q1.bc.v", "junction": "D1.junction.v", "nand": "CL.v"}[name]
    t_end = {"amplifier": 2e-5, "junction": 1.3e-6, "nand": 1.2e-9}[name]
    model = scene.compile([wanted])
    settings = {"rtol": 1e-9, "atol": 1e-12}
    result = model.simulate((0, t_end), [0, t_end], **settings)
    value = scene.parameters[wanted].value
    ends = [
        model.simulate((0, t_end), [0, t_end], parameters={wanted: value * (1 + h)}, **settings)
        for h in (1e-4, -1e-4)
    ]
    difference = (ends[0][state][-1] - ends[1][state][-1]) / (2e-4 * value)
    # Errors of the runs, some 1e-9 V, by twice the step, 2e-4; that of differences is less.
    own = result.sensitivity(state, wanted)[-1]
    scale = abs(value) * 1.0
    assert own * scale == pytest.approx(difference * scale, rel=1e-4, abs=2e-5)


def test_held_voltages_choose_an_operating_point():
    """A latch of two inverters rests where .ic puts it."""
    text = (
        "latch\n.model n NMOS(VTO=1 KP=1m)\nVdd v 0 5\n"
        "R1 v a 10k\nR2 v b 10k\nM1 a b 0 0 n W=1u L=1u\nM2 b a 0 0 n W=1u L=1u\n"
        "C1 a 0 1p\nC2 b 0 1p\n.ic v(a)={high} v(b)={low}\n.param high=%s low=%s\n"
    )
    for high, low in ((5, 0.2), (0.2, 5)):
        scene = read(text % (high, low))
        start = scene.compile().start()
        np.testing.assert_allclose(start.y, [high, low], rtol=1e-12)


def test_a_c_project_begins_at_the_operating_point(tmp_path):
    scene = cotree.load(HERE / "netlists" / "amplifier.cir")
    model = scene.compile()
    model.write(tmp_path, "rodas5")
    text = (tmp_path / "main.c").read_text()
    assert f"{model.start().y[0]:.12g}"[:10] in text


def test_commands_take_netlists(tmp_path, capsys):
    assert main(["run", str(HERE / "netlists" / "divider.cir")]) == 0
    assert "L1.i" in capsys.readouterr().out
    wrong = tmp_path / "wrong.sp"
    wrong.write_text("title\nR1 a 0\n")
    assert main(["run", str(wrong)]) == 2
    assert "wrong.sp:2:" in capsys.readouterr().err


def cmos(rows):
    return read(
        "title\n.model n NMOS(VTO=1 KP=1m LAMBDA=0.02)\n.model p PMOS(VTO=-1 KP=0.5m)\n"
        f"Vdd v 0 5\n{rows}\n"
    )


@pytest.mark.sampled(2)
@pytest.mark.parametrize("volts", [0.0, 1.0, 2.4, 5.0])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_chains_of_inverters_without_capacitors_have_operating_points(volts, n):
    """Each rail is reached but for what leaks: some 1e-12 A through some kilo-ohms."""
    rows = [
        f"Mn{i} a{i + 1} a{i} 0 0 n W=2u L=1u\nMp{i} a{i + 1} a{i} v v p W=4u L=1u"
        for i in range(n)
    ]
    scene = cmos("\n".join([f"Va a0 0 {volts}", *rows, f"C1 a{n} 0 1p"]))
    model = scene.compile()
    start = model.start()
    n_states = len(model.states) - model.kernels.layout.n_algebraic
    assert np.max(np.abs(model.rhs(0.0, start.y)[:n_states])) < 1.0  # 1e-12 A into 1 pF
    if volts in (0.0, 5.0):
        high = (volts == 0.0) == (n % 2 == 1)
        assert start.y[0] == pytest.approx(5.0 if high else 0.0, abs=1e-8)


def test_a_transistor_that_conducts_without_a_voltage_keeps_its_digits():
    """k (vgs - vt) vds of a nanovolt, to rounding: no difference of squares."""
    scene = cotree.Scene("small")
    scene.edge("V", "voltage_source", "d", "ground", voltage=1e-9)
    scene.edge("G", "voltage_source", "g", "ground", voltage=5.0)
    scene.edge("M", "mosfet_n", "d", "g", "ground", factor=2e-3, threshold=1.0, leakage=0.0)
    scene.output("i", "M.id")
    found = scene.compile().output_values(0.0, [])[0]
    assert found == pytest.approx(2e-3 * (4e-9 - 0.5e-18), rel=1e-15)


def test_letters_that_simulators_read_differently_are_told_with_their_line():
    scene = read("title\nI1 0 a 1A\nR1 a 0 {2a*3}\nC1 a 0 5aF\nR2 a 0 1mA\nRamp a A 2\nR3 A 0 1")
    assert scene.parameters["I1"].value == 1.0
    told = [note for note in scene.origin.notes if "letter a" in note]
    assert [note[:8] for note in told] == ["a.cir:2:", "a.cir:3:", "a.cir:4:"]
    assert "'1A' is taken as in amperes" in told[0]
    assert "'5aF' is taken as 1e-18" in told[2]


#: What the rows give at 97 us and 911 us with ``.tran 1u``, by formulas of ngspice's manual; times
#: and frequencies of zero are not given ones, and the first delay of EXP is then a step, too.
WAVES = {
    "EXP(0 1 0 100u 500u 100u)": [
        1 - np.exp(-0.96),
        1 - np.exp(-9.10) - (1 - np.exp(-4.11)),
    ],
    "EXP(0 1)": [np.exp(-95) - np.exp(-96), 0.0],
    "EXP(0 1 100u 0 300u 0)": [0.0, 0.0],
    "PULSE(0 1 50u 0 0 0 0)": [1.0, 1.0],
    "SIN(1 1 0)": [1.0, 1.0],
    "SFFM(1 2 3k 0.5 1k 30 60)": [
        1 + 2 * np.sin(2 * np.pi * 3e3 * t + np.pi / 6 + 0.5 * np.sin(2e3 * np.pi * t + np.pi / 3))
        for t in (97e-6, 911e-6)
    ],
    "AM(2 3 1k 20k 50u)": [
        2 * (3 + np.sin(2e3 * np.pi * t)) * np.sin(4e4 * np.pi * t) for t in (47e-6, 861e-6)
    ],
}


@pytest.mark.sampled(5)
@pytest.mark.parametrize("row", WAVES)
def test_waveforms_with_their_defaults(row):
    for end, value in zip(("97u", "911u"), WAVES[row], strict=True):
        scene = read(f"title\nV1 a 0 {row}\nR1 a 0 1\n.tran 1u {end}\n")
        scene.output("a", "a.v")
        found = scene.compile().output_values(scene.defaults.t_end, [])
        assert found[0] == pytest.approx(value, rel=1e-9, abs=1e-12)


#: Currents [uA] out of sources at collector, base, emitter and substrate with gmin of 1e-6 S and
#: hardly any junction, of ngspice 39: beside both junctions, and from the substrate to the
#: collector of npn and the base of pnp transistors.
LEAKS = {
    "Q1 c b e s qn": ("3 0 0 -5", [-11.0, 3.0, 0.0, 8.0]),
    "Q1 c b e qn": ("3 -2 0 0", [-8.0, 7.0, -2.0, 0.0]),
    "Q1 c b e s qn 3 m=2": ("3 0 0 0", [-12.0, 6.0, 0.0, 6.0]),
    "Q1 c b e qp": ("-3 2 0 0", [5.0, -9.0, 2.0, 0.0]),
    "D1 c b d 3 m=2": ("-1 0 0 0", [1.0, -1.0, 0.0, 0.0]),
    # Of several bipolar transistors in parallel it is as many times as large, of diodes, those of
    # channels among them, it is not.
    "M1 c b e s n m=3": ("1 0 1 0", [-1.0, 0.0, -1.0, 2.0]),
}


@pytest.mark.parametrize("row", LEAKS)
def test_conductances_beside_junctions_are_where_ngspice_has_them(row):
    volts, expected = LEAKS[row]
    models = ".model qn NPN(IS=1e-20)\n.model qp PNP(IS=1e-20)\n.model d D(IS=1e-20)\n"
    models += ".model n NMOS(IS=1e-20 VTO=5)\n"
    nodes = list(zip("cbes", volts.split(), strict=True))
    # Nodes that the device leaves out hang on resistors of no current.
    rows = "".join(f"V{n} {n} 0 {v}\nR{n} {n} {n}x 1\n" for n, v in nodes)
    scene = read(f"title\n.options gmin=1e-6\n{models}{rows}{row}\n")
    for node in "cbes":
        scene.output(f"at_{node}", f"V{node}.i")
    model = scene.compile()
    found = 1e6 * model.output_values(0.0, model.start().y)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_zero_exponents_and_shares_are_zero():
    """The capacitance of M = 0 is constant, that of FC = 0 straight from no voltage on."""
    rows = {"M=0": lambda v: 1.0, "FC=0": lambda v: 1 + 0.5 * v, "": lambda v: (1 - v) ** -0.5}
    for given, capacity in rows.items():
        model = f".model d D(IS=1e-30 CJO=1n {given})"
        scene = read(f"title\n{model}\nI1 0 a 1u\nD1 a 0 d\n.options gmin=0\n.tran 1 1 uic\n")
        rate = scene.compile().rhs(0.0, [0.3])[0]
        assert rate == pytest.approx(1e3 / capacity(0.3), rel=1e-9), given


def test_a_substrate_has_a_charge():
    model = ".model q NPN(IS=1e-20 CJS=2p MJS=0.5 VJS=0.8)"
    scene = read(f"title\n{model}\nI1 c 0 1u\nQ1 c 0 0 s q\nVs s 0 -1\n.tran 1 1 uic\n")
    rate = scene.compile().rhs(0.0, [-2.0])[0]
    # One microampere, less the conductances of two volts here and one there.
    expected = (1e-6 - 2e-12 - 1e-12) / (2e-12 / np.sqrt(1 + 2 / 0.8))
    assert abs(rate) == pytest.approx(expected, rel=1e-5)
    scene = cotree.Scene("three")
    with pytest.raises(cotree.SceneError, match="name its substrate as the fourth node"):
        scene.edge(
            **{"name": "Q", "type": "bjt_npn", "saturation_current": 1e-15},
            **{"forward_gain": 9.0, "substrate_capacitance": 1e-12},
        )


LONG_TAIL = (
    "title\n.model q NPN(IS=1e-15 BF=100 RB=100 TF=0.5n{more})\nVcc cc 0 10\nVee ee 0 -10\n"
    "Vin in 0 PULSE(-2 2 100n 1n 1n 400n 1u)\nRc1 cc c1 5k\nRc2 cc c2 5k\nQ1 c1 in e q\n"
    "Q2 c2 0 e q\nQ3 c2 0 e q\nRe e ee 5k\n.tran 1n {end}\n"
)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    "method", ["rodas5", *(pytest.param(n, marks=pytest.mark.slow) for n in ("ida", "cvode"))]
)
def test_charges_in_transit_alone_do_not_stop_a_run(method):
    """A long-tailed pair that switches: its transistors have no capacitance of their own."""
    scene = read(LONG_TAIL.format(more="", end="620n"))
    assert "be_capacitance" in scene.edges["Q2"].fields
    assert any("transit times and no capacitance of be" in note for note in scene.origin.notes)
    scene.output("c2", "c2.v")
    ends = []
    for more in ("", " CJE=1e-17"):
        scene = read(LONG_TAIL.format(more=more, end="620n"))
        scene.output("c2", "c2.v")
        by = method if not more else "rodas5"
        result = scene.compile().simulate((0, 6.2e-7), [0, 5.03e-7, 6.2e-7], by, rtol=1e-7)
        assert result.success, result.message
        ends.append(result["c2"])
    # Three times the least capacitance or a third of it moves nothing: 1e-4 of 10 V in the edge.
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-3)


@pytest.mark.slow
def test_a_transit_time_with_an_early_voltage_is_read():
    """Its charge depends on the collector, whose junction is given a capacitance, too."""
    scene = read(LONG_TAIL.format(more=" VAF=50", end="10n"))
    assert {"be_capacitance", "bc_capacitance"} <= scene.edges["Q1"].fields.keys()
    assert scene.compile().simulate().success


@pytest.mark.sampled(2)
@pytest.mark.parametrize("uic", ["", " uic"])
@pytest.mark.parametrize("sign", ["", "-"])
def test_windings_of_one_flux_are_the_limit_of_close_ones(sign, uic):
    """K = 1 is met as 1 - k is, 1e-6 and then 1e-7 of what flows at the loads."""
    text = (
        "title\nV1 a 0 SIN(3 10 1k)\nR1 a p 10\nL1 p 0 10m ic=0.02\nL2 s 0 40m ic=0.003\n"
        f"L3 0 q 2.5m\nK1 L1 L2 {sign}{{k}}\nK2 L1 L3 {{k}}\nK3 L2 L3 {sign}{{k}}\nRl s 0 500\n"
        f"Rq q 0 50\nCl s 0 100n\n.tran 2u 2.3m 0 2u{uic}\n"
    )
    ends = []
    for k in ("1", "0.999999", "0.9999999"):
        scene = read(text.replace("{k}", k))
        for node in "psq":
            scene.output(f"at_{node}", f"{node}.v")
        result = scene.compile().simulate((0, 2.3e-3), [0, 1e-3, 2.3e-3], rtol=1e-10, atol=1e-13)
        ends.append(np.array([result[name][1:] for name in scene.outputs]))
    kinds = {edge.component.name for edge in read(text.replace("{k}", "1")).edges.values()}
    assert "transformer" in kinds
    assert "coupled_inductors" not in kinds
    far, near = (np.max(np.abs(end - ends[0])) for end in ends[1:])
    assert near == pytest.approx(far / 10, rel=0.05)
    assert near < 1e-5


def test_one_flux_with_others_less_close_is_refused():
    rows = "L1 a 0 1\nL2 b 0 1\nL3 c 0 1\nK1 L1 L2 1\nK2 L2 L3 0.5\n"
    with pytest.raises(cotree.SceneError, match=r"a\.cir:\d: windings that are coupled completely"):
        read(f"title\n{rows}")


def test_one_flux_by_a_parameter_says_what_to_write():
    rows = ".param k=1\nV1 a 0 1\nR1 a p 1\nL1 p 0 1m\nL2 s 0 1m\nR2 s 0 1\nK1 L1 L2 {k}\n"
    with pytest.raises(cotree.ParameterError, match="write the coupling as the number 1"):
        read(f"title\n{rows}.tran 1u 1m\n").compile()


def test_no_resistance_and_no_inductance_are_shorts_and_no_capacitance_is_nothing():
    """Of links in parallel one is left, and a link within a loop of links is none."""
    rows = ["V1 a 0 6", "R0 a b 0", "R9 a b {z}", "L0 b c 0", "R8 c a R=0", "C0 c 0 0p"]
    circuit = read("\n".join(["title", ".param z=0", *rows, "R1 c d 1k", "R2 d 0 2k", ""]))
    circuit.output("d", "d.v")
    model = circuit.compile()
    assert set(circuit.edges) == {"V1", "R0", "L0", "R1", "R2"}
    assert model.output_values(0.0, model.start().y)[0] == pytest.approx(4.0, rel=1e-12)


def test_coefficients_of_temperature_have_no_effect_at_27_degrees():
    for given in ("TC=1m,2u", "tc=1m", "tc1=1m tc2=2u", "TC=0,0 m=2"):
        circuit = read(f"title\nV1 a 0 DC=1 AC = 2\nR1 a 0 2 {given}\nC1 a 0 3 {given}\n")
        assert [circuit.parameters[name].value for name in ("V1", "R1", "C1")] == [1.0, 2.0, 3.0]


@pytest.mark.compiler
def test_a_relaxation_oscillator_and_its_sensitivity():
    """A capacitor charged over a resistance, discharged from 3 V to 1 V by a switch of 10 ohms."""
    circuit = read(
        "title\nV1 a 0 5\nR1 a c 1k\nC1 c 0 100n ic=0\nS1 c 0 c 0 m\n"
        ".model m sw(vt=2 vh=1 ron=10 roff=1e15)\n.tran 0.1u 0.35m uic\n.end\n"
    )
    model = circuit.compile(["m_vt"])

    def voltage(vt):
        """Go from switch to switch by exponentials; 1e15 ohms are none here."""
        end, t, on, v = 0.35e-3, 0.0, False, 0.0
        while True:
            goal, tau = (5 * 10 / 1010, 1e-7 / (1e-3 + 0.1)) if on else (5.0, 1e-4)
            bound = vt - 1 if on else vt + 1
            lasts = tau * np.log((v - goal) / (bound - goal))
            if t + lasts > end:
                return goal + (v - goal) * np.exp((t - end) / tau)
            t, on, v = t + lasts, not on, bound

    result = model.simulate(rtol=1e-10, atol=1e-12, throw=True)
    # Nine switches, each located to some digits less than the run has.
    assert result["C1.v"][-1] == pytest.approx(voltage(2.0), rel=1e-7)
    slope = (voltage(2.0 + 1e-5) - voltage(2.0 - 1e-5)) / 2e-5
    assert result.sensitivity("C1.v", "m_vt")[-1] == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *[("V(a)^3", 8.0), ("V(a)**2", 4.0), ("pwr(V(a), 3)", -8.0), ("-V(a)^2", -4.0)],
        *[("pwr(0 - 2, 3)", -8.0), ("{pwr(-2, 2)}", -4.0), ("pwr(V(0), 0)", 1.0)],
        *[("pwr(V(a), k - 7)", -1.0), ("pwr(V(a) + 2, V(0))", 1.0), ("pwr(V(0), k)", 0.0)],
        *[("2^3^2", 64.0), ("2-3-4", -5.0), ("V(a)*-3", 6.0), ("i(V1)*1k", 2.0)],
        *[("u(V(a)) + uramp(-V(a))*10 + sgn(V(a))*100", -80.0), ("limit(V(a), 0, 1)", 0.0)],
        *[("V(a) > -3 && V(a) < 0 ? 1 : 2", 1.0), ("!(V(a) > 0)", 1.0), ("(V(a) > -3)*5", 5.0)],
        *[("V(a) < -3 || V(a) > 5 ? 1 : V(a) > 0 ? 2 : 3", 3.0), ("V(a,0)*1m", -2e-3)],
        *[("log10(100) + ln(exp(1)) + ceil(-2.5) + nint", None), ("if(V(a) > 0, 1, {k})", None)],
        *[("log10(100) + ln(exp(1)) + ceil(-2.5)", 1.0), ("if(V(a) > 0, 1, k)", 7.0)],
        *[("asinh(2) + acosh(2) + atanh(.5)", 3.3098997), ("2u*1meg", 2.0)],
        *[("u(V(0)) + u(V(a))*10", 0.5), ("u2(-V(a)/8) + u2(-V(a))*10 + u2(V(a))", 10.25)],
        *[("asinh(V(a)*1e8)", -19.8069751), ("asinh(V(a)*1e4)", -10.5966347)],
    ],
)
def test_expressions_of_voltages_mean_what_they_do_in_ngspice(text, value):
    netlist = f"title\n.param k=7\nV1 a 0 -2\nR1 a 0 1k\nB1 p 0 V={text}\nR2 p 0 1k\n"
    if value is None:
        with pytest.raises(cotree.SceneError, match=r"a\.cir:5: "):
            read(netlist)
        return
    circuit = read(netlist)
    circuit.output("p", "p.v")
    model = circuit.compile(tunable=[])
    # Values of ngspice 39, printed with six digits.
    assert model.output_values(0.0, model.start().y)[0] == pytest.approx(value, rel=1e-6)


def test_a_negative_resistance_is_read():
    """6 A flow through 3 ohms less 2, so that 12 V lie against the current."""
    circuit = read("title\nV1 a 0 6\nR1 a b 3\nR2 b 0 -2\n")
    circuit.output("b", "b.v")
    model = circuit.compile()
    assert model.output_values(0.0, model.start().y)[0] == pytest.approx(-12.0, rel=1e-12)


def test_negative_storages_are_read():
    """0.6 nF are left of the capacitors, and 0.6 mH of the inductors; ngspice runs both."""
    circuit = read(
        "title\nV1 a 0 1\nR1 a b 1k\nC1 b 0 1n\nC2 b 0 -0.4n\n"
        "R2 a c 1k\nL1 c d 1m\nL2 d 0 -0.4m\n.tran 1n 1u uic\n"
    )
    circuit.output("b", "b.v")
    circuit.output("c", "c.v")
    result = circuit.compile().simulate(rtol=1e-9, atol=1e-12)
    # Both time constants are 0.6 us.
    assert result["b"][-1] == pytest.approx(1.0 - np.exp(-1.0 / 0.6), abs=1e-7)
    assert result["c"][-1] == pytest.approx(np.exp(-1.0 / 0.6), abs=1e-7)


def test_functions_of_a_netlist_and_nodes_of_all_circuits():
    """Three currents at 1 kohm meet: (6 - x) - x - x**2 = 0; ngspice 39 prints 1.645751."""
    circuit = read(
        "title\n.param Vs=3 g=2\n.func sq(x) {x*x}\n.func lim(a,b) {min(sq(a), b)+g}\n"
        ".global vdd\nV1 vdd 0 {lim(Vs, 4)}\nXa out cell\nR2 out 0 1k\n"
        ".subckt cell o\n.func half(x) = 'x/2'\nR1 vdd o {sq(10)*half(20)}\n"
        "B1 o 0 I=sq(V(o))/1000\n.ends\n"
    )
    circuit.output("o", "out.v")
    model = circuit.compile(["Vs", "g"])
    start = model.start()
    assert model.output_values(0.0, start.y)[0] == pytest.approx(7**0.5 - 1, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        # Two values at 1 s are a jump, as on an oscilloscope.
        ("PWL(0 1 1 1 1 2 2 3)", [1.0, 1.0, 2.5, 3.0]),
        ("PWL(0 0 {T/2} {A} {T} 0)", [2.0, 2.0, 0.0, 0.0]),
        ("PULSE(0 1 0 1 1 0.1 4 0)", [0.5, 0.6, 0.0, 0.5]),
    ],
)
def test_waveforms_of_points_and_parameters(text, values):
    scene = read(f"title\n.param T=1 A=4\nV1 a 0 {text}\nR1 a 0 1k\n.tran {{T/100}} {{9*T}}\n")
    scene.output("a", "a.v")
    model = scene.compile()
    times = [0.25, 0.75, 1.5, 2.0] if "PULSE" not in text else [0.5, 1.5, 3.0, 4.5]
    result = model.simulate((0, 5), [0.0, *times])
    assert result["a"][1:] == pytest.approx(values, abs=1e-12)


def test_the_second_delay_of_an_exponential_may_be_shorter():
    """ngspice 39 leaves out both exponentials before the first delay, then begins with both."""
    scene = read("title\nV1 a 0 EXP(1 3 1 0.4 0.5 0.7)\nR1 a 0 1k\n.tran 0.01 3\n")
    scene.output("a", "a.v")
    found = scene.compile().simulate((0, 2), [0.0, 0.75, 1.5, 2.0])["a"]
    after = [
        1.0 + 2.0 * (1.0 - np.exp(-(t - 1.0) / 0.4)) - 2.0 * (1.0 - np.exp(-(t - 0.5) / 0.7))
        for t in (1.5, 2.0)
    ]
    assert found == pytest.approx([1.0, 1.0, *after], abs=1e-12)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e6", 1e6),
        ("2*1E3/1e-3", 2e6),
        # ngspice 39 prints these.
        ("2^3^2", 64.0),
        ("2**3**2", 64.0),
        ("2**-1**2", 0.25),
        ("n**3", 8.0),
        ("n^-1", 0.5),
        ("pow(n, 3)", -8.0),
        ("pwr(n, 3)", 8.0),
        ("-n**2", -4.0),
    ],
)
def test_expressions_of_parameters_mean_what_they_do_in_ngspice(text, value):
    scene = read(f"title\n.param n=-2\nV1 a 0 {{{text}}}\nR1 a 0 1k\n")
    scene.output("a", "a.v")
    assert scene.compile(optimize="-O0").output_values(0.0, []) == pytest.approx([value], rel=1e-15)
    assert not scene.origin.notes
