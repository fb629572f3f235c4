"""Draw the picture of the README: ``python docs/readme_picture.py`` rewrites it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import cotree

FILE = Path(__file__).parent / "images" / "readme.png"


def draw() -> Figure:
    """Draw a position and its sensitivity with finite differences, as in figures 5 and 6."""
    model = cotree.load("slider-pendulum").compile(["L"])
    t, h = np.linspace(0, 10, 501), 1e-4
    result = model.simulate((0, 10), t)
    sides = [model.simulate((0, 10), t, parameters={"L": 1 + x})["j1.s"] for x in (h, -h)]
    differences = (sides[0] - sides[1]) / (2 * h)
    figure = Figure(figsize=(4.2, 3.4), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    top.plot(t, result["j1.s"], color="tab:blue")
    bottom.plot(t, result.sensitivity("j1.s", "L"), color="tab:orange")
    bottom.plot(
        t[::12], differences[::12], "o", ms=4, mfc="none", color="0.3", label="finite differences"
    )
    bottom.legend(loc="lower right", bbox_to_anchor=(1, 0.95), frameon=False, fontsize=8)
    top.set(title="slider-pendulum", ylabel="slider $s$ [m]")
    bottom.set(xlabel="time [s]", ylabel="∂s / ∂L [m/m]")
    for ax in (top, bottom):
        ax.grid(color="0.9")
        ax.spines[["top", "right"]].set_visible(False)
    return figure


if __name__ == "__main__":
    draw().savefig(FILE, dpi=150, metadata={"Software": None})
