"""Animations of results, saved as GIF files or self-contained HTML pages.

Names are untrusted: the page template escapes them, and JSON contains no HTML markup. A content
security policy contains the hashes of viewer and style, so that no other script can run or access a
network.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.codegen.render import environment
from cotree.errors import SceneError
from cotree.files import atomic_write, check_suffix, template_folder
from cotree.scene.expressions import check_number
from cotree.scene.part import origins_of
from cotree.sharing import forming
from cotree.version import VERSION
from cotree.watch.catalogue import draft_scene
from cotree.watch.frame_times import WatchedModel, choose_frames, coordinates_at
from cotree.watch.picture import MARGIN, Painter, decimals, gif, place_camera
from cotree.watch.shapes import visual_meshes
from cotree.watch.stage import MotionValues, set_stage

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from markupsafe import Markup

    from cotree.scene.description import SceneDescription
    from cotree.solvers import RunRecord
    from cotree.watch.drawing import Drawing
    from cotree.watch.shapes import Array, Mesh


_GRAINS = 50_000  # number of position steps within the extent of the motion
_TURN = 2e-5  # rounding step of quaternion components
_SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "4", "10")


@dataclass(frozen=True)
class PageContext:
    """The variables of the page template."""

    #: Title of the page and note on the run; both are untrusted.
    title: str
    note: str
    #: Content security policy of the page, and name of the program that wrote the file.
    policy: str
    generator: str
    last: int  # index of the last frame
    speeds: tuple[tuple[str, str], ...]  # labels and factors of the playback speeds
    #: Style sheet, script and data of the page, already escaped.
    style: Markup
    script: Markup
    data: Markup


def page(drawing: Drawing) -> str:
    """Return the HTML page; equal drawings have equal pages."""
    from markupsafe import Markup

    folder = template_folder() / "html"
    style, viewer, start = (
        (folder / name).read_text(encoding="utf-8")
        for name in ("viewer.css", "viewer.js", "animation.js")
    )
    script = viewer + start
    policy = f"default-src 'none'; script-src {hashed(script)}; style-src {hashed(style)}"
    context = PageContext(
        title=drawing.title,
        note=drawing.note,
        policy=policy,
        generator=f"cotree {VERSION}",
        last=len(drawing.frames.times) - 1,
        speeds=tuple((f"{factor}×", factor) for factor in _SPEEDS),
        # The style and the script are files of the package.
        style=Markup(style),
        script=Markup(script),
        data=Markup(embedded(page_data(drawing))),
    )
    return environment(is_html=True).get_template("html/page.html.jinja").render(page=context)


def embedded(value: Any) -> str:
    """Return JSON that is safe inside a script element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    # A "</script>" in a name would end the element, so "<" is escaped.
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def page_data(drawing: Drawing) -> dict[str, Any]:
    """Return the viewer's data as lists and numbers.

    Positions are integer multiples of ``unit``, quaternions of ``turn``; each row is the difference
    from the previous row. A track at rest has one row.
    """
    poses, frames = drawing.poses, drawing.frames
    camera, reach = place_camera(drawing, None)
    # Omit tracks without shapes.
    used = sorted(
        {solid.track for solid in drawing.solids}
        | {track for strut in drawing.struts for track in strut.tracks}
        | {label.track for label in drawing.labels}
    )
    number = {track: i for i, track in enumerate(used)}
    extent = float(np.abs(poses.positions[used]).max())
    extent = max(extent, float(np.abs(camera.centres).max()), float(max(reach)))
    # Positions become multiples of the unit, which is rounded to few digits before.
    unit = float(f"{extent / _GRAINS:.3g}") or 1.0
    times = frames.times
    return {
        "frames": len(times),
        "start": float(times[0]),
        "step": float(times[1] - times[0]) if len(times) > 1 else 0.0,
        "pause": frames.pause,
        "digits": decimals(times),
        "flat": drawing.is_flat,
        "up": drawing.up.tolist(),
        "towards": _short(drawing.towards),
        "reach": _short(reach),
        "margin": MARGIN,
        "extent": _short([extent])[0],
        "unit": unit,
        "turn": _TURN,
        "centres": _differences(camera.centres / unit),
        "tracks": [
            {
                "p": _differences(poses.positions[track] / unit),
                "q": _differences(_quaternions(poses.axes[track]) / _TURN),
            }
            for track in used
        ],
        "solids": [
            {
                "name": solid.name,
                "track": number[solid.track],
                "color": list(solid.color),
                "mesh": _packed(solid.mesh),
            }
            for solid in drawing.solids
        ],
        "struts": [
            {
                "name": strut.name,
                "tracks": [number[track] for track in strut.tracks],
                "ends": [_short(end) for end in strut.ends],
                "side": _short(strut.side),
                "color": list(strut.color),
                "mesh": _packed(strut.mesh),
            }
            for strut in drawing.struts
        ],
        "labels": [
            {"text": label.text, "track": number[label.track], "at": _short(label.local)}
            for label in drawing.labels
        ],
        "floor": _short(drawing.floor().ravel()),
    }


def _short(values: Sequence[float] | Array) -> list[float]:
    return [float(f"{float(v):.6g}") + 0.0 for v in values]


def _differences(rows: Array) -> list[int]:
    """Round rows to integers; return the first row and the differences of adjacent rows."""
    whole = np.rint(rows).astype(np.int64)
    # Round before taking differences, so that rounding errors do not accumulate.
    steps = np.diff(whole, axis=0)
    if not steps.any():
        return [int(v) for v in whole[0]]
    return [int(v) for v in np.concatenate([whole[:1], steps]).ravel()]


def _quaternions(axes: Array) -> Array:
    """Convert rotation matrices to unit quaternions, scalar first, with continuous signs."""
    r = axes
    # Four times the squared components. Divide by the largest one (S. Shepperd, 1978).
    trace = np.trace(r, axis1=1, axis2=2)
    squares = np.stack([1.0 + trace, *(1.0 - trace + 2.0 * r[:, i, i] for i in range(3))], axis=1)
    products = np.empty((len(r), 4, 4))
    for i in range(4):
        products[:, i, i] = squares[:, i]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        products[:, 0, i + 1] = products[:, i + 1, 0] = r[:, k, j] - r[:, j, k]
        products[:, i + 1, j + 1] = products[:, j + 1, i + 1] = r[:, i, j] + r[:, j, i]
    found: Array = products[np.arange(len(r)), np.argmax(squares, axis=1)]
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    # q and -q are the same rotation; continuous signs allow interpolation by the viewer.
    turns = np.sign(np.einsum("ti,ti->t", found[1:], found[:-1]))
    turns = np.cumprod(np.where(turns < 0.0, -1.0, 1.0))
    found[1:] *= turns[:, None]
    return found


def _packed(mesh: Mesh) -> dict[str, Any]:
    """Return a mesh in little-endian base64; vertices are two-byte fractions of their box."""
    low = mesh.points.min(axis=0)
    span = np.ptp(mesh.points, axis=0)
    parts = (mesh.points - low) / np.where(span > 0.0, span, 1.0)
    is_wide = len(mesh.points) > 65535
    return {
        "low": _short(low),
        "span": _short(span),
        "points": _base64(np.rint(65535.0 * parts).astype("<u2")),
        "faces": _base64(mesh.faces.astype("<u4" if is_wide else "<u2")),
        "wide": is_wide,
    }


def _base64(values: npt.NDArray[Any]) -> str:
    return base64.b64encode(values.tobytes()).decode("ascii")


def hashed(text: str) -> str:
    """Return the source of a text in a content security policy."""
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"


_SUFFIXES = (".gif", ".html")
_NOTEBOOK_HEIGHT = 520  # height of the figure in a notebook, [pixel]
_LARGEST_PICTURE = 4000
_FURTHEST = 1e12  # largest drawn coordinate, [m] or [rad]


@dataclass(frozen=True, eq=False, repr=False)
class Animation:
    """An animated mechanism; a notebook displays it directly.

    Attributes
    ----------
    drawing : Drawing
        The shapes, and their poses in each frame.
    """

    drawing: Drawing

    def __repr__(self) -> str:
        frames = self.drawing.frames
        return (
            f"<Animation of {self.drawing.title}: {len(frames.times)} frames, {frames.speed:.3g} "
            "s of the run per second>"
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
            Maximum number of frames of a GIF; longer animations are reduced to every second, third,
            ... frame.

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
        with atomic_write(target, "the animation") as draft:
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
        """Return the animation as an HTML page."""
        return page(self.drawing)

    def _repr_html_(self) -> str:
        return (
            # Names are untrusted: the sandbox isolates the page from the notebook.
            f'<iframe sandbox="allow-scripts" srcdoc="{html.escape(self.html)}" width="100%" '
            f'height="{_NOTEBOOK_HEIGHT}" style="border:0"></iframe>'
        )


def _check_size(value: int, what: str, least: int, most: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise SceneError(f"{what} is {str(value)[:20]}: give a whole number from {least} to {most}")


def check_animation(path: Path) -> str:
    """Return the suffix of an animation file; raise SceneError if it is unknown."""
    return check_suffix(path, _SUFFIXES, "animate into")


def check_moving(scene: SceneDescription) -> None:
    """Raise SceneError if a scene has no multibody part."""
    if not scene.mechanics.edges:
        raise SceneError(
            f"scene '{scene.name}' has no bodies or joints: only multibody systems can be "
            "animated; plots show other results"
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
    """Return the animation of a run; see :meth:`cotree.results.Result.animate`."""
    if model is None:
        raise SceneError(
            "this result was copied or read from a file and has no model: pass it as "
            "result.animate(model=...)"
        )
    # A result does not refer to its model, so compare the names of the states.
    if model.states != result.states:
        raise SceneError(
            "the states of this model differ from those of the result: pass the model of the run"
        )
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
    """Return the run up to the first coordinate that is not finite or too large."""
    # Comparisons with nan are false, so nan counts as too large.
    with np.errstate(invalid="ignore"):
        is_bad = ~(np.abs(result.y[:n]) < _FURTHEST).all(axis=0)
    end = int(np.argmax(is_bad)) if is_bad.any() else len(result.t)
    if end == 0:
        raise SceneError("the run has no point that could be drawn: see result.message")
    return replace(
        result, t=result.t[:end], y=result.y[:, :end], input_values=result.input_values[:, :end]
    )
