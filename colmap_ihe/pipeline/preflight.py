"""What can be refused before any work: options that pycolmap does not know, a backend or a package that is not
there."""

from __future__ import annotations

from colmap_ihe.colmap import features, mapping, matching
from colmap_ihe.dense import backend as dense
from colmap_ihe.dense import fusion, mesh
from colmap_ihe.photographs.raw.denoise import require_wavelets
from colmap_ihe.project.options import Options


def check_options(options: Options, images: int) -> None:
    """Builds all of pycolmap's options once, so that a slip costs no finished work. `images` is how many there
    are, on which the matching strategy depends. Raises `OptionError`, `CapabilityError`."""
    if options.develop.denoise > 0:
        require_wavelets()
    model = features.choose_model(options.camera, images, images)
    features.native_options(options.camera, options.features, model)
    with_gps = images  # not known yet: spatial without GPS is refused when its turn comes
    matching.native_options(
        options.matches, matching.choose_strategy(options.matches.strategy, images, with_gps)
    )
    mapping.native_options(options.sparse)
    if options.dense.enabled:
        dense.pick_backend(options.dense.backend)
        fusion.fusion_options(options.dense.colmap)
        dense.patchmatch_options(options.dense.patchmatch)
    if options.meshed:
        mesh.poisson_options(options.mesh.colmap)
