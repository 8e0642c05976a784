"""What the parts of the road are expected to take, from the size of the set: `benchmarks/remaining.py` measures it."""

from __future__ import annotations

from colmap_ihe.colmap import textured
from colmap_ihe.colmap.dense import pick_backend
from colmap_ihe.colmap.matching import choose_strategy, pairs_of
from colmap_ihe.forecast import Part
from colmap_ihe.options import Options

_ASPECT = 1.5  # of photographs, by and large


def expected(options: Options, images: int, pixels: int, with_gps: int, until: str) -> list[Part]:
    """The parts between `captures` and the end of the stage `until`, in order, of a set of `images` photographs with
    `pixels` in all; with those of the page, which follows where there is a model."""
    megapixels = pixels / 1e6
    pairs = pairs_of(choose_strategy(options.matches.strategy, images, with_gps), images)
    parts = [
        Part("fit", "images", 0.01 * megapixels),
        Part("convert", "images", 0.03 * megapixels),
        Part("features", "images", 1.1 * megapixels),
        Part("matches", "pairs", 0.15 * pairs),
        Part("sparse", "images", 1.0 * images),
    ]
    if options.dense.enabled:
        parts += _dense(options, images, megapixels)
    before = [n for n, part in enumerate(parts) if part.stage == until]
    parts = parts[: before[-1] + 1] if before else parts * (until != "captures")
    if any(part.stage == "sparse" for part in parts):
        parts += [Part("page", "photographs looked at", 0.06 * megapixels), Part("page", "pairs drawn", 6.0)]
    return parts


def _dense(options: Options, images: int, megapixels: float) -> list[Part]:
    seen = min(megapixels, images * options.dense.max_image_size**2 / _ASPECT / 1e6)
    if pick_backend(options.dense.backend) == "patchmatch":
        depth = Part("dense", "runs of PatchMatch", 3.0 * seen)
    else:
        depth = Part("dense", "depth maps", 3.0 * seen)
    parts = [Part("dense", "undistorted sets", 0.2 * megapixels), depth, Part("dense", "fusions", 0.9 * seen)]
    if not options.mesh.enabled:
        return parts
    parts.append(Part("mesh", "parts of the surface", 1.7 * seen))
    if options.mesh.texture is False or (options.mesh.texture == "auto" and not textured.is_possible()):
        return parts
    return [
        *parts,
        Part("mesh", "photographs looked through", 1.0 * seen),
        Part("mesh", "atlases", 2.0),
        Part("mesh", "photographs compared at seams", 0.7 * seen),
        Part("mesh", "photographs on the texture", 0.2 * seen),
        Part("mesh", "sets of files", 2.0),
    ]
