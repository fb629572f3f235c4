"""The compiled model: C kernels with permanent buffers, and their results as NumPy arrays."""
