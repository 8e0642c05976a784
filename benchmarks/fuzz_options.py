"""Parsers of what somebody writes by hand or hands over: options, weights, histograms, truth, lists."""

from __future__ import annotations

import json
import random
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from fuzz_mutations import BYTES, JSON, TEXT, WORDS, YAML, Target
from PIL import Image

import colmap_ihe  # noqa: F401  before pycolmap
from colmap_ihe.evaluation.pair_list import read_pairs
from colmap_ihe.evaluation.truth import read_truth
from colmap_ihe.fit.counting import SetCounts
from colmap_ihe.fit.histogram_file import StoredCounts, digest_of, read_stored
from colmap_ihe.fit.weights_file import read_weights
from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.photographs.raw.calibration import read_bad_pixels
from colmap_ihe.pipeline.repeat import differences_from, read_run
from colmap_ihe.pipeline.stages import STAGES
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.project.options_file import load_options


def _yaml_samples() -> list[bytes]:
    more: dict[str, Any] = {
        "cameras": {"a/*.JPG": {"make": "DJI", "focal_length": 8.8, "sensor_width": 13.2}, "*": {"focal_length": 24}},
        "fit": {"weights": "weights.yaml", "step": 0.1},
        "features": {"colmap": {"sift": {"max_num_features": 4096}}},
        "matches": {"strategy": "sequential", "pairing": {"overlap": 5}, "colmap": {"max_num_matches": 1000}},
        "sparse": {"colmap": {"min_num_matches": 10, "mapper": {"init_min_tri_angle": 8.0}}},
        "camera": {"model": "OPENCV", "params": [900, 900, 320, 240, 0, 0, 0, 0]},
        "cluster": "local:2",
    }  # fmt: skip
    whole = yaml.safe_dump(Options().as_yaml(), sort_keys=False).encode()
    anchored = b"features: &f {max_image_size: 800}\ndense: {<<: *f, enabled: false}\n"
    return [
        yaml.safe_dump(more, sort_keys=False).encode(),
        whole,
        anchored,
        b"fit:\n  step: 0.1\n  guard: none\n",
    ]


def _options(data: bytes, folder: Path) -> object:
    (folder / "project.yaml").write_bytes(data)
    options = load_options(folder / "project.yaml", ["dense.max_image_size=800"])
    json.dumps(options.as_yaml()).encode()
    yaml.safe_dump(options.as_yaml()).encode()
    for stage in STAGES:
        stage.check(options, 5)
    return options


def _set_samples() -> list[bytes]:
    words = [f"fit.method={word}".encode("utf-8", "surrogatepass") for word in WORDS[:9]]
    return [b"fit.step=0.1", b"cameras.*.JPG={focal_length: 24}", *words]


def _assigned(data: bytes, _folder: Path) -> object:
    return load_options(None, [data.decode("utf-8", "surrogateescape")])


def _weights_samples() -> list[bytes]:
    curve = {"encoding": "linear", "white": 0.5, "curve": list(range(0, 255 * 256, 256))}
    formula = {"method": "decolorize", "weights": None, "parameters": [0.3, 0.4, 0.3], "encoding": "coded"}
    return [
        b"weights: [0.2, 0.3, 0.5]\n",
        yaml.safe_dump(
            {"method": "ihe", "weights": [0.2, 0.3, 0.5], "score": 0.1, "tones": 200, **curve}
        ).encode(),
        yaml.safe_dump(formula).encode(),
    ]


def _weights(data: bytes, folder: Path) -> object:
    (folder / "w.yaml").write_bytes(data)
    return read_weights(folder / "w.yaml")


def _counted(encoding: Any) -> StoredCounts:
    histogram = Histogram(encoding, "pixel")
    values = np.random.default_rng(1).integers(0, 200, (9, 9, 3))
    histogram.add(values.astype(np.uint8) if encoding == "coded" else values.astype(np.uint16))
    return StoredCounts({encoding: SetCounts(histogram, ["a" * 24], [])}, 1.0, {"denoise": 0.0})


def _stored_samples() -> list[bytes]:
    return [_counted(encoding).to_bytes() for encoding in ("coded", "linear")]


def _sealed(data: bytes, rng: random.Random) -> bytes:
    """With the digest of what follows, mostly, so that more is looked at than that."""
    lines = data.split(b"\n", 2)
    return (
        b"\n".join([lines[0], digest_of(lines[2]), lines[2]])
        if len(lines) == 3 and rng.random() < 0.9
        else data
    )


def _stored(data: bytes, folder: Path) -> object:
    (folder / "a.histogram").write_bytes(data)
    return read_stored(folder / "a.histogram")


def _truth_samples() -> list[bytes]:
    camera = {
        "width": 32, "height": 24, "calibration": [[30.0, 0, 16], [0, 30.0, 12], [0, 0, 1]],
        "cam_from_world": [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 2]], "depth": "a.depth.png", "nearest_m": 1.5,
    }  # fmt: skip
    return [json.dumps({"cameras": {"a": camera, "b": camera}, "extent_m": 12.5}).encode()]


def _depth_png() -> bytes:
    buffer = BytesIO()
    Image.fromarray(np.arange(24 * 32, dtype=np.uint16).reshape(24, 32)).save(buffer, "PNG")
    return buffer.getvalue()


def _truth(data: bytes, folder: Path) -> object:
    (folder / "a.depth.png").write_bytes(_depth_png())
    (folder / "cameras.json").write_bytes(data)
    return [image.depth_m() for image in read_truth(folder).images.values()]


def _depth(data: bytes, folder: Path) -> object:
    (folder / "cameras.json").write_bytes(_truth_samples()[0])
    (folder / "a.depth.png").write_bytes(data)
    return read_truth(folder).images["a"].depth_m()


_STRECHA = b"900 0 400\n0 910 300\n0 0 1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 4 1\n800 600\n"


def _strecha(data: bytes, folder: Path) -> object:
    (folder / "0000.jpg.camera").write_bytes(data)
    return read_truth(folder)


def _pairs(data: bytes, folder: Path) -> object:
    (folder / "pairs.txt").write_bytes(data)
    return read_pairs(folder / "pairs.txt", ["a b.jpg", "c.jpg", "d/é.jpg"])


def _bad_pixels(data: bytes, folder: Path) -> object:
    (folder / "bad-pixels.txt").write_bytes(data)
    return read_bad_pixels(folder / "bad-pixels.txt")


def _run_samples() -> list[bytes]:
    found = {"options": Options().as_yaml(), "versions": {"pycolmap": "4"}, "photographs": {"a.jpg": "00"}}
    return [json.dumps(found).encode()]


def _run(data: bytes, folder: Path) -> object:
    (folder / "records").mkdir()
    (folder / "records/run.json").write_bytes(data)
    (folder / "images").mkdir()
    noted = read_run(folder, ["fit.step=0.1"])
    return differences_from(noted, Project.at(folder, None), noted.options, {"a.jpg": [1, 1, "00"]})


TARGETS = (
    Target("project.yaml", _yaml_samples, YAML, _options),
    Target("--set", _set_samples, YAML, _assigned),
    Target("weights.yaml", _weights_samples, YAML, _weights),
    Target(".histogram", _stored_samples, (*BYTES, *JSON[-2:]), _stored, finish=_sealed, share=0.3),
    Target("truth: cameras.json", _truth_samples, JSON, _truth),
    Target("truth: .camera", lambda: [_STRECHA], TEXT, _strecha),
    Target("truth: depth", lambda: [_depth_png()], BYTES, _depth),
    Target("--pairs", lambda: [b"# two\na b.jpg c.jpg\nc.jpg d/\xc3\xa9.jpg\n"], TEXT, _pairs),
    Target("bad-pixels.txt", lambda: [b"1204 377\n5 6 0 # hot\n\n"], TEXT, _bad_pixels),
    Target("run.json (--from-record)", _run_samples, JSON, _run),
)
