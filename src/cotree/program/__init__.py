"""The program: kernels over one arena of nodes, between the equations and the C text."""

from __future__ import annotations

from cotree.program.counts import OperationCount, count_operations
from cotree.program.kernels import KERNELS, KernelSpec
from cotree.program.program import Kernel, Layout, Program

__all__ = [
    "KERNELS",
    "Kernel",
    "KernelSpec",
    "Layout",
    "OperationCount",
    "Program",
    "count_operations",
]
