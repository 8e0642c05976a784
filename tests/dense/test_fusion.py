"""Fusion in cells of space, and masks all the way from the sparse model to the cloud."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from plane import SIZE, Centre, K, make_project
from running import StopsWhen

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense import fusion
from colmap_ihe.dense.depth_maps import depth_file, read_planes, sgm_depth_maps
from colmap_ihe.dense.fusion_cells import PixelCoverage, Price, cells_of
from colmap_ihe.dense.ply import columns, read_ply
from colmap_ihe.dense.undistort import mask_of, read_mask, undistort
from colmap_ihe.errors import Cancelled

STRIP = {f"{n:02}.png": (0.5 * n, 0.0, 0.0) for n in range(14)}
FEW = dict(list(STRIP.items())[:5])
A_MAP = fusion.fusion_bytes(SIZE[0] * SIZE[1])


def dense_of(root: Path, views: Mapping[str, Centre]) -> Path:
    """Return the dense workspace of a project with its depth maps, and with the masks in `root`."""
    make_project(root, views)
    folders = (root / "sparse", root / "grey", root / "colour", root / "dense")
    undistort(*folders, masks_dir=root / "masks")
    sgm_depth_maps(root / "dense")
    return root / "dense"


def positions(dense: Path) -> NDArray[np.float32]:
    return columns(read_ply(dense / "fused.ply")["vertex"], "xyz")


@pytest.fixture(scope="module")
def strip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return dense_of(tmp_path_factory.mktemp("strip"), STRIP)


def test_cells_give_the_cloud_that_one_fusion_gives(strip: Path) -> None:
    count = fusion.fuse(strip)
    whole = positions(strip)
    assert fusion.fuse(strip, most_bytes=4 * A_MAP) == pytest.approx(count, rel=0.02)
    parts = positions(strip)
    assert not list(strip.glob("fused.part*"))
    assert not (strip / "stereo" / ".cell").exists()
    # As dense everywhere, at borders of cells too: none missing there, and none twice.
    edges = np.arange(-0.5, 7.5, 0.1)
    before, after = (np.histogram(cloud[:, 0], edges)[0] for cloud in (whole, parts))
    busy = before > 500
    ratio = after[busy] / before[busy]
    assert busy.sum() > 50
    assert ratio.min() > 0.9
    assert ratio.max() < 1.1, ratio


def test_every_point_of_cells_says_which_images_see_it(strip: Path) -> None:
    count = fusion.fuse(strip, most_bytes=4 * A_MAP)
    words = np.fromfile(strip / "fused.ply.vis", "<u4")
    assert words[:2].view("<u8")[0] == count
    model = pycolmap.Reconstruction(strip / "sparse")
    order = [model.images[i].name for i in model.reg_image_ids()]
    points, start = positions(strip), 2
    for row in range(count):
        images = words[start + 1 : start + 1 + words[start]]
        assert len(images) >= 1
        if row % 997 == 0:
            centres = np.array([STRIP[order[i]][0] for i in images])
            assert np.abs(centres - points[row, 0]).max() < SIZE[0] / K[0, 0] * 4
        start += 1 + len(images)
    assert start == len(words)


def test_cells_can_be_cancelled_and_leave_nothing(strip: Path) -> None:
    before = positions(strip)
    with pytest.raises(Cancelled):
        fusion.fuse(strip, most_bytes=4 * A_MAP, progress=StopsWhen(lambda done: done))
    assert not list(strip.glob("fused.part*"))
    assert not (strip / "stereo" / ".cell").exists()
    assert np.array_equal(positions(strip), before)


def shown(points: NDArray[np.float64], image: NDArray[np.int64]) -> PixelCoverage:
    """As ever so many pixels of images of 40 by 40, that look along z."""
    column = np.clip((points[:, :2] - np.floor(points[:, :2])) * 40, 0, 39).astype(np.int64)
    return PixelCoverage(points, image, column, np.full(len(points), 3.0), np.ones(len(points), np.int64))


def test_space_is_cut_until_what_is_held_is_little_enough() -> None:
    draw = np.random.default_rng(0)
    image = np.repeat(np.arange(40), 50)
    points = draw.uniform(0, 1, (2000, 3)) + np.stack([image, 0 * image, 0 * image], axis=1)
    cells = cells_of(shown(points, image), Price(map=1, point=1), most=6000)
    assert 15 < len(cells) < 40
    assert all(cell.cost <= 6000 for cell in cells)
    assert (np.sum([cell.holds(points) for cell in cells], axis=0) == 1).all()
    everywhere = draw.uniform(-1e6, 1e6, (1000, 3))
    assert (np.sum([cell.holds(everywhere) for cell in cells], axis=0) == 1).all()
    for cell in cells:
        assert set(image[cell.holds(points)]) <= set(cell.images)


def test_windows_make_cells_small_where_all_images_see_the_same() -> None:
    draw = np.random.default_rng(0)
    image = np.repeat(np.arange(20), 300)
    seen = shown(draw.uniform(0, 1, (6000, 3)) * [1, 1, 0.1], image)
    whole, *others = cells_of(seen, Price(map=1, point=1), most=1e9)
    assert not others
    assert whole.images == tuple(range(20))
    cells = cells_of(seen, Price(map=1, point=1), most=whole.cost / 6)
    assert len(cells) >= 8
    assert all(cell.cost <= whole.cost / 6 and len(cell.images) == 20 for cell in cells)


def test_what_cannot_be_cut_stays_one_cell() -> None:
    one_place = shown(np.full((100, 3), 0.5), np.repeat(np.arange(20), 5))
    assert len(cells_of(one_place, Price(map=1, point=1), most=1)) == 1
    nothing = np.empty(0, np.int64)
    nowhere = PixelCoverage(np.empty((0, 3)), nothing, np.empty((0, 2), np.int64), np.empty(0), nothing)
    assert len(cells_of(nowhere, Price(map=1, point=1), most=1)) == 1


def test_what_a_mask_hides_has_no_depth_and_no_point(tmp_path: Path) -> None:
    masks = tmp_path / "masks"
    masks.mkdir()
    hidden = 1.0  # everything right of this x of the world, in all images
    for name, (x, _, _) in FEW.items():
        white = np.full(SIZE[::-1], 255, np.uint8)
        white[:, max(0, min(SIZE[0], int(K[0, 2] + (hidden - x) / 4 * K[0, 0]))) :] = 0
        Image.fromarray(white).save(masks / f"{name}.png")
    dense = dense_of(tmp_path, FEW)
    assert fusion.fuse(dense) > 10_000
    for name in FEW:
        mask = read_mask(dense, name)
        assert mask is not None
        assert set(np.unique(mask)) <= {0, 255}
        assert not read_planes(depth_file(dense, name))[0][mask == 0].any()
    # The plane is at z = 4 in its middle, and slanted: the border is as far off as that makes it.
    assert positions(dense)[:, 0].max() < hidden + 0.15


def test_fusion_keeps_to_masks_where_depth_maps_do_not(tmp_path: Path) -> None:
    """As those of PatchMatch, which knows of no masks."""
    dense = dense_of(tmp_path, FEW)
    assert fusion.fuse(dense) > 10_000
    for name in FEW:
        mask = mask_of(dense, name)
        mask.parent.mkdir(exist_ok=True)
        Image.fromarray(np.zeros(SIZE[::-1], np.uint8)).save(mask)
    assert fusion.fuse(dense) == 0
