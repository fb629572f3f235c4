"""The scalar networks of a scene: rules of variables, their order, and their values."""
