"""Animation of mechanisms from a result and the first graph of its model, without a compiler."""

from __future__ import annotations

from cotree.watch.animation import Animation, animate, check_animation, check_moving

__all__ = ["Animation", "animate", "check_animation", "check_moving"]
