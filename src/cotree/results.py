"""Simulation results with their plots and animations."""

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
    from cotree.watch.frame_times import WatchedModel


@dataclass(frozen=True, eq=False, repr=False)
class Result(RunRecord):
    """The outcome of one simulation.

    Attributes
    ----------
    model : WatchedModel or None
        The model; copies and pickles of a result do not have it.
    settings : Settings or None
        The settings of the run; copies and pickles do not have them.
    """

    model: WatchedModel | None = None
    settings: Settings | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for pickling, without the model (a loaded library) and the settings."""
        # The model contains pointers, and inputs may be functions: another process cannot use them.
        return {**super().__getstate__(), "model": None, "settings": None}

    def smooth(self) -> RunRecord:
        """Return the same run at enough times for smooth curves.

        Values between points are those of the method's own interpolation, with both sides of each
        jump. The result itself is returned if it has 400 points or no model, or if its run failed,
        took more than 4000 steps or had Python functions as inputs.
        """
        from cotree.plot.smooth import at_more_times

        kernels = getattr(self.model, "kernels", None)
        if kernels is None or self.settings is None:
            return self
        return at_more_times(self, kernels, self.settings)

    def plot(
        self, names: str | Sequence[str | tuple[str, str]] | None = None, *, ax: Axes | None = None
    ) -> Figure:
        """Draw curves over time; names are the titles of ``columns()``.

        Curves are smooth between the points of the result; see :meth:`smooth`. ``plt.show()`` shows
        the figure; notebooks, and prompts after an import of pyplot, show it at once.

        Parameters
        ----------
        names : str, sequence of str or of (str, str), optional
            States, outputs, inputs, and sensitivities as "d(j1.s)/d(L)" or ("j1.s", "L"). If no
            sensitivity is named, all those of the named states and outputs are plotted next to
            them. By default the coordinates.
        ax : Axes, optional
            Existing axes to draw into: curves of one unit, and only sensitivities that are named.

        Returns
        -------
        Figure
            A panel for each unit, and next to it one for each parameter.

        Raises
        ------
        SceneError
            If the result does not contain a name, or curves for ``ax`` have several units.
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
        """Animate the mechanism, in its plane or in space.

        Positions between the points of the result are interpolated from values, rates and
        accelerations. If a body rotates by more than about half a turn between two points, request
        more with ``simulate(t_eval=...)``.

        Parameters
        ----------
        fps : float
            Frames per second of the animation; at most 2000 frames are drawn.
        speed : float, optional
            Seconds of the run per second of the animation. By default runs of 2 to 30 s are shown
            in real time, others slower or faster.
        view : (float, float), optional
            Azimuth and elevation of the viewer, [deg]; by default a plane is viewed along its
            normal.
        model : WatchedModel, optional
            The model, for results that were copied or unpickled.
        trust_paths : bool
            Whether a robot's file may refer to meshes outside its folder and its packages.

        Returns
        -------
        cotree.watch.Animation
            Has ``save("name.gif")`` and ``save("name.html")``; notebooks show it.

        Raises
        ------
        SceneError
            If no body of the scene moves in space, or a setting is invalid.
        """
        from cotree.watch import animate

        return animate(
            self, model or self.model, fps=fps, speed=speed, view=view, trust_paths=trust_paths
        )
