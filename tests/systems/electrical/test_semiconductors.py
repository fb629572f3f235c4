"""Diodes and transistors with what real ones have: closed forms, and charges that are conserved."""

from __future__ import annotations

import numpy as np
import pytest

import cotree

U = 0.02585


def depleted(v, capacity, potential, grading, share):
    """Return the charge of a depletion layer, with a parabola beyond a share of the potential."""

    def below(x):
        return capacity * potential / (1 - grading) * (1 - (1 - x / potential) ** (1 - grading))

    edge = share * potential
    if v <= edge:
        return below(v)
    slope = capacity * (1 - share) ** -grading
    bend = slope * grading / (potential * (1 - share))
    return below(edge) + slope * (v - edge) + bend * (v - edge) ** 2 / 2


def test_a_depletion_layer_takes_the_charge_that_flows_into_it():
    scene = cotree.Scene("layer")
    scene.parameter("C", 1e-9)
    layer = {"junction_capacitance": "C", "junction_potential": 0.8, "junction_grading": 0.4}
    scene.edge("I", "current_source", "ground", "a", current=1e-3)
    scene.edge("D", "diode", "a", "ground", saturation_current=1e-30, initial={"v": -5.0}, **layer)
    model = scene.compile(["C"])
    result = model.simulate((0, 3.6e-6), rtol=1e-10, atol=1e-12)
    end = result["D.v"][-1]
    assert end > 0.45  # beyond half of the potential
    charge = depleted(end, 1e-9, 0.8, 0.4, 0.5) - depleted(-5.0, 1e-9, 0.8, 0.4, 0.5)
    # Some hundred steps of rtol 1e-10.
    assert charge == pytest.approx(3.6e-9, rel=1e-8)
    # Q(v, C) = C q(v) stays: dv/dC = -q / (C dq/dv).
    slope = (depleted(end + 1e-6, 1e-9, 0.8, 0.4, 0.5) - depleted(end, 1e-9, 0.8, 0.4, 0.5)) / 1e-6
    assert result.sensitivity("D.v", "C")[-1] == pytest.approx(-3.6 / slope, rel=1e-5)


def test_a_diode_with_resistance_and_breakdown_conducts_by_its_law():
    scene = cotree.Scene("static")
    more = {"series_resistance": 10.0, "leakage": 1e-9, "breakdown_voltage": 6.0}
    for name, current in (("on", 1e-3), ("back", -5e-4)):
        scene.edge(f"I{name}", "current_source", "ground", name, current=current)
        scene.edge(name, "diode", name, "ground", saturation_current=1e-14, **more)
        scene.output(f"v_{name}", f"{name}.v")
        scene.output(f"j_{name}", f"{name}.junction.v")
        scene.output(f"i_{name}", f"{name}.i")
    model = scene.compile()
    got = dict(zip(model.outputs, model.output_values(0.0, model.start().y), strict=True))
    for name, current in (("on", 1e-3), ("back", -5e-4)):
        v = got[f"j_{name}"]
        law = 1e-14 * np.expm1(v / U) + 1e-9 * v - 1e-3 * np.exp(-(v + 6.0) / U)
        assert law == pytest.approx(current, rel=1e-10)
        assert got[f"i_{name}"] == pytest.approx(current, rel=1e-12)
        assert got[f"v_{name}"] == pytest.approx(v + 10.0 * current, rel=1e-12)


GUMMEL_POON = {
    **{"saturation_current": 1e-15, "forward_gain": 120.0, "reverse_gain": 4.0},
    **{"forward_ideality": 1.02, "reverse_ideality": 1.05, "be_recombination": 1e-14},
    **{"bc_recombination": 2e-14, "forward_early_voltage": 60.0, "reverse_early_voltage": 12.0},
    **{"forward_knee_current": 0.02, "reverse_knee_current": 0.01},
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("type", "sign"), [("bjt_npn", 1), ("bjt_pnp", -1)])
@pytest.mark.parametrize(("vbe", "vbc"), [(0.75, -3.0), (0.7, 0.6), (-1.0, 0.65), (-2.0, -2.0)])
def test_currents_are_those_of_gummel_and_poon(type, sign, vbe, vbc):
    scene = cotree.Scene("static")
    scene.edge("Ve", "voltage_source", "b", "ground", voltage=sign * vbe)
    scene.edge("Vc", "voltage_source", "b", "c", voltage=sign * vbc)
    scene.edge("Q", type, "c", "b", "ground", **GUMMEL_POON)
    scene.output("ic", "Q.ic")
    scene.output("ib", "Q.ib")
    ic, ib = scene.compile().output_values(0.0, [])
    f = 1e-15 * np.expm1(vbe / (1.02 * U))
    r = 1e-15 * np.expm1(vbc / (1.05 * U))
    leak_e = 1e-14 * np.expm1(vbe / (1.5 * U))
    leak_c = 2e-14 * np.expm1(vbc / (2.0 * U))
    qb = (1 + np.sqrt(1 + 4 * (f / 0.02 + r / 0.01))) / (1 - vbc / 60 - vbe / 12) / 2
    assert sign * ic == pytest.approx((f - r) / qb - r / 4 - leak_c, rel=1e-12)
    assert sign * ib == pytest.approx(f / 120 + r / 4 + leak_e + leak_c, rel=1e-12)


def test_the_charge_of_a_base_does_not_depend_on_the_way():
    """Both junctions go around a loop of voltages; what flowed into the base flowed out again."""
    # No static current into the base: what flows there is charge.
    charged = {
        **GUMMEL_POON,
        **{"be_recombination": 0.0, "bc_recombination": 0.0},
        **{"forward_gain": 1e30, "reverse_gain": 1e30},
        **{"be_capacitance": 2e-12, "bc_capacitance": 1e-12},
        **{"forward_transit_time": 1e-9, "reverse_transit_time": 1e-8},
    }
    scene = cotree.Scene("loop")
    scene.edge("Ve", "sine_voltage", "b", "ground", offset=0.68, amplitude=0.05, frequency=1e6)
    scene.edge(
        *("Vc", "sine_voltage", "b", "c"),
        **{"offset": -1.0, "amplitude": 0.9, "frequency": 1e6, "phase": 1.3},
    )
    scene.edge(
        *("Q", "bjt_npn", "c", "b", "ground"),
        **charged,
    )
    scene.edge("I", "current_source", "ground", "sum", current="Q.ib")
    scene.edge("C", "capacitor", "sum", "ground", capacitance=1e-12)
    result = scene.compile().simulate((0, 1e-6), rtol=1e-10, atol=1e-12)
    most = np.max(np.abs(result["C.v"]))
    assert most > 1e-2
    # A hundred steps of rtol 1e-10.
    assert abs(result["C.v"][-1]) < 1e-7 * most


@pytest.mark.parametrize(("type", "sign"), [("mosfet_n", 1), ("mosfet_p", -1)])
def test_the_bulk_raises_the_threshold(type, sign):
    scene = cotree.Scene("bulk")
    for name, volts in (("d", 3.0), ("g", 2.0), ("b", -1.5)):
        scene.edge(f"V{name}", "voltage_source", name, "ground", voltage=sign * volts)
    fields = {"factor": 1e-3, "threshold": sign * 0.7, "leakage": 0.0}
    body = {"body_effect": 0.5, "surface_potential": 0.65}
    scene.edge("M", type, "d", "g", "ground", "b", **fields, **body)
    # Drain and source exchanged: the lower of them counts.
    scene.edge("N", type, "ground", "g", "d", "b", **fields, **body)
    scene.output("m", "M.id")
    scene.output("n", "N.id")
    m, n = scene.compile().output_values(0.0, [])
    threshold = 0.7 + 0.5 * (np.sqrt(0.65 + 1.5) - np.sqrt(0.65))
    assert sign * m == pytest.approx(0.5e-3 * (2.0 - threshold) ** 2, rel=1e-12)
    assert sign * n == pytest.approx(-0.5e-3 * (2.0 - threshold) ** 2, rel=1e-12)


def test_what_does_not_go_together_is_refused():
    scene = cotree.Scene("wrong")
    base = {"saturation_current": 1e-15, "forward_gain": 100.0, "forward_transit_time": 1e-9}
    with pytest.raises(cotree.SceneError, match=r"'Q' .* give a bc_capacitance"):
        scene.edge("Q", "bjt_npn", "c", "b", "e", forward_early_voltage=50.0, **base)
    fields = {"factor": 1e-3, "threshold": 0.7, "body_effect": 0.5}
    with pytest.raises(cotree.SceneError, match="'M' has a body_effect: name its bulk"):
        scene.edge("M", "mosfet_n", "d", "g", "s", **fields)
    with pytest.raises(cotree.SceneError, match="start of the simulation is 'rest'"):
        scene.simulation(start="rest")
    with pytest.raises(cotree.SceneError, match="held of the simulation needs start"):
        scene.simulation(held={"a": 1.0})


def test_only_electrical_networks_begin_at_rest():
    scene = cotree.Scene("heat")
    scene.edge("R", "thermal_resistor", "a", "ground", resistance=1.0)
    scene.edge("C", "heat_capacitor", "a", "ground", capacity=1.0)
    scene.simulation(start="operating point")
    with pytest.raises(
        cotree.SceneError, match="has no operating point: it is not part of an electrical network"
    ):
        scene.compile()


@pytest.mark.parametrize("method", ["rodas5", "rodas4"])
def test_kinks_that_two_fast_diodes_reach_together_are_located(method):
    """A bridge just before two junctions reach 0.5 V; explicit steps to there are unstable."""
    scene = cotree.Scene("bridge")
    scene.edge("V", "sine_voltage", "a", "b", offset=0.0, amplitude=10.0, frequency=50.0)
    values = {"saturation_current": 1e-14, "thermal_voltage": 0.027158162857515335}
    values |= {"series_resistance": 0.1, "junction_capacitance": 2e-12, "leakage": 1e-12}
    for i, ends in enumerate((("a", "p"), ("b", "p"), ("ground", "a"), ("ground", "b")), 1):
        scene.edge(f"D{i}", "diode", *ends, **values)
    scene.edge("R", "resistor", "p", "ground", resistance=1e3)
    scene.edge("C", "capacitor", "p", "ground", capacitance=1e-5)
    begin = {"D1": -5.033214112232773, "D2": 0.500000037915037, "D3": 0.49999991923898}
    begin["D4"] = -5.033213741879156
    initial = {f"{name}.junction.v": v for name, v in begin.items()} | {"C.v": 4.533213876039293}
    t = 0.011866398624069
    model = scene.compile(tunable=[])
    settings = {"rtol": 1e-7, "atol": 1e-9, "throw": True, "initial": initial}
    for span in (1e-9, 1e-5):
        result = model.simulate((t, t + span), method=method, **settings)
        expected = model.simulate((t, t + span), method="ida", **settings)
        for name in initial:
            assert result[name][-1] == pytest.approx(expected[name][-1], rel=1e-6)
