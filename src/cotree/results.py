"""Results with their pictures.

In: the record of a run and the model that made it. Out: a ``Result``, which can be drawn over time
and, where bodies move in space, animated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.solvers.result import RunRecord

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from cotree.watch import Animation
    from cotree.watch.frames import WatchedModel


@dataclass(frozen=True, eq=False, repr=False)
class Result(RunRecord):
    """The outcome of one simulation.

    Attributes
    ----------
    model : WatchedModel or None
        The model that ran; it is left behind where a result is copied or pickled.
    """

    model: WatchedModel | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave the model behind, which is a library in memory."""
        # Another process could not use its pointers.
        return {**self.__dict__, "model": None}

    def plot(self, names: str | Sequence[str | tuple[str, str]] | None = None) -> Figure:
        """Draw curves over time by the titles of ``columns()``; see ``cotree.plot.plot_result``.

        Sensitivities are "d(j1.s)/d(L)" or ("j1.s", "L"); where none is named, all those of the
        states and outputs that are stand beside them.
        """
        from cotree.plot import plot_result

        return plot_result(self, names)

    def animate(
        self,
        *,
        fps: float = 25.0,
        speed: float | None = None,
        view: tuple[float, float] | None = None,
        model: WatchedModel | None = None,
        trust_paths: bool = False,
    ) -> Animation:
        """Draw the mechanism as it moves, in its plane or in space.

        Positions between the points of the result follow from values, rates and accelerations at
        both ends; where a body turns by more than about half a turn between two points, ask for
        more with ``simulate(t_eval=...)``. A run that failed is shown up to where it got.

        Parameters
        ----------
        fps : float
            Frames for each second of watching. Of more than 2000 frames 2000 are made.
        speed : float, optional
            Seconds of the run for each second of watching. Runs of 2 to 30 s are shown as they
            happened where absent, others slower or faster.
        view : (float, float), optional
            Azimuth and elevation of the viewer, [deg]; a plane is viewed along its normal where
            absent.
        model : WatchedModel, optional
            The model that ran, which copied and pickled results do not keep.
        trust_paths : bool
            Whether a robot's file may name meshes outside its folder and its packages.

        Returns
        -------
        cotree.watch.Animation
            With ``save("name.gif")`` and ``save("name.html")``; a notebook shows it.

        Raises
        ------
        SceneError
            If nothing in the scene moves in space, or a setting makes no sense.
        """
        from cotree.watch import animate

        return animate(
            self,
            model or self.model,
            fps=fps,
            speed=speed,
            view=view,
            trust_paths=trust_paths,
        )
