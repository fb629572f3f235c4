from __future__ import annotations

import pytest

from cotree.domains import DOMAINS, domain
from cotree.errors import SceneError


def test_mechanical_domains():
    assert tuple(DOMAINS)[:2] == ("translation", "rotation")
    assert domain("translation").across == ("position", "velocity", "acceleration")
    assert (domain("rotation").through_symbol, domain("rotation").through_unit) == ("T", "N m")


def test_each_row_is_complete():
    for name, row in DOMAINS.items():
        assert row.name == name
        assert all((row.across, row.across_symbol, row.through, row.through_symbol))
        assert row.summary().startswith(f"{name}: across ")


def test_unknown_domain_names_the_nearest():
    with pytest.raises(SceneError, match="unknown domain 'hydralic'; did you mean 'hydraulic'"):
        domain("hydralic")
