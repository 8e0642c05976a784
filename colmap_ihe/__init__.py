"""colmap-ihe: one grey conversion fitted to the whole set of photographs, in front of COLMAP."""

# Before pycolmap, which binds the system's zlib to its own symbols if it is first (docs/decisions/0003).
import zlib  # noqa: F401
