"""Draw the three pictures of the README: ``python docs/readme_pictures.py`` rewrites them.

A mechanism with a sensitivity and finite differences over it, a circuit with a sensitivity, and a
robot at several times.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageChops

import cotree

FOLDER = Path(__file__).parent / "images" / "readme"
SIZE, DPI = (4.2, 3.4), 150


def mechanism() -> Figure:
    """Draw the slider-pendulum of the paper, as in its figures 5 and 6."""
    model = cotree.load("slider-pendulum").compile(["L"])
    t, h = np.linspace(0, 10, 501), 1e-4
    result = model.simulate((0, 10), t)
    sides = [model.simulate((0, 10), t, parameters={"L": 1 + x})["j1.s"] for x in (h, -h)]
    differences = (sides[0] - sides[1]) / (2 * h)
    return _two_panels(
        (result.t, result["j1.s"], "slider $s$ [m]"),
        (result.t, result.sensitivity("j1.s", "L"), "∂s / ∂L [m/m]"),
        "slider-pendulum",
        circles=(t[::12], differences[::12]),
    )


def circuit() -> Figure:
    """Draw a bridge rectifier over two periods."""
    scene = cotree.load("bridge-rectifier")
    result = scene.compile(["C"]).simulate((0, 0.04), np.linspace(0, 0.04, 1001))
    name, ms = result.outputs[0], 1e3 * result.t
    return _two_panels(
        (ms, result[name], f"{name} [V]"),
        (ms, 1e-3 * result.sensitivity(name, "C"), f"∂{name} / ∂C [mV/μF]"),
        "bridge rectifier",
        time="time [ms]",
    )


def robot() -> Figure:
    """Draw an arm on its way to a position, at several times one over the other."""
    result = cotree.load("robot-arm").compile().simulate((0, 1.2), np.linspace(0, 1.2, 301))
    animation = result.animate(fps=25, speed=0.5)
    last = len(animation.drawing.frames.times) - 1
    width, height = 600, 480
    picture: Image.Image | None = None
    for share in (0.0, 0.25, 0.45, 0.65, 1.0):
        frame = animation.frame(round(share * last), width=width, height=height).convert("RGB")
        # Those before fade towards white, so that the last one stands out.
        white = Image.new("RGB", frame.size, "white")
        faded = frame if share == 1.0 else Image.blend(frame, white, 0.6)
        picture = faded if picture is None else ImageChops.darker(picture, faded)
    assert picture is not None
    figure = Figure(figsize=SIZE, layout="constrained")
    ax = figure.subplots()
    # Without the line of times at the top, of which each frame has its own.
    ax.imshow(picture.crop((60, 34, width - 60, height - 20)))
    ax.set_title("robot arm", fontsize=11)
    ax.set_axis_off()
    return figure


def _two_panels(upper, lower, title, circles=None, time="time [s]"):  # type: ignore[no-untyped-def]
    figure = Figure(figsize=SIZE, layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    for ax, (x, y, label), color in ((top, upper, "tab:blue"), (bottom, lower, "tab:orange")):
        ax.plot(x, y, color=color, lw=1.5)
        ax.set_ylabel(label)
        ax.grid(color="0.9")
        ax.spines[["top", "right"]].set_visible(False)
    if circles is not None:
        bottom.plot(*circles, "o", ms=4, mfc="none", color="0.3", label="finite differences")
        bottom.legend(loc="lower right", bbox_to_anchor=(1, 0.95), frameon=False, fontsize=8)
    top.set_title(title, fontsize=11)
    bottom.set_xlabel(time)
    return figure


def main() -> None:
    """Write the pictures."""
    FOLDER.mkdir(exist_ok=True)
    for draw in (mechanism, circuit, robot):
        draw().savefig(FOLDER / f"{draw.__name__}.png", dpi=DPI, metadata={"Software": None})


if __name__ == "__main__":
    main()
