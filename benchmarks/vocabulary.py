"""Measure the clustering of a vocabulary tree: its time, and whether more of it finds more of the pairs that match.

    python benchmarks/vocabulary.py PROJECT [--neighbours 30]

PROJECT has features and verified matches, by a strategy that does not ask a vocabulary: exhaustive, or spatial. For
each setting of the clustering a tree is built of its features, and asked for the neighbours of each photograph: core
seconds, the pairs that it names, and how many of the verified ones (15 inliers or more) are among them.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from colmap_ihe.colmap import matching
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.project.folder import Project

SETTINGS = [(100_000, (4, 1)), (100_000, (10, 1)), (100_000, (100, 3)), (200_000, (5, 1)), (400_000, (5, 1))]
"""Features at the most, and rounds of clustering: within one start, and starts."""
LEAST_INLIERS = 15


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("project", type=Path)
    parser.add_argument("--neighbours", type=int, default=30)
    parsed = parser.parse_args()
    database = Project.at(parsed.project).database
    with pycolmap.Database.open(database) as opened:
        ids, inliers = opened.read_two_view_geometry_num_inliers()
        print(f"{opened.num_images()} photographs, {opened.num_keypoints():,} features")
    wanted = {
        pycolmap.pair_id_to_image_pair(i) for i, n in zip(ids, inliers, strict=True) if n >= LEAST_INLIERS
    }
    rows = []
    for most, rounds in SETTINGS:
        matching._VOCABULARY_FEATURES, matching._ROUNDS = most, rounds
        with tempfile.TemporaryDirectory() as folder:
            tree, before = Path(folder) / "tree.bin", time.process_time()
            matching.build_vocabulary(database, tree, SILENT)
            built, options = time.process_time(), pycolmap.VocabTreePairingOptions()
            options.mergedict({"num_images": parsed.neighbours, "vocab_tree_path": tree, "num_threads": 1})
            pairs = matching._pairs(database, "vocabtree", options)
            asked = time.process_time()
        rows.append(
            (
                *(f"{most:,}", f"{rounds[0]} x {rounds[1]}"),
                *(f"{built - before:.1f}", f"{asked - built:.1f}", f"{len(pairs):,}"),
                f"{len(wanted.intersection(pairs)):,} of {len(wanted):,}",
            )
        )
        print_table("", rows[-1:])
    columns = ("features up to", "rounds", "built, core s", "asked, core s", "pairs", "verified among them")
    print_table("", rows, columns)


if __name__ == "__main__":
    main()
