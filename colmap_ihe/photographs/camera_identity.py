"""Tell which photographs one camera took, by their size and by what EXIF says of it.

COLMAP 4.2 takes photographs for those of one camera if they agree in make, model, focal length and size, and in AUTO
gives each a camera of its own where one of make, model and focal length is missing (measured with import_images, see
tests/colmap/test_image_import.py).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine.decoder_pool import in_decoder
from colmap_ihe.photographs.coded import stored_header
from colmap_ihe.photographs.exif.metadata import Metadata, decode_metadata

Optics = tuple[str, str, float]
Key = tuple[str, str, float, int, int]


@dataclass(frozen=True)
class CameraIdentity:
    """Hold what EXIF says of a photograph's camera, empty or 0 where it does not, and the size of the photograph.
    Focal lengths in mm, `focal_35mm` the equivalent; sizes in pixels as stored."""

    make: str
    model: str
    focal_mm: float
    focal_35mm: float
    width: int
    height: int

    @property
    def focal(self) -> float:
        """Return the number by which COLMAP tells focal lengths apart, 0 for none."""
        return self.focal_35mm or self.focal_mm

    @property
    def optics(self) -> Optics:
        """Return what is the same for photographs by one camera, also of several sizes."""
        return self.make, self.model, self.focal

    @property
    def size(self) -> tuple[int, int]:
        return self.width, self.height

    @property
    def key(self) -> Key:
        """Return what is the same for photographs by one camera."""
        return self.make, self.model, self.focal, self.width, self.height

    @property
    def upright_key(self) -> Key:
        """Return what is the same for photographs by one camera, also if some were turned in their pixels."""
        sides = self.width, self.height
        return self.make, self.model, self.focal, max(sides), min(sides)

    @property
    def is_whole(self) -> bool:
        """Tell whether COLMAP finds photographs by the same camera with it."""
        return all(self.optics)


def camera_identity(metadata: Metadata, width: int, height: int) -> CameraIdentity:
    """Return the identity of the camera of a photograph of this size in pixels."""
    return CameraIdentity(
        metadata.make, metadata.model, metadata.focal_mm, metadata.focal_35mm, width, height
    )


def read_identities(folder: Path, names: Iterable[str]) -> dict[str, CameraIdentity]:
    """Return the identities of the cameras of grey images below `folder`, which have the EXIF of their photographs, by
    name in the order of the names; without images that cannot be read. It takes 1 to 2 ms an image."""
    identities = {}
    for name in sorted(names):
        try:
            identities[name] = in_decoder(decode_identity, folder / name)
        except PhotographError:  # COLMAP does not take it either
            continue
    return identities


def decode_identity(path: Path) -> CameraIdentity:
    """Return the identity of the camera of one image, in this process. Raises OSError, `PhotographError`."""
    width, height, _ = stored_header(path)
    return camera_identity(decode_metadata(path, "coded"), width, height)


def without_whole_identity(identities: Mapping[str, CameraIdentity]) -> list[list[str]]:
    """Return the names of photographs to which COLMAP would give a camera each for want of EXIF: those together that
    agree in size and in what EXIF says, sorted, and the groups by their first name."""
    groups: defaultdict[Key, list[str]] = defaultdict(list)
    for name in sorted(identities):
        if not identities[name].is_whole:
            groups[identities[name].key].append(name)
    return list(groups.values())


def identities_of_cameras(
    camera_ids: Mapping[str, int], identities: Mapping[str, CameraIdentity]
) -> dict[int, CameraIdentity]:
    """Return what EXIF and size say of COLMAP's cameras, by id. `camera_ids`: those of images by name. A camera whose
    images differ in it, as with `camera.mode: single`, or of which none could be read, is left out."""
    by_camera: defaultdict[int, dict[Key, CameraIdentity]] = defaultdict(dict)
    for name in sorted(camera_ids.keys() & identities.keys()):
        by_camera[camera_ids[name]].setdefault(identities[name].key, identities[name])
    return {i: next(iter(found.values())) for i, found in sorted(by_camera.items()) if len(found) == 1}


def turned_partners(cameras: Mapping[int, CameraIdentity]) -> list[tuple[int, int]]:
    """Return the pairs of COLMAP's cameras, by id, that are one camera of which some photographs were turned in their
    pixels: make, model and focal length are the same, and the width of one is the height of the other. Where more
    than two cameras fit, as with a camera for each photograph, nothing tells which belong together: none is returned.
    """
    groups: defaultdict[Key, list[int]] = defaultdict(list)
    for camera_id in sorted(cameras):
        groups[cameras[camera_id].upright_key].append(camera_id)
    pairs = [(group[0], group[1]) for group in groups.values() if len(group) == 2]
    return [pair for pair in pairs if cameras[pair[0]].width != cameras[pair[1]].width]
