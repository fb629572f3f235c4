"""Diodes and transistors: static laws without capacitances; add capacitors for these."""

from __future__ import annotations

from typing import Any

from cotree.components.component import Component, Role
from cotree.components.law import Law
from cotree.components.ports import one_port, optional, value
from cotree.components.terminal import Kind, Measure, Terminal

_DOMAIN = "electrical"

_THERMAL_VOLTAGE = optional(
    "thermal_voltage", "V", "k T / e, times an ideality factor", 0.02585, "positive"
)


def _junction(voltage: Any, saturation_current: Any, thermal_voltage: Any) -> Any:
    import sympy

    return saturation_current * (sympy.exp(voltage / thermal_voltage) - 1)


DIODE = one_port(
    "diode",
    "Shockley diode: I (exp(v / V) - 1)",
    (value("saturation_current", "A", "I, what flows backwards"), _THERMAL_VOLTAGE),
    Terminal(
        _DOMAIN,
        Kind.DISSIPATOR,
        through=Law.taking(("across", "saturation_current", "thermal_voltage"), _junction),
    ),
)


def _bipolar(name: str, doc: str, sign: int) -> Component:
    """Make a bipolar transistor; ``sign`` is -1 for one whose junctions conduct the other way.

    Transport form: Ic = It - Ibc', with It = I (exp(vbe / V) - exp(vbc / V)).
    """

    def law(across: Any, other: Any, current: Any, gain: Any, thermal_voltage: Any) -> Any:
        own = _junction(sign * across, current, thermal_voltage)
        return sign * (own * (1 + 1 / gain) - _junction(sign * other, current, thermal_voltage))

    def port(own: str, other: str, gain: str, between: tuple[str, str]) -> Terminal:
        names = ("across", f"across_{other}", "saturation_current", gain, "thermal_voltage")
        return Terminal(
            _DOMAIN,
            Kind.DISSIPATOR,
            own,
            through=Law.taking(names, law),
            is_passive=False,
            between=between,
        )

    return Component(
        name,
        Role.NETWORK,
        doc,
        fields=(
            value("saturation_current", "A", "of both junctions"),
            value("forward_gain", "1", "collector current per base current"),
            optional("reverse_gain", "1", "the same with collector and emitter exchanged", 1.0),
            _THERMAL_VOLTAGE,
        ),
        domains=(_DOMAIN,),
        ports=(
            port("be", "bc", "forward_gain", ("base", "emitter")),
            port("bc", "be", "reverse_gain", ("base", "collector")),
        ),
        terminals=("collector", "base", "emitter"),
        measures=(
            Measure("ib", "A", ((1, "through", "be"), (1, "through", "bc"))),
            Measure("ic", "A", ((-1, "through", "bc"),)),
            Measure("ie", "A", ((-1, "through", "be"),)),
            Measure("vbe", "V", ((1, "across", "be"),)),
            Measure("vbc", "V", ((1, "across", "bc"),)),
            Measure("vce", "V", ((1, "across", "be"), (-1, "across", "bc"))),
        ),
    )


BJT_NPN = _bipolar("bjt_npn", "bipolar transistor after Ebers and Moll, npn", 1)
BJT_PNP = _bipolar("bjt_pnp", "bipolar transistor after Ebers and Moll, pnp", -1)


def _mosfet(name: str, doc: str, sign: int) -> Component:
    """Make a field-effect transistor; ``sign`` is -1 for one with a channel of holes.

    Drain and source may change places: i = k/2 (a^2 - b^2) (1 + l |vds|), where a and b are what
    the gate is above the threshold, against source and drain.
    """

    def law(
        across: Any, gate: Any, factor: Any, threshold: Any, modulation: Any, leakage: Any
    ) -> Any:
        import sympy

        vds, vgs = sign * across, sign * gate

        def above(voltage: Any) -> Any:
            own = voltage - sign * threshold
            return sympy.Piecewise((own**2, own > 0), (0, True))

        channel = factor / 2 * (above(vgs) - above(vgs - vds)) * (1 + modulation * sympy.Abs(vds))
        return sign * channel + leakage * across

    names = ("across", "across_gs", "factor", "threshold", "modulation", "leakage")
    return Component(
        name,
        Role.NETWORK,
        doc,
        fields=(
            value("factor", "A/V^2", "of the square law: mobility, oxide, width by length"),
            value("threshold", "V", "of the gate against the source", ""),
            optional("modulation", "1/V", "of the channel's length", 0.0, "nonnegative"),
            optional("leakage", "S", "between drain and source", 1e-12, "nonnegative"),
        ),
        domains=(_DOMAIN,),
        ports=(
            Terminal(
                _DOMAIN,
                Kind.DISSIPATOR,
                "ds",
                through=Law.taking(names, law),
                is_passive=False,
                between=("drain", "source"),
            ),
            Terminal(
                _DOMAIN,
                Kind.THROUGH_SOURCE,
                "gs",
                through=Law(lambda: 0),
                is_passive=False,
                between=("gate", "source"),
            ),
        ),
        terminals=("drain", "gate", "source"),
        measures=(
            Measure("id", "A", ((1, "through", "ds"),)),
            Measure("vds", "V", ((1, "across", "ds"),)),
            Measure("vgs", "V", ((1, "across", "gs"),)),
        ),
    )


MOSFET_N = _mosfet("mosfet_n", "field-effect transistor by the square law, n channel", 1)
MOSFET_P = _mosfet("mosfet_p", "field-effect transistor by the square law, p channel", -1)

COMPONENTS = (DIODE, BJT_NPN, BJT_PNP, MOSFET_N, MOSFET_P)
