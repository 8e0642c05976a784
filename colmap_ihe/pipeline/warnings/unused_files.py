"""Name what lies in a project's folder, looks meant for us, and is not used."""

from __future__ import annotations

from collections.abc import Iterable

from colmap_ihe.machine.words import listed
from colmap_ihe.photographs.discover import CODED_SUFFIXES, RAW_SUFFIXES
from colmap_ihe.photographs.raw.calibration import BAD_PIXELS, kind_of_folder
from colmap_ihe.project.folder import Project

_PHOTOGRAPHS = ("image", "photo", "picture", "raw", "jpg", "jpeg", "dcim")
_OPTIONS = ("project", "options", "config", "settings", "colmap", "weights")
_YAML = (".yaml", ".yml", ".json", ".toml", ".ini")


def unused_files(project: Project) -> list[str]:
    """Return a sentence for each kind of file or folder at the top of a project that is named like one that is read,
    and is not read."""
    used = {project.images, project.masks, project.calibration, project.options_file}
    entries = [e for e in sorted(project.root.iterdir()) if e not in used]
    folders = [e.name for e in entries if e.is_dir()]
    files = [e for e in entries if e.is_file()]
    settings = [e.name for e in files if e.suffix.lower() in _YAML and _begins(e.name, _OPTIONS)]
    loose = [e.name for e in files if e.suffix.lower() in RAW_SUFFIXES | CODED_SUFFIXES]
    photographs = [*(f"{n}/" for n in folders if _begins(n, _PHOTOGRAPHS)), *loose]
    masks = [f"{n}/" for n in folders if _begins(n, ("mask",))]
    frames = [f"{n}/" for n in folders if _begins(n, ("calib",)) or kind_of_folder(n)]
    frames += [e.name for e in files if e.name.casefold() == BAD_PIXELS]
    return [
        *_sentence(settings, f"options are read from {project.options_file.name}"),
        *_sentence(photographs, f"photographs are read from {project.images}"),
        *_sentence(masks, f"masks are read from {project.masks.name}/"),
        *_sentence(
            frames,
            f"calibration frames are read from {project.calibration.name}/bias, darks and flats, bad pixels from"
            f" {project.calibration.name}/{BAD_PIXELS}",
        ),
    ]


def _begins(name: str, beginnings: Iterable[str]) -> bool:
    return name.casefold().startswith(tuple(beginnings))


def _sentence(names: list[str], where: str) -> list[str]:
    return [f"not used: {listed(names)}; {where}"] if names else []
