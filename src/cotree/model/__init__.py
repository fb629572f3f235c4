"""The compiled model: kernels with buffers bound once, and what they compute as numpy arrays."""
