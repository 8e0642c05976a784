"""Nothing leads out of a project, by options, links or records, and nothing that is read is run."""

from __future__ import annotations

import ast
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

import colmap_ihe
from colmap_ihe import convert_folder
from colmap_ihe.batch.folder import BatchFolder
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import OptionError, PhotographError, ProjectError
from colmap_ihe.machine.files import open_file, read_json
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import Capture, discover
from colmap_ihe.pipeline.masks import write_masks
from colmap_ihe.pipeline.output_folder import RECORD, Ledger
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import FitOptions
from colmap_ihe.project.options_file import load_options, named_paths

PACKAGE = Path(colmap_ihe.__file__).parent
SOLVER = """sparse: {mapper: global, colmap: {mapper: {bundle_adjustment: {ceres: {solver_options:
 {trust_region_problem_dump_directory: /x}}}}}}"""


# Paths in options


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("fit: {weights: /etc/passwd}", "fit.weights"),
        ("fit: {weights: ../other/weights.yaml}", "fit.weights"),
        ("fit: {weights: link/weights.yaml}", "fit.weights"),
        ("camera: {calibration: /home/somebody/calibration.yaml}", "camera.calibration"),
        ("camera: {calibration: ../other/calibration.yaml}", "camera.calibration"),
        ("cluster: tcp://9.9.9.9:8786", "cluster.address"),
        ("cluster: {address: scheduler.json}", "cluster.address"),
        ("sparse: {colmap: {snapshot_path: snapshots}}", "sparse.colmap.snapshot_path"),
        ("matches: {strategy: vocabtree, pairing: {vocab_tree_path: /x}}", "matches.pairing.vocab_tree_path"),
        ("dense: {colmap: {mask_path: /x}}", "dense.colmap.mask_path"),
        (SOLVER, "trust_region_problem_dump_directory"),
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
    sections = {k: v if isinstance(v, dict) else {"address": v} for k, v in yaml.safe_load(text).items()}
    ((full, value),) = named_paths(sections)
    assert load_options(file, [f"{full}={json.dumps(value)}"])


@pytest.mark.parametrize("address", ["local:2", "tcp://127.0.0.1:8786", "tls://10.1.2.3:8786"])
def test_weights_within_the_project_and_workers_nearby_may_stand_in_a_file(
    tmp_path: Path, address: str
) -> None:
    (tmp_path / "project.yaml").write_text(f"fit: {{weights: more/weights.yaml}}\ncluster: {address}\n")
    options = load_options(tmp_path / "project.yaml")
    assert (options.fit.weights, options.cluster.address) == ("more/weights.yaml", address)


def _paths_of(options: object, place: str = "") -> Iterator[str]:
    for name in dir(options):
        value = None if name.startswith("_") else getattr(options, name)
        if isinstance(value, Path):
            yield f"{place}{name}"
        elif hasattr(value, "mergedict"):
            yield from _paths_of(value, f"{place}{name}.")


def test_every_path_among_colmaps_options_is_told_by_its_name() -> None:
    names = [name for name in dir(pycolmap) if name.endswith("Options")]
    found = {path for name in names for path in _paths_of(getattr(pycolmap, name)())}
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


@pytest.mark.posix
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


def test_a_record_of_grey_images_removes_nothing_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/a.png").write_text("mine")
    (tmp_path / "grey").mkdir()
    (tmp_path / "grey/link").symlink_to(tmp_path / "mine")
    entry = {"photograph": "a.jpg", "fingerprint": "0", "digest": ""}
    named = dict.fromkeys(("link/a.png", "../mine/a.png", str(tmp_path / "mine/a.png")), entry)
    (tmp_path / "grey" / RECORD).write_text(json.dumps({"files": named, "notes": {}}))
    ledger = Ledger(tmp_path / "grey")
    ledger.begin({}, {})
    assert (tmp_path / "mine/a.png").read_text() == "mine"
    with pytest.raises(ProjectError, match="leads out of the folder"):
        ledger.refuse({"link/b.png": "b.jpg"})


def masked(folder: Path, spoil: Callable[[Path], object]) -> dict[str, float]:
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
    assert masked(tmp_path / "other", os.mkfifo) == {}


# What is never loaded, and never run


MODULES = {
    "pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "tarfile", "code", "pty",
}  # fmt: skip
CALLS = {
    "eval", "exec", "compile", "__import__", "execfile", "os.system", "os.popen", "os.execv", "os.execvp", "os.spawnv",
    "os.spawnl", "np.fromregex", "yaml.load", "yaml.load_all", "yaml.unsafe_load", "yaml.full_load",
    "shutil.unpack_archive", "zipfile.ZipFile", "subprocess.getoutput", "subprocess.getstatusoutput",
}  # fmt: skip
NAMES = {"yaml.Loader", "yaml.UnsafeLoader", "yaml.FullLoader"} | {name for name in CALLS if "." in name}
RUNS = {f"subprocess.{name}" for name in ("run", "Popen", "call", "check_call", "check_output")}


def doubts_about(node: ast.AST) -> Iterator[str]:
    """What may run or unpickle something; `shell` and `allow_pickle` stand only where they are false."""
    match node:
        case ast.Import(names=aliases) | ast.ImportFrom(names=aliases):
            imported = {str(getattr(node, "module", "")), *(alias.name for alias in aliases)}
            yield from (f"imports {name}" for name in imported if name.split(".")[0] in MODULES)
        case ast.Attribute() if ast.unparse(node) in NAMES:
            yield f"uses {ast.unparse(node)}"
        case ast.Call(func=function, args=arguments, keywords=keywords):
            called = ast.unparse(function)
            options = {keyword.arg: ast.unparse(keyword.value) for keyword in keywords}
            if called in CALLS:
                yield f"calls {called}"
            if {options.get("shell", "False"), options.get("allow_pickle", "False")} != {"False"}:
                yield "sets shell or allow_pickle"
            if called == "np.load" and "allow_pickle" not in options:
                yield "calls np.load without allow_pickle=False"
            if called in RUNS and isinstance(arguments[0], ast.Constant | ast.JoinedStr | ast.BinOp):
                yield f"gives a string to {called}"


def test_nothing_in_the_package_runs_or_unpickles_what_it_reads() -> None:
    found = [
        f"{file.name}:{getattr(node, 'lineno', 0)} {doubt}"
        for file in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        for doubt in doubts_about(node)
    ]
    assert not found


@pytest.mark.parametrize(
    "text",
    [
        "import pickle.a", "from marshal import x", "eval('1')", "os.system(x)", "x = yaml.Loader", "np.load(x)",
        "run(x, shell=True)", "np.load(x, allow_pickle=True)", "subprocess.run(f'{x}')",
    ],
)  # fmt: skip
def test_what_runs_or_unpickles_would_be_found(text: str) -> None:
    assert [doubt for node in ast.walk(ast.parse(text)) for doubt in doubts_about(node)]


def test_a_program_in_the_clothes_of_a_photograph_is_not_run(tmp_path: Path) -> None:
    """Pillow runs Ghostscript on PostScript, whatever the name of the file."""
    eps = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 96 80\n%%EndComments\n(ran) print\n%%EOF\n"
    (tmp_path / "a.jpg").write_bytes(eps)
    with pytest.raises(PhotographError, match="not a photograph of the kind its name says"):
        read_photograph(Capture("a.jpg", tmp_path / "a.jpg", "coded", "a"))
    with pytest.raises(ProjectError, match="cannot be read as a mask"):
        masked(tmp_path, lambda place: place.write_bytes(eps))
