"""What somebody writes by hand or hands over, spoilt: options, weights, histograms, truth, lists."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import yaml
from calibrations import calibrated
from PIL import Image
from spoilt import BYTES, JSON, TEXT, YAML, file, parser

from colmap_ihe.colmap.calibration_file import read_calibration, write_calibration
from colmap_ihe.evaluation.figures import read_pairs
from colmap_ihe.evaluation.truth import read_truth
from colmap_ihe.fit.counting import SetCounts
from colmap_ihe.fit.histogram_file import StoredCounts, digest_of, read_stored
from colmap_ihe.fit.weights_file import read_weights
from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.grey.weights import Encoding
from colmap_ihe.photographs.raw.calibration import read_bad_pixels
from colmap_ihe.pipeline.repeat import differences_from, read_run
from colmap_ihe.pipeline.stages import STAGES
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.project.options_file import load_options


def yaml_of(values: object) -> bytes:
    return yaml.safe_dump(values, sort_keys=False).encode()


def project_yaml(_: Path) -> list[bytes]:
    more: dict[str, Any] = {
        "cameras": {"a/*.JPG": {"make": "DJI", "focal_length": 8.8, "sensor_width": 13.2}, "*": {"focal_length": 24}},
        "fit": {"weights": "weights.yaml", "step": 0.1},
        "features": {"colmap": {"sift": {"max_num_features": 4096}}},
        "matches": {"strategy": "sequential", "pairing": {"overlap": 5}, "colmap": {"max_num_matches": 1000}},
        "sparse": {"colmap": {"min_num_matches": 10, "mapper": {"init_min_tri_angle": 8.0}}},
        "camera": {"model": "OPENCV", "params": [900, 900, 320, 240, 0, 0, 0, 0], "fixed": True},
        "cluster": "local:2",
    }  # fmt: skip
    anchored = b"features: &f {max_image_size: 800}\ndense: {<<: *f, enabled: false}\n"
    return [yaml_of(more), yaml_of(Options().as_yaml()), anchored, b"fit:\n  step: 0.1\n  guard: none\n"]


@parser(project_yaml, YAML)
def test_project_yaml(data: bytes, folder: Path) -> object:
    (folder / "project.yaml").write_bytes(data)
    options = load_options(folder / "project.yaml", ["dense.max_image_size=800"])
    json.dumps(options.as_yaml()).encode()
    yaml_of(options.as_yaml())
    for stage in STAGES:
        stage.check(options, 5)
    return options


@parser(lambda _: [b"fit.step=0.1", b"cameras.*.JPG={focal_length: 24}", b"fit.method=nan"], YAML)
def test_set(data: bytes, _: Path) -> object:
    return load_options(None, [data.decode("utf-8", "surrogateescape")])


def weights(_: Path) -> list[bytes]:
    curve = {"encoding": "linear", "white": 0.5, "curve": list(range(0, 255 * 256, 256))}
    formula = {"method": "decolorize", "weights": None, "parameters": [0.3, 0.4, 0.3], "encoding": "coded"}
    fitted = {"method": "ihe", "weights": [0.2, 0.3, 0.5], "score": 0.1, "tones": 200, **curve}
    return [b"weights: [0.2, 0.3, 0.5]\n", yaml_of(fitted), yaml_of(formula)]


test_weights = parser(weights, YAML)(file("w.yaml", read_weights))


def calibrations(folder: Path) -> list[bytes]:
    write_calibration(folder / "written.yaml", [calibrated(), calibrated("", "", 0, (640, 480))])
    return [(folder / "written.yaml").read_bytes()]


test_calibration = parser(calibrations, YAML)(file("c.yaml", read_calibration))


def histograms(_: Path) -> list[bytes]:
    samples = []
    values = np.random.default_rng(1).integers(0, 200, (9, 9, 3))
    for pixels in (values.astype(np.uint8), values.astype(np.uint16)):
        encoding: Encoding = "coded" if pixels.dtype == np.uint8 else "linear"
        histogram = Histogram(encoding, "pixel")
        histogram.add(pixels)
        counts = {encoding: SetCounts(histogram, ["a" * 24], [])}
        samples.append(StoredCounts(counts, 1.0, {"denoise": 0.0}).to_bytes())
    return samples


def sealed(data: bytes, rng: Random) -> bytes:
    """With the digest of what follows, mostly, so that more is looked at than that."""
    lines = data.split(b"\n", 2)
    if len(lines) == 3 and rng.random() < 0.9:
        lines[1] = digest_of(lines[2])
    return b"\n".join(lines)


_histogram = parser(histograms, (*BYTES, *JSON[-2:]), seal=sealed, share=0.3)
test_histogram = _histogram(file("a.histogram", read_stored))


def cameras_json(_: Path) -> list[bytes]:
    camera = {
        "width": 32, "height": 24, "calibration": [[30.0, 0, 16], [0, 30.0, 12], [0, 0, 1]],
        "cam_from_world": [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 2]], "depth": "a.depth.png", "nearest_m": 1.5,
    }  # fmt: skip
    return [json.dumps({"cameras": {"a": camera, "b": camera}, "extent_m": 12.5}).encode()]


def depth_png(_: Path) -> list[bytes]:
    buffer = BytesIO()
    Image.fromarray(np.arange(24 * 32, dtype=np.uint16).reshape(24, 32)).save(buffer, "PNG")
    return [buffer.getvalue()]


@parser(cameras_json, JSON)
def test_true_cameras(data: bytes, folder: Path) -> object:
    (folder / "a.depth.png").write_bytes(*depth_png(folder))
    (folder / "cameras.json").write_bytes(data)
    return [image.depth_m() for image in read_truth(folder).images.values()]


@parser(depth_png, BYTES)
def test_true_depth(data: bytes, folder: Path) -> object:
    (folder / "cameras.json").write_bytes(*cameras_json(folder))
    (folder / "a.depth.png").write_bytes(data)
    return read_truth(folder).images["a"].depth_m()


NAMES = ["a b.jpg", "c.jpg", "d/é.jpg"]
test_strechas_cameras = parser(
    lambda _: [b"900 0 400\n0 910 300\n0 0 1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 4 1\n800 600\n"], TEXT
)(file("0000.jpg.camera", lambda camera: read_truth(camera.parent)))
test_pairs = parser(lambda _: [b"# two\na b.jpg c.jpg\nc.jpg d/\xc3\xa9.jpg\n"], TEXT)(
    file("pairs.txt", lambda pairs: read_pairs(pairs, NAMES))
)
test_bad_pixels = parser(lambda _: [b"1204 377\n5 6 0 # hot\n\n"], TEXT)(
    file("bad-pixels.txt", read_bad_pixels)
)


def run_json(_: Path) -> list[bytes]:
    noted = {"options": Options().as_yaml(), "versions": {"pycolmap": "4"}, "photographs": {"a.jpg": "00"}}
    return [json.dumps(noted).encode()]


@parser(run_json, JSON)
def test_run_json(data: bytes, folder: Path) -> object:
    for name in ("images", "records"):
        (folder / name).mkdir()
    (folder / "records/run.json").write_bytes(data)
    noted = read_run(folder, ["fit.step=0.1"])
    return differences_from(noted, Project.at(folder, None), noted.options, {"a.jpg": [1, 1, "00"]})
