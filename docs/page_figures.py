"""Draw the figures of pages: ``python docs/page_figures.py docs/how_to/inverse_dynamics.md``.

The blocks of a page run in order. A block that draws assigns a matplotlib figure to ``figure``,
which is saved as the image that follows the block.
"""

from __future__ import annotations

import re
import sys
import tempfile
from contextlib import chdir
from pathlib import Path
from typing import Any


def draw(page: Path) -> None:
    """Run the blocks of a page and save the figure of each image that follows a block."""
    page = page.resolve()
    parts = re.findall(
        r"```python\n(.*?)```(?:\n\n!\[[^\]]*\]\(([^)]+\.png)\))?",
        page.read_text(encoding="utf-8"),
        re.DOTALL,
    )
    names: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for block, image in parts:
            exec(compile(block, str(page), "exec"), names)
            if image:
                file = page.parent / image
                names["figure"].savefig(file, dpi=100, metadata={"Software": None})
                print(file)


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        draw(Path(argument))
