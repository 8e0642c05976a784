"""What somebody else may have written: every parser returns or says why not, and nothing leads out of a project."""

from __future__ import annotations

import ast
import json
import os
import random
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from fuzz import outcome_of
from fuzz_mutations import Target
from fuzz_pictures import Answering
from fuzz_records import records
from fuzz_targets import TARGETS
from PIL import Image

import colmap_ihe
from colmap_ihe import convert_folder
from colmap_ihe.batch_folder import BatchFolder
from colmap_ihe.batched import BatchState, batched, publish
from colmap_ihe.captures.decode import read_photograph, read_size, refuse_too_large
from colmap_ihe.captures.discover import Capture, discover
from colmap_ihe.captures.metadata import read_metadata
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.colmap.ply import read_mesh, write_mesh
from colmap_ihe.errors import OptionError, PhotographError, ProjectError
from colmap_ihe.evaluate.chosen import read_pairs
from colmap_ihe.evaluate.truth import read_truth
from colmap_ihe.files import open_file, read_json, write_json
from colmap_ihe.ledger import RECORD, Ledger
from colmap_ihe.option_paths import named_paths
from colmap_ihe.options import FitOptions
from colmap_ihe.preprocess import write_masks
from colmap_ihe.project import Project
from colmap_ihe.project_yaml import load_options
from colmap_ihe.record_shapes import is_whole
from colmap_ihe.texture.mesh import Mesh
from colmap_ihe.yaml_text import parse_yaml

PACKAGE = Path(colmap_ihe.__file__).parent
EXECUTIONS = 25  # of each parser: benchmarks/fuzz.py is for more


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: str(target.name))
def test_a_parser_returns_or_refuses(target: Target, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    samples = list(target.samples())
    sound = {outcome_of(target, target.finish(s, random.Random(0)), tmp_path / "work") for s in samples}
    assert "accepted" in sound and sound <= {"accepted", "refused"}
    for number in range(round(EXECUTIONS * target.share)):
        data = target.made(samples, random.Random(f"test/{target.name}/{number}"))
        assert outcome_of(target, data, tmp_path / "work") in ("accepted", "refused"), f"execution {number}"


# What was found once


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("a: " + "[" * 3000 + "]" * 3000, id="deep"),
        pytest.param("a: " + "9" * 5000, id="a number of thousands of digits"),
        pytest.param("a: 2016-13-45", id="a date that there is not"),
        pytest.param("a: !!int ''", id="a number without digits"),
        pytest.param("a: !!timestamp x", id="no time"),
        pytest.param("a: !!bool x", id="neither true nor false"),
        pytest.param("a: &a [*a]", id="an alias inside itself"),
        pytest.param(
            "a0: &a0 x\n" + "\n".join(f"a{n}: &a{n} [*a{n - 1}]" for n in range(1, 40)), id="a deep chain"
        ),
        pytest.param('a: "\\ud800"', id="half a character"),
        pytest.param('a: "\\0"', id="no text"),
        pytest.param("a: " + "x" * 20_000, id="long"),
    ],
)
def test_yaml_that_nobody_writes_is_refused_in_a_line(text: str) -> None:
    with pytest.raises(ValueError, match=r"^[^\n]+$"):
        parse_yaml(text)


@pytest.mark.parametrize("inside", ["[{names}]", "{{<<: [{names}], y{n}: 1}}"])
def test_aliases_that_unfold_without_end_are_refused_at_once(inside: str) -> None:
    rows = ["a0: &a0 {x: 1}"]
    for n in range(1, 40):
        names = ", ".join([f"*a{n - 1}"] * 9)
        rows.append(f"a{n}: &a{n} {inside.format(names=names, n=n)}")
    with pytest.raises(ValueError, match=r"unfold to more than (100000 values|24 levels)"):
        parse_yaml("\n".join(rows))


def test_aliases_and_merges_of_a_person_are_read() -> None:
    assert parse_yaml("a: &a {x: 1}\nb: {<<: *a, y: 2}\nc: *a") == {
        "a": {"x": 1},
        "b": {"x": 1, "y": 2},
        "c": {"x": 1},
    }


@pytest.mark.parametrize("params", ["[" + "9" * 400 + "]", "[[1], 2]", "[{}, 2]"])
def test_parameters_of_a_camera_are_numbers(tmp_path: Path, params: str) -> None:
    (tmp_path / "project.yaml").write_text(f"camera: {{model: OPENCV, params: {params}}}")
    with pytest.raises(OptionError, match=r"camera.params"):
        load_options(tmp_path / "project.yaml")


@pytest.mark.parametrize("depth", ["a\nb", "../up.png", "/etc/passwd", "link.png", ""])
def test_true_depth_lies_beside_its_cameras(tmp_path: Path, depth: str) -> None:
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth/link.png").symlink_to(tmp_path / "up.png")
    camera = {
        "width": 24,
        "height": 16,
        "calibration": np.eye(3).tolist(),
        "cam_from_world": np.eye(3, 4).tolist(),
    }
    found = {"cameras": {"a": camera | {"depth": depth, "nearest_m": 1}}, "extent_m": 1}
    (tmp_path / "truth/cameras.json").write_text(json.dumps(found))
    with pytest.raises(ProjectError, match="is not a file beside"):
        read_truth(tmp_path / "truth")


@pytest.mark.parametrize("content", ["[" * 100_000, '{"a": ' * 100_000, "1" * 5000])
def test_json_that_is_too_deep_or_too_long_is_none(tmp_path: Path, content: str) -> None:
    (tmp_path / "a.json").write_text(content)
    assert read_json(tmp_path / "a.json") is None


def test_a_dng_whose_directories_follow_each_other_for_ever_is_left(tmp_path: Path) -> None:
    target = next(t for t in TARGETS if t.name == "DNG black levels")
    data = target.made(list(target.samples()), random.Random("1/DNG black levels/103"))
    assert outcome_of(target, data, tmp_path / "work") == "accepted"


@pytest.mark.parametrize(
    ("stage", "change"),
    [
        ("convert", {"grey": {"a.jpg": "../../../up.png"}}),
        ("convert", {"grey": {"a.jpg": "/etc/passwd"}}),
        ("convert", {"grey": {}}),
        ("convert", {"grey": {"a.jpg": "x" * 300 + ".png"}}),
        ("convert", {"grey": {"a.jpg": "a\ud800.png"}}),
        ("captures", {"recipes": {"a.jpg": {"dark": "../up.npy"}}}),
        ("captures", {"recipes": {"a.jpg": {"kept_in": "/tmp"}}}),
        ("captures", {"recipes": {"a.jpg": {"unknown": 1}}}),
        ("mesh", {"files": ["../fused.ply"]}),
        ("fit", {"weights": {"coded": {"weights": [1, 1, 1]}}}),
        ("sparse", {"models": []}),
        ("dense", {"points": "many"}),
    ],
)
def test_a_record_that_no_stage_left_counts_for_none(
    tmp_path: Path, stage: str, change: dict[str, object]
) -> None:
    sound = records()[stage]
    assert is_whole(stage, sound)
    (tmp_path / "images").mkdir()
    place = Project.at(tmp_path)
    place.write_record(stage, sound)
    assert place.read_record(stage) == json.loads(json.dumps(sound))
    place.write_record(stage, sound | change)
    assert place.read_record(stage) is None


def test_words_where_a_run_leaves_numbers_do_not_stop_the_page_of_a_batch(tmp_path: Path) -> None:
    for name in ("images", "records", "report"):
        (tmp_path / "root/a" / name).mkdir(parents=True)
    words = {"mean_reprojection_error_px": "small", "points3D": [1], "stages": {"fit": "long"}, "left_out": 3}
    for file in ("report/summary.json", "records/batch.json"):
        (tmp_path / "root/a" / file).write_text(json.dumps(words | {"seconds": "many", "began": 5}))
    folder = BatchFolder.at(tmp_path / "root")
    folder.make()
    row = batched(folder, Project.at(tmp_path / "root/a"), "done")
    publish(folder, BatchState(str(folder.root), "finished", [row], "now"), {})
    assert row.figures["mean_reprojection_error_px"] is None and row.stages == {}


@pytest.mark.parametrize(
    "value", [5, None, [1], {"encoding": "coded", "matrix": None, "profile": 10**12}, {"exif": 3}]
)
def test_an_answer_that_makes_no_sense_is_its_photographs_fault(tmp_path: Path, value: object) -> None:
    """A decoder that a photograph took over says anything."""
    capture = Capture("a.jpg", tmp_path / "a.jpg", "coded", "a")
    with Answering({"value": value}):
        for ask in (read_size, read_photograph):
            with pytest.raises(PhotographError, match=r"a.jpg: the decoder lost its way on it"):
                ask(capture)
        assert "lost its way" in read_metadata(capture.path, "coded").problem


def test_a_face_without_its_corners_is_refused(tmp_path: Path) -> None:
    mesh = Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8))
    write_mesh(tmp_path / "a.ply", mesh)
    whole = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(whole[:-4] + (99).to_bytes(4, "little"))
    with pytest.raises(ProjectError, match="a face has a corner that is not there"):
        read_mesh(tmp_path / "a.ply")


def test_a_line_of_pairs_that_no_names_can_fill_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "pairs.txt").write_text("a" + " " * 5_000_000 + "b")
    with pytest.raises(OptionError, match="line 1"):
        read_pairs(tmp_path / "pairs.txt", ["a", "c"])


def test_half_a_character_goes_through_json_and_back(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"a\ud800": "\udfffé"})
    assert read_json(tmp_path / "a.json") == {"a\ud800": "\udfffé"}


# Paths in options


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("fit: {weights: /etc/passwd}", "fit.weights"),
        ("fit: {weights: ../other/weights.yaml}", "fit.weights"),
        ("fit: {weights: link/weights.yaml}", "fit.weights"),
        ("cluster: tcp://example.org:8786", "cluster.address"),
        ("cluster: {address: scheduler.json}", "cluster.address"),
        ("sparse: {colmap: {snapshot_path: snapshots}}", "sparse.colmap.snapshot_path"),
        ("matches: {strategy: vocabtree, pairing: {vocab_tree_path: /x}}", "matches.pairing.vocab_tree_path"),
        ("dense: {colmap: {mask_path: /x}}", "dense.colmap.mask_path"),
        (
            "sparse: {mapper: global, colmap: {mapper: {bundle_adjustment: {ceres: {solver_options:"
            " {trust_region_problem_dump_directory: /x}}}}}}",
            "trust_region_problem_dump_directory",
        ),
    ],
)
def test_a_file_of_options_names_nothing_outside_of_the_project(tmp_path: Path, text: str, key: str) -> None:
    (tmp_path / "project").mkdir()
    (tmp_path / "project/link").symlink_to(tmp_path)
    file = tmp_path / "project/project.yaml"
    file.write_text(text)
    with pytest.raises(OptionError, match=key) as caught:
        load_options(file)
    assert str(file) in str(caught.value) and "say it yourself" in caught.value.hint
    # On the command line the user may name what he likes.
    (_, value), *_ = named_paths(
        {k: v if isinstance(v, dict) else {"address": v} for k, v in yaml.safe_load(text).items()}
    )
    (full,) = [
        k
        for k, _ in named_paths(
            {k: v if isinstance(v, dict) else {"address": v} for k, v in yaml.safe_load(text).items()}
        )
    ]
    assert load_options(file, [f"{full}={json.dumps(value)}"])


def test_weights_within_the_project_and_workers_here_may_stand_in_a_file(tmp_path: Path) -> None:
    (tmp_path / "project.yaml").write_text("fit: {weights: more/weights.yaml}\ncluster: local:2\n")
    options = load_options(tmp_path / "project.yaml")
    assert (options.fit.weights, options.cluster.address) == ("more/weights.yaml", "local:2")


def _paths_of(options: object, place: str = "") -> Iterator[str]:
    for name in dir(options):
        value = None if name.startswith("_") else getattr(options, name)
        if isinstance(value, Path):
            yield f"{place}{name}"
        elif hasattr(value, "mergedict"):
            yield from _paths_of(value, f"{place}{name}.")


def test_every_path_among_colmaps_options_is_told_by_its_name() -> None:
    found = {
        path
        for name in dir(pycolmap)
        if name.endswith("Options")
        for path in _paths_of(getattr(pycolmap, name)())
    }
    assert len(found) > 4
    for path in found:
        assert [key for key, _ in named_paths({"sparse": {"colmap": {path.rpartition(".")[2]: "x"}}})]


# Links, pipes and folders


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    folder.mkdir()
    for name in ("a.jpg", "b.jpg"):
        Image.fromarray(np.random.default_rng(1).integers(0, 255, (80, 96, 3), np.uint8)).save(folder / name)
    return folder


def test_odd_things_called_like_photographs_are_left_out_and_named(photos: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (photos / "a.jpg").rename(tmp_path / "elsewhere/a.jpg")
    (photos / "a.jpg").symlink_to(tmp_path / "elsewhere/a.jpg")
    (photos / "gone.jpg").symlink_to(photos / "nowhere.jpg")
    (photos / "loop.jpg").symlink_to(photos / "loop.jpg")
    (photos / "device.jpg").symlink_to("/dev/zero")
    (photos / "same.jpg").symlink_to("b.jpg")
    os.mkfifo(photos / "pipe.jpg")
    (photos / "folder.jpg").mkdir()
    (photos / "north").symlink_to(tmp_path / "elsewhere")
    (photos / "round").symlink_to(photos)
    (tmp_path / "linked").symlink_to(photos)
    for folder in (photos, tmp_path / "linked"):  # the folder itself may be a link
        found = discover(folder)
        assert [c.name for c in found.captures] == ["b.jpg", "same.jpg"]
        assert found.ignored == ("north/",)
        assert set(found.refused) == {"a.jpg", "gone.jpg", "loop.jpg", "device.jpg", "pipe.jpg"}
        assert "leads out" in found.refused["a.jpg"] and "leads out" in found.refused["device.jpg"]
        assert "a pipe or a device" in found.refused["pipe.jpg"]
    _, grey, left_out = convert_folder(photos, tmp_path / "grey", fit=FitOptions(method="rec709"))
    assert set(grey) == {"b.jpg", "same.jpg"} and set(left_out) == set(found.refused)
    with pytest.raises(PhotographError, match="leads out of the folder of photographs"):
        convert_folder(photos, tmp_path / "strict", fit=FitOptions(method="rec709"), strict=True)


def test_a_pipe_or_a_folder_is_never_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for place in (tmp_path / "pipe", tmp_path, Path("/dev/zero")):
        with pytest.raises(OSError, match=r"pipe or a device|Is a directory"):
            open_file(place)
    assert read_json(tmp_path / "pipe") is None
    with pytest.raises(OptionError, match="a pipe or a device"):
        load_options(tmp_path / "pipe")


@pytest.mark.parametrize(
    "place",
    ["workspace", "colour", "report", "records", "compare", "workspace/images", "records/lock", "report/a/b"],
)
def test_nothing_is_written_through_links_out_of_the_project(
    tmp_path: Path, photos: Path, place: str
) -> None:
    root = tmp_path / "project"
    (tmp_path / "mine").mkdir()
    (root / place).parent.mkdir(parents=True)
    (root / place).symlink_to(tmp_path / "mine")
    with pytest.raises(ProjectError, match="leads out of the project") as caught:
        Project.at(root, photos)
    assert str(root / place) in str(caught.value)
    (root / place).unlink()
    (root / "inside").mkdir()
    (root / place).symlink_to(root / "inside")
    Project.at(root, photos)


def test_pipes_in_our_folders_are_refused(tmp_path: Path, photos: Path) -> None:
    (tmp_path / "project/records").mkdir(parents=True)
    os.mkfifo(tmp_path / "project/records/lock")
    with pytest.raises(ProjectError, match="neither file nor folder"):
        Project.at(tmp_path / "project", photos)


def test_a_project_behind_a_link_is_as_any(tmp_path: Path, photos: Path) -> None:
    (tmp_path / "real/report").mkdir(parents=True)
    (tmp_path / "linked").symlink_to(tmp_path / "real")
    (tmp_path / "real/images").symlink_to(photos)
    assert Project.at(tmp_path / "linked").images == tmp_path / "linked/images"


def test_the_page_of_a_batch_is_not_written_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "root").mkdir()
    (tmp_path / "mine").mkdir()
    (tmp_path / "root/batch").symlink_to(tmp_path / "mine")
    with pytest.raises(ProjectError, match="leads out"):
        BatchFolder.at(tmp_path / "root").make()
    assert not list((tmp_path / "mine").iterdir())


def test_a_record_of_grey_images_removes_nothing_behind_a_link(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/a.png").write_text("mine")
    (tmp_path / "grey").mkdir()
    (tmp_path / "grey/link").symlink_to(tmp_path / "mine")
    entry = {"photograph": "a.jpg", "fingerprint": "0", "digest": ""}
    (tmp_path / "grey" / RECORD).write_text(json.dumps({"files": {"link/a.png": entry}, "notes": {}}))
    ledger = Ledger(tmp_path / "grey")
    ledger.begin({}, {})
    assert (tmp_path / "mine/a.png").read_text() == "mine"
    with pytest.raises(ProjectError, match="leads out of the folder"):
        ledger.refuse({"link/b.png": "b.jpg"})


def masked(folder: Path, spoil: Callable[[Path], object]) -> set[str]:
    (folder / "grey").mkdir()
    (folder / "masks").mkdir()
    Image.new("L", (24, 16)).save(folder / "grey/a.png")
    spoil(folder / "masks/a.jpg.png")
    return write_masks(folder / "masks", {"a.jpg": "a.png"}, folder / "grey", folder / "made")


def test_a_mask_elsewhere_is_refused_and_a_pipe_is_none(tmp_path: Path) -> None:
    Image.new("L", (24, 16)).save(tmp_path / "else.png")
    with pytest.raises(ProjectError, match="leads out of the folder of masks"):
        masked(tmp_path, lambda place: place.symlink_to(tmp_path / "else.png"))
    (tmp_path / "other").mkdir()
    assert masked(tmp_path / "other", os.mkfifo) == set()


# What is never loaded, and never run


def test_nothing_in_the_package_runs_or_unpickles_what_it_reads() -> None:
    """Neither by name nor by option; `shell` and `allow_pickle` stand only where they are false."""
    names = {"eval", "exec", "compile", "__import__", "execfile"}
    modules = {
        "pickle",
        "cPickle",
        "marshal",
        "shelve",
        "dill",
        "cloudpickle",
        "joblib",
        "tarfile",
        "code",
        "pty",
    }
    members = {
        ("os", "system"), ("os", "popen"), ("os", "execv"), ("os", "execvp"), ("os", "spawnv"), ("os", "spawnl"),
        ("yaml", "load"), ("yaml", "load_all"), ("yaml", "unsafe_load"), ("yaml", "full_load"), ("yaml", "Loader"),
        ("yaml", "UnsafeLoader"), ("yaml", "FullLoader"), ("shutil", "unpack_archive"), ("zipfile", "ZipFile"),
        ("subprocess", "getoutput"), ("subprocess", "getstatusoutput"), ("np", "fromregex"),
    }  # fmt: skip
    found, calls = [], 0
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            place = f"{file.name}:{getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.Import | ast.ImportFrom):
                imported = {alias.name.split(".")[0] for alias in node.names}
                imported |= {str(getattr(node, "module", "")).split(".")[0]}
                found += [f"{place} imports {name}" for name in imported & modules]
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                if (node.value.id, node.attr) in members:
                    found.append(f"{place} uses {node.value.id}.{node.attr}")
            elif isinstance(node, ast.Call):
                calls += 1
                if isinstance(node.func, ast.Name) and node.func.id in names:
                    found.append(f"{place} calls {node.func.id}")
                said = {k.arg: k.value for k in node.keywords}
                for option in ("shell", "allow_pickle"):
                    value = said.get(option)
                    if value is not None and not (isinstance(value, ast.Constant) and value.value is False):
                        found.append(f"{place} sets {option}")
                called = node.func.attr if isinstance(node.func, ast.Attribute) else ""
                of = getattr(getattr(node.func, "value", None), "id", "")
                if (of, called) == ("np", "load") and "allow_pickle" not in said:
                    found.append(f"{place} calls np.load without allow_pickle=False")
                if of == "subprocess" and called in ("run", "Popen", "call", "check_call", "check_output"):
                    first = node.args[0] if node.args else None
                    if isinstance(first, ast.Constant | ast.JoinedStr | ast.BinOp):
                        found.append(f"{place} gives a string to {called}")
    assert calls > 3000
    assert not found


def test_a_program_in_the_clothes_of_a_photograph_is_not_run(tmp_path: Path) -> None:
    """Pillow runs Ghostscript on PostScript, whatever the name of the file."""
    eps = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 96 80\n%%EndComments\n(ran) print\n%%EOF\n"
    (tmp_path / "a.jpg").write_bytes(eps)
    with pytest.raises(PhotographError, match="not a photograph of the kind its name says"):
        read_photograph(Capture("a.jpg", tmp_path / "a.jpg", "coded", "a"))
    with pytest.raises(ProjectError, match="cannot be read as a mask"):
        masked(tmp_path, lambda place: place.write_bytes(eps))


# What says that it is huge


BOMBS = """
import json, resource, sys
from pathlib import Path
import colmap_ihe
from colmap_ihe.errors import KnownError
from colmap_ihe.evaluate.truth import TrueImage
from colmap_ihe.preprocess import write_masks
import numpy as np
folder = Path(sys.argv[1])
limit = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + (256 << 20)
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
said = []
for name in sorted(p.name for p in (folder / "masks").iterdir()):
    try:
        write_masks(folder / "masks", {name.removesuffix(".png"): "a.png"}, folder / "grey", folder / "made")
    except KnownError as error:
        said.append(str(error))
try:
    TrueImage(24, 16, np.eye(3), np.eye(3, 4), folder / "masks/bomb.jpg.png").depth_m()
except KnownError as error:
    said.append(str(error))
print(json.dumps(said))
"""


def test_pixels_are_counted_before_they_are_decoded(tmp_path: Path) -> None:
    """Masks and true depth, which this process reads itself, with 256 MB to do it in; photographs and frames, which
    decoders read, in test_mutated.py."""
    from test_mutated import HUGE, png_of, with_sides

    (tmp_path / "grey").mkdir()
    (tmp_path / "masks").mkdir()
    Image.new("L", (24, 16)).save(tmp_path / "grey/a.png")
    bomb = png_of(HUGE, HUGE, rows=bytes(1 << 24))
    (tmp_path / "masks/bomb.jpg.png").write_bytes(bomb)
    (tmp_path / "masks/large.jpg.png").write_bytes(png_of(20_000, 20_000, rows=bytes(1 << 24)))
    Image.new("RGB", (24, 16)).save(tmp_path / "small.tif")
    for name, side in (("tiff", HUGE), ("most", 0x7FFFFFFF)):
        (tmp_path / f"masks/{name}.jpg.png").write_bytes(
            with_sides((tmp_path / "small.tif").read_bytes(), side, side)
        )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", BOMBS, str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    said = json.loads(done.stdout)
    assert len(said) == 5
    assert all("pixels" in text or "cannot be read as a mask" in text for text in said)
    assert not list((tmp_path / "made").glob("*"))


def test_a_calibration_frame_of_too_many_pixels_is_refused_by_its_header() -> None:
    with pytest.raises(PhotographError, match="wanted at most 500 megapixels"):
        refuse_too_large("dark.dng", 60_000, 60_000)
