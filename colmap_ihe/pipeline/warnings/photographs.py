"""Say what is odd about a set of photographs, in sentences for its owner."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence

from colmap_ihe.errors import MappingError, OptionError, PhotographError
from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.grey.weights import Grey, Weights
from colmap_ihe.machine import memory
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.machine.words import counted, listed
from colmap_ihe.photographs import camera_identity
from colmap_ihe.photographs.camera_identity import CameraIdentity
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.each import LeftOut
from colmap_ihe.photographs.file_kinds import unread_files
from colmap_ihe.photographs.icc_profile import UNREADABLE_PROFILE
from colmap_ihe.photographs.known_cameras import focal_px, pattern_of, unused_patterns
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.pipeline.warnings.colmap_sensors import knows_sensor
from colmap_ihe.pipeline.warnings.files import panorama_warnings
from colmap_ihe.pipeline.warnings.linear import linear_warnings
from colmap_ihe.project.options import CamerasOptions


def identity_of(one: Surveyed) -> CameraIdentity:
    return camera_identity.camera_identity(one.metadata, one.width, one.height)


def copies(surveyed: Sequence[Surveyed], contents: Mapping[str, str]) -> list[str]:
    """Warn of the same file twice: it is one view, counts twice in the fit and adds nothing to a model."""
    names: dict[str, list[str]] = defaultdict(list)
    for one in surveyed:
        if one.capture.name in contents:
            names[contents[one.capture.name]].append(one.capture.name)
    twice = [f"{listed(some[1:])} of {some[0]}" for some in names.values() if len(some) > 1]
    if not twice:
        return []
    shown = listed(twice, separator="; ")
    return [f"some photographs are copies of others, which add no view and count twice: {shown}; remove them"]


def require_two(names: Sequence[str], contents: Mapping[str, str]) -> None:
    """Raise `MappingError` for what cannot be two views, whatever is in them."""
    if len(names) == 1:
        raise MappingError(
            f"{names[0]} is the only photograph that can be used, and a model needs two or more",
            hint="its grey image is in workspace/images; add photographs of the same from other places",
        )
    known = {contents.get(name, name) for name in names}
    if len(known) == 1:
        raise MappingError(
            f"all {len(names)} photographs are copies of one file: {listed(names)}",
            hint="a model needs two or more, from different places",
        )


def require_features(features: int, images: int) -> None:
    if not features:
        raise MappingError(
            f"no features were found in any of the {images} photographs",
            hint="they are black, white, of one colour, blurred or wholly masked: see workspace/images",
        )


def poor_photographs(counts: Mapping[str, int]) -> list[str]:
    """Warn of photographs with few features. `counts`: their features by name."""
    if not counts:
        return []
    shown = listed([f"{name} ({count})" for name, count in counts.items()])
    which = "1 photograph has" if len(counts) == 1 else f"{len(counts)} photographs have"
    return [
        f"{which} hardly any features, as if black, blurred or of one colour, and will hardly find a place: {shown}"
    ]


def odd_sizes(surveyed: list[Surveyed], sizes: Counter[tuple[str, str, int, int]]) -> list[str]:
    """Warn of a lone size from a camera that else took another, upright or not: usually a crop or an export."""
    warnings = []
    for one in surveyed:
        key = (one.metadata.make, one.metadata.model, one.width, one.height)
        usual = max((k for k in sizes if k[:2] == key[:2]), key=sizes.__getitem__)
        if sizes[usual] >= 3 * sizes[key] and sorted(usual[2:]) != sorted(key[2:]) and one.metadata.model:
            warnings.append(
                f"{one.capture.name} is {one.width}x{one.height}, the others of this camera {usual[2]}x{usual[3]}:"
                " it gets a camera of its own; use the uncropped original if there is one"
            )
    return warnings


def linked_folders(ignored: tuple[str, ...]) -> list[str]:
    """Warn of links to folders elsewhere, which are not followed: their owner may count on what is behind them."""
    links = [name for name in ignored if name.endswith("/")]
    if not links:
        return []
    return [
        f"{len(links)} links lead to folders elsewhere and are not followed, as {links[0]}: put the photographs there,"
        " or name the one that holds all of them with --images"
    ]


def warnings_of(
    surveyed: Sequence[Surveyed], ignored: tuple[str, ...] = (), notes: tuple[str, ...] = ()
) -> list[str]:
    """Warn of what headers say that the owner of the set should know, whatever is done with it. `ignored` and `notes`
    as in `Discovery`."""
    return [
        *notes,
        *exif_warnings(surveyed),
        *profile_warnings(surveyed),
        *page_warnings(surveyed),
        *linear_warnings(surveyed),
        *panorama_warnings(surveyed),
        *unread_files(ignored, [s.capture.name for s in surveyed]),
        *linked_folders(ignored),
        *memory_warnings([s.capture for s in surveyed]),
    ]


def memory_warnings(captures: Sequence[Capture]) -> list[str]:
    """Say so where memory and not the number of cores decides how long the work takes."""
    workers = local_workers()
    count = memory.at_once(captures, workers)
    if count == workers:
        return []
    return [f"{memory.in_words(captures, count)}; there are {workers} cores"]


def exif_warnings(surveyed: Sequence[Surveyed]) -> list[str]:
    warnings = []
    broken = [f"{s.capture.name} ({s.metadata.problem})" for s in surveyed if s.metadata.problem]
    if broken:
        warnings.append(f"EXIF could not be read in full: {listed(broken)}")
    odd = [f"{s.capture.name} ({_focal_of(s):.2g})" for s in surveyed if not _is_plausible(s)]
    if odd:
        warnings.append(
            f"EXIF says a focal length that COLMAP refuses, less than a tenth or more than ten times the longer"
            f" side: {listed(odd)}; another program may have resized the photographs: see `cameras:` with"
            " override in docs/options.md"
        )
    return warnings


def _focal_of(one: Surveyed) -> float:
    """Return the focal length by EXIF, in longer sides of the image; 0 where it does not say."""
    return focal_px(one.metadata, one.width, one.height) / max(one.width, one.height)


def _is_plausible(one: Surveyed) -> bool:
    """Apply the limits of COLMAP's mapper, min_ and max_focal_length_ratio."""
    focal = _focal_of(one)
    return not focal or 0.1 <= focal <= 10


def camera_warnings(cameras: CamerasOptions, surveyed: Sequence[Surveyed], left_out: LeftOut) -> list[str]:
    """Say which patterns fit no photograph, and what is still missing where one fits. Raises `OptionError` for a
    pattern that gives focal lengths or sensors and leaves every photograph without its focal length."""
    names = {s.capture.name for s in surveyed} | set(left_out)
    warnings = [
        f"cameras: the pattern {pattern!r} fits no photograph, or only those of patterns before it; names are as"
        f" {min(names)!r}"
        for pattern in unused_patterns(cameras, names)
    ]
    for pattern, known in cameras.root.items():
        if not (known.focal_length or known.sensor_width or known.focal_length_35mm):
            continue
        fitting = [s for s in surveyed if pattern_of(cameras, s.capture.name) == pattern]
        lacking = [s for s in fitting if not _focal_is_known(s)]
        if not lacking:
            continue
        missing = "the width of the sensor" if lacking[0].metadata.focal_mm else "the focal length"
        said = f"cameras, {pattern!r}: {missing} of {lacking[0].capture.name} is neither given nor in EXIF"
        if len(lacking) == len(fitting):
            raise OptionError(said, "give focal_length and sensor_width in mm, both, or focal_length_35mm")
        warnings.append(f"{said}, {len(lacking)} of {len(fitting)} photographs: COLMAP guesses")
    return warnings + _mixed_cameras(surveyed)


def _focal_is_known(one: Surveyed) -> bool:
    about = one.metadata
    return bool(_focal_of(one) or (about.focal_mm and knows_sensor(about.make, about.model)))


def _mixed_cameras(surveyed: Sequence[Surveyed]) -> list[str]:
    """Warn of sensors of several widths, which COLMAP does not tell apart."""
    found: dict[camera_identity.Key, set[int]] = defaultdict(set)
    for one in surveyed:
        if identity_of(one).is_whole:
            found[identity_of(one).key].add(round(1000 * _focal_of(one)))
    return [
        f"the photographs by {make} {model} at {focal:g} mm have sensors of several widths, and COLMAP takes them"
        " for one camera: tell them apart by `model` in `cameras:`, with override"
        for (make, model, focal, _, _), lengths in found.items()
        if max(lengths) - min(lengths) > 1
    ]


def profile_warnings(surveyed: Sequence[Surveyed]) -> list[str]:
    """Warn of profiles that cannot be read, and of several: numbers are taken as stored, so one colour in two profiles
    is two colours."""
    profiles = Counter(s.metadata.profile for s in surveyed if s.capture.kind == "coded")
    warnings = []
    if UNREADABLE_PROFILE in profiles:
        unread = counted(profiles[UNREADABLE_PROFILE], "photograph")
        warnings.append(f"{unread} with {UNREADABLE_PROFILE}: their colours are taken for sRGB")
    if len(profiles) < 2:
        return warnings
    counts = ", ".join(f"{count} in {name}" for name, count in profiles.most_common())
    return [
        *warnings,
        f"the photographs are in different colour profiles ({counts}): the same colour has different values in"
        " them, and so different greys; export all of them in one",
    ]


def page_warnings(surveyed: Sequence[Surveyed]) -> list[str]:
    several = [f"{s.capture.name} ({s.metadata.pages})" for s in surveyed if s.metadata.pages > 1]
    if not several:
        return []
    return [f"of TIFF files with several pages the first one is used: {listed(several)}"]


def fit_warnings(captures: Sequence[Capture], weights: Iterable[Grey]) -> list[str]:
    """Say so where a grey is not the same in all photographs, and where a fit had nothing to fit to. Reads
    photographs up to the first one with colour in it, which mostly is the first."""
    weights = list(weights)
    if any(CONVERSIONS[w.method].scope == "image" for w in weights if w.method in CONVERSIONS):
        return [
            f"{weights[0].method} is fitted to each photograph: the same colour is another grey in another"
            " photograph, which costs matches; see docs/conversions.md"
        ]
    fitted = [w for w in weights if isinstance(w, Weights) and w.score is not None]
    if not fitted:
        return []
    if all(w.tones == 1 for w in fitted):
        return ["the photographs hold a single tone, as if all were black: nothing can be found in them"]
    for capture in captures:
        try:
            rgb = read_photograph(capture).rgb
        except PhotographError:
            continue
        if any((row != row[:, :1]).any() for row in rgb):
            return []
    return [
        "the photographs are greyscale (R = G = B): every triplet of weights gives the same grey, so none was"
        " found to be better"
    ]


def wallis_warnings(wallis: bool) -> list[str]:
    """Warn of what is done to grey images after the conversion."""
    if not wallis:
        return []
    return [
        "the Wallis filter goes by the surroundings of a pixel: the same colour is another grey in another place"
        " and in another photograph; see docs/method.md"
    ]
