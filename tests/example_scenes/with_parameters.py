"""Scenes that several tests build upon."""

import cotree


def scene_with(name, **parameters):
    """Build a scene of nothing but parameters."""
    scene = cotree.Scene(name)
    for key, value in parameters.items():
        scene.parameter(key, value)
    return scene
