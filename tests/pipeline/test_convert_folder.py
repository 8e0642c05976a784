"""convert: what is up to date is not written again, and what is not ours is never written over."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from icc import rgb_profile
from PIL import Image
from same_results import pixels_of
from told import Told

import colmap_ihe.pipeline.convert_folder
from colmap_ihe import Weights, convert_folder
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import Cancelled, KnownError, PhotographError, ProjectError, WeightsError
from colmap_ihe.grey.convert import to_grey
from colmap_ihe.grey.wallis import wallis
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import discover
from colmap_ihe.photographs.encode import Format
from colmap_ihe.pipeline.output_folder import RECORD
from colmap_ihe.project.options import ConvertOptions, FitOptions

GREEN, BLUE = Weights(0, 1, 0, method="file"), Weights(0, 0, 1, method="file")
QUICK = FitOptions(step=0.1)
Patch = pytest.MonkeyPatch
Noted = dict[str, tuple[int, bytes]]


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    (folder / "north").mkdir(parents=True)
    for seed, name in enumerate(["a.png", "b.jpg", "north/c.tif"]):
        draw(folder / name, seed)
    return folder


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "grey"


@pytest.fixture
def before(photos: Path, out: Path) -> Noted:
    """What `out` holds after the photographs were converted to it."""
    convert_folder(photos, out, weights=GREEN)
    return noted(out)


def draw(file: Path, seed: int) -> None:
    pixels = np.random.default_rng(seed).integers(0, 256, (70, 90, 3), np.uint8)
    Image.fromarray(pixels).save(file)


def noted(folder: Path) -> Noted:
    files = [p for p in folder.rglob("*") if p.is_file() and p.name != RECORD]
    return {p.relative_to(folder).as_posix(): (p.stat().st_mtime_ns, p.read_bytes()) for p in files}


def rewritten(before: Noted, folder: Path) -> set[str]:
    after = noted(folder)
    return {name for name, (time, _) in after.items() if name not in before or before[name][0] != time}


def test_subfolders_are_kept(photos: Path, out: Path) -> None:
    _, grey, left_out = convert_folder(photos, out, weights=GREEN)
    assert grey == {"a.png": "a.png", "b.jpg": "b.png", "north/c.tif": "north/c.png"}
    assert left_out == {}
    assert set(noted(out)) == set(grey.values())


def test_only_what_a_change_makes_stale_is_written_again(photos: Path, out: Path, before: Noted) -> None:
    for file in photos.rglob("*.*"):
        os.utime(file, (1, 1))  # a copy, or a checkout: the content is the same
    told = Told()
    convert_folder(photos, out, weights=GREEN, progress=told)
    assert (rewritten(before, out), told.up_to_date) == (set(), ["convert"])
    draw(photos / "b.jpg", 7)
    draw(photos / "d.png", 8)
    (out / "north/c.png").unlink()
    _, grey, _ = convert_folder(photos, out, weights=GREEN)
    assert rewritten(before, out) == {"b.png", "d.png", "north/c.png"}
    assert noted(out)["b.png"][1] != before["b.png"][1]
    assert noted(out)["north/c.png"][1] == before["north/c.png"][1]
    assert len(grey) == 4


@pytest.mark.parametrize(
    "change", [{"weights": BLUE}, {"options": ConvertOptions(format="jpeg")}, {"version": "9.9"}]
)
def test_other_weights_format_and_version_make_all_stale(
    photos: Path, out: Path, before: Noted, monkeypatch: pytest.MonkeyPatch, change: dict[str, Any]
) -> None:
    if version := change.pop("version", ""):
        monkeypatch.setattr(colmap_ihe.pipeline.convert_folder, "__version__", version)
    _, grey, _ = convert_folder(photos, out, **{"weights": GREEN, **change})
    assert set(noted(out)) == set(grey.values())
    assert rewritten(before, out) == set(grey.values())


def test_tone_makes_raw_stale_and_nothing_else(small_demo: Path, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    shutil.copy(small_demo / "images/portico_01.dng", tmp_path / "photos/raw.dng")
    shutil.copy(small_demo / "images/portico_02.jpg", tmp_path / "photos/coded.jpg")
    out, told = tmp_path / "grey", Told()
    convert_folder(tmp_path / "photos", out, fit=QUICK, progress=told)
    assert any("mixes RAW and gamma-coded" in text for text in told.warnings)
    before = noted(out)
    convert_folder(tmp_path / "photos", out, fit=QUICK, options=ConvertOptions(tone="linear"))
    assert rewritten(before, out) == {"raw.png"}


def test_raw_is_equalised_and_another_campaign_reuses_the_curve(small_demo: Path, tmp_path: Path) -> None:
    for folder, views in (("first", "123"), ("second", "45")):
        (tmp_path / folder).mkdir()
        for n in views:
            shutil.copy(small_demo / f"images/portico_0{n}.dng", tmp_path / folder)
    even = ConvertOptions(tone="equalise")
    fitted, grey, _ = convert_folder(tmp_path / "first", tmp_path / "grey", fit=QUICK, options=even)
    images = [pixels_of(tmp_path / "grey" / name) for name in grey.values()]
    counts = np.bincount(np.concatenate([i.ravel() for i in images]), minlength=256)
    assert np.sort(counts)[26:-26].min() > 0.4 * counts.mean()
    assert np.sort(counts)[26:-26].max() < 2.5 * counts.mean()
    told = Told()
    convert_folder(tmp_path / "first", tmp_path / "grey", weights=fitted, options=even, progress=told)
    assert told.up_to_date == ["convert"]
    _, others, _ = convert_folder(tmp_path / "second", tmp_path / "others", weights=fitted, options=even)
    rgb = read_photograph(discover(tmp_path / "second").captures[0]).rgb
    grey_again = pixels_of(tmp_path / "others" / others["portico_04.dng"])
    np.testing.assert_array_equal(grey_again, to_grey(rgb, fitted, "equalise"))


def test_equalising_raw_without_a_curve_is_refused_at_once(small_demo: Path, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    shutil.copy(small_demo / "images/portico_01.dng", tmp_path / "photos")
    even = ConvertOptions(tone="equalise")
    bare = Weights(0, 1, 0, encoding="linear", white=0.5)
    with pytest.raises(WeightsError, match="no curve") as caught:
        convert_folder(tmp_path / "photos", tmp_path / "grey", weights=bare, options=even)
    assert "fit" in caught.value.hint
    with pytest.raises(WeightsError, match="value is no triplet"):
        convert_folder(tmp_path / "photos", tmp_path / "grey", fit=FitOptions(method="value"), options=even)
    assert not list(tmp_path.glob("grey/*.png"))


def test_a_curve_that_is_not_used_makes_nothing_stale(small_demo: Path, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    shutil.copy(small_demo / "images/portico_01.dng", tmp_path / "photos")
    out, told = tmp_path / "grey", Told()
    fitted, _, _ = convert_folder(tmp_path / "photos", out, fit=FitOptions(method="mean"))
    assert isinstance(fitted, Weights)
    assert len(fitted.curve) == 255
    convert_folder(tmp_path / "photos", out, weights=replace(fitted, curve=()), progress=told)
    assert told.up_to_date == ["convert"]


def test_wallis_makes_all_stale_and_warns(photos: Path, out: Path) -> None:
    told = Told()
    convert_folder(photos, out, weights=GREEN, progress=told)
    assert not told.warnings
    before = noted(out)
    plain = pixels_of(out / "a.png")
    convert_folder(photos, out, weights=GREEN, options=ConvertOptions(wallis=True), progress=told)
    assert rewritten(before, out) == {"a.png", "b.png", "north/c.png"}
    assert ["Wallis" in text and "another grey" in text for text in told.warnings] == [True]
    np.testing.assert_array_equal(pixels_of(out / "a.png"), wallis(plain))


def test_the_fit_is_kept_while_the_set_and_its_options_are_the_same(photos: Path, tmp_path: Path) -> None:
    out, told = tmp_path / "grey", Told()
    first, _, _ = convert_folder(photos, out, fit=QUICK)
    again, _, _ = convert_folder(photos, out, fit=QUICK, progress=told)
    assert again == first
    assert told.up_to_date == ["fit", "convert"]
    draw(photos / "b.jpg", 7)
    told = Told()
    other, _, _ = convert_folder(photos, out, fit=QUICK, progress=told)
    assert told.up_to_date == []
    assert other.images == 3
    told = Told()
    convert_folder(photos, out, fit=FitOptions(step=0.2), progress=told)
    assert "fit" not in told.up_to_date


def test_what_an_interrupted_run_has_written_is_kept(photos: Path, out: Path, monkeypatch: Patch) -> None:
    written: list[Path] = []

    def stop_after_one(path: Path, content: bytes) -> None:
        if written:
            raise Cancelled
        written.append(path)
        path.write_bytes(content)

    with monkeypatch.context() as patch, pytest.raises(Cancelled):
        patch.setattr("colmap_ihe.pipeline.stages.convert.write_bytes", stop_after_one)
        convert_folder(photos, out, weights=GREEN)
    before = noted(out)
    assert len(before) == 1
    convert_folder(photos, out, weights=GREEN)
    assert len(rewritten(before, out)) == 2
    assert len(noted(out)) == 3


def test_a_killed_run_leaves_files_that_are_known_to_be_ours(photos: Path, out: Path, before: Noted) -> None:
    """As after SIGKILL: the record says what was to be written, and not that it was."""
    record = json.loads((out / RECORD).read_text())
    for file in record["files"].values():
        file["digest"] = ""
    (out / RECORD).write_text(json.dumps(record))
    (out / "b.png").unlink()
    (out / ".0123456789abcdef01234567.99.tmp").write_bytes(b"half a file")
    (out / ".mine.tmp").write_bytes(b"somebody's")
    convert_folder(photos, out, weights=GREEN)
    assert rewritten(before, out) == {"b.png", ".mine.tmp"}
    convert_folder(photos, out, weights=BLUE)
    assert len(rewritten(before, out)) == 4


@pytest.mark.usefixtures("before")
def test_a_file_that_somebody_changed_is_kept_and_never_written_over(photos: Path, out: Path) -> None:
    told = Told()
    (out / "a.png").write_bytes(b"retouched")
    convert_folder(photos, out, weights=GREEN, progress=told)
    assert any("a.png was changed since" in text for text in told.warnings)
    with pytest.raises(ProjectError, match=r"a\.png: is to be written again and was changed since"):
        convert_folder(photos, out, weights=BLUE)
    (photos / "a.png").unlink()
    convert_folder(photos, out, weights=BLUE)
    assert (out / "a.png").read_bytes() == b"retouched"


@pytest.mark.usefixtures("before")
def test_a_strangers_file_in_the_way_is_refused(photos: Path, out: Path) -> None:
    (out / "d.png").write_bytes(b"somebody's")
    draw(photos / "d.png", 3)
    before = noted(out)
    with pytest.raises(ProjectError, match=r"d\.png: is there already and was not written by colmap-ihe"):
        convert_folder(photos, out, weights=GREEN)
    assert noted(out) == before


def test_the_grey_images_of_another_set_are_not_thrown_away(tmp_path: Path, out: Path, before: Noted) -> None:
    (tmp_path / "second").mkdir()
    draw(tmp_path / "second/x.png", 9)
    with pytest.raises(ProjectError, match="holds grey images of other photographs, as a"):
        convert_folder(tmp_path / "second", out, weights=GREEN)
    assert noted(out) == before


@pytest.mark.parametrize("text", ["{}", '{"files": ["a"], "notes": {}}', '{"files": {"a": 1}, "notes": {}}'])
def test_a_record_that_is_none_is_refused(photos: Path, out: Path, text: str) -> None:
    out.mkdir()
    (out / RECORD).write_text(text)
    with pytest.raises(ProjectError, match="is not a record of this version"):
        convert_folder(photos, out, weights=GREEN)
    (out / RECORD).write_text(text + "broken")
    with pytest.raises(ProjectError, match="is not empty, and not of an earlier run"):
        convert_folder(photos, out, weights=GREEN)


@pytest.mark.parametrize("place", [".", "grey", "../photos/grey", "../link/grey", ".."])
def test_photographs_and_grey_images_lie_apart(photos: Path, tmp_path: Path, place: str) -> None:
    (tmp_path / "link").symlink_to(photos)
    before = noted(photos)
    for out, colour in ((photos / place, None), (tmp_path / "grey", photos / place)):
        with pytest.raises(ProjectError, match="lies in the folder of photographs or holds it"):
            convert_folder(photos, out, colour=colour, weights=GREEN)
    assert noted(photos) == before
    assert not (tmp_path / "grey").exists()


def test_broken_photographs_stay_left_out(photos: Path, tmp_path: Path) -> None:
    """One has no header, the other is found broken as it is fitted; the second run knows both from its record."""
    (photos / "text.jpg").write_text("no photograph")
    whole = (photos / "b.jpg").read_bytes()
    (photos / "b.jpg").write_bytes(whole[: len(whole) // 2])
    for _ in range(2):
        _, grey, left_out = convert_folder(photos, tmp_path / "grey", fit=QUICK)
        assert (set(grey), set(left_out)) == ({"a.png", "north/c.tif"}, {"b.jpg", "text.jpg"})
    with pytest.raises(PhotographError, match=r"text\.jpg: cannot be read"):
        convert_folder(photos, tmp_path / "strict", fit=QUICK, strict=True)
    assert not (tmp_path / "strict").exists()
    (photos / "text.jpg").unlink()
    with pytest.raises(PhotographError, match=r"b\.jpg"):
        convert_folder(photos, tmp_path / "grey", fit=QUICK, strict=True)


def test_weights_of_the_other_kind_are_refused_at_once(photos: Path, small_demo: Path, out: Path) -> None:
    shutil.copy(small_demo / "images/portico_01.dng", photos / "z.dng")
    expected = r"z\.dng: a linear photograph, and the weights are for coded ones"
    with pytest.raises(WeightsError, match=expected):
        convert_folder(photos, out, weights=GREEN)
    assert not out.exists()


# Colour twins


def test_colour_twins_have_names_pixels_exif_and_profile(photos: Path, tmp_path: Path) -> None:
    out, colour, told = tmp_path / "grey", tmp_path / "colour", Told()
    adobe, exif = rgb_profile("Adobe RGB (1998)"), Image.Exif()
    exif[0x0110] = "A camera"
    pixels = pixels_of(photos / "a.png")
    Image.fromarray(pixels).save(photos / "a.png", icc_profile=adobe, exif=exif)
    _, grey, _ = convert_folder(photos, out, colour=colour, weights=GREEN, progress=told)
    assert set(noted(colour)) == set(noted(out)) == set(grey.values())
    with Image.open(colour / "a.png") as twin, Image.open(out / "a.png") as image:
        np.testing.assert_array_equal(np.asarray(twin), pixels)
        np.testing.assert_array_equal(np.asarray(image), pixels[..., 1])
        assert twin.info["icc_profile"] == adobe
        assert "icc_profile" not in image.info
        assert twin.getexif()[0x0110] == image.getexif()[0x0110] == "A camera"
    assert any("1 in Adobe RGB" in text and "2 in sRGB" in text for text in told.warnings)


def test_other_weights_leave_colour_twins_as_they_are(photos: Path, tmp_path: Path) -> None:
    grey, colour = tmp_path / "grey", tmp_path / "colour"
    convert_folder(photos, grey, weights=GREEN)
    convert_folder(photos, grey, colour=colour, weights=GREEN)
    before = {folder: noted(folder) for folder in (grey, colour)}
    convert_folder(photos, grey, colour=colour, weights=BLUE)
    assert rewritten(before[colour], colour) == set()
    assert len(rewritten(before[grey], grey)) == 3


def test_colour_twins_of_raw_are_as_bright_with_given_weights(small_demo: Path, tmp_path: Path) -> None:
    raw, mean = tmp_path / "photos", FitOptions(method="mean")
    raw.mkdir()
    shutil.copy(small_demo / "images/portico_01.dng", raw / "a.dng")
    fitted, _, _ = convert_folder(raw, tmp_path / "g1", colour=tmp_path / "c1", fit=mean)
    convert_folder(raw, tmp_path / "g2", colour=tmp_path / "c2", weights=fitted)
    assert (tmp_path / "c1/a.png").read_bytes() == (tmp_path / "c2/a.png").read_bytes()
    assert (tmp_path / "g1/a.png").read_bytes() == (tmp_path / "g2/a.png").read_bytes()


@pytest.mark.parametrize("colour", ["grey", "grey/colour", "."])
def test_colour_twins_lie_in_a_folder_of_their_own(photos: Path, tmp_path: Path, colour: str) -> None:
    shutil.move(photos, tmp_path / "in/photos")
    (tmp_path / "out").mkdir()
    out = tmp_path / "out"
    with pytest.raises(KnownError, match="holds it"):
        convert_folder(tmp_path / "in/photos", out / "grey", colour=out / colour, weights=GREEN)


# The same camera


def camera(file: Path) -> tuple[Any, ...]:
    found = pycolmap.infer_camera_from_image(file)
    return (found.width, found.height, found.model, found.params.tolist(), found.has_prior_focal_length)


@pytest.mark.data
@pytest.mark.filterwarnings("ignore::UserWarning")  # Pillow's words on broken EXIF
@pytest.mark.parametrize("file_format", ["png", "tiff", "jpeg"])
def test_colmap_sees_the_same_camera_in_grey(photographs: Path, tmp_path: Path, file_format: Format) -> None:
    photos, out, colour = (tmp_path / name for name in ("photos", "out", "colour"))
    photos.mkdir()
    others = [photographs / "sceaux/100_7100.JPG", photographs / "fountain-p11/0000.jpg"]
    for source in [*(photographs / "exif").glob("*.jpg"), *others]:
        shutil.copy(source, photos / source.name)
    options = ConvertOptions(format=file_format)
    _, grey, left_out = convert_folder(photos, out, colour=colour, weights=GREEN, options=options)
    assert len(grey) == 10
    assert "premature end of data" in left_out["corrupted.jpg"]  # its last rows are not in the file
    for source_name, name in grey.items():
        assert camera(out / name) == camera(colour / name) == camera(photos / source_name)
        with Image.open(out / name) as image:
            assert image.mode == "L"
