"""Transistors: static laws, and further effects where a scene gives their fields."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from cotree.components.bipolar import FIELDS, TERMINALS, bipolar, measures
from cotree.components.component import Component, optional, value
from cotree.components.diodes import DIODE
from cotree.components.junctions import is_absent, junction_current, symbol
from cotree.components.law import Law
from cotree.components.ports import scalar
from cotree.components.terminal import Kind, PortMeasure, Terminal
from cotree.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.components.component import Adapt, Adapted, Given, Nodes

_DOMAIN = "electrical"


def _bipolar(name: str, doc: str, sign: int) -> Component:
    """Make a bipolar transistor; ``sign`` is -1 for one whose junctions conduct the other way.

    Transport form: Ic = It - Ibc', with It = I (exp(vbe / V) - exp(vbc / V)).
    """

    def law(across: Any, other: Any, current: Any, gain: Any, thermal_voltage: Any) -> Any:
        # Own current with its base share 1/gain, less that of the other junction: through the base
        # the transport current flows from one to the other.
        own = junction_current(sign * across, current, thermal_voltage)
        return sign * (
            own * (1 + 1 / gain) - junction_current(sign * other, current, thermal_voltage)
        )

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

    plain = scalar(
        name,
        doc,
        FIELDS,
        port("be", "bc", "forward_gain", ("base", "emitter")),
        port("bc", "be", "reverse_gain", ("base", "collector")),
        terminals=TERMINALS,
        optional_terminals=("substrate",),
        measures=measures({}),
    )
    return replace(plain, adapt=bipolar(name, doc, sign, plain))


BJT_NPN = _bipolar("bjt_npn", "bipolar transistor after Ebers and Moll, npn", 1)
BJT_PNP = _bipolar("bjt_pnp", "bipolar transistor after Ebers and Moll, pnp", -1)


#: Arguments of the law of a channel.
_CHANNEL = ("across", "across_gs", "factor", "threshold", "modulation", "leakage")


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
        # Square law with channel-length modulation, level 1 of H. Shichman and D. A. Hodges, IEEE
        # Journal of Solid-State Circuits 3 (1968) 285: ohmic and saturated regions follow from a
        # and b together.
        at_source = vgs - sign * threshold
        a, b = (sympy.Max(0, above) for above in (at_source, at_source - vds))
        # Where both ends conduct a - b is vds, which their difference has no digits of if it is
        # small: that of two volts would leave a current of 1e-18 A or so at no voltage.
        is_open = sympy.Min(at_source, at_source - vds) > 0
        across_channel = sympy.Piecewise((vds, is_open), (a - b, True))
        channel = factor / 2 * (a + b) * across_channel * (1 + modulation * sympy.Abs(vds))
        return sign * channel + leakage * across

    plain = scalar(
        name,
        doc,
        (
            value("factor", "A/V^2", "of the square law: mobility, oxide, width by length"),
            value("threshold", "V", "of the gate against the source", ""),
            optional("modulation", "1/V", "of the channel's length", 0.0, "nonnegative"),
            optional("leakage", "S", "between drain and source", 1e-12, "nonnegative"),
            optional("body_effect", "V^0.5", "of the bulk's voltage", 0.0, "nonnegative"),
            optional("surface_potential", "V", "of the channel at threshold", 0.6, "positive"),
        ),
        Terminal(
            _DOMAIN,
            Kind.DISSIPATOR,
            "ds",
            through=Law.taking(_CHANNEL, law),
            is_passive=False,
            between=("drain", "source"),
        ),
        Terminal(
            _DOMAIN,
            Kind.THROUGH_SOURCE,
            "gs",
            # The gate takes no static current: its port only measures the voltage.
            through=Law(lambda: 0),
            is_passive=False,
            between=("gate", "source"),
        ),
        terminals=("drain", "gate", "source"),
        optional_terminals=("bulk",),
        measures=(
            PortMeasure("id", "A", ((1, "through", "ds"),)),
            PortMeasure("vds", "V", ((1, "across", "ds"),)),
            PortMeasure("vgs", "V", ((1, "across", "gs"),)),
        ),
    )
    return replace(plain, adapt=_with_bulk(plain, law, sign))


def _with_bulk(plain: Component, law: Callable[..., Any], sign: int) -> Adapt:
    """Give a field-effect transistor its fourth node, where a scene names it.

    The threshold is raised by g (sqrt(P - v) - sqrt(P)), where v is what the bulk is above the
    lower of source and drain; forwards the root goes on straight, as in SPICE.
    """

    def shifted() -> Any:
        import sympy

        vds, vbs = sign * symbol("across"), sign * symbol("across_bs")
        effect, potential = symbol("body_effect"), symbol("surface_potential")
        v = vbs - sympy.Min(vds, 0)
        # The root is never taken of what is not positive, whichever branch is evaluated.
        straight = sympy.Max(v, 0) / (2 * sympy.sqrt(potential))
        root = sympy.Max(0, sympy.sqrt(potential - sympy.Min(v, 0)) - straight)
        raised = sign * effect * (root - sympy.sqrt(potential))
        arguments = {name: symbol(name) for name in _CHANNEL}
        arguments["threshold"] += raised
        return law(*arguments.values())

    @lru_cache(maxsize=1)
    def made() -> Component:
        drain = replace(plain.ports[0], through=Law.of(shifted()))
        # Like the gate, the bulk is a port without current.
        bulk = replace(plain.ports[1], port="bs", between=("bulk", "source"))
        return replace(
            plain,
            ports=(drain, plain.ports[1], bulk),
            terminals=(*plain.terminals, "bulk"),
            measures=(*plain.measures, PortMeasure("vbs", "V", ((1, "across", "bs"),))),
        )

    def adapt(edge: str, nodes: Nodes, given: Given) -> Adapted:
        if len(nodes) == len(plain.terminals) + 1:
            return made(), nodes, given
        if not is_absent(given.get("body_effect")):
            raise SceneError(f"edge '{edge}' has a body_effect: name its bulk as the fourth node")
        return plain, nodes, given

    return adapt


MOSFET_N = _mosfet("mosfet_n", "field-effect transistor by the square law, n channel", 1)
MOSFET_P = _mosfet("mosfet_p", "field-effect transistor by the square law, p channel", -1)

COMPONENTS = (DIODE, BJT_NPN, BJT_PNP, MOSFET_N, MOSFET_P)
