"""A texture for a mesh from oriented photographs: arrays in, arrays out."""
