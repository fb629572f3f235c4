"""Animation of mechanisms.

In: a result and the first graph of its model. Out: an :class:`Animation`, which is saved as a GIF
or an HTML file. Drawing needs no compiler, since positions are evaluated from the graph.
"""

from __future__ import annotations

from cotree.watch.animation import Animation, animate, check_animation, check_moving

__all__ = ["Animation", "animate", "check_animation", "check_moving"]
