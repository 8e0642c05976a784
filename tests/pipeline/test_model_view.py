"""A sparse model as a page shows it."""

from __future__ import annotations

from pathlib import Path

from doubled import doubled_model

from colmap_ihe.pipeline.model_view import ModelView


def test_points_are_counted_by_photographs_and_never_by_more_than_there_are(tmp_path: Path) -> None:
    doubled_model([1, 2, 3, 4], [1, 1, 2, 2, 3, 4], [1, 1, 2]).write(tmp_path)
    view = ModelView(tmp_path)
    assert view.points_by_images() == {2: 1, 4: 2}
    assert [view.seen(name).points for name in view.names] == [3, 3, 2, 2]
