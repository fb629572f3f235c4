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

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from cotree.scene.settings import Settings
    from cotree.watch import Animation
    from cotree.watch.frames import WatchedModel


@dataclass(frozen=True, eq=False, repr=False)
class Result(RunRecord):
    """The outcome of one simulation.

    Attributes
    ----------
    model : WatchedModel or None
        The model that ran; it is left behind where a result is copied or pickled.
    settings : Settings or None
        The settings of the run, which are left behind with it.
    """

    model: WatchedModel | None = None
    settings: Settings | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave the model behind, which is a library in memory, and settings of it."""
        # Another process could not use its pointers, nor inputs that are functions.
        return {**super().__getstate__(), "model": None, "settings": None}

    def smooth(self) -> RunRecord:
        """Return the same run at as many times as make its curves smooth.

        Values between the points of this result are those of the method's own interpolation, with
        both sides of each jump. Of runs that have 400 points, failed, took more than 4000 steps or
        have functions of Python as inputs, and of results without their model, this is the result
        itself.
        """
        from cotree.solvers.simulate import at_more_times

        kernels = getattr(self.model, "kernels", None)
        if kernels is None or self.settings is None:
            return self
        return at_more_times(self, kernels, self.settings)

    def plot(
        self,
        names: str | Sequence[str | tuple[str, str]] | None = None,
        *,
        ax: Axes | None = None,
    ) -> Figure:
        """Draw curves over time by the titles of ``columns()``.

        Curves are smooth between the points of the result; see :meth:`smooth`. ``plt.show()``
        shows the figure, and a notebook does, where matplotlib's pyplot was imported before, and
        at any interactive prompt.

        Parameters
        ----------
        names : str, sequence of str or of (str, str), optional
            States, outputs, inputs, and sensitivities as "d(j1.s)/d(L)" or ("j1.s", "L"); where
            none is named, all those of the states and outputs that are stand beside them. The
            coordinates where absent.
        ax : Axes, optional
            Axes to draw into, beside what they show: curves of one unit, and no sensitivity that is
            not named.

        Returns
        -------
        Figure
            A panel for each unit, and beside it one for each parameter.

        Raises
        ------
        SceneError
            If there is nothing of a name in the result, or curves for ``ax`` have several units.
        """
        from cotree.plot import draw_curves, plot_result

        if ax is not None:
            return draw_curves(self.smooth(), names, ax)
        from cotree.plot.figures import figure_for_people

        return plot_result(self.smooth(), names, make=figure_for_people)

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
