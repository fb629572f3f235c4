"""The machine, its load and the software that times are taken with."""

from __future__ import annotations

import os
import platform
from contextlib import suppress
from pathlib import Path

import numpy as np

from cotree.build import find_toolchain
from cotree.codegen.sundials import SUNDIALS_VERSION
from cotree.solvers.native import is_available
from cotree.version import VERSION


def machine(backend: str) -> dict[str, str]:
    """Name processor, compiler and versions.

    Parameters
    ----------
    backend : str
        How the model's kernels are evaluated.
    """
    import scipy

    toolchain = find_toolchain()
    return {
        "cotree": VERSION,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        # Engines open no other version.
        "sundials": ".".join(map(str, SUNDIALS_VERSION)) if is_available("cvode") else "none",
        "system": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "processors": str(os.cpu_count()),
        "kernels": backend,
        "compiler": "none" if toolchain is None else toolchain.version,
    }


def load() -> str:
    """Give how many processes have run or waited in the last minute; "unknown" on Windows."""
    return f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown"


def _processor() -> str:
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        for line in lines:
            label, _, value = line.partition(":")
            if label.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()
