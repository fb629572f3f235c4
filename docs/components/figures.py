"""Draw the figure of every component type: ``python docs/components/figures.py``.

Grey is the first node's body, blue the second's; red is what may move, green what acts.
"""

from __future__ import annotations

from pathlib import Path

import figures_of_chords
import figures_of_fluids
import figures_of_joints
import figures_of_motion
import figures_of_reactions
import figures_of_transducers
import matplotlib as mpl
from drawing import Sheet

FOLDER = Path(__file__).resolve().parents[1] / "images" / "components"
FIGURES = {
    **figures_of_joints.FIGURES,
    **figures_of_chords.FIGURES,
    **figures_of_fluids.FIGURES,
    **figures_of_motion.FIGURES,
    **figures_of_reactions.FIGURES,
    **figures_of_transducers.FIGURES,
}


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
