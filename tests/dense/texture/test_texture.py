"""Texture on scenes whose colours are known: planes seen by cameras above them."""

from __future__ import annotations

from typing import Any

import numpy as np
import planes
import pytest

from colmap_ihe.dense.camera import PinholeCamera, UInt8
from colmap_ihe.dense.texture.atlas import Patches, cut, pack
from colmap_ihe.dense.texture.bake import bake, corner_colours, paint, sample, texels_of
from colmap_ihe.dense.texture.labels import Choices, _beside, _change_faces, label_faces
from colmap_ihe.dense.texture.level import seam_offsets
from colmap_ihe.dense.texture.mesh import (
    Mesh,
    components,
    face_normals,
    neighbours,
    vertex_normals,
    without_small_parts,
)
from colmap_ihe.dense.texture.raster import covered, depth_picture
from colmap_ihe.dense.texture.seams import SeamPoints, seam_points
from colmap_ihe.dense.texture.select import Candidates, choose, quality_in

SIZE = (200, 200)
UNSEEN = -1


def grid(side: int = 10, low: float = -1.0, high: float = 1.0, z: float = 0.0) -> Mesh:
    """A square across z, facing -z, of `side` x `side` x 2 faces."""
    ticks = np.linspace(low, high, side + 1)
    x, y = np.meshgrid(ticks, ticks)
    vertices = np.stack((x.ravel(), y.ravel(), np.full(x.size, z)), axis=1).astype(np.float32)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    step = side + 1
    halves = ((corner, corner + step, corner + 1), (corner + 1, corner + step, corner + step + 1))
    faces = np.concatenate([np.stack(half, axis=1) for half in halves])
    return Mesh(vertices, faces.astype(np.int32), np.full(vertices.shape, 77, np.uint8))


def joined(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + start for m, start in zip(meshes, starts, strict=True)]).astype(np.int32),
        np.concatenate([m.colours for m in meshes]),
    )


def camera(x: float = 0.0, y: float = 0.0, z: float = -4.0, focal: float = 300.0) -> PinholeCamera:
    """Looks along +z; 4 before the square, which then is 150 pixels wide."""
    return planes.camera([x, y, z], size=SIZE, focal=focal)


def picture(view: PinholeCamera, colour: object, z: float = 0.0) -> UInt8:
    """What `view` sees of a plane at `z` with `colour(x, y)`, (N, 3) of (N,) twice."""
    column, row = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    centre = view.centre
    away = (z - centre[2]) / view.K[0, 0]
    x = centre[0] + (column - SIZE[0] / 2) * away
    y = centre[1] + (row - SIZE[1] / 2) * away
    assert callable(colour)
    values = np.clip(np.rint(colour(x.ravel(), y.ravel())), 0, 255)
    return np.asarray(values, np.uint8).reshape(*SIZE[::-1], 3)


def ramp(x: Any, y: Any) -> Any:
    return np.stack((120 + 60 * x, 120 + 60 * y, 120 + 30 * x - 30 * y), axis=1)


def labelled(mesh: Mesh, views: list[PinholeCamera]) -> tuple[Any, Any]:
    candidates = Candidates.none(len(mesh.faces))
    for number, view in enumerate(views):
        candidates.add(number, quality_in(mesh, view), mesh.colours[mesh.faces[:, 0]])
    pairs = neighbours(mesh.faces)
    labels, coloured = choose(candidates, mesh, pairs, views)
    return np.where(coloured, labels, UNSEEN), pairs


def patched(mesh: Mesh, views: list[PinholeCamera]) -> Patches:
    candidates = Candidates.none(len(mesh.faces))
    for number, view in enumerate(views):
        candidates.add(number, quality_in(mesh, view), mesh.colours[mesh.faces[:, 0]])
    pairs = neighbours(mesh.faces)
    return cut(mesh, *choose(candidates, mesh, pairs, views), views, pairs)


def textured(mesh: Mesh, views: list[PinholeCamera], pictures: list[UInt8], *, level: bool = True) -> Any:
    """(F, 3): the texture at the centre of each face."""
    patches = patched(mesh, views)
    atlas = pack(patches, 1024)
    points = seam_points(patches, atlas)
    colours, seen = corner_colours(patches, pictures, mesh.colours)
    offsets = seam_offsets(patches, colours, seen, np.full_like(colours, np.nan))
    if not level:
        offsets, points = 0 * offsets, SeamPoints(points.texel[:0], points.patch[:0], points.coloured[:0])
    texture = bake(atlas, patches, paint(atlas, patches, pictures, colours), offsets, points)
    assert texture.shape == (atlas.size[1], atlas.size[0], 3)
    column, row = np.floor(atlas.texel[atlas.faces].mean(axis=1)).astype(int).T
    return texture[row, column].astype(float)


def test_a_face_covers_the_pixels_whose_centres_are_in_it() -> None:
    corners = np.array([[[1.0, 1.0], [5.0, 1.0], [1.0, 5.0]]])
    (part,) = covered(corners, (8, 8))
    rows, columns = np.divmod(part.pixel, 8)
    expected = {(r, c) for r in range(8) for c in range(8) if r >= 1 and c >= 1 and r + c + 1 <= 6}
    assert set(zip(rows.tolist(), columns.tolist(), strict=True)) == expected
    points = np.einsum("nk,kc->nc", part.weights, corners[0])
    assert np.allclose(points, np.stack((columns + 0.5, rows + 0.5), axis=1))
    for broken in ([[1, 1], [np.nan, 1], [1, 5]], [[1, 1], [2, 2], [3, 3]], [[-9, -9], [-5, -9], [-9, -5]]):
        assert not any(len(part.pixel) for part in covered(np.array([broken], float), (8, 8)))


def test_depth_has_the_nearest_face_in_front() -> None:
    view = camera()
    mesh = joined(grid(z=0.0), grid(low=-0.3, high=0.3, z=-1.0))
    pixels, depths = view.project(mesh.vertices)
    depth = depth_picture(pixels[mesh.faces], depths[mesh.faces], SIZE)
    assert depth[100, 100] == pytest.approx(3.0)
    assert depth[100, 40] == pytest.approx(4.0)
    assert np.isinf(depth[0, 0])


def test_a_plane_has_the_colours_of_its_photograph() -> None:
    mesh, view = grid(), camera()
    colours = textured(mesh, [view], [picture(view, ramp)])
    centres = mesh.corners().mean(axis=1)
    assert np.abs(colours - ramp(centres[:, 0], centres[:, 1])).max() < 3


def test_what_is_hidden_has_no_colour_of_what_stands_before_it() -> None:
    """The red square hides the middle of the ramp from the first camera; the second sees it from aside."""
    wall, screen = grid(20), grid(4, -0.3, 0.3, z=-1.0)
    mesh = joined(wall, screen)
    views = [camera(), camera(x=1.2, focal=250.0)]
    pictures = []
    for view in views:
        pixels = picture(view, ramp)
        corners, _ = view.project(screen.vertices)
        (left, top), (right, bottom) = np.rint(corners.min(axis=0)), np.rint(corners.max(axis=0))
        pixels[int(top) : int(bottom), int(left) : int(right)] = (255, 0, 0)
        pictures.append(pixels)
    colours = textured(mesh, views, pictures, level=False)[: len(wall.faces)]
    chosen = labelled(mesh, views)[0][: len(wall.faces)]
    centres = wall.corners().mean(axis=1)
    behind = np.abs(centres[:, :2]).max(axis=1) < 0.35
    assert set(chosen[behind]) <= {1, UNSEEN}
    assert (chosen[behind] == 1).mean() > 0.25  # the rest is behind the screen from there too
    seen = chosen != UNSEEN
    assert np.abs(colours - ramp(centres[:, 0], centres[:, 1])).max(axis=1)[seen].max() < 4
    assert np.abs(colours[~seen] - 77).max(initial=0) <= 1  # its vertex colours


def test_faces_that_look_away_or_lie_outside_are_not_seen() -> None:
    mesh = grid()
    assert (quality_in(mesh, camera()) > 0).all()
    turned = Mesh(mesh.vertices, mesh.faces[:, ::-1].copy(), mesh.colours)
    assert not quality_in(turned, camera()).any()
    assert not quality_in(mesh, camera(x=9)).any()
    assert not quality_in(mesh, camera(z=4)).any()
    part = quality_in(mesh, camera(x=1.5)) > 0
    assert 0 < part.sum() < len(part)


def test_what_a_mask_hides_gives_no_colour() -> None:
    mesh = grid()
    left = np.full(SIZE[::-1], 255, np.uint8)
    left[:, : SIZE[0] // 2] = 0
    seen = quality_in(mesh, camera(), lambda: left) > 0
    pixels, _ = camera().project(mesh.corners().mean(axis=1))
    assert not seen[pixels[:, 0] < SIZE[0] / 2].any()
    assert seen[pixels[:, 0] > SIZE[0] / 2 + 15].all()


def test_the_nearer_photograph_is_taken_and_patches_are_whole() -> None:
    mesh = grid(20)
    chosen, _ = labelled(mesh, [camera(), camera(z=-3.2), camera(x=0.1, z=-4.1)])
    assert (chosen == 1).all()
    noisy = Candidates.none(len(mesh.faces))
    draw = np.random.default_rng(0)
    for number in range(3):
        noisy.add(
            number,
            (1 + 0.1 * draw.random(len(mesh.faces))).astype(np.float32),
            mesh.colours[mesh.faces[:, 0]],
        )
    pairs = neighbours(mesh.faces)
    labels, _ = choose(noisy, mesh, pairs, [camera()] * 3)
    assert len(set(labels)) == 1  # a tenth of quality is not worth a seam


@pytest.mark.parametrize("level", [False, True])
def test_photographs_of_different_exposure_meet_without_a_seam(level: bool) -> None:
    """The left half is seen by a dark photograph only, the right half by a bright one."""
    mesh = grid(20)
    views = [camera(x=-1.05), camera(x=1.05)]
    pictures = [picture(views[0], lambda x, y: 0.8 * ramp(x, y)), picture(views[1], ramp)]
    colours = textured(mesh, views, pictures, level=level)
    chosen, pairs = labelled(mesh, views)
    assert set(chosen) == {0, 1}
    across = chosen[pairs[:, 0]] != chosen[pairs[:, 1]]
    jump = np.abs(colours[pairs[:, 0]] - colours[pairs[:, 1]]).mean(axis=1)
    if level:
        assert jump[across].mean() < 1.5 * jump[~across].mean() + 1
        assert np.abs(colours.mean(axis=0) - 0.9 * 120).max() < 12
    else:
        assert jump[across].mean() > 15


def test_levelled_colours_do_not_drift_from_what_photographs_agree_on() -> None:
    """Two photographs that differ by 30 levels: where all others agree on the brighter one, it is not halved."""
    mesh, views = grid(20), [camera(x=-1.05), camera(x=1.05)]
    patches = patched(mesh, views)
    colours = np.where(patches.label[:, None] == 0, 100.0, 130.0) * np.ones(3)
    seen = np.ones(len(colours), bool)
    for agreed, expected in ((np.nan, 115), (130.0, 130)):
        offsets = seam_offsets(patches, colours, seen, np.full_like(colours, agreed))
        assert np.abs(colours + offsets - expected).mean() < 3


def test_details_that_differ_meet_at_a_seam() -> None:
    """Two photographs show stripes, one of them shifted by half a period: offsets of corners cannot level that."""
    mesh, views = grid(20), [camera(x=-1.05), camera(x=1.05)]

    def stripes(shift: float) -> Any:
        return lambda _, y: np.stack([120 + 60 * np.sin(40 * y + shift)] * 3, axis=1)

    pictures = [picture(views[0], stripes(0)), picture(views[1], stripes(np.pi))]
    patches = patched(mesh, views)
    atlas = pack(patches, 1024)
    points = seam_points(patches, atlas)
    assert (atlas.source[atlas.faces] == patches.faces).all()
    assert set(points.patch.ravel()) == {0, 1}
    colours, seen = corner_colours(patches, pictures, mesh.colours)
    offsets = seam_offsets(patches, colours, seen, np.full_like(colours, np.nan))
    none = SeamPoints(points.texel[:0], points.patch[:0], points.coloured[:0])
    steps = []
    for at in (none, points):
        texture = bake(atlas, patches, paint(atlas, patches, pictures, colours), offsets, at)
        one, other = (sample(texture, points.texel[:, side]) for side in (0, 1))
        steps.append(float(np.median(np.abs(one - other))))
    assert steps[0] > 20
    assert steps[1] < 1.5
    painted = paint(atlas, patches, pictures, colours)
    difference = bake(atlas, patches, painted, offsets, points).astype(float)
    difference -= bake(atlas, patches, painted, offsets, none)
    changed = np.abs(difference).max(axis=2) > 1
    assert 0.02 < changed.mean() < 0.3  # a band along the seam, and nothing else


def test_a_patch_goes_to_its_neighbour_where_its_faces_one_by_one_do_not() -> None:
    """A square of 32 faces is better in view 1, by more than a face loses by neighbours of the other view."""
    mesh = grid(20)
    pairs = neighbours(mesh.faces)
    square = np.abs(mesh.corners().mean(axis=1)[:, :2]).max(axis=1) < 0.2
    assert square.sum() == 32
    label = np.tile(np.array([0, 1], np.int32), (len(mesh.faces), 1))

    def labels(gain: float) -> Any:
        cost = np.where(square[:, None], (gain, 0), (0, 5)).astype(np.float32)
        choices = Choices(label, cost, 2, np.zeros(len(label), bool), 2)
        one_by_one = _change_faces(choices, square.astype(np.int32), _beside(len(label), pairs), 0.4)
        return one_by_one, label_faces(choices, pairs)

    stays, goes = labels(0.42)
    assert (stays == square).all()
    assert not goes.any()  # 32 faces lose 13.4, 16 edges of 1 are worth 16
    assert (labels(1.0)[1] == square).all()


def test_a_small_patch_stays_where_no_neighbour_sees_it() -> None:
    mesh = grid(20)
    pairs = neighbours(mesh.faces)
    only = np.zeros(len(mesh.faces), bool)
    only[100] = True
    for seen, expected in ((only, {0, 1}), (np.zeros_like(only), {0})):
        candidates = Candidates.none(len(mesh.faces))
        candidates.add(0, np.where(seen, 0, 1).astype(np.float32), mesh.colours[mesh.faces[:, 0]])
        candidates.add(1, np.where(only, 5, 0).astype(np.float32), mesh.colours[mesh.faces[:, 0]])
        assert set(choose(candidates, mesh, pairs, [camera()] * 2)[0].tolist()) == expected


def test_a_face_that_is_seen_only_beside_an_edge_lies_in_the_patch_around_it() -> None:
    """It has no colours of the photograph, but makes no patch of its own."""
    mesh, view = grid(20), camera()
    quality = quality_in(mesh, view)
    quality[100] *= -1
    candidates = Candidates.none(len(mesh.faces))
    candidates.add(0, quality, mesh.colours[mesh.faces[:, 0]])
    pairs = neighbours(mesh.faces)
    labels, coloured = choose(candidates, mesh, pairs, [camera()])
    assert (labels == 0).all()
    assert np.flatnonzero(~coloured).tolist() == [100]
    patches = cut(mesh, labels, coloured, [view], pairs)
    assert patches.patch.max() == 0
    red = np.full((*SIZE[::-1], 3), (255, 0, 0), np.uint8)
    _, seen = corner_colours(patches, [red], mesh.colours)
    assert seen.all()  # by the faces around it


def with_flap(apex: list[float]) -> Mesh:
    """The square, with one more face at its border that looks away from the camera."""
    mesh = grid(20)
    vertices = np.concatenate((mesh.vertices, np.array([apex], np.float32)))
    faces = np.concatenate((mesh.faces, np.array([[9, 10, len(vertices) - 1]], np.int32)))
    return Mesh(vertices, faces, np.full(vertices.shape, 77, np.uint8))


def test_a_face_that_no_photograph_shows_lies_folded_in_the_patch_beside_it() -> None:
    """It makes no patch of its own, and takes no texel from the faces over which it lies."""
    mesh, view = with_flap([-0.05, -0.5, 0.01]), camera()
    patches = patched(mesh, [view])
    assert patches.patch.max() == 0
    assert np.flatnonzero(~patches.coloured).tolist() == [len(mesh.faces) - 1]
    colours = textured(mesh, [view], [picture(view, ramp)])[:-1]
    centres = mesh.corners().mean(axis=1)[:-1]
    assert np.abs(colours - ramp(centres[:, 0], centres[:, 1])).max() < 3


def test_a_face_behind_a_camera_is_not_laid_on_its_picture() -> None:
    mesh, view = with_flap([-0.05, -1.5, -9.0]), camera()
    patches = patched(mesh, [view])
    assert patches.patch.max() == 1
    assert np.isfinite(patches.pixel).all()
    assert max(pack(patches, 1024).size) < 300


def test_a_large_part_that_no_photograph_shows_is_laid_flat() -> None:
    """The back of the square, which hangs together with it along one side."""
    front, back = grid(20), grid(20, z=0.1)
    mesh = joined(front, Mesh(back.vertices, back.faces[:, ::-1], back.colours))
    along = np.arange(20)
    start = len(front.vertices)
    joint = np.stack((along + 1, along, start + along), axis=1)
    faces = np.concatenate(
        (mesh.faces, joint, np.stack((along + 1, start + along, start + along + 1), axis=1))
    )
    patches = patched(Mesh(mesh.vertices, faces.astype(np.int32), mesh.colours), [camera()])
    assert set(patches.label[patches.faces[800:1600]].ravel().tolist()) == {1 + 5}


def test_every_face_has_a_texel_and_charts_do_not_touch() -> None:
    mesh, views = grid(20), [camera(x=-1.05), camera(x=1.05)]
    patches = patched(mesh, views)
    atlas = pack(patches, 256)
    assert max(atlas.size) <= 256
    texels = texels_of(atlas, patches.coloured)
    assert len(np.unique(texels.pixel)) == len(texels.pixel)
    assert set(texels.face) == set(range(len(mesh.faces)))
    owner = np.full(atlas.size[::-1], -1)
    owner.ravel()[texels.pixel] = patches.patch[texels.face]
    for shifted in (owner[1:], owner[:, 1:]):
        beside = owner[: shifted.shape[0], : shifted.shape[1]]
        assert not ((shifted != beside) & (shifted >= 0) & (beside >= 0)).any()
    chosen, _ = labelled(mesh, views)
    seen = chosen != UNSEEN
    assert (patches.label[patches.faces[seen]] == chosen[seen, None]).all()


def test_a_small_texture_is_of_smaller_scale() -> None:
    mesh, view = grid(), camera(focal=380.0)
    patches = patched(mesh, [view])
    full, small = pack(patches, 1024), pack(patches, 64)
    assert full.scale == 1.0
    assert max(small.size) <= 64
    assert 0.2 < small.scale < 0.5


def test_normals_have_length_one_on_a_mesh_with_degenerate_faces() -> None:
    flat = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    needle = [[5, 0, 0], [6, 0, 0], [7, 0, 0]]  # without area
    spike = [[2, 0, 0]]  # on a face without area, beside the flat one
    both = [[0, 0, 9], [1, 0, 9], [0, 1, 9]]  # seen from both sides: cancels out
    alone = [[8, 8, 8]]  # of no face
    vertices = np.array([*flat, *needle, *spike, *both, *alone], np.float32)
    faces = np.array([[0, 1, 2], [3, 4, 5], [0, 1, 6], [7, 8, 9], [7, 9, 8]], np.int32)
    normals = vertex_normals(Mesh(vertices, faces, np.zeros(vertices.shape, np.uint8)))
    assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    assert np.allclose(
        normals[[0, 1, 2, 6]], (0, 0, 1)
    )  # of the flat face, and for the spike of its neighbours
    tilted = Mesh(vertices[:, [2, 0, 1]], faces, np.zeros(vertices.shape, np.uint8))
    assert np.allclose(vertex_normals(tilted)[[0, 1, 2, 6]], (1, 0, 0))
    tiny = Mesh(vertices * np.float32(1e-18), faces, np.zeros(vertices.shape, np.uint8))
    assert np.allclose(vertex_normals(tiny)[[0, 1, 2]], (0, 0, 1))


def test_what_belongs_together() -> None:
    assert components(6, np.array([[0, 1], [4, 1], [2, 3]])).tolist() == [0, 0, 1, 1, 0, 2]
    assert components(3, np.zeros((0, 2), int)).tolist() == [0, 1, 2]
    mesh = joined(grid(4), grid(2, -0.1, 0.1, z=-1.0))
    assert len(neighbours(grid(1).faces)) == 1
    kept = without_small_parts(mesh, 0.05)
    assert len(kept.faces) == len(grid(4).faces)
    assert len(without_small_parts(mesh, 0.0, least_area=100.0).faces) == len(grid(4).faces)
    assert (face_normals(kept.corners())[:, 2] < 0).all()


@pytest.mark.parametrize(
    ("faces", "colours", "words"),
    [
        (np.zeros((1, 4), np.int32), np.zeros((3, 3), np.uint8), r"faces\.shape"),
        (np.array([[0, 1, 3]], np.int32), np.zeros((3, 3), np.uint8), "does not exist: 3 of 3"),
        (np.zeros((0, 3), np.int32), np.zeros((2, 3), np.uint8), "2 colours of 3"),
    ],
)
def test_a_broken_mesh_is_refused(faces: Any, colours: UInt8, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Mesh(np.zeros((3, 3), np.float32), faces, colours)
