"""Diodes, bipolar transistors (Gummel-Poon model) and field-effect transistors.

Capacitances are C = dQ/dv, so that a capacitive current is the rate of a charge. Optional terms
exist only if the scene gives their fields; without them, a diode stores no charge and has no state.

If the scene gives only gains, the model is that of Ebers and Moll. Terms of the junctions are
f = I (exp(vbe / (nf V)) - 1) and r, the same for vbc. The base charge is
qb = q1/2 (1 + sqrt(1 + 4 q2)) with q1 = 1 / (1 - vbc/Vf - vbe/Vr) and q2 = f/If + r/Ir.
The currents are

    collector to emitter (f - r) / qb, base to emitter f / bf, base to collector r / br,

to which recombination, leakage, charges and resistances are added. See H. K. Gummel and H. C. Poon,
An integral charge control model of bipolar transistors, Bell System Technical Journal 49 (1970).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from cotree.components.component import (
    Adapt,
    Adapted,
    Component,
    Field,
    Given,
    Nodes,
    optional,
    value,
)
from cotree.components.law import ZERO, Law, argument, exp, larger, magnitude, select, smaller, sqrt
from cotree.components.ports import resistive, scalar
from cotree.components.terminal import Kind, PortMeasure, Terminal, active_port
from cotree.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


def junction_current(voltage: Any, saturation_current: Any, thermal_voltage: Any) -> Any:
    """Return I (exp(v / V) - 1): W. Shockley, Bell Syst. Tech. J. 28 (1949) 435."""
    # The reverse current saturates at -I. The thermal voltage V is k T / e times ideality factor.
    return saturation_current * (exp(voltage / thermal_voltage) - 1)


def depletion_capacity(voltage: Any, prefix: str, share: Any = None) -> Any:
    """Return the capacitance C (1 - v/V)^-m, continued by its tangent for v > F V.

    C, V and m are the fields ``PREFIX_capacitance``, ``_potential`` and ``_grading``. F is
    ``share``, by default ``forward_share``; it limits the base of the power to at least 1 - F.
    """
    names = ("capacitance", "potential", "grading")
    capacitance, potential, grading = (argument(f"{prefix}_{name}") for name in names)
    share = argument("forward_share") if share is None else share
    # ``over`` = max(v/V - F, 0) limits the base, and is the argument of the tangent.
    over = larger(voltage / potential - share, 0)
    base = 1 - voltage / potential + over
    # Value and slope are continuous where the tangent begins.
    return capacitance * base ** (-grading) * (1 + grading * over / (1 - share))


def depletion_fields(prefix: str, potential: float, grading: float) -> tuple[Field, ...]:
    """Build the fields of a depletion capacitance: default built-in potential, [V], and grading."""
    capacitance = "depletion capacitance at zero voltage"
    built_in = "built-in potential of the junction"
    exponent = "grading exponent: 0.5 for an abrupt junction, 0.33 for a linear one"
    return (
        optional(f"{prefix}_capacitance", "F", capacitance, 0.0, "nonnegative"),
        optional(f"{prefix}_potential", "V", built_in, potential, "positive"),
        optional(f"{prefix}_grading", "1", exponent, grading, "nonnegative"),
    )


FORWARD_SHARE = optional(
    "forward_share",
    "1",
    "fraction of the built-in potential above which capacitance is linear",
    0.5,
)


def split_extras(
    fields: tuple[Field, ...], given: Mapping[str, Any]
) -> tuple[frozenset[str], dict[str, Any]]:
    """Return the names in ``fields`` that add a term, and the given values without zero terms."""
    names = {row.name for row in fields}
    has = frozenset(name for name in names if not is_absent(given.get(name)))
    return has, {
        key: item
        for key, item in given.items()
        if item is not None and (key in has or key not in names)
    }


def is_absent(value: Any) -> bool:
    """Return whether a field is not given, or given as the number zero."""
    return value is None or (isinstance(value, (int, float)) and value == 0)


_DOMAIN = "electrical"

_DOC = "Shockley diode with the current I (exp(v / V) - 1)"
_CAPACITANCE, *_SHAPE = depletion_fields("junction", 1.0, 0.5)

#: Optional fields, each of which adds a port or a term of a law.
_DIODE_EXTRAS = (
    optional("leakage", "S", "conductance parallel to the junction", 0.0, "nonnegative"),
    optional(
        "series_resistance", "ohm", "resistance in series with the junction", 0.0, "nonnegative"
    ),
    optional(
        "breakdown_voltage",
        "V",
        "reverse breakdown voltage; no breakdown if omitted",
        None,
        "positive",
    ),
    _CAPACITANCE,
    optional("transit_time", "s", "transit time: diffusion charge per current", 0.0, "nonnegative"),
)

_FIELDS = (
    value("saturation_current", "A", "saturation current I"),
    optional(
        "thermal_voltage",
        "V",
        "thermal voltage k T / e times the ideality factor",
        0.02585,
        "positive",
    ),
    *_DIODE_EXTRAS,
    optional(
        "breakdown_current", "A", "reverse current at the breakdown voltage", 1e-3, "positive"
    ),
    *_SHAPE,
    FORWARD_SHARE,
)


@lru_cache(maxsize=64)
def _diode(has: frozenset[str]) -> Component:
    if "series_resistance" not in has:
        return scalar("diode", _DOC, _FIELDS, _junction(has, "", ("", "")))
    # With a series resistance, an inner node lies between two ports.
    return scalar(
        "diode",
        _DOC,
        _FIELDS,
        _junction(has, "junction", ("inner", "cathode")),
        resistive(_DOMAIN, "series_resistance", "series", ("anode", "inner")),
        terminals=("anode", "cathode"),
        measures=(
            PortMeasure("v", "V", ((1, "across", "series"), (1, "across", "junction"))),
            PortMeasure("i", "A", ((1, "through", "series"),)),
        ),
    )


def _junction(has: frozenset[str], name: str, between: tuple[str, str]) -> Terminal:
    through, storage = _current(has), None
    # If the junction stores charge, its voltage is a state; the static current adds to C dv/dt.
    if has & {"junction_capacitance", "transit_time"}:
        storage = _capacity(has)
    kind = Kind.DISSIPATOR if storage is None else Kind.ACROSS_STORAGE
    return Terminal(_DOMAIN, kind, name, through=through, storage=storage, between=between)


def _current(has: frozenset[str]) -> Any:
    v, thermal = argument("across"), argument("thermal_voltage")
    current = junction_current(v, argument("saturation_current"), thermal)
    if "leakage" in has:
        current += argument("leakage") * v
    if "breakdown_voltage" in has:
        beyond = v + argument("breakdown_voltage")
        # Avalanche current beyond the breakdown voltage; it is exponential in the voltage.
        current -= argument("breakdown_current") * exp(-beyond / thermal)
    return current


def _capacity(has: frozenset[str]) -> Any:
    v, thermal = argument("across"), argument("thermal_voltage")
    capacity: Any = 0
    if "junction_capacitance" in has:
        capacity += depletion_capacity(v, "junction")
    if "transit_time" in has:
        # The diffusion charge is the transit time times the current.
        slope = junction_current(v, argument("saturation_current"), thermal).slope("across")
        capacity += argument("transit_time") * slope
    return capacity


def _adapted(edge: str, nodes: Nodes, given: Given) -> Adapted:
    has, rest = split_extras(_DIODE_EXTRAS, given)
    return (_diode(has) if has else DIODE), nodes, rest


DIODE = scalar(
    "diode",
    _DOC,
    _FIELDS,
    Terminal(
        _DOMAIN,
        Kind.DISSIPATOR,
        through=Law.taking(("across", "saturation_current", "thermal_voltage"), junction_current),
    ),
    adapt=_adapted,
)


_FORWARD, _REVERSE = depletion_fields("be", 0.75, 0.33), depletion_fields("bc", 0.75, 0.33)
_SUBSTRATE = depletion_fields("substrate", 0.75, 0.0)
_TRANSIT = "transit time: base charge per current"
_IDEALITY = "ideality factor of recombination at the junction"

#: Optional fields, each of which adds a port or a term of a law.
_EXTRAS = (
    optional("forward_ideality", "1", "forward ideality factor", 1.0, "positive"),
    optional("reverse_ideality", "1", "reverse ideality factor", 1.0, "positive"),
    *(
        optional(f"{way}_{name}", unit, f"{way} {what}; infinite if omitted", None, "positive")
        for name, unit, what in (
            ("early_voltage", "V", "Early voltage"),
            ("knee_current", "A", "knee current of high injection"),
        )
        for way in ("forward", "reverse")
    ),
    *(
        optional(f"{junction}_recombination", "A", doc, 0.0, "nonnegative")
        for junction, doc in (
            ("be", "saturation current of recombination at the base-emitter junction"),
            ("bc", "saturation current of recombination at the base-collector junction"),
        )
    ),
    optional("leakage", "S", "conductance parallel to each junction", 0.0, "nonnegative"),
    *(
        optional(f"{end}_resistance", "ohm", f"resistance of the {end}", 0.0, "nonnegative")
        for end in ("base", "collector", "emitter")
    ),
    _FORWARD[0],
    _REVERSE[0],
    *(
        optional(f"{way}_transit_time", "s", f"{way} {_TRANSIT}", 0.0, "nonnegative")
        for way in ("forward", "reverse")
    ),
    _SUBSTRATE[0],
)

FIELDS = (
    value("saturation_current", "A", "transport saturation current I"),
    value("forward_gain", "1", "forward current gain: collector over base current"),
    optional("reverse_gain", "1", "reverse current gain: emitter over base current", 1.0),
    optional("thermal_voltage", "V", "thermal voltage V = k T / e", 0.02585, "positive"),
    *_EXTRAS,
    optional("be_recombination_ideality", "1", _IDEALITY, 1.5, "positive"),
    optional("bc_recombination_ideality", "1", _IDEALITY, 2.0, "positive"),
    *_FORWARD[1:],
    *_REVERSE[1:],
    *_SUBSTRATE[1:],
    FORWARD_SHARE,
)

_CHARGES = {
    "be": {"be_capacitance", "forward_transit_time"},
    "bc": {"bc_capacitance", "reverse_transit_time"},
}
#: Fields that make the base charge depend on both junction voltages.
BASE_CHARGE = {
    "forward_early_voltage",
    "reverse_early_voltage",
    "forward_knee_current",
    "reverse_knee_current",
}
#: Names of the nodes, without the substrate.
TERMINALS: tuple[str, ...] = ("collector", "base", "emitter")
_RESISTANCES = ("base_resistance", "collector_resistance", "emitter_resistance")


# Cached, since many transistors have the same laws.
@lru_cache(maxsize=256)
def _transistor(
    name: str, doc: str, sign: int, has: frozenset[str], has_substrate: bool
) -> Component:
    # A resistance at a terminal leads to an inner node, to which the junctions are connected.
    inner = {
        row.partition("_")[0]: f"inner_{row.partition('_')[0]}"
        for row in _RESISTANCES
        if row in has
    }
    base, collector, emitter = (inner.get(end, end) for end in ("base", "collector", "emitter"))
    laws = _Laws(sign, has)
    ports = [
        laws.port("be", "bc", (base, emitter)),
        laws.port("bc", "be", (base, collector)),
        *(resistive(_DOMAIN, f"{end}_resistance", end, (end, at)) for end, at in inner.items()),
    ]
    terminals = TERMINALS
    if has_substrate:
        terminals = (*terminals, "substrate")
        ports.append(laws.substrate(("substrate", collector if sign > 0 else base)))
    found = measures(inner, sign if has_substrate else 0)
    return scalar(name, doc, FIELDS, *ports, terminals=terminals, measures=found)


def measures(inner: Mapping[str, str], substrate: int = 0) -> tuple[PortMeasure, ...]:
    """Return the measures for terminal currents and voltages.

    ``inner`` maps terminals with a resistance to inner nodes. ``substrate`` is the sign of a
    transistor with a substrate port, else zero.
    """

    def drop(sign: int, end: str) -> tuple[tuple[int, str, str], ...]:
        return ((sign, "across", end),) if end in inner else ()

    # ``drop`` is the voltage from a terminal to its inner node; the emitter has the opposite sign.
    be, bc = (1, "across", "be"), (1, "across", "bc")
    # Substrate current flows into the collector of npn and into the base of pnp transistors.
    own: dict[int, tuple[tuple[int, str, str], ...]] = {substrate: ((-1, "through", "substrate"),)}
    own[0] = ()
    return (
        PortMeasure("ib", "A", ((1, "through", "be"), (1, "through", "bc"), *own.get(-1, ()))),
        PortMeasure("ic", "A", ((-1, "through", "bc"), *own.get(1, ()))),
        PortMeasure("ie", "A", ((-1, "through", "be"),)),
        PortMeasure("vbe", "V", (*drop(1, "base"), be, *drop(-1, "emitter"))),
        PortMeasure("vbc", "V", (*drop(1, "base"), bc, *drop(-1, "collector"))),
        PortMeasure(
            "vce", "V", (be, (-1, "across", "bc"), *drop(1, "collector"), *drop(-1, "emitter"))
        ),
    )


class _Laws:
    """Terminal equations of the junctions, in terms of the voltages ``vbe`` and ``vbc``."""

    def __init__(self, sign: int, has: frozenset[str]) -> None:
        self.sign, self.has = sign, has
        self.voltage = {"be": argument("vbe"), "bc": argument("vbc")}
        self.thermal = argument("thermal_voltage")
        saturation = argument("saturation_current")
        self.forward, self.reverse = (
            junction_current(v, saturation, argument(f"{way}_ideality") * self.thermal)
            for v, way in ((self.voltage["be"], "forward"), (self.voltage["bc"], "reverse"))
        )

    def _base_charge(self) -> Any:
        def share(of: Any, name: str) -> Any:
            return of / argument(name) if name in self.has else 0

        # Base-width modulation (Early effect) is linear in both voltages.
        q1 = 1 / (
            1
            - share(self.voltage["bc"], "forward_early_voltage")
            - share(self.voltage["be"], "reverse_early_voltage")
        )
        # Without knee currents the root is one, so qb equals q1.
        if not self.has & {"forward_knee_current", "reverse_knee_current"}:
            return q1
        # High-level injection: gains fall beyond the knee currents.
        q2 = share(self.forward, "forward_knee_current")
        q2 += share(self.reverse, "reverse_knee_current")
        # The sum can become negative only during a root search.
        return q1 / 2 * (1 + sqrt(larger(1 + 4 * q2, 1e-6)))

    def _current(self, own: str) -> Any:
        # Transport current from collector to emitter; recombination in the base is added below.
        transport = (self.forward - self.reverse) / self._base_charge()
        # The transport current has opposite signs at the be and bc ports and cancels in the base.
        if own == "be":
            total = transport + self.forward / argument("forward_gain")
        else:
            total = self.reverse / argument("reverse_gain") - transport
        v = self.voltage[own]
        if f"{own}_recombination" in self.has:
            ideality = argument(f"{own}_recombination_ideality")
            factor = exp(v / (ideality * self.thermal)) - 1
            total += argument(f"{own}_recombination") * factor
        return total + argument("leakage") * v if "leakage" in self.has else total

    def _capacities(self, own: str, other: str) -> tuple[Any, Any]:
        """Return a junction charge's derivatives with respect to its own and the other voltage."""
        v, capacity = self.voltage[own], ZERO
        if f"{own}_capacitance" in self.has:
            capacity += depletion_capacity(v, own)
        charge = ZERO
        if own == "be" and "forward_transit_time" in self.has:
            charge = argument("forward_transit_time") * self.forward / self._base_charge()
        if own == "bc" and "reverse_transit_time" in self.has:
            charge = argument("reverse_transit_time") * self.reverse
        return capacity + charge.slope(f"v{own}"), charge.slope(f"v{other}")

    def port(self, own: str, other: str, between: tuple[str, str]) -> Terminal:
        """Build the port of junction ``own``, 'be' or 'bc'; ``other`` is the other junction."""
        through, storage, kind = self.sign * self._current(own), None, Kind.DISSIPATOR
        if self.has & _CHARGES[own]:
            capacity, cross = self._capacities(own, other)
            kind, storage = Kind.ACROSS_STORAGE, self._of_port(capacity, own, other)
            # The sign of pnp transistors cancels, since voltage rates and currents both contain it.
            through += cross * argument(f"across_rate_{other}")
        through = self._of_port(through, own, other)
        return active_port(_DOMAIN, kind, own, through=through, storage=storage, between=between)

    def substrate(self, between: tuple[str, str]) -> Terminal:
        """Build the port of the substrate junction, which never conducts in forward direction."""
        # The p substrate adjoins n material, the collector of npn and the base of pnp: same sign.
        v, storage, kind = argument("across"), None, Kind.DISSIPATOR
        if "substrate_capacitance" in self.has:
            kind = Kind.ACROSS_STORAGE
            # The junction is reverse biased: its linear continuation begins at zero voltage.
            storage = depletion_capacity(v, "substrate", share=0)
        leakage = argument("leakage") * v if "leakage" in self.has else ZERO
        return active_port(
            _DOMAIN, kind, "substrate", through=leakage, storage=storage, between=between
        )

    def _of_port(self, expression: Any, own: str, other: str) -> Any:
        # Laws are written for npn transistors; for pnp, voltages and currents change sign.
        names = {own: "across", other: f"across_{other}"}
        return expression.where(
            **{f"v{at}": self.sign * argument(name) for at, name in names.items()}
        )


def bipolar(name: str, doc: str, sign: int, plain: Component) -> Adapt:
    """Return a function that adds the terms whose fields a scene gives; see :func:`_bipolar`."""

    def adapt(edge: str, nodes: Nodes, given: Given) -> Adapted:
        has, rest = split_extras(_EXTRAS, given)
        has_substrate = len(nodes) == len(TERMINALS) + 1
        if "substrate_capacitance" in has and not has_substrate:
            raise SceneError(
                f"edge '{edge}' has a substrate_capacitance: name its substrate as the fourth node"
            )
        if not has and not has_substrate:
            return plain, nodes, rest
        # The be charge then also depends on vbc, whose rate exists only if bc is a storage.
        is_coupled = "forward_transit_time" in has and has & BASE_CHARGE
        if is_coupled and not has & _CHARGES["bc"]:
            raise SceneError(
                f"edge '{edge}' has a forward_transit_time and a charge of the base that the "
                "collector's voltage changes: give a bc_capacitance, too"
            )
        return _transistor(name, doc, sign, has, has_substrate), nodes, rest

    return adapt


def _bipolar(name: str, doc: str, sign: int) -> Component:
    """Build a bipolar transistor; ``sign`` is 1 for npn and -1 for pnp.

    Transport form: Ic = It - Ibc', with It = I (exp(vbe / V) - exp(vbc / V)).
    """

    def law(across: Any, other: Any, current: Any, gain: Any, thermal_voltage: Any) -> Any:
        # The junction's current times 1 + 1/gain, minus the other junction's: the transport current
        # flows from one junction through the base to the other.
        own = junction_current(sign * across, current, thermal_voltage)
        return sign * (
            own * (1 + 1 / gain) - junction_current(sign * other, current, thermal_voltage)
        )

    def port(own: str, other: str, gain: str, between: tuple[str, str]) -> Terminal:
        names = ("across", f"across_{other}", "saturation_current", gain, "thermal_voltage")
        through = Law.taking(names, law)
        return active_port(_DOMAIN, Kind.DISSIPATOR, own, through=through, between=between)

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


BJT_NPN = _bipolar("bjt_npn", "npn bipolar transistor by the Gummel-Poon model", 1)
BJT_PNP = _bipolar("bjt_pnp", "pnp bipolar transistor by the Gummel-Poon model", -1)


#: Arguments of the channel law.
_CHANNEL = ("across", "across_gs", "factor", "threshold", "modulation", "leakage")


def _mosfet(name: str, doc: str, sign: int) -> Component:
    """Build a field-effect transistor; ``sign`` is 1 for an n-channel and -1 for a p-channel.

    The law i = k/2 (a^2 - b^2) (1 + l |vds|) is symmetric in drain and source. a and b are the gate
    voltages relative to source and drain, minus the threshold and at least zero.
    """

    def law(
        across: Any, gate: Any, factor: Any, threshold: Any, modulation: Any, leakage: Any
    ) -> Any:
        vds, vgs = sign * across, sign * gate
        # Square law with channel-length modulation (level 1: H. Shichman and D. A. Hodges, IEEE
        # Journal of Solid-State Circuits 3 (1968) 285). a and b cover both ohmic and saturated
        # region.
        at_source = vgs - sign * threshold
        a, b = (larger(above, 0) for above in (at_source, at_source - vds))
        # In the ohmic region, a - b equals vds, but cancellation would cause a current of about
        # 1e-18 A at vds = 0 and a gate voltage of 2 V.
        is_open = smaller(at_source, at_source - vds)
        across_channel = select(-is_open, a - b, vds)
        channel = factor / 2 * (1 + modulation * magnitude(vds)) * ((a + b) * across_channel)
        return sign * channel + leakage * across

    plain = scalar(
        name,
        doc,
        (
            value(
                "factor",
                "A/V^2",
                "k in the current k/2 (vgs - vth)^2: mobility times oxide capacitance times W/L",
            ),
            value("threshold", "V", "threshold voltage between gate and source", ""),
            optional("modulation", "1/V", "channel-length modulation", 0.0, "nonnegative"),
            optional("leakage", "S", "conductance between drain and source", 1e-12, "nonnegative"),
            optional("body_effect", "V^0.5", "body effect coefficient", 0.0, "nonnegative"),
            optional(
                "surface_potential",
                "V",
                "surface potential of the channel at threshold",
                0.6,
                "positive",
            ),
        ),
        active_port(
            _DOMAIN,
            Kind.DISSIPATOR,
            "ds",
            through=Law.taking(_CHANNEL, law),
            between=("drain", "source"),
        ),
        active_port(
            _DOMAIN,
            Kind.THROUGH_SOURCE,
            "gs",
            # The gate has no static current; its port only measures the voltage.
            through=ZERO,
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
    """Return a function that adds a bulk node to a field-effect transistor if a scene names one.

    The threshold is raised by g (sqrt(P - v) - sqrt(P)), where v is the voltage of the bulk against
    the lower of source and drain. For v > 0 the root is continued linearly, as in SPICE.
    """

    def shifted() -> Any:
        vds, vbs = sign * argument("across"), sign * argument("across_bs")
        effect, potential = argument("body_effect"), argument("surface_potential")
        v = vbs - smaller(vds, 0)
        # The argument of the root is positive in every branch.
        straight = larger(v, 0) / (2 * sqrt(potential))
        root = larger(sqrt(potential - smaller(v, 0)) - straight, 0)
        raised = sign * effect * (root - sqrt(potential))
        arguments = {name: argument(name) for name in _CHANNEL}
        arguments["threshold"] += raised
        return law(*arguments.values())

    @lru_cache(maxsize=1)
    def made() -> Component:
        drain = replace(plain.ports[0], through=shifted())
        # Like the gate, the bulk has no current.
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


MOSFET_N = _mosfet("mosfet_n", "n-channel MOSFET by the square law (SPICE level 1)", 1)
MOSFET_P = _mosfet("mosfet_p", "p-channel MOSFET by the square law (SPICE level 1)", -1)

COMPONENTS = (DIODE, BJT_NPN, BJT_PNP, MOSFET_N, MOSFET_P)
