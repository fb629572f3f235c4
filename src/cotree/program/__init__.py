"""The program: kernels as expression graphs, between the equations and the C text."""

from __future__ import annotations
