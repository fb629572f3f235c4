"""Building blocks of scalar components, such as sources, storages and couplings."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from cotree.components.component import Component, Demand, Field, Given, Role
from cotree.components.law import Law, argument
from cotree.components.terminal import Kind, Terminal, active_port
from cotree.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


def scalar(
    name: str, doc: str, fields: tuple[Field, ...], *ports: Terminal, **options: Any
) -> Component:
    """Build a scalar component; ``options`` are further attributes of :class:`Component`."""
    # Domains are in the order of the ports: the order of a set would vary between runs.
    domains = tuple(dict.fromkeys(port.domain for port in ports))
    return Component(name, Role.NETWORK, doc, fields, domains, ports=ports, **options)


def across_source(domain: str, name: str, doc: str, field: Field) -> Component:
    """Build a source that prescribes an across variable."""
    law = argument(field.name)
    return scalar(name, doc, (field,), Terminal(domain, Kind.ACROSS_SOURCE, across=law))


def through_source(
    domain: str, name: str, doc: str, field: Field, acts_on_head: bool = False
) -> Component:
    """Build a source of a flow from head to tail, or from tail to head if ``acts_on_head``."""
    # Inside, through flows from head to tail; a load on the head is the negative.
    sign = -1 if acts_on_head else 1
    law = Law.taking((field.name,), lambda given: sign * given)
    return scalar(name, doc, (field,), Terminal(domain, Kind.THROUGH_SOURCE, through=law))


def storage(
    domain: str,
    name: str,
    doc: str,
    field: Field,
    kind: Kind = Kind.ACROSS_STORAGE,
    is_absolute: bool = False,
) -> Component:
    """Build a linear storage: through = field * d(across)/dt, or across = field * d(through)/dt.

    If ``is_absolute``, the tail of the storage must be the ground, as for inertias.
    """
    terminal = Terminal(domain, kind, storage=argument(field.name), is_absolute=is_absolute)
    return scalar(name, doc, (field,), terminal)


def content_storage(
    domain: str, name: str, doc: str, field: Field, kind: Kind = Kind.ACROSS_STORAGE
) -> Component:
    """Build a storage whose field is its content, such as a charge as a function of voltage."""
    content = argument(field.name)
    return scalar(name, doc, (field,), active_port(domain, kind, content=content))


def resistance(domain: str, name: str, doc: str, field: Field) -> Component:
    """Build a dissipator with across = field * through."""
    return scalar(name, doc, (field,), resistive(domain, field.name))


def resistive(
    domain: str, field: str, port: str = "", between: tuple[str, str] = ("", "")
) -> Terminal:
    """Build a port with across = field * through, between two terminals or between its nodes."""
    return Terminal(
        domain,
        Kind.DISSIPATOR,
        port,
        # A branch uses the law for across, a chord uses the law for through.
        across=Law.taking(("through", field), lambda through, given: given * through),
        through=Law.taking(("across", field), lambda across, given: across / given),
        between=between,
    )


_APART = Demand(Law(lambda lower, upper: upper - lower), "needs an upper limit above the lower one")


def demands_on_limits(type: str, edge: str, given: Given) -> tuple[Demand, ...]:
    """Return the demands on the limits of a travel; raise SceneError if an edge has none."""
    n_limits = ("lower" in given) + ("upper" in given)
    if not n_limits:
        raise SceneError(f"edge '{edge}' of type '{type}' needs a lower or an upper limit")
    return (_APART,) if n_limits > 1 else ()


def ideal_coupling(
    name: str,
    doc: str,
    field: Field,
    first: tuple[str, str],
    second: tuple[str, str],
    *,
    reverses: bool = False,
) -> Component:
    """Build a lossless transformer with the law across_1 = ``field`` * across_2.

    Each port is (domain, name). ``reverses`` changes the sign of the ratio.
    """
    sign = -1 if reverses else 1
    laws = (
        # v1 = r v2 and f2 = -r f1, each solved for both variables; the tree selects a form.
        (f"across_{second[1]}", lambda v, r: sign * r * v),
        (f"through_{second[1]}", lambda f, r: -f / (sign * r)),
        (f"across_{first[1]}", lambda v, r: v / (sign * r)),
        (f"through_{first[1]}", lambda f, r: -sign * r * f),
    )
    return _coupled(name, doc, field, (first, second), laws, is_passive=True)


def ideal_gyration(
    name: str, doc: str, field: Field, first: tuple[str, str], second: tuple[str, str]
) -> Component:
    """Build a lossless gyrator: through of the first port is ``field`` times across of the second.

    Each port is (domain, name); the inverse relation has the opposite sign.
    """
    laws = (
        # f1 = k v2 and f2 = -k v1, each solved for both variables.
        (f"through_{second[1]}", lambda f, k: -f / k),
        (f"across_{second[1]}", lambda v, k: k * v),
        (f"through_{first[1]}", lambda f, k: f / k),
        (f"across_{first[1]}", lambda v, k: -k * v),
    )
    # Equations that relate across to through variables are not symmetric.
    return _coupled(name, doc, field, (first, second), laws, is_passive=False)


def _coupled(
    name: str,
    doc: str,
    field: Field,
    ports: tuple[tuple[str, str], tuple[str, str]],
    laws: Sequence[tuple[str, Callable[..., Any]]],
    is_passive: bool,
) -> Component:
    """Build a component of two ports; the law of each depends on the other port's variables."""
    # Each port has two laws; the tree selects one of them.
    made = [Law.taking((argument, field.name), law) for argument, law in laws]
    terminals = (
        Terminal(
            domain,
            Kind.COUPLED,
            port,
            across=made[2 * i],
            through=made[2 * i + 1],
            is_passive=is_passive,
        )
        for i, (domain, port) in enumerate(ports)
    )
    return scalar(name, doc, (field,), *terminals)


#: Name of the heat port.
HEAT = "heat"


def loss_of(component: Component) -> Law | None:
    """Return the heat that a component produces, [W]: its loss, or a dissipator's power."""
    if component.loss is not None:
        return component.loss
    if len(component.ports) == 1 and component.ports[0].kind is Kind.DISSIPATOR:
        # A single port has an empty name: its variables are called ``across_`` and ``through_``.
        return Law(lambda across_, through_: across_ * through_)
    return None


@lru_cache(maxsize=256)
def with_heat(component: Component) -> Component:
    """Add a thermal port from which a component's heat flows: its flow is minus the loss."""
    loss = loss_of(component)
    assert loss is not None  # callers pass only components with a loss
    port = Terminal("thermal", Kind.THROUGH_SOURCE, HEAT, through=-loss)
    return replace(
        component, ports=(*component.ports, port), domains=(*component.domains, "thermal")
    )
