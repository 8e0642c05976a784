"""Photographs in: discovered, described, decoded, and encoded again with what they say of themselves."""
