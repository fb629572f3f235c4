"""Parts of scalar components: fields of laws, linear components of one port, couplings."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from cotree.components.component import Component, Field, Role
from cotree.components.law import Law
from cotree.components.terminal import Kind, Terminal

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


def scalar(
    name: str, doc: str, fields: tuple[Field, ...], *ports: Terminal, **options: Any
) -> Component:
    """Make a scalar component with given terminal equations, in the graphs of their domains.

    ``options`` are further attributes of :class:`Component`: ``terminals``, ``measures``, ``loss``,
    ...
    """
    # Domains keep the order of the ports: with sets, the order of edges would vary between runs.
    domains = tuple(dict.fromkeys(port.domain for port in ports))
    return Component(name, Role.NETWORK, doc, fields, domains, ports=ports, **options)


def across_source(domain: str, name: str, doc: str, field: Field) -> Component:
    """Make a source that prescribes an across variable."""
    law = Law.field(field.name)
    return scalar(name, doc, (field,), Terminal(domain, Kind.ACROSS_SOURCE, across=law))


def through_source(
    domain: str, name: str, doc: str, field: Field, acts_on_head: bool = False
) -> Component:
    """Make a source that prescribes a through variable.

    With ``acts_on_head`` it flows from tail to head within the source, not from head to tail.
    """
    # A through variable flows from head to tail inside; a load on the head is its negative.
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
    """Make a linear storage, whose state is its across or its through variable.

    ``field`` is the capacity, through = capacity * rate of across, or the inertance, across =
    inertance * rate of through. ``is_absolute``: it must begin at the ground, as inertias do.
    """
    terminal = Terminal(domain, kind, storage=Law.field(field.name), is_absolute=is_absolute)
    return scalar(name, doc, (field,), terminal)


def content_storage(
    domain: str, name: str, doc: str, field: Field, kind: Kind = Kind.ACROSS_STORAGE
) -> Component:
    """Make a storage whose content, such as charge as a function of voltage, is a field."""
    content = Law.field(field.name)
    return scalar(name, doc, (field,), Terminal(domain, kind, content=content, is_passive=False))


def resistance(domain: str, name: str, doc: str, field: Field) -> Component:
    """Make a dissipator with across = field * through."""
    return scalar(name, doc, (field,), resistive(domain, field.name))


def resistive(
    domain: str, field: str, port: str = "", between: tuple[str, str] = ("", "")
) -> Terminal:
    """Form the terminal equation across = field * through of a port.

    ``between`` are the terminals at head and tail, if ports share nodes.
    """
    return Terminal(
        domain,
        Kind.DISSIPATOR,
        port,
        # Both forms are needed: a branch requires its across variable explicitly, a chord its
        # through variable.
        across=Law.taking(("through", field), lambda through, given: given * through),
        through=Law.taking(("across", field), lambda across, given: across / given),
        between=between,
    )


def ideal_coupling(
    name: str,
    doc: str,
    field: Field,
    first: tuple[str, str],
    second: tuple[str, str],
    *,
    reverses: bool = False,
) -> Component:
    """Make a lossless transformer: across of the first port is ``field`` times that of the second.

    Power is conserved, so the through variables have the inverse ratio, with opposite sign. Ports
    are given as their domain and name; ``reverses`` changes the sign of the ratio.
    """
    sign = -1 if reverses else 1
    laws = (
        # Across and through variable of the first port, then of the second: v1 = r v2 and f2 = -r
        # f1. Each equation is solved for both variables, since the tree determines which form is
        # needed.
        (f"across_{second[1]}", lambda v, r: sign * r * v),
        (f"through_{second[1]}", lambda f, r: -f / (sign * r)),
        (f"across_{first[1]}", lambda v, r: v / (sign * r)),
        (f"through_{first[1]}", lambda f, r: -sign * r * f),
    )
    return _coupled(name, doc, field, (first, second), laws, is_passive=True)


def ideal_gyration(
    name: str, doc: str, field: Field, first: tuple[str, str], second: tuple[str, str]
) -> Component:
    """Make a lossless gyrator: through of the first port is ``field`` times across of the second.

    Power is conserved, so that through of the second port is minus ``field`` times across of the
    first. Ports are given as their domain and name.
    """
    laws = (
        # f1 = k v2 and f2 = -k v1, each solved for both variables: v1 f1 + v2 f2 is zero.
        (f"through_{second[1]}", lambda f, k: -f / k),
        (f"across_{second[1]}", lambda v, k: k * v),
        (f"through_{first[1]}", lambda f, k: f / k),
        (f"across_{first[1]}", lambda v, k: -k * v),
    )
    # Equations that couple across with through variables are not symmetric.
    return _coupled(name, doc, field, (first, second), laws, is_passive=False)


def _coupled(
    name: str,
    doc: str,
    field: Field,
    ports: tuple[tuple[str, str], tuple[str, str]],
    laws: Sequence[tuple[str, Callable[..., Any]]],
    is_passive: bool,
) -> Component:
    """Couple two ports: each law gives a variable of one port in terms of the other port."""
    # Each port has two laws; the tree determines which one is used.
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
    """Return the heat of a component, [W]: its own loss, or all power of a dissipator."""
    if component.loss is not None:
        return component.loss
    if len(component.ports) == 1 and component.ports[0].kind is Kind.DISSIPATOR:
        # The name of a single port is empty; in other ports its variables are ``across_`` and
        # ``through_``.
        return Law(lambda across_, through_: across_ * through_)
    return None


@lru_cache(maxsize=256)
def with_heat(component: Component) -> Component:
    """Add a thermal port to a component, through which its loss flows.

    The heat flows out of the component: minus the loss flows into its port.
    """
    loss = loss_of(component)
    assert loss is not None  # this function is called only for components with a loss
    port = Terminal("thermal", Kind.THROUGH_SOURCE, HEAT, through=Law.of(-loss.expression))
    return replace(
        component, ports=(*component.ports, port), domains=(*component.domains, "thermal")
    )
