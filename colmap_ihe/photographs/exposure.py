"""Exposure normalisation: photographs of one scene, brought to one exposure by what EXIF says of them."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median

from colmap_ihe.photographs.exif.metadata import Metadata

_APART = 16.0
_NAMED = 5


def exposure_gains(metadata_by_name: Mapping[str, Metadata]) -> tuple[dict[str, float], list[str]]:
    """Return a linear factor for each photograph, in (0, 1], and warnings in sentences.

    The signal of a surface goes with exposure time x ISO / f-number^2 (ISO 12232), so each photograph gets the
    least of these over its own: all come to the exposure of the least exposed one, no value grows and nothing
    clips. Meant for linear values.

    - Highlights. What was clipped before stays lost, and comes out darker than the end of the range: a surface
      that burnt out in a long exposure is then darker than in a short one. Only where nothing is clipped is the
      same surface the same grey.
    - Depth. A factor of 1/4 leaves 14 of 16 bits and does not touch the noise: photographs keep the noise that they
      were taken with. The level of the whole set does not matter, for its white point is found afterwards.
    - EXIF is nominal. Shutters and apertures are off by a tenth, a flash or a filter is not in it, and the light
      is taken to be the same.

    A photograph that lacks one of the three numbers gets the median of the others' factors, and a warning names
    it; 1 where all lack them.
    """
    exposures = {n: m.exposure_s * m.iso / m.f_number**2 for n, m in metadata_by_name.items() if _is_known(m)}
    unknown = [name for name in metadata_by_name if name not in exposures]
    if not exposures:
        return dict.fromkeys(metadata_by_name, 1.0), _unknown(unknown, "none of them is changed")
    least, most = min(exposures.values()), max(exposures.values())
    factors = {name: least / exposure for name, exposure in exposures.items()}
    usual = median(factors.values())
    gains = {name: factors.get(name, usual) for name in metadata_by_name}
    warnings = _unknown(unknown, f"they get the factor of the median, {usual:.3g}")
    if most > _APART * least:
        name = min(exposures, key=exposures.__getitem__)
        warnings.append(
            f"exposures differ by a factor of {most / least:.0f} by their EXIF: all are brought to that of {name},"
            " the least exposed one, and noise still differs; take it out if its EXIF is mistaken"
        )
    return gains, warnings


def _is_known(metadata: Metadata) -> bool:
    return min(metadata.exposure_s, metadata.f_number, metadata.iso) > 0


def _unknown(names: list[str], what: str) -> list[str]:
    if not names:
        return []
    shown = ", ".join(names[:_NAMED]) + (" ..." if len(names) > _NAMED else "")
    return [f"{len(names)} photographs do not say shutter, aperture and ISO ({shown}): {what}"]
