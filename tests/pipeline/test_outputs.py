"""What a kill, a lost file or a slip in an option must not do to finished work."""

from __future__ import annotations

import json
import shutil
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np
import pytest
from icc import rgb_profile
from PIL import Image
from small_demo import Make, MakeOptions

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import Cancelled, OptionError, PhotographError, ProjectError
from colmap_ihe.machine.progress import Progress, Silent
from colmap_ihe.pipeline import outputs
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.pipeline.stage import Stage


def cameras_in(project: Path) -> int:
    with pycolmap.Database.open(project / "workspace/database.db") as database:
        return database.num_cameras()


def test_a_kill_while_old_files_are_removed_does_not_make_them_new(
    finished: Path, quick_options: MakeOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The grey images of the old weights are there, half removed: the next run must not keep one."""

    def killed(stage: Stage, _project: object) -> None:
        if stage.name == "convert":
            (finished / "workspace/images/portico_01.png").unlink()
            raise Cancelled

    old = (finished / "workspace/images/portico_02.png").read_bytes()
    blue = quick_options("fit.method=blue")
    with monkeypatch.context() as patch:
        patch.setattr(outputs, "remove", killed)
        with pytest.raises(Cancelled):
            reconstruct(finished, blue, until="convert")
    reconstruct(finished, blue, until="convert")
    assert (finished / "workspace/images/portico_02.png").read_bytes() != old


def test_cameras_are_the_same_after_a_kill_amid_features(finished: Path, quick_options: MakeOptions) -> None:
    """COLMAP groups cameras within one call; images that come in later must not get cameras of their own."""
    options = quick_options()
    assert cameras_in(finished) == 1

    class StopsAtOnce(Silent):
        def start(self, total: int, unit: str = "images") -> None:
            self.cancelled = True

        def stage(self, name: str) -> AbstractContextManager[Progress]:
            return nullcontext(self if name == "features" else Silent())

    with pytest.raises(Cancelled):
        reconstruct(finished, options, start="features", until="features", progress=StopsAtOnce())
    done = reconstruct(finished, options, until="features")
    assert (cameras_in(finished), done.summary["registered_images"]) == (1, None)


def test_photographs_may_not_lie_where_we_write(tmp_path: Path, small_demo: Path) -> None:
    root = tmp_path / "set"
    root.mkdir()
    shutil.copy(small_demo / "images/portico_01.jpg", root)
    with pytest.raises(ProjectError, match="would lie in one folder"):
        reconstruct(root, images=root)
    assert [p.name for p in root.iterdir()] == ["portico_01.jpg"]


def test_strict_is_heard_when_the_record_is_there_already(
    new_project: Make, quick_options: MakeOptions
) -> None:
    project = new_project(3)
    (project / "images/broken.jpg").write_bytes(b"no photograph")
    done = reconstruct(project, quick_options(), until="convert")
    assert list(done.summary["left_out"]) == ["broken.jpg"]
    with pytest.raises(PhotographError, match=r"broken\.jpg"):
        reconstruct(project, quick_options("captures.strict=true"), until="convert")


def test_a_summary_tells_of_all_that_is_still_true(finished: Path, quick_options: MakeOptions) -> None:
    before = json.loads((finished / "report/summary.json").read_text())
    reconstruct(finished, quick_options(), until="fit")
    assert json.loads((finished / "report/summary.json").read_text()) == before


def test_masks_may_be_named_after_the_photograph(finished: Path, quick_options: MakeOptions) -> None:
    """The upper half of one view is masked: no feature there, and the other views keep theirs."""
    name = next(p.name for p in sorted((finished / "images").iterdir()) if p.stem == "portico_02")
    with Image.open(finished / "workspace/images/portico_02.png") as image:
        width, height = image.size
    mask = np.full((height, width), 255, np.uint8)
    mask[: height // 2] = 0
    (finished / "masks").mkdir()
    Image.fromarray(mask).save(finished / f"masks/{name}.png")
    Image.fromarray(mask).save(finished / "masks/nobody.jpg.png")
    done = reconstruct(finished, quick_options(), until="features")
    assert not done.summary["left_out"]
    assert any("not used, of no photograph: nobody.jpg.png" in text for text in done.summary["warnings"])
    with pycolmap.Database.open(finished / "workspace/database.db") as database:
        rows = {i.name: database.read_keypoints(i.image_id)[:, 1] for i in database.read_all_images()}
    assert rows["portico_02.png"].min() > height / 2 - 1
    assert len(rows["portico_02.png"]) > 20
    assert rows["portico_03.png"].min() < height / 4
    Image.fromarray(mask[:50]).save(finished / f"masks/{name}.png")
    with pytest.raises(ProjectError, match="its photograph has"):
        reconstruct(finished, quick_options(), until="features")


def test_colour_twins_of_a_project_are_in_srgb(tmp_path: Path, quick_options: MakeOptions) -> None:
    """As the cloud, the mesh and its texture are, which have no place for a profile."""
    pixels = np.full((80, 90, 3), (200, 100, 120), np.uint8)
    (tmp_path / "images").mkdir()
    Image.fromarray(pixels).save(tmp_path / "images/a.png", icc_profile=rgb_profile("Adobe RGB (1998)"))
    reconstruct(tmp_path, quick_options(), until="convert")
    with Image.open(tmp_path / "colour/a.png") as twin:
        assert "icc_profile" not in twin.info
        assert np.abs(np.asarray(twin)[0, 0].astype(int) - (227, 100, 122)).max() <= 1


def test_from_a_stage_after_the_last_is_refused(finished: Path, quick_options: MakeOptions) -> None:
    with pytest.raises(OptionError, match="--from dense"):
        reconstruct(finished, quick_options(), start="dense", until="fit")
