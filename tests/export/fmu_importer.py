"""An FMU as tests drive it, through FMPy's C interface."""

from __future__ import annotations

import ctypes
import math
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import FMU3Model, FMU3Slave

SCENES = sorted(
    path.stem for path in (Path(__file__).parents[2] / "src" / "cotree" / "scenes").glob("*.toml")
)


def share(
    cases: list[tuple[Any, ...]], slow: list[tuple[Any, ...]], quick: tuple[Any, ...]
) -> list[Any]:
    """Return cases as parameters: one to quick runs, some to slow ones, all to campaigns."""
    marks = {case: [pytest.mark.slow, pytest.mark.campaign] for case in cases}
    marks |= {case: [pytest.mark.slow] for case in slow} | {quick: []}
    return [pytest.param(*case, marks=marks[case]) for case in cases]


#: Scenes and versions. Every second one has all scenes, half of them in each version.
UNITS = [(n, v) for i, n in enumerate(SCENES) for v in ((3, 2) if i % 2 else (2, 3))]


def simulated(
    path: Path, kind: str, t_end: float, interval: float, names: list[str], tolerance: float
) -> Any:
    """Simulate an FMU with FMPy; return its points, an array with a column ``time``."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # FMPy leaves folders to the collector
        return simulate_fmu(
            str(path),
            fmi_type=kind,
            stop_time=t_end,
            output_interval=interval,
            step_size=interval if kind == "CoSimulation" else None,
            relative_tolerance=tolerance,
            output=names,
            record_events=False,
        )


class Unit:
    """An instance of an FMU, with names in place of value references."""

    def __init__(self, path: Path, kind: str = "ModelExchange", **how: Any) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self.folder = extract(str(path), self._folder.name)
        self.description = read_model_description(self.folder)
        self.version = 3 if self.description.fmiVersion.startswith("3") else 2
        self.is_exchanged = kind == "ModelExchange"
        classes = {2: (FMU2Slave, FMU2Model), 3: (FMU3Slave, FMU3Model)}
        own = self.description.modelExchange or self.description.coSimulation
        self.fmu = classes[self.version][self.is_exchanged](
            guid=self.description.guid,
            unzipDirectory=self.folder,
            modelIdentifier=own.modelIdentifier,
            instanceName="unit",
        )
        self.messages: list[str] = []
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.names = {v: k for k, v in self.references.items()}
        self.fmu.instantiate(**how)

    def __enter__(self) -> Unit:
        return self

    def __exit__(self, *_: object) -> None:
        self.fmu.freeInstance()
        self._folder.cleanup()

    def list(self, causality: str) -> list[str]:
        return [v.name for v in self.description.modelVariables if v.causality == causality]

    @property
    def rates(self) -> list[str]:
        return [u.variable.name for u in self.description.derivatives]

    @property
    def states(self) -> list[str]:
        return [u.variable.derivative.name for u in self.description.derivatives]

    def at(self, names: list[str]) -> list[int]:
        return [self.references[name] for name in names]

    def get(self, *names: str) -> np.ndarray:
        read = self.fmu.getFloat64 if self.version == 3 else self.fmu.getReal
        return np.array(read(self.at(list(names))))

    def set(self, **values: float) -> None:
        self.put(values)

    def put(self, values: dict[str, float]) -> None:
        write = self.fmu.setFloat64 if self.version == 3 else self.fmu.setReal
        write(self.at(list(values)), list(values.values()))

    def initialize(
        self,
        tolerance: float = 1e-10,
        stop: float | None = None,
        values: dict[str, float] | None = None,
    ) -> None:
        self.begin(tolerance, stop, values)
        self.fmu.exitInitializationMode()

    def begin(
        self,
        tolerance: float = 1e-10,
        stop: float | None = None,
        values: dict[str, float] | None = None,
    ) -> None:
        if values:
            self.put(values)
        if self.version == 3:
            self.fmu.enterInitializationMode(tolerance=tolerance, startTime=0.0, stopTime=stop)
        else:
            self.fmu.setupExperiment(tolerance=tolerance, startTime=0.0, stopTime=stop)
            self.fmu.enterInitializationMode()

    def update(self) -> float:
        """Update discrete states; give the time of the next event, infinity for none."""
        update = self.fmu.updateDiscreteStates if self.version == 3 else self.fmu.newDiscreteStates
        *_, has_next, t_next = update()
        return t_next if has_next else math.inf

    def go(self, t: float, x: np.ndarray) -> None:
        """Set time and states in Continuous-Time Mode."""
        self.fmu.setTime(t)
        values = (ctypes.c_double * len(x))(*x)
        self.fmu.setContinuousStates(values, len(x))

    def step(self, t: float, size: float) -> Any:
        return self.fmu.doStep(t, size)

    def slopes(self, unknowns: list[str], knowns: list[str]) -> np.ndarray:
        """Form the matrix of directional derivatives, one column for each known."""
        n = len(knowns)
        columns = [
            self.fmu.getDirectionalDerivative(self.at(unknowns), self.at(knowns), list(row))
            for row in np.eye(n)
        ]
        return np.array(columns).T.reshape(len(unknowns), n)

    def adjoints(self, unknowns: list[str], knowns: list[str]) -> np.ndarray:
        """Form it by adjoint derivatives, one row for each unknown."""
        rows = [
            self.fmu.getAdjointDerivative(
                self.at(unknowns), self.at(knowns), list(row), len(knowns)
            )
            for row in np.eye(len(unknowns))
        ]
        return np.array(rows).reshape(len(unknowns), len(knowns))
