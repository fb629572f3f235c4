"""Files of the package that are generated from the pages of components."""

from __future__ import annotations

import tomllib

from cotree.components import OWN
from cotree.scene.toml_text import table_text


def examples_text(pages):
    """Collect the edge of each component in the scene of its page, by its TOML."""
    lines = [
        "# An edge of each component of its page; pytest tests/golden --update-golden writes it\n"
    ]
    for name in sorted(OWN):
        edges = tomllib.loads(pages[name])["edges"]
        own = next(edge for edge, table in edges.items() if table["type"] == name)
        lines.append(table_text(f"{name}.{own}", edges[own]))
    return "".join(lines)
