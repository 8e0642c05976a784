"""Show stereo what the second grey adds: in the undistorted grey images, from their colour twins."""

from __future__ import annotations

from pathlib import Path

from colmap_ihe.dense.undistort import read_colour, read_grey
from colmap_ihe.grey.second import SecondGrey
from colmap_ihe.machine.executor import in_order, local_executor
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.encode import SUFFIXES, encode_image


def add_second_grey(dense_dir: Path, second: SecondGrey, progress: Progress) -> int:
    """Write the grey images that the second grey adds to anew, and return their number. `dense_dir` is as `undistort`
    leaves it. Raises `ProjectError`, `Cancelled`."""
    folder = dense_dir / "grey" / "images"
    names = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
    formats = {suffix: name for name, suffix in SUFFIXES.items()}

    def add(name: str) -> bool:
        grey = read_grey(folder / name)
        combined, shares = second.combined(grey, read_colour(dense_dir / "images" / name))
        if shares.any():
            write_bytes(folder / name, encode_image(combined, b"", formats[Path(name).suffix]))
        return bool(shares.any())

    progress.start(len(names), "images, second grey")
    count = 0
    with local_executor() as executor:
        for changed in in_order(executor, add, names, progress=progress):
            count += changed
            progress.advance()
    return count
