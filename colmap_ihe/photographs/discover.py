"""Photographs in: which files of a folder are captures, and what their grey images are called."""

from __future__ import annotations

import os
import re
import stat
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath, PurePosixPath
from typing import Literal

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.files import readable_name
from colmap_ihe.machine.words import counted, listed
from colmap_ihe.photographs.file_kinds import unread_files
from colmap_ihe.project.recipe import Recipe

RAW_SUFFIXES = frozenset(
    """
    .3fr .arw .cr2 .cr3 .crw .dc2 .dcr .dng .erf .fff .gpr .iiq .k25 .kc2 .kdc .mdc .mef .mos
    .mrw .nef .nrw .orf .pef .ptx .raf .raw .rw2 .rwl .sr2 .srf .srw .x3f
    """.split()  # noqa: SIM905
)
JPEG_SUFFIXES = frozenset([".jpg", ".jpeg", ".jpe", ".heic", ".heif", ".hif"])
"""Of JPEG files, and of those that cameras and phones write in their place."""
CODED_SUFFIXES = JPEG_SUFFIXES | {".tif", ".tiff", ".png"}
_RAW_FOLDERS = frozenset({"raw", "raws", *(suffix[1:] for suffix in RAW_SUFFIXES)})
_JPEG_FOLDERS = frozenset({"jpg", "jpgs", "jpeg", "jpegs", "heic", "heif", "hif"})
_FOREIGN_FOLDER = re.compile(
    r"@eadir|@__thumb|@tmp|@recycle|#recycle|#snapshot|\$recycle\.bin|recycler|\.trash(es|-.*)?|lost\+found"
    r"|__macosx|\.?thumbnails|system volume information|network trash folder|temporary items|.*\.lrdata",
    re.IGNORECASE,
)
"""Of NAS boxes, of systems and of programs: thumbnails, recycle bins, what a repair found, previews."""


_FOLDER_ICON = "Icon\r"  # of macOS
_ODD_NAME = "its name holds control characters, or is not UTF-8 text; rename it"


@dataclass(frozen=True)
class Capture:
    """Describe one shot. `name` is its path below the folder of photographs, with `/`, as the user knows it;
    `grey_stem` is the same without suffix, unless two captures would then collide; `paired` names the JPEG that the
    camera wrote beside this RAW. `recipe` says how it is developed, `pixels` how many it has once its header was read,
    else 0."""

    name: str
    path: Path = field(compare=False)
    kind: Literal["raw", "coded"]
    grey_stem: str
    paired: tuple[str, ...] = ()
    recipe: Recipe = field(default=Recipe(), compare=False)
    pixels: int = field(default=0, compare=False)

    def absolute(self) -> Capture:
        """Return the same with an absolute path, for a process that may work in another folder."""
        return replace(self, path=self.path.absolute())


_Member = tuple[str, Literal["raw", "coded"], tuple[str, ...], str]  # name, kind, paired, stem


@dataclass(frozen=True)
class Discovery:
    """Hold `captures` in the order of their names; `ignored`: files that are no photographs by their suffix, and with
    `/` at their end links to folders elsewhere; `refused`, by name: what is called like a photograph and cannot be
    one, such as a link that leads elsewhere, each with the reason; `notes`: sentences on how the files were taken."""

    captures: tuple[Capture, ...]
    ignored: tuple[str, ...]
    refused: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def discover(folder: Path) -> Discovery:
    """Return all captures below `folder`, with subfolders. RAW and JPEG of one shot are one capture: RAW wins.

    Hidden files are passed over, and what systems and NAS boxes keep in folders. RAW and JPEG may also lie in folders
    called after their kinds, side by side. Links below are followed to photographs within the folder, itself perhaps
    a link, and nowhere else; pipes and devices are not opened. Raises `ProjectError` if the folder is missing or holds
    no photograph.
    """
    if not folder.is_dir():
        raise ProjectError(f"{folder}: no such folder", hint="name a folder that holds photographs")
    shots: dict[str, list[str]] = defaultdict(list)
    ignored = []
    refused: dict[str, str] = {}
    whole = folder.resolve()
    names, notes = _found_below(folder)
    for name, is_folder in names:
        suffix, text = PurePosixPath(name).suffix.lower(), readable_name(name)
        if is_folder:
            if not (folder / name).resolve().is_relative_to(whole):
                ignored.append(f"{text}/")
        elif suffix not in RAW_SUFFIXES and suffix not in CODED_SUFFIXES:
            ignored.append(text)
        elif text != name:
            refused[text] = f"{text}: {_ODD_NAME}"
        elif why := _why_refused(folder / name, whole):
            refused[name] = f"{name}: {why}"
        else:
            shots[_shot_of(name)].append(name)
    if not shots:
        others = f"it holds {counted(len(ignored), 'other file')}" if ignored else "it is empty"
        content = listed([*refused.values(), *unread_files(ignored, ())], 3, "; ") or others
        raise ProjectError(
            f"{folder}: no photograph found, {content}",
            hint="expected RAW, JPEG, HEIC, TIFF or PNG files, in subfolders or not",
        )
    members = [member for names in shots.values() for member in _captures_of(names)]
    greys = _grey_stems({name: stem for name, _, _, stem in members})
    captures = [Capture(name, folder / name, kind, greys[name], paired) for name, kind, paired, _ in members]
    captures.sort(key=lambda c: c.name)
    notes += shot_notes(captures)
    return Discovery(tuple(captures), tuple(sorted(ignored)), refused, tuple(notes))


def is_foreign(path: PurePath) -> bool:
    """Tell whether a path below a folder of the user's is hidden, or one that a system or a NAS box keeps there."""
    return any(part.startswith(".") or _FOREIGN_FOLDER.fullmatch(part) for part in path.parts)


def _why_refused(path: Path, whole: Path) -> str:
    """Return why a file called like a photograph is not opened; empty if it may be."""
    try:
        end = path.resolve(strict=True)
        kind = end.stat().st_mode
    except (OSError, RuntimeError):  # Python before 3.13 has RuntimeError for a loop
        return "cannot be read (a link to nowhere); put the photograph in its place"
    if not end.is_relative_to(whole):
        return "a link that leads out of the folder of photographs; put the photograph in its place"
    odd = "cannot be read (no file but a pipe or a device); take it out of the folder"
    return "" if stat.S_ISREG(kind) else odd


def captures_of_files(paths: Iterable[Path]) -> list[Capture]:
    """Return captures of just these files, RAW and JPEG of one shot as one; for a fit, so names are whole paths."""
    shots: dict[str, list[str]] = defaultdict(list)
    for path in dict.fromkeys(p.absolute() for p in paths):
        suffix = path.suffix.lower()
        if not path.is_file() or (suffix not in RAW_SUFFIXES and suffix not in CODED_SUFFIXES):
            raise ProjectError(
                f"{path}: no such photograph", hint="name folders, or RAW, JPEG, HEIC, TIFF or PNG files"
            )
        shots[_shot_of(path.as_posix())].append(path.as_posix())
    return [
        Capture(name, Path(name), kind, name, paired)
        for names in shots.values()
        for name, kind, paired, _ in _captures_of(names)
    ]


def _grey_stems(stems: dict[str, str]) -> dict[str, str]:
    """Return the name of each capture's grey image: its stem, or its whole name where another has that stem. Case does
    not tell names apart, for there are disks that fold it."""
    while True:
        taken = Counter(stem.casefold() for stem in stems.values())
        again = {name: name if taken[stem.casefold()] > 1 else stem for name, stem in stems.items()}
        if again == stems:
            return stems
        stems = again


def _captures_of(names: Sequence[str]) -> list[_Member]:
    """Return the captures among files of one shot: a RAW takes the JPEG beside it, anything else stands alone."""
    raws = [n for n in names if _suffix(n) in RAW_SUFFIXES]
    jpegs = tuple(n for n in names if _suffix(n) in JPEG_SUFFIXES)
    if len(raws) != 1:
        return [(n, "raw" if n in raws else "coded", (), _stem(n)) for n in names]
    others = [n for n in names if n not in raws and n not in jpegs]
    return [(raws[0], "raw", jpegs, _stem(raws[0])), *((n, "coded", (), _stem(n)) for n in others)]


def _suffix(name: str) -> str:
    return PurePosixPath(name).suffix.lower()


def _stem(name: str) -> str:
    return str(PurePosixPath(name).with_suffix(""))


def _shot_of(name: str) -> str:
    """Return what the files of one shot have in common: the name without suffix, and without a last folder that is
    called after their kind, as RAW/ and JPG/."""
    path = PurePosixPath(name)
    kinds = _RAW_FOLDERS if _suffix(name) in RAW_SUFFIXES else _JPEG_FOLDERS
    is_kind = _suffix(name) in RAW_SUFFIXES | JPEG_SUFFIXES and path.parent.name.lower() in kinds
    return _stem((path.parent.parent if is_kind else path.parent).joinpath(path.name).as_posix())


def shot_notes(captures: Iterable[Capture]) -> list[str]:
    """Say so where files of two folders were taken for one shot."""
    both = [
        (j, c.name)
        for c in captures
        for j in c.paired
        if PurePosixPath(j).parent != PurePosixPath(c.name).parent
    ]
    if not both:
        return []
    return [
        f"{counted(len(both), 'JPEG file')} in a folder beside the RAW files of the same names, as {both[0][0]} of"
        f" {both[0][1]}: each two are one shot, and the RAW file is used"
    ]


def _found_below(folder: Path) -> tuple[list[tuple[str, bool]], list[str]]:
    """Return the name of every file and of every link to a folder, and whether it is such a link; and a sentence on
    what systems and NAS boxes keep in folders, which is passed over."""

    def refuse(error: OSError) -> None:
        message = f"{error.filename}: cannot be read ({error.strerror})"
        raise ProjectError(message, hint="give read permission")

    names, foreign = [], []
    for parent, folders, files in os.walk(folder, onerror=refuse):
        below = Path(parent).relative_to(folder)
        foreign += [f"{(below / f).as_posix()}/" for f in sorted(folders) if _FOREIGN_FOLDER.fullmatch(f)]
        foreign += [(below / f).as_posix() for f in sorted(files) if f.startswith("._") and _is_picture(f)]
        folders[:] = sorted(f for f in folders if not is_foreign(PurePath(f)))
        names += [((below / f).as_posix(), True) for f in folders if (Path(parent) / f).is_symlink()]
        names += [
            ((below / f).as_posix(), False) for f in files if not f.startswith(".") and f != _FOLDER_ICON
        ]
    notes = [f"passed over, as no photographs of the set: {listed(list(map(readable_name, foreign)))}"]
    return sorted(names), notes if foreign else []


def _is_picture(name: str) -> bool:
    return _suffix(name) in RAW_SUFFIXES | CODED_SUFFIXES
