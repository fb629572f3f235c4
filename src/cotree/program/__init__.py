"""The program: kernels as expression graphs, formed from the equations and translated to C."""

from __future__ import annotations
