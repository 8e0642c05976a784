"""What looks meant for us and is not used is told once, in words that say where it would be."""

from __future__ import annotations

from pathlib import Path

from colmap_ihe.pipeline.warnings.unused_files import unused_files
from colmap_ihe.project.folder import Project


def _made(root: Path, *names: str) -> Project:
    """Make empty files of these names, and folders where a name ends in `/`."""
    for name in ("images/", *names):
        path = root / name
        (path if name.endswith("/") else path.parent).mkdir(parents=True, exist_ok=True)
        if not name.endswith("/"):
            path.touch()
    return Project(root, root / "images")


def test_what_is_used_or_is_nobodys_is_not_told(tmp_path: Path) -> None:
    used = ("masks/a.png", "project.yaml", "Calibration/Dark/1.dng", "Calibration/flats/1.NEF")
    ours = ("workspace/x", "colour/x", "report/x", "records/x", "set-aside/x", "compare/x")
    others = ("notes.txt", "plan.pdf", ".git/", ".masks/", "sketches/")
    assert unused_files(_made(tmp_path, *used, *ours, *others, "Calibration/bad-pixels.txt")) == []


def test_each_kind_is_told_in_one_sentence(tmp_path: Path) -> None:
    settings = ("Project.yml", "options.yaml")
    photographs = ("IMG_1.JPG", "photos/")
    masks = ("masks/", "mask/", "masks_old/")
    project = _made(
        tmp_path, *settings, *photographs, *masks, "flats/1.dng", "bad-pixels.txt", "calibration/"
    )
    assert unused_files(project) == [
        "not used: Project.yml, options.yaml; options are read from project.yaml",
        f"not used: photos/, IMG_1.JPG; photographs are read from {tmp_path}/images",
        "not used: mask/, masks_old/; masks are read from masks/",
        "not used: flats/, bad-pixels.txt; calibration frames are read from calibration/bias, darks and flats,"
        " bad pixels from calibration/bad-pixels.txt",
    ]


def test_photographs_of_the_project_are_told_where_others_are_named(tmp_path: Path) -> None:
    _made(tmp_path / "church", "images/a.jpg")
    (tmp_path / "card").mkdir()
    project = Project(tmp_path / "church", tmp_path / "card")
    assert unused_files(project) == [f"not used: images/; photographs are read from {tmp_path}/card"]
