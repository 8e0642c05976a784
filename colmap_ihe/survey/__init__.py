"""Make a model metric: named points, control, scale, coded targets."""
