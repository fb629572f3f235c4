"""The scalar networks of a scene: rules, their order, and the values that follow."""
