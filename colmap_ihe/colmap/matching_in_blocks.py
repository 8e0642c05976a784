"""Matching by processes and the workers of a cluster: blocks of pairs, each in a database of its own images only."""

from __future__ import annotations

import shutil
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

from colmap_ihe.colmap.database import counting_rows
from colmap_ihe.colmap.feature_files import (
    read_features,
    read_pack,
    room_of_a_task,
    write_features,
    write_pack,
)
from colmap_ihe.colmap.native import apply_options, called, hush, pycolmap
from colmap_ihe.colmap.pair_blocks import Pair, batch_of, blocks_of, group_size, groups_of
from colmap_ihe.colmap.process import ColmapProcesses
from colmap_ihe.errors import Cancelled
from colmap_ihe.machine.executor import TaskProgress, in_order, width_of
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.machine.progress import Progress
from colmap_ihe.project.options import MatchesOptions

SEED = 0
"""Of RANSAC, for every pair anew: so a pair gives the same matches wherever, and beside whatever, it is verified."""
_GRACE_SECONDS = 60.0  # to keep what is matched already; COLMAP stops after the batch that it is at
_alone = Lock()  # for workers of several threads, which COLMAP's matcher is not safe on


@dataclass(frozen=True)
class _Block:
    """`images`: the camera of each by its id; `packs`: the files that their features are in; `batch`: pairs until it
    can be stopped."""

    pairs: tuple[Pair, ...]
    images: Mapping[int, pycolmap.Camera]
    packs: Mapping[Path, Sequence[int]]
    options: MatchesOptions
    batch: int
    result: Path


def match_in_processes(
    database: Path,
    pairs: Sequence[Pair],
    options: MatchesOptions,
    parts: Path,
    count: int,
    progress: Progress,
) -> None:
    """As `match_in_blocks`, by `count` processes at a time here. What was matched is kept when it is stopped."""
    told: dict[Path, int] = {}
    with ColmapProcesses(most_threads=1) as apart, ThreadPoolExecutor(count) as executor:

        def match_apart(block: _Block) -> Path:
            return apart.call(match_block, block, _Told(progress, block, told), _GRACE_SECONDS)

        _match(database, pairs, options, parts, executor, count, progress, match_apart, told)


def match_in_blocks(
    database: Path,
    pairs: Sequence[Pair],
    options: MatchesOptions,
    parts: Path,
    executor: Executor,
    progress: Progress,
) -> None:
    """Verified matches of those of `pairs` that are not in the database yet, by the workers of `executor`. `parts`: a
    folder for what is under way, which goes afterwards. Raises as `match_features`."""
    _match(database, pairs, options, parts, executor, width_of(executor), progress, match_block, {})


def _match(
    database: Path,
    pairs: Sequence[Pair],
    options: MatchesOptions,
    parts: Path,
    executor: Executor,
    width: int,
    progress: Progress,
    match: Callable[[_Block], Path],
    told: dict[Path, int],
) -> None:
    """`told`: the pairs of each block, by its result, that `match` has told the watch of."""
    parts.mkdir(parents=True)
    with pycolmap.Database.open(database) as opened:
        done = {pair for pair in pairs if opened.exists_two_view_geometry(*pair)}
        images = sorted(opened.read_all_images(), key=lambda image: str(image.name))
        known = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        features = max((opened.num_keypoints_for_image(image.image_id) for image in images), default=0)
    cameras = {image.image_id: known[image.camera_id] for image in images}
    # The first way round that a pair is named, as COLMAP has it: the other gives other matches.
    unlike = {_ordered(pair): pair for pair in reversed(pairs)}
    wanted = [pair for pair in reversed(unlike.values()) if pair not in done]
    progress.advance(len(pairs) - len(wanted))
    groups = groups_of(wanted, list(cameras), group_size(len(wanted), len(cameras), features, width))
    packs = _packed(database, groups, parts, progress)
    blocks = [
        _block(some, cameras, packs, options, batch_of(features), parts / f"matches-{number:06}.db")
        for number, some in enumerate(blocks_of(wanted, groups))
    ]
    try:
        for block, result in zip(blocks, in_order(executor, match, blocks, 2 * width, progress), strict=True):
            _copy_matches(result, database, block.pairs)
            result.unlink()
            progress.advance(len(block.pairs) - told.get(result, 0))
    finally:
        with suppress(RuntimeError):  # of a disk without room, perhaps, for which the others stopped
            for block in blocks:
                if block.result.exists():  # of one that was stopped
                    _copy_matches(block.result, database, block.pairs)
        shutil.rmtree(parts, ignore_errors=True)


class _Told(TaskProgress):
    """Tells a watch of the pairs of a block as they are done, and remembers how many."""

    def __init__(self, progress: Progress, block: _Block, told: dict[Path, int]) -> None:
        super().__init__()
        self._progress, self._block, self._told = progress, block, told

    def advance(self, count: int = 1) -> None:
        before = self._told.get(self._block.result, 0)
        count = min(count, len(self._block.pairs) - before)
        self._told[self._block.result] = before + count
        self._progress.advance(count)
        self.check()


def _ordered(pair: Pair) -> Pair:
    return min(pair), max(pair)


def _packed(
    database: Path, groups: Sequence[Sequence[int]], parts: Path, progress: Progress
) -> dict[int, Path]:
    """Writes the features of each group into a pack; the pack of each image."""
    packs: dict[int, Path] = {}
    with pycolmap.Database.open(database) as opened:
        for number, some in enumerate(groups):
            progress.check()
            path = parts / f"features-{number:06}.npz"
            write_pack(path, {i: read_features(opened, i) for i in some if opened.exists_keypoints(i)})
            packs |= dict.fromkeys(some, path)
    return packs


def _block(
    pairs: Sequence[Pair],
    cameras: Mapping[int, pycolmap.Camera],
    packs: Mapping[int, Path],
    options: MatchesOptions,
    batch: int,
    result: Path,
) -> _Block:
    ids = sorted({image_id for pair in pairs for image_id in pair})
    by_pack: dict[Path, list[int]] = defaultdict(list)
    for image_id in ids:
        by_pack[packs[image_id]].append(image_id)
    return _Block(tuple(pairs), {i: cameras[i] for i in ids}, dict(by_pack), options, batch, result)


def match_block(block: _Block, progress: Progress | None = None) -> Path:
    """Write a database with the matches of a block and their geometry, with one thread whatever the options say, and
    return its path. Where `progress` stops it, it writes what there is; a worker of a cluster has no `progress`, since
    nobody waits for what it had begun."""
    hush()
    matching = pycolmap.FeatureMatchingOptions()
    verification = verification_options(block.options)
    apply_options(matching, block.options.colmap, "matches.colmap")
    matching.num_threads = 1
    with room_of_a_task() as folder:
        database, listed = folder / "block.db", folder / "pairs.txt"
        _fill(database, block)
        pairing = pycolmap.ImportedPairingOptions(match_list_path=listed, block_size=block.batch)
        listed.write_text("".join(f"{one} {other}\n" for one, other in block.pairs), encoding="ascii")
        try:
            with _alone, counting_rows(database, "two_view_geometries") as rows:
                called(
                    pycolmap.match_image_pairs,
                    database,
                    matching_options=matching,
                    pairing_options=pairing,
                    verification_options=verification,
                    progress=progress or TaskProgress(),
                    units_done=rows,
                )
        except Cancelled:
            if progress is not None:
                _write_matches(database, folder, block)
            raise
        _write_matches(database, folder, block)
    return block.result


def _write_matches(database: Path, folder: Path, block: _Block) -> None:
    _copy_matches(database, folder / "matches.db", block.pairs)
    write_bytes(block.result, (folder / "matches.db").read_bytes())


def verification_options(options: MatchesOptions) -> pycolmap.TwoViewGeometryOptions:
    """pycolmap's options for verification. Raises `OptionError`."""
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    apply_options(verification, options.verification, "matches.verification")
    return verification


def _fill(database: Path, block: _Block) -> None:
    """The images of a block, named after their ids since names in lists of pairs cannot hold spaces, each a frame
    of its own as COLMAP imports them."""
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        for camera in {camera.camera_id: camera for camera in block.images.values()}.values():
            opened.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig(rig_id=camera.camera_id)
            rig.add_ref_sensor(camera.sensor_id)
            opened.write_rig(rig, use_rig_id=True)
        for image_id, camera in block.images.items():
            image = pycolmap.Image(name=str(image_id), camera_id=camera.camera_id, image_id=image_id)
            frame = pycolmap.Frame(frame_id=image_id, rig_id=camera.camera_id)
            frame.add_data_id(image.data_id)
            opened.write_frame(frame, use_frame_id=True)
            image.frame_id = image_id
            opened.write_image(image, use_image_id=True)
        for pack, some in block.packs.items():
            for image_id, features in read_pack(pack, some):
                write_features(opened, image_id, features)


def _copy_matches(source: Path, target: Path, pairs: Sequence[Pair]) -> None:
    """Those of `pairs` that COLMAP has looked at; it keeps a row for one without a match too, which is then done."""
    with (
        pycolmap.Database.open(source) as one,
        pycolmap.Database.open(target) as other,
        pycolmap.DatabaseTransaction(other),
    ):
        for pair in map(_ordered, pairs):
            if one.exists_matches(*pair) and not other.exists_matches(*pair):
                other.write_matches(*pair, one.read_matches(*pair))
            if one.exists_two_view_geometry(*pair) and not other.exists_two_view_geometry(*pair):
                other.write_two_view_geometry(*pair, one.read_two_view_geometry(*pair))
