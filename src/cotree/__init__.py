"""From a linear graph of a dynamic system to compiled C with exact sensitivities."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cotree.api import Model, Scene, load
    from cotree.blocks import state_space, transfer_function
    from cotree.build import cache_directory, clear_cache
    from cotree.components import register_component
    from cotree.design.optimise import optimise
    from cotree.ensemble.members import grid
    from cotree.ensemble.sampling import sample
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
        StoreError,
        TopologyError,
        UnitError,
    )
    from cotree.estimation.candidates import Candidates, NextMeasurement
    from cotree.estimation.experiment import Experiment
    from cotree.estimation.fit import estimation_problem, fit
    from cotree.estimation.petab.problem import PetabProblem, read_petab
    from cotree.model.signals import sampled
    from cotree.plot.ensembles import bands, curves, heat_map
    from cotree.reading import read_sbml, read_spice, read_urdf
    from cotree.results import Result
    from cotree.scene.settings import Settings
    from cotree.studies.bench import bench
    from cotree.version import VERSION as __version__

__all__ = [
    "BuildError",
    "Candidates",
    "CodegenError",
    "Error",
    "Experiment",
    "ExpressionError",
    "FormulationError",
    "Model",
    "ModelError",
    "NextMeasurement",
    "ParameterError",
    "PetabProblem",
    "Result",
    "Scene",
    "SceneError",
    "Settings",
    "SingularSystemError",
    "SolveError",
    "StoreError",
    "TopologyError",
    "UnitError",
    "__version__",
    "bands",
    "bench",
    "cache_directory",
    "clear_cache",
    "curves",
    "estimation_problem",
    "fit",
    "grid",
    "heat_map",
    "load",
    "optimise",
    "read_petab",
    "read_sbml",
    "read_spice",
    "read_urdf",
    "register_component",
    "sample",
    "sampled",
    "state_space",
    "transfer_function",
]

# Modules of all public names except errors. They are imported at the first use of a name (PEP 562),
# so that a program imports only what it uses.
_HOMES = {
    "Candidates": "estimation.candidates",
    "Experiment": "estimation.experiment",
    "Model": "api",
    "NextMeasurement": "estimation.candidates",
    "PetabProblem": "estimation.petab.problem",
    "Result": "results",
    "Scene": "api",
    "Settings": "scene.settings",
    "__version__": "version",
    "bands": "plot.ensembles",
    "bench": "studies.bench",
    "cache_directory": "build",
    "clear_cache": "build",
    "curves": "plot.ensembles",
    "estimation_problem": "estimation.fit",
    "fit": "estimation.fit",
    "grid": "ensemble.members",
    "heat_map": "plot.ensembles",
    "load": "api",
    "optimise": "design.optimise",
    "read_petab": "estimation.petab.problem",
    "read_sbml": "reading",
    "read_spice": "reading",
    "read_urdf": "reading",
    "register_component": "components",
    "sample": "ensemble.sampling",
    "sampled": "model.signals",
    "state_space": "blocks",
    "transfer_function": "blocks",
}

if not TYPE_CHECKING:  # type checkers use the imports above and report unknown names

    def __getattr__(name: str) -> object:
        """Import a public name at its first use."""
        if name not in __all__:
            raise AttributeError(f"module 'cotree' has no attribute '{name}'")
        from importlib import import_module

        home = import_module(f"cotree.{_HOMES.get(name, 'errors')}")
        globals()[name] = value = getattr(home, "VERSION" if name == "__version__" else name)
        return value

    def __dir__() -> list[str]:
        """List the public names, imported or not."""
        return sorted({*globals(), *__all__})
