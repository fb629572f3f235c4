"""The scalar networks of a scene: rules of variables, their order of computation, their values."""
