"""The table of conversions: each of the six properties it claims holds, and each it does not claim is seen to fail.

A fixed function of the colour has colours that it cannot tell apart, and for these a blue and a green are
named here. Those that see chrominance get a blue and a green of one luma.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import reduce
from operator import add
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracle import photograph
from small_demo import ROOT

from colmap_ihe.errors import PhotographError
from colmap_ihe.grey.contrast import Contrast
from colmap_ihe.grey.conversions import CONVERSIONS, Conversion, Property, SetFit
from colmap_ihe.grey.convert import to_grey
from colmap_ihe.grey.ihe import fit_weights
from colmap_ihe.grey.methods.color2gray import THETA, color2gray
from colmap_ihe.grey.methods.contrast_preserving import contrast_preserving
from colmap_ihe.grey.methods.decolorize import decolorize
from colmap_ihe.grey.methods.realtime import weighed
from colmap_ihe.grey.srgb import lab
from colmap_ihe.grey.weights import FIXED, Weights, triplets

pytest.importorskip("colour", reason="colour-science, which `apparent` needs, is not installed")

Float32 = NDArray[np.float32]
Colour = tuple[float, float, float]
LEVEL = 1 / 255

GREEN: Colour = (0.15, 0.35, 0.1)
BLUE_OF_ONE_LUMA: Colour = (0.15, 0.35 - 0.7 * 0.0722 / 0.7152, 0.8)

UNSEEN: dict[str, tuple[Colour, Colour]] = {
    "rec709": (GREEN, BLUE_OF_ONE_LUMA),
    "rgb2gray": (GREEN, (0.15, 0.35 - 0.7 * 0.1140 / 0.5870, 0.8)),
    "photoshop": (GREEN, (0.15, 0.05, 0.7)),
    "mean": (GREEN, (0.15, 0.05, 0.4)),
    "red": (GREEN, (0.15, 0.1, 0.8)),
    "green": (GREEN, (0.15, 0.35, 0.9)),
    "blue": ((0.15, 0.8, 0.4), (0.15, 0.1, 0.4)),
    "cie-y": (GREEN, (0.15, 0.2631, 0.7)),
    "value": ((0.15, 0.7, 0.1), (0.15, 0.1, 0.7)),
}
"""A green and a blue of the same grey, for each conversion that does not claim to see chrominance."""


def converted(conversion: Conversion, images: list[Float32]) -> list[Float32]:
    """The greys of a set, as the pipeline would make them."""
    if conversion.convert is not None:
        return [conversion.convert(image) for image in images]
    if conversion.apply is not None:
        parameters = fitted(conversion, images).finish()
        return [conversion.apply(image, parameters) for image in images]
    if conversion.name in FIXED:
        return [weighed(image, FIXED[conversion.name]) for image in images]
    assert conversion.name in ("ihe", "snr", "auto")
    codes = [np.rint(255 * image).astype(np.uint8) for image in images]
    weights = fit_weights(codes, step=0.1)
    if conversion.name == "snr":
        contrast = reduce(add, (measured(image) for image in codes))
        red, green, blue = contrast.best(triplets(0.1))
        weights = Weights(red / 100, green / 100, blue / 100)
    return [to_grey(image, weights).astype(np.float32) / np.float32(255) for image in codes]


def measured(image: NDArray[np.uint8]) -> Contrast:
    contrast = Contrast()
    contrast.add(image)
    return contrast


def fitted(conversion: Conversion, images: Sequence[Float32]) -> SetFit:
    assert conversion.new_fit is not None
    fit = conversion.new_fit()
    for image in images:
        fit.add(image)
    return fit


def coded(image: NDArray[Any]) -> Float32:
    """As from an 8-bit file."""
    return np.asarray(np.rint(np.clip(image, 0, 1) * 255) / 255, np.float32)


def shaded(mask: NDArray[np.bool_], first: Colour, second: Colour, seed: int = 0) -> NDArray[np.float64]:
    """Two colours as on a wall: darker towards the left, with the noise of a camera."""
    rgb = np.where(mask[..., None], first, second) * np.linspace(0.6, 1, mask.shape[1])[:, None]
    return np.asarray(rgb + np.random.default_rng(seed).normal(0, 0.008, rgb.shape))


def two_colours(first: Colour, second: Colour) -> tuple[Float32, NDArray[np.bool_]]:
    """Checks of two colours, and where the first is."""
    mask = (np.indices((96, 96)) // 12).sum(axis=0) % 2 == 0
    return shaded(mask, first, second).astype(np.float32), mask


def two_views(first: Colour, second: Colour) -> tuple[list[Float32], NDArray[np.float64]]:
    """Blobs of two colours seen twice, noise apart, and the affine map (2, 3) from the first view to the second."""
    rng = np.random.default_rng(7)
    field: Any = cv2.GaussianBlur(rng.normal(0, 1, (400, 400)), (0, 0), 4)
    motion: Any = cv2.getRotationMatrix2D((200, 200), 9, 1.04)
    turned: Any = cv2.warpAffine(field, motion, (400, 400), flags=cv2.INTER_CUBIC)
    views = []
    for seed, blobs in enumerate((field, turned)):
        views.append(shaded(blobs[60:-60, 60:-60] > 0, first, second, seed).astype(np.float32))
    shift = motion[:, :2] @ [60, 60] + motion[:, 2] - 60
    return views, np.column_stack([motion[:, :2], shift])


def correct_matches(greys: list[Float32], motion: NDArray[np.float64]) -> int:
    """SIFT matches, at COLMAP's threshold, that pass the ratio test and lie within 3 pixels of the truth."""
    sift = cv2.SIFT_create(contrastThreshold=0.02)  # type: ignore[attr-defined,unused-ignore]
    found = [sift.detectAndCompute(np.rint(255 * grey).astype(np.uint8), None) for grey in greys]
    (points, first), (others, second) = found
    if first is None or second is None or len(second) < 2:
        return 0
    correct = 0
    for best, next_best in cv2.BFMatcher().knnMatch(first, second, k=2):
        expected = motion @ [*points[best.queryIdx].pt, 1]
        near = np.linalg.norm(expected - others[best.trainIdx].pt) < 3
        correct += bool(best.distance < 0.8 * next_best.distance and near)
    return correct


def feature_discriminability(conversion: Conversion) -> bool:
    """More correct matches than Rec.709 on blobs of one luma; False where blobs of its own vanish for it."""
    if conversion.name in UNSEEN:
        views, motion = two_views(*UNSEEN[conversion.name])
        return correct_matches(converted(conversion, views), motion) > 5
    views, motion = two_views(GREEN, BLUE_OF_ONE_LUMA)
    plain = correct_matches(converted(CONVERSIONS["rec709"], views), motion)
    return correct_matches(converted(conversion, views), motion) > max(30, 5 * plain)


def chrominance_awareness(conversion: Conversion) -> bool:
    """Blue and green come out apart, by more than ten levels where they are of one luma."""
    image, mask = two_colours(*UNSEEN.get(conversion.name, (GREEN, BLUE_OF_ONE_LUMA)))
    (grey,) = converted(conversion, [image])
    apart = abs(float(np.median(grey[mask])) - float(np.median(grey[~mask])))
    return apart > (1 if conversion.name in UNSEEN else 10) * LEVEL


def patchwork(colours: Float32) -> Float32:
    """Colours (n, 3), each in several places with other neighbours."""
    order = np.random.default_rng(3).permutation(np.repeat(np.arange(len(colours)), 9))
    side = int(np.sqrt(len(order)))
    patches = colours[order[: side * side]].reshape(side, side, 3)
    return np.asarray(patches.repeat(6, axis=0).repeat(6, axis=1), np.float32)


def spread(grey: list[Float32], images: list[Float32]) -> float:
    """The most by which pixels of one colour differ in grey, over all images."""
    tones = np.concatenate([g.reshape(-1) for g in grey])
    rgb = np.concatenate([np.rint(i.reshape(-1, 3) * 255).astype(np.int64) for i in images])
    _, which = np.unique(rgb @ [1, 256, 65536], return_inverse=True)
    low, high = np.full(which.max() + 1, np.inf), np.full(which.max() + 1, -np.inf)
    np.minimum.at(low, which, tones)
    np.maximum.at(high, which, tones)
    return float((high - low).max())


SHARED = coded(np.random.default_rng(5).random((40, 3)))


def global_mapping(conversion: Conversion) -> bool:
    """The same colour is the same grey in every place of an image."""
    image = patchwork(SHARED)
    return spread(converted(conversion, [image]), [image]) < 0.1 * LEVEL


def colour_consistency(conversion: Conversion) -> bool:
    """The same colour is the same grey in photographs that share it, one of them mostly of reds."""
    reds = coded(np.random.default_rng(6).random((200, 3)) * [1, 0.3, 0.1])
    images = [patchwork(SHARED), patchwork(np.concatenate([SHARED[:10], reds]))]
    return spread(converted(conversion, images), images) < 0.1 * LEVEL


def greyscale_preservation(conversion: Conversion) -> bool:
    """R = G = B = v stays v beside colours, for all 256 values."""
    ramp = np.arange(256, dtype=np.float32).reshape(16, 16) / np.float32(255)
    image = photograph(8, 64, 64)
    image[16:32, 16:32] = ramp[..., None]
    (grey,) = converted(conversion, [image])
    return float(np.abs(grey[16:32, 16:32] - ramp).max()) < 0.5 * LEVEL


def unsupervised(conversion: Conversion) -> bool:
    """There is nothing to be set; where there is, another setting turns the order of two colours round."""
    called: Callable[..., Any] | None = conversion.convert
    return called is None or len(inspect.signature(called).parameters) == 1


CHECKS: dict[Property, Callable[[Conversion], bool]] = {
    "feature discriminability": feature_discriminability,
    "chrominance awareness": chrominance_awareness,
    "global mapping": global_mapping,
    "colour consistency": colour_consistency,
    "greyscale preservation": greyscale_preservation,
    "unsupervised": unsupervised,
}


@pytest.mark.parametrize("name", CONVERSIONS)
@pytest.mark.parametrize("wanted", CHECKS)
def test_a_property_holds_where_it_is_claimed_and_only_there(name: str, wanted: Property) -> None:
    conversion = CONVERSIONS[name]
    assert CHECKS[wanted](conversion) == (wanted in conversion.properties)


def test_the_order_of_two_colours_by_color2gray_is_up_to_its_theta() -> None:
    image, mask = two_colours((0.7, 0.3, 0.35), (0.25, 0.48, 0.4))
    signs = [
        np.sign(np.median(grey[mask]) - np.median(grey[~mask]))
        for grey in (color2gray(image, theta=THETA), color2gray(image, theta=THETA + np.pi))
    ]
    assert sorted(signs) == [-1, 1]
    assert abs(float(np.diff(lab(np.array([[0.7, 0.3, 0.35], [0.25, 0.48, 0.4]], np.float32))[:, 0])[0])) < 2


def test_the_named_greens_and_blues_are_of_one_grey_and_seen_by_others() -> None:
    for name, pair in UNSEEN.items():
        image = np.array([pair], np.float32)
        assert np.ptp(converted(CONVERSIONS[name], [image])[0]) < 0.5 * LEVEL
        assert np.argmax(image[0, 0]) == 1
        assert np.argmax(image[0, 1]) == 2
    assert set(UNSEEN) == {
        name for name, c in CONVERSIONS.items() if "chrominance awareness" not in c.properties
    }


def test_every_name_of_the_method_is_in_the_table() -> None:
    assert set(CONVERSIONS) == {
        *FIXED,
        *("ihe", "snr", "auto", "cie-y", "value", "decolorize", "decolorize-set", "realtime", "realtime-set"),
        *("contrast-preserving", "song", "color2gray", "apparent"),
    }
    for name, conversion in CONVERSIONS.items():
        assert conversion.name == name
        assert all(getattr(conversion, f.name) for f in fields(conversion) if f.name in ("does", "source"))
        assert set(conversion.properties) <= set(CHECKS)


@pytest.mark.parametrize("conversion", CONVERSIONS.values(), ids=CONVERSIONS)
def test_scope_and_callables_fit_together(conversion: Conversion) -> None:
    triplet = conversion.name in FIXED or conversion.name in ("ihe", "snr", "auto")
    assert (conversion.convert is not None) == (conversion.scope != "set" and not triplet)
    assert (conversion.new_fit is not None) == (conversion.scope == "set" and not triplet)
    assert (conversion.apply is None) == (conversion.new_fit is None)
    assert ("colour consistency" in conversion.properties) == (conversion.scope != "image")
    assert ("global mapping" in conversion.properties) != conversion.local


def test_the_page_of_the_manual_says_the_same() -> None:
    page = (ROOT / "docs" / "conversions.md").read_text().splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in page if line.startswith("| `")]
    assert [row[0].strip("`") for row in rows[1:]] == list(CONVERSIONS)
    fitted = {"set": "once for the set", "image": "per image", "colour": "nothing to fit"}
    for row, conversion in zip(rows[1:], CONVERSIONS.values(), strict=True):
        assert row[1:4] == [conversion.does, fitted[conversion.scope], "yes" if conversion.local else "no"]
        # the first two properties share a column
        held = ["yes" if wanted in conversion.properties else "**no**" for wanted in list(CHECKS)[1:]]
        assert row[4:9] == held
        assert row[9] == conversion.source


MADE = [c for c in CONVERSIONS.values() if c.convert or c.new_fit]


@pytest.mark.parametrize("size", [(50, 70), (1, 1), (1, 33), (47, 1), (2, 2)], ids=str)
@pytest.mark.parametrize("conversion", MADE, ids=[c.name for c in MADE])
def test_any_size_gives_one_finite_grey_a_pixel_the_same_each_time(
    conversion: Conversion, size: tuple[int, int]
) -> None:
    image = photograph(9, *size)
    before = image.copy()
    try:
        (grey,), (again,) = converted(conversion, [image]), converted(conversion, [image])
    except PhotographError:
        assert conversion.name == "contrast-preserving"  # OpenCV gives up on a handful of pixels
        assert min(size) <= 2
        return
    assert grey.shape == size
    assert grey.dtype == np.float32
    assert np.isfinite(grey).all()
    assert grey.min() >= 0
    assert grey.max() <= 1
    np.testing.assert_array_equal(grey, again)
    np.testing.assert_array_equal(image, before)


@pytest.mark.parametrize("conversion", MADE, ids=[c.name for c in MADE])
def test_another_shape_or_dtype_is_refused_with_what_came(conversion: Conversion) -> None:
    for wrong in (np.zeros((4, 4), "f4"), np.zeros((4, 4, 3), "u1"), np.zeros((0, 4, 3), "f4")):
        with pytest.raises(ValueError, match=r"expected \(H, W, 3\) float32"):
            converted(conversion, [wrong])


@pytest.mark.parametrize("name", ["decolorize-set", "realtime-set"])
@settings(max_examples=12)  # each set holds 128 MB
@given(order=st.permutations(range(4)), cut=st.integers(0, 4))
def test_order_and_grouping_change_nothing(name: str, order: list[int], cut: int) -> None:
    conversion, images = CONVERSIONS[name], [photograph(n, 30 + n, 40) for n in range(4)]
    whole = fitted(conversion, images)
    parts = [fitted(conversion, [images[n] for n in part]) for part in (order[:cut], order[cut:])]
    total = parts[0] + parts[1]
    assert total.finish() == whole.finish()
    for counted in ("sums", "pairs", "images", "axis"):
        assert getattr(total, counted, None) == getattr(whole, counted, None)


@pytest.mark.parametrize("name", ["decolorize-set", "realtime-set"])
def test_an_empty_set_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="no photographs"):
        fitted(CONVERSIONS[name], []).finish()


@pytest.mark.parametrize(("convert", "off"), [(decolorize, 1e-6), (contrast_preserving, 0)])
def test_a_photograph_without_colour_stays_as_it_is(
    convert: Callable[[Float32], Float32], off: float
) -> None:
    ramp = np.linspace(0, 1, 256, dtype=np.float32).reshape(16, 16, 1).repeat(3, axis=2)
    np.testing.assert_allclose(convert(ramp), ramp[..., 0], rtol=0, atol=off)
