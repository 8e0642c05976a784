"""ICC profiles: which colours the numbers of a photograph stand for.

Fit and conversion run on the numbers as stored, whatever their profile; a photograph without one is sRGB.
"""

from __future__ import annotations

from io import BytesIO

from PIL import Image, ImageCms

from colmap_ihe.errors import PhotographError

_COLOUR_SPACE = slice(16, 20)  # of an ICC profile's header (ICC.1:2022, 7.2)
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
        name = ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(BytesIO(profile))).strip()
    except (ImageCms.PyCMSError, OSError):
        return "a profile that cannot be read"
    for usual in ("sRGB", "Adobe RGB"):  # "sRGB IEC61966-2.1", "sRGB built-in", "Adobe RGB (1998)"
        if usual.lower() in name.lower():
            return usual
    return name or "a profile without a name"


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
