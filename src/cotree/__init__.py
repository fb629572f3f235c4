"""From a linear graph of a dynamic system to compiled C with exact sensitivities."""

from __future__ import annotations

from cotree.api import Model, Scene, load
from cotree.build import cache_directory, clear_cache
from cotree.components import register_component
from cotree.errors import (
    BuildError,
    CodegenError,
    Error,
    ExpressionError,
    FormulationError,
    ModelError,
    ParameterError,
    SceneError,
    SingularSystemError,
    SolveError,
    TopologyError,
)
from cotree.reading import read_spice, read_urdf
from cotree.results import Result
from cotree.studies.bench import bench
from cotree.version import VERSION as __version__

__all__ = [
    "BuildError",
    "CodegenError",
    "Error",
    "ExpressionError",
    "FormulationError",
    "Model",
    "ModelError",
    "ParameterError",
    "Result",
    "Scene",
    "SceneError",
    "SingularSystemError",
    "SolveError",
    "TopologyError",
    "__version__",
    "bench",
    "cache_directory",
    "clear_cache",
    "load",
    "read_spice",
    "read_urdf",
    "register_component",
]
