"""Exposures by EXIF: what each photograph is multiplied with."""

from __future__ import annotations

import pytest

from colmap_ihe.photographs.exif.metadata import Metadata
from colmap_ihe.photographs.exposure import exposure_gains


def shot(exposure_s: float = 0.01, f_number: float = 8.0, iso: float = 100.0) -> Metadata:
    return Metadata(exposure_s=exposure_s, f_number=f_number, iso=iso)


def test_all_come_to_the_exposure_of_the_least_exposed() -> None:
    gains, warnings = exposure_gains(
        {"a": shot(), "slow": shot(exposure_s=0.02), "open": shot(f_number=4), "iso": shot(iso=800)}
    )
    assert gains == pytest.approx({"a": 1.0, "slow": 0.5, "open": 0.25, "iso": 0.125})
    assert not warnings


def test_equal_exposures_by_other_numbers_are_equal() -> None:
    gains, _ = exposure_gains({"a": shot(0.01, 8, 100), "b": shot(0.02, 8, 50), "c": shot(0.04, 16, 100)})
    assert gains == pytest.approx(dict.fromkeys("abc", 1.0))


def test_who_lacks_a_number_gets_the_median_and_is_named() -> None:
    gains, warnings = exposure_gains(
        {"a": shot(), "b": shot(0.02), "c": shot(0.04), "no lens": shot(f_number=0), "nothing": Metadata()}
    )
    assert gains["no lens"] == gains["nothing"] == gains["b"] == 0.5
    (text,) = warnings
    assert "2 photographs" in text
    assert "no lens, nothing" in text


def test_where_all_lack_them_nothing_is_changed() -> None:
    gains, warnings = exposure_gains({"a": Metadata(), "b": shot(iso=0)})
    assert gains == {"a": 1.0, "b": 1.0}
    assert "none of them is changed" in warnings[0]
    assert exposure_gains({}) == ({}, [])


def test_a_wide_range_names_the_least_exposed() -> None:
    gains, warnings = exposure_gains({"a": shot(), "b": shot(0.02), "flash.dng": shot(0.0001)})
    assert gains["b"] == pytest.approx(0.005)
    assert "flash.dng" in warnings[0]
