"""The compiled model: kernels with buffers bound once, and their results as numpy arrays."""
