"""What somebody else may have written, and spoilt parsers once: it is refused in one line and takes little memory."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import tifffile
from bombs import HUGE, png_of, with_sides
from PIL import Image
from stage_records import records

from colmap_ihe.errors import OptionError, PhotographError, ProjectError
from colmap_ihe.evaluation.figures import read_pairs
from colmap_ihe.evaluation.truth import read_truth
from colmap_ihe.photographs.decode import refuse_too_large
from colmap_ihe.photographs.raw.dng_black import black_plane
from colmap_ihe.pipeline.records import is_valid, read_record
from colmap_ihe.project.folder import Project
from colmap_ihe.project.safe_yaml import parse_yaml

CHAIN = "a0: &a0 x\n" + "\n".join(f"a{n}: &a{n} [*a{n - 1}]" for n in range(1, 40))
UNWRITTEN = {
    "deep": "a: " + "[" * 3000 + "]" * 3000,
    "a number of thousands of digits": "a: " + "9" * 5000,
    "a date that there is not": "a: 2016-13-45",
    "a number without digits": "a: !!int ''",
    "no time": "a: !!timestamp x",
    "neither true nor false": "a: !!bool x",
    "an alias inside itself": "a: &a [*a]",
    "a deep chain": CHAIN,
    "half a character": 'a: "\\ud800"',
    "no text": 'a: "\\0"',
    "long": "a: " + "x" * 20_000,
}


@pytest.mark.parametrize("text", UNWRITTEN.values(), ids=UNWRITTEN)
def test_yaml_that_nobody_writes_is_refused_in_a_line(text: str) -> None:
    with pytest.raises(ValueError, match=r"^[^\n]+$"):
        parse_yaml(text)


@pytest.mark.parametrize("inside", ["[{names}]", "{{<<: [{names}], y{n}: 1}}"])
def test_aliases_that_unfold_without_end_are_refused_at_once(inside: str) -> None:
    rows = ["a0: &a0 {x: 1}"]
    for n in range(1, 40):
        names = ", ".join([f"*a{n - 1}"] * 9)
        rows.append(f"a{n}: &a{n} {inside.format(names=names, n=n)}")
    with pytest.raises(ValueError, match=r"unfold to more than (100000 values|24 levels)"):
        parse_yaml("\n".join(rows))


def test_aliases_and_merges_of_a_person_are_read() -> None:
    values = parse_yaml("a: &a {x: 1}\nb: {<<: *a, y: 2}\nc: *a")
    assert values == {"a": {"x": 1}, "b": {"x": 1, "y": 2}, "c": {"x": 1}}


@pytest.mark.parametrize("depth", ["a\nb", "../up.png", "/etc/passwd", "link.png", ""])
def test_true_depth_lies_beside_its_cameras(tmp_path: Path, depth: str) -> None:
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth/link.png").symlink_to(tmp_path / "up.png")
    camera = {"width": 24, "height": 16, "depth": depth, "nearest_m": 1}
    camera |= {"calibration": np.eye(3).tolist(), "cam_from_world": np.eye(3, 4).tolist()}
    found = {"cameras": {"a": camera}, "extent_m": 1}
    (tmp_path / "truth/cameras.json").write_text(json.dumps(found))
    with pytest.raises(ProjectError, match="is not a file beside"):
        read_truth(tmp_path / "truth")


def test_a_dng_whose_directories_follow_each_other_for_ever_is_left(tmp_path: Path) -> None:
    buffer = BytesIO()
    with tifffile.TiffWriter(buffer) as tiff:
        for _ in range(3):
            tiff.write(np.zeros((16, 24), np.uint16), metadata=None)
    data, place = bytearray(buffer.getvalue()), 4
    while directory := struct.unpack_from("<I", data, place)[0]:
        place = directory + 2 + 12 * struct.unpack_from("<H", data, directory)[0]
    data[place : place + 4] = data[4:8]  # behind the last the first again
    (tmp_path / "a.dng").write_bytes(data)
    assert black_plane(tmp_path / "a.dng", (16, 24)) is None


@pytest.mark.parametrize(
    ("stage", "change"),
    [
        ("convert", {"grey": {"a.jpg": "../../../up.png"}}),
        ("convert", {"grey": {"a.jpg": "/etc/passwd"}}),
        ("convert", {"grey": {}}),
        ("convert", {"grey": {"a.jpg": "x" * 300 + ".png"}}),
        ("convert", {"grey": {"a.jpg": "a\ud800.png"}}),
        ("captures", {"recipes": {"a.jpg": {"dark": "../up.npy"}}}),
        ("captures", {"recipes": {"a.jpg": {"cache_folder": "/tmp"}}}),
        ("captures", {"recipes": {"a.jpg": {"unknown": 1}}}),
        ("mesh", {"files": ["../fused.ply"]}),
        ("fit", {"weights": {"coded": {"weights": [1, 1, 1]}}}),
        ("sparse", {"models": []}),
        ("dense", {"points": "many"}),
    ],
)
def test_a_record_that_no_stage_left_counts_for_none(
    tmp_path: Path, stage: str, change: dict[str, object]
) -> None:
    sound = records()[stage]
    assert is_valid(stage, sound)
    (tmp_path / "images").mkdir()
    place = Project.at(tmp_path)
    place.write_record(stage, sound)
    assert read_record(place, stage) == json.loads(json.dumps(sound))
    place.write_record(stage, sound | change)
    assert read_record(place, stage) is None


def test_a_line_of_pairs_that_no_names_can_fill_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "pairs.txt").write_text("a" + " " * 5_000_000 + "b")
    with pytest.raises(OptionError, match="line 1"):
        read_pairs(tmp_path / "pairs.txt", ["a", "c"])


# What says that it is huge


BOMBS = """
import json, resource, sys
from pathlib import Path
import colmap_ihe
from colmap_ihe.errors import KnownError
from colmap_ihe.evaluation.truth import TrueImage
from colmap_ihe.pipeline.masks import write_masks
import numpy as np
folder = Path(sys.argv[1])
limit = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + (256 << 20)
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
said = []
for name in sorted(p.name for p in (folder / "masks").iterdir()):
    try:
        write_masks(folder / "masks", {name.removesuffix(".png"): "a.png"}, folder / "grey", folder / "made")
    except KnownError as error:
        said.append(str(error))
try:
    TrueImage(24, 16, np.eye(3), np.eye(3, 4), folder / "masks/bomb.jpg.png").depth_m()
except KnownError as error:
    said.append(str(error))
print(json.dumps(said))
"""


def test_pixels_are_counted_before_they_are_decoded(tmp_path: Path) -> None:
    """Masks and true depth, which this process reads itself, with 256 MB to do it in; photographs and frames, which
    decoders read, in test_mutated.py."""
    (tmp_path / "grey").mkdir()
    (tmp_path / "masks").mkdir()
    Image.new("L", (24, 16)).save(tmp_path / "grey/a.png")
    bomb = png_of(HUGE, HUGE, rows=bytes(1 << 24))
    (tmp_path / "masks/bomb.jpg.png").write_bytes(bomb)
    (tmp_path / "masks/large.jpg.png").write_bytes(png_of(20_000, 20_000, rows=bytes(1 << 24)))
    Image.new("RGB", (24, 16)).save(tmp_path / "small.tif")
    for name, side in (("tiff", HUGE), ("most", 0x7FFFFFFF)):
        huge = with_sides((tmp_path / "small.tif").read_bytes(), side, side)
        (tmp_path / f"masks/{name}.jpg.png").write_bytes(huge)
    command = [sys.executable, "-W", "ignore", "-c", BOMBS, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    said = json.loads(done.stdout)
    assert len(said) == 5
    assert all("pixels" in text or "cannot be read as a mask" in text for text in said)
    assert not list((tmp_path / "made").glob("*"))


def test_a_calibration_frame_of_too_many_pixels_is_refused_by_its_header() -> None:
    with pytest.raises(PhotographError, match="expected at most 500 megapixels"):
        refuse_too_large("dark.dng", 60_000, 60_000)
