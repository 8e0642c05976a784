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
        Part("features", "images", 0.55 * megapixels + 0.4 * images),
        Part("matches", "pairs", 0.1 * pairs),
        Part("sparse", "images", 0.7 * images),
    ]
    if options.dense.enabled:
        parts += _dense(options, images, megapixels)
    before = [n for n, part in enumerate(parts) if part.stage == until]
    parts = parts[: before[-1] + 1] if before else parts * (until != "captures")
    if any(part.stage == "sparse" for part in parts):
        parts += [Part("page", "photographs looked at", 0.045 * megapixels), Part("page", "pairs drawn", 5.0)]
    return parts


def _dense(options: Options, images: int, megapixels: float) -> list[Part]:
    seen = min(megapixels, images * options.dense.max_image_size**2 / _ASPECT / 1e6)
    if pick_backend(options.dense.backend) == "patchmatch":
        depth = Part("dense", "runs of PatchMatch", 3.0 * seen)
    else:
        depth = Part("dense", "depth maps", 1.7 * seen)
    parts = [
        Part("dense", "undistorted sets", 0.1 * megapixels + 0.2 * images),
        depth,
        Part("dense", "fusions", 0.35 * seen),
    ]
    if not options.mesh.enabled:
        return parts
    parts.append(Part("mesh", "parts of the surface", 0.87 * seen))
    if options.mesh.texture is False or (options.mesh.texture == "auto" and not textured.is_possible()):
        return parts
    return [
        *parts,
        Part("mesh", "photographs looked through", 0.45 * seen),
        Part("mesh", "atlases", 1.0),
        Part("mesh", "photographs compared at seams", 0.45 * seen),
        Part("mesh", "photographs on the texture", 0.15 * seen),
        Part("mesh", "sets of files", 1.0),
    ]
