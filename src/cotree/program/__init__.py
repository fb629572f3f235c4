"""The program: kernels over one arena of nodes, between the equations and the C text."""

from __future__ import annotations
