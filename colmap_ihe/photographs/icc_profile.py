"""ICC profiles: which colours the numbers of a photograph stand for.

Fit and conversion run on the numbers as stored, whatever their profile; a photograph without one is sRGB. Colour
twins of a project are brought to sRGB, which cloud, mesh and texture are in.
"""

from __future__ import annotations

from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageCms

from colmap_ihe.errors import PhotographError

UNREADABLE_PROFILE = "a profile that cannot be read"
_COLOUR_SPACE = slice(16, 20)  # of an ICC profile's header (ICC.1:2022, 7.2)
_SRGB_FROM_ADOBE = np.array(
    [[1.39836, -0.39836, 0], [0, 1, 0], [0, -0.04293, 1.04293]], np.float32
)  # linear; Adobe RGB (1998) 4.3.5.3 and IEC 61966-2-1: red and blue lie on the same lines
_DCF_OPTION = "R03"  # DCF 2.0: cameras say Adobe RGB by this and the file's name, mostly without a profile


def rgb_profile(image: Image.Image) -> bytes:
    """Return the ICC profile of an opened photograph if it is of RGB, else empty."""
    profile = image.info.get("icc_profile")
    return profile if isinstance(profile, bytes) and profile[_COLOUR_SPACE] == b"RGB " else b""


def name_of_profile(image: Image.Image, interoperability: str = "") -> str:
    """Return what an opened photograph's RGB numbers are: "sRGB", also where it does not say, or a profile's name.
    `interoperability` is the index that EXIF has for it."""
    profile = rgb_profile(image)
    if not profile:
        return "Adobe RGB" if interoperability == _DCF_OPTION else "sRGB"
    try:
        read = ImageCms.ImageCmsProfile(BytesIO(profile))
        name = ImageCms.getProfileDescription(read).strip()
        ImageCms.buildTransform(read, ImageCms.createProfile("sRGB"), "RGB", "RGB")
    except (ImageCms.PyCMSError, OSError):
        return UNREADABLE_PROFILE
    for usual in ("sRGB", "Adobe RGB"):  # "sRGB IEC61966-2.1", "sRGB built-in", "Adobe RGB (1998)"
        if usual.lower() in name.lower():
            return usual
    return name or "a profile without a name"


def to_srgb(rgb: NDArray[np.uint8], profile: bytes, name: str) -> NDArray[np.uint8]:
    """Return (H, W, 3) uint8 RGB in sRGB. `profile` that it is in; empty for the colours called `name` by
    `name_of_profile`. A profile that cannot be used, which `name_of_profile` says, leaves the numbers as they are."""
    if not profile:
        return _adobe_to_srgb(rgb) if name == "Adobe RGB" else rgb
    try:
        source = ImageCms.ImageCmsProfile(BytesIO(profile))
        srgb = ImageCms.createProfile("sRGB")
        converted = ImageCms.profileToProfile(Image.fromarray(rgb), source, srgb, outputMode="RGB")
    except (ImageCms.PyCMSError, OSError):
        return rgb
    return rgb if converted is None else np.asarray(converted)


def _adobe_to_srgb(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return Adobe RGB (1998) in sRGB; both have the white of D65, and green and blue of Adobe RGB lie outside."""
    light = (np.arange(256, dtype=np.float32) / 255) ** np.float32(563 / 256)
    linear = np.clip(light[rgb] @ _SRGB_FROM_ADOBE.T, 0, 1)
    coded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** np.float32(1 / 2.4) - 0.055)
    return np.asarray(255 * coded + 0.5, np.uint8)


def cmyk_to_srgb(image: Image.Image, name: str) -> Image.Image:
    """Return a CMYK photograph in sRGB, through its own profile, or by Pillow's plain inks if it has none. Raises
    `PhotographError` for a profile that cannot be used."""
    profile = image.info.get("icc_profile")
    if not profile:
        return image.convert("RGB")
    try:
        source = ImageCms.ImageCmsProfile(BytesIO(profile))
        converted = ImageCms.profileToProfile(image, source, ImageCms.createProfile("sRGB"), outputMode="RGB")
    except (ImageCms.PyCMSError, OSError) as error:
        raise PhotographError(
            f"{name}: a CMYK photograph whose ICC profile cannot be used ({error})",
            hint="save it as RGB in an image editor",
        ) from error
    return converted if converted is not None else image  # None only where it converts in place
