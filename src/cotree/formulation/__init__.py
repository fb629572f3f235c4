"""The branch-chord formulation: from a scene and its trees to governing equations."""
