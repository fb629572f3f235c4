"""Animations of results, and their files."""

from __future__ import annotations

import html
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import SceneError
from cotree.files import check_suffix, written_whole
from cotree.scene.expressions import check_number
from cotree.scene.part import origins_of
from cotree.sharing import forming
from cotree.watch.catalogue import draft_scene
from cotree.watch.frames import choose_frames, coordinates_at
from cotree.watch.meshes import visual_meshes
from cotree.watch.page import page
from cotree.watch.picture import Painter, gif
from cotree.watch.stage import MotionValues, set_stage

if TYPE_CHECKING:
    import os

    from cotree.scene.description import SceneDescription
    from cotree.solvers import RunRecord
    from cotree.watch.drawing import Drawing
    from cotree.watch.frames import WatchedModel
    from cotree.watch.shapes import Mesh

_SUFFIXES = (".gif", ".html")
_NOTEBOOK_HEIGHT = 520  # pixels
_LARGEST_PICTURE = 4000
_FURTHEST = 1e12  # largest coordinate that is drawn, [m] or [rad]


@dataclass(frozen=True, eq=False, repr=False)
class Animation:
    """An animated mechanism; a notebook displays it directly.

    Attributes
    ----------
    drawing : Drawing
        Shapes, and their poses in each frame.
    """

    drawing: Drawing

    def __repr__(self) -> str:
        frames = self.drawing.frames
        return (
            f"<Animation of {self.drawing.title}: {len(frames.times)} frames, "
            f"{frames.speed:.3g} s of the run a second>"
        )

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        width: int = 640,
        height: int | None = None,
        max_frames: int = 400,
    ) -> None:
        """Write a GIF or an HTML file, completely or not at all.

        Parameters
        ----------
        path : path
            The file: ``.gif``, or ``.html`` for a page with a time slider.
        width, height : int and int or None
            Size of a GIF, [px]; if the height is None, it follows from the drawing.
        max_frames : int
            Largest number of frames of a GIF; of more frames every second, third and so on is
            taken.

        Raises
        ------
        SceneError
            If the suffix is unknown, a number is out of range or the file cannot be written.
        """
        target = Path(path)
        if check_animation(target) == ".html":
            text = self.html.encode("utf-8")
        else:
            _check_size(width, "width", 32, _LARGEST_PICTURE)
            if height is not None:
                _check_size(height, "height", 32, _LARGEST_PICTURE)
            _check_size(max_frames, "max_frames", 1, 100_000)
            text = gif(self.drawing, width, height, max_frames)
        with written_whole(target, "the animation") as draft:
            draft.write_bytes(text)

    def frame(self, number: int, *, width: int = 640, height: int | None = None) -> Any:
        """Render one frame as a Pillow image.

        Parameters
        ----------
        number : int
            The frame; negative numbers count from the end.
        width, height : int
            Size, [px]; by default the height follows from the drawing.

        Raises
        ------
        SceneError
            If there is no such frame.
        """
        n = len(self.drawing.frames.times)
        if not -n <= number < n:
            raise SceneError(f"there is no frame {number}: the animation has {n}")
        return Painter(self.drawing, width, height).paint(number % n)

    @cached_property
    def html(self) -> str:
        """The animation as a page of its own."""
        return page(self.drawing)

    def _repr_html_(self) -> str:
        """Show the page in a notebook, in an isolated frame."""
        return (
            # Names are untrusted: the sandbox separates the page from the notebook.
            f'<iframe sandbox="allow-scripts" srcdoc="{html.escape(self.html)}" width="100%" '
            f'height="{_NOTEBOOK_HEIGHT}" style="border:0"></iframe>'
        )


def _check_size(value: int, what: str, least: int, most: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise SceneError(f"{what} is {str(value)[:20]}: give a whole number from {least} to {most}")


def check_animation(path: Path) -> str:
    """Return the suffix of an animation's file."""
    return check_suffix(path, _SUFFIXES, "animate into")


def check_moving(scene: SceneDescription) -> None:
    """Refuse a scene without a multibody part."""
    if not scene.mechanics.edges:
        raise SceneError(
            f"scene '{scene.name}' has no bodies or joints in space to be watched: only multibody "
            "systems can be animated; plots show the others"
        )


def animate(
    result: RunRecord,
    model: WatchedModel | None,
    *,
    fps: float = 25.0,
    speed: float | None = None,
    view: tuple[float, float] | None = None,
    trust_paths: bool = False,
) -> Animation:
    """Draw a mechanism over a run; see :meth:`cotree.results.Result.animate`."""
    if model is None:
        raise SceneError(
            "this result was copied or read from a file and has no model: "
            "give it as result.animate(model=...)"
        )
    # A result has no reference to its model, so the names of the states are compared.
    if model.states != result.states:
        raise SceneError("this model has other states than the result: give the one that made it")
    first = model.spec.formed.first
    check_moving(first.scene)
    if view is not None:
        try:
            azimuth, elevation = view
        except (TypeError, ValueError):
            raise SceneError("view must be a pair: azimuth and elevation in degrees") from None
        view = check_number(azimuth, "azimuth"), check_number(elevation, "elevation")
    shown = _finite_part(result, len(first.system.coordinates))
    n_bodies = len(first.motion.geometry)
    frames = choose_frames(float(shown.t[0]), float(shown.t[-1]), fps, speed, n_bodies)
    p = model.kernels.arguments_of(result.parameter_values)
    with forming:
        coordinates = coordinates_at(shown, model, first.system, p, frames.times)
        values = MotionValues(first.motion, p, frames.times, coordinates)
        stage = set_stage(first, values, view)
        meshes: dict[int, list[tuple[str, Mesh]]] = {}
        for origin in origins_of(first.scene):
            own = visual_meshes(origin, stage.places, trust_paths=trust_paths)
            for cluster, rows in own.items():
                meshes.setdefault(cluster, []).extend(rows)
        draft = draft_scene(first, values, stage, meshes)
    note = "" if result.success else f"stopped early at t = {shown.t[-1]:.6g} s"
    return Animation(draft.drawing(first.scene.name, note, frames))


def _finite_part(result: RunRecord, n: int) -> RunRecord:
    """Cut a run before coordinates that are not finite or out of bounds."""
    # Comparisons with nan are false, so that such points are bad.
    with np.errstate(invalid="ignore"):
        is_bad = ~(np.abs(result.y[:n]) < _FURTHEST).all(axis=0)
    end = int(np.argmax(is_bad)) if is_bad.any() else len(result.t)
    if end == 0:
        raise SceneError("the run has no point that could be drawn: see result.message")
    return replace(
        result, t=result.t[:end], y=result.y[:, :end], input_values=result.input_values[:, :end]
    )
