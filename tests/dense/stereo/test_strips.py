import cv2
import numpy as np
import pytest

from colmap_ihe.dense.stereo.strips import overwrite, strips


@pytest.mark.parametrize(
    ("shape", "beside"), [((700, 900), 3), ((40, 30), 3), ((1, 200_000), 20), ((3, 0), 0)]
)
def test_strips_give_what_the_whole_image_gives(shape: tuple[int, int], beside: int) -> None:
    image = np.random.default_rng(0).integers(0, 256, shape).astype(np.float32)
    window = (2 * beside + 1,) * 2
    result = np.full(shape, np.nan, np.float32)
    for strip in strips(shape, beside):
        if image.size:
            result[strip.own] = cv2.blur(image[strip.seen], window)[strip.inner]
    assert not image.size or np.array_equal(result, cv2.blur(image, window))


def test_strips_of_a_photograph_are_many() -> None:
    assert len(list(strips((3000, 4000), 3))) > 10


@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
def test_overwrite_is_copyto_also_of_a_part_of_an_array(dtype: type[np.generic]) -> None:
    chance = np.random.default_rng(0)
    target, values = (chance.integers(1, 200, (50, 67)).astype(dtype) for _ in range(2))
    where = chance.random((47, 60)) < 0.5
    expected = target.copy()
    np.copyto(expected[3:, 2:62], values[:47, 5:65], where=where)
    overwrite(target[3:, 2:62], values[:47, 5:65], where)
    assert np.array_equal(target, expected)
