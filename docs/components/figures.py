"""Draw the figure of every component type: ``python docs/components/figures.py``.

Grey is the first node's body, blue the second's; red is what may move, green what acts.
"""

from __future__ import annotations

from pathlib import Path

import figures_of_chords  # noqa: F401  they enter their figures
import figures_of_circuits  # noqa: F401
import figures_of_fluids  # noqa: F401
import figures_of_friction  # noqa: F401
import figures_of_joints  # noqa: F401
import figures_of_motion  # noqa: F401
import figures_of_reactions  # noqa: F401
import figures_of_transducers  # noqa: F401
import matplotlib as mpl
from drawing import FIGURES, Sheet

FOLDER = Path(__file__).resolve().parents[1] / "images" / "components"


def draw(name: str) -> Sheet:
    """Draw one figure."""
    sheet = Sheet()
    FIGURES[name](sheet)
    return sheet


def main() -> None:
    """Write every figure; the same bytes on every run."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    settings = {"svg.fonttype": "none", "svg.hashsalt": "cotree", "font.family": "DejaVu Sans"}
    with mpl.rc_context(settings):
        for name in FIGURES:
            sheet = draw(name)
            sheet.figure.savefig(FOLDER / f"{name}.svg", metadata={"Date": None, "Creator": None})


if __name__ == "__main__":
    main()
