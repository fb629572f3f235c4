"""Hatchling's hook: write the stub of the methods of components, editable installs included."""

import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class StubHook(BuildHookInterface):
    """Writes ``component_methods.pyi`` into the package."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Write the stub before the wheel, or the link of an editable install, is made."""
        sources = Path(self.root) / "src"
        sys.path.insert(0, str(sources))
        from cotree.scene.usage_text import stub_text

        stub = sources / "cotree" / "scene" / "component_methods.pyi"
        stub.write_text(stub_text(), encoding="utf-8")
