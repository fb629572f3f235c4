"""The machine, its load and the software that times are taken with."""

from __future__ import annotations

import os
import platform

import numpy as np

from cotree.build import find_toolchain
from cotree.build.options import processor_name
from cotree.codegen.integrators import SUNDIALS_VERSION
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
        "processor": processor_name(),
        "processors": str(os.cpu_count()),
        "kernels": backend,
        "compiler": "none" if toolchain is None else toolchain.version,
    }


def load() -> str:
    """Give how many processes have run or waited in the last minute; "unknown" on Windows."""
    return f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown"
