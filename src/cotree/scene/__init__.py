"""The scene: edges between named nodes, with parameters, inputs, outputs and initial values."""
