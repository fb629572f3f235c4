"""Physical domains: the across and through variables that the edges of a graph carry."""

from __future__ import annotations

from cotree.domains.domain import DOMAINS, Domain, domain

__all__ = ["DOMAINS", "Domain", "domain"]
