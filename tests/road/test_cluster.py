"""`reconstruct --cluster` on real schedulers and workers: what one machine makes, whatever is killed."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest
from command_line import ENVIRONMENT, LONG, started, wait_until_begun
from same_results import contents, known_of
from small_demo import ROOT, SETTINGS, Make, MakeOptions

import colmap_ihe
from colmap_ihe.cli import main
from colmap_ihe.errors import CapabilityError, ClusterError, OptionError
from colmap_ihe.photographs.discover import discover
from colmap_ihe.pipeline.reconstruct import reconstruct

pytestmark = pytest.mark.cluster

SPREAD = ("convert", "features", "matches", "dense")  # the stages that workers take part in for long


class Cluster:
    """A scheduler and its workers, each in a process group of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.processes: list[subprocess.Popen[bytes]] = []

    def start(self, *command: str, env: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
        with (self.folder / f"{len(self.processes)}.log").open("wb") as words:
            process = subprocess.Popen(
                command,
                stdout=words,
                stderr=words,
                cwd=self.folder,  # which `-m` puts before PYTHONPATH
                start_new_session=True,
                env=ENVIRONMENT | (env or {}),
            )
        self.processes.append(process)
        return process

    def scheduler(self) -> subprocess.Popen[bytes]:
        module = "distributed.cli.dask_scheduler"
        where = ["--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard"]
        return self.start(sys.executable, "-m", module, *where)

    def worker(
        self, name: str, *, before: tuple[str, ...] = (), env: dict[str, str] | None = None
    ) -> subprocess.Popen[bytes]:
        module = "distributed.cli.dask_worker"
        how = ["--nthreads", "1", "--name", name, "--no-dashboard", "--local-directory", str(self.folder)]
        return self.start(*before, sys.executable, "-m", module, self.address, *how, env=env)


def kill(process: subprocess.Popen[bytes]) -> None:
    """It and all that it has started."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        return
    process.wait()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """A scheduler without workers."""
    folder = tmp_path / "cluster"
    folder.mkdir()
    made = Cluster(folder)
    made.scheduler()
    yield made
    for process in made.processes:
        kill(process)


def run(project: Path, address: str, *more: str) -> AbstractContextManager[subprocess.Popen[str]]:
    patience = ("--set", "cluster.patience=60")
    return started("reconstruct", project, "--no-mesh", "--cluster", address, *patience, *more)


def result_of(process: subprocess.Popen[str]) -> dict[str, Any]:
    output, errors = process.communicate(timeout=2 * LONG)
    assert process.returncode == 0, errors
    return dict(json.loads(output))


def last_line_of(process: subprocess.Popen[str]) -> str:
    """The one line that a run failed with."""
    _, errors = process.communicate(timeout=LONG)
    assert process.returncode == 1, errors
    assert "Traceback" not in errors
    return errors.strip().splitlines()[-1]


def assert_whole(project: Path, summary: dict[str, Any], like: Path) -> None:
    """The result of one machine in `like`, and nothing left over."""
    assert summary["registered_images"] == 8
    assert 0.05 < summary["mean_reprojection_error_px"] < 1
    assert summary["dense_points"] > 15_000
    for folder in ("workspace/images", "colour"):
        assert contents(project / folder) == contents(like / folder)
    assert known_of(project / "workspace/database.db") == known_of(like / "workspace/database.db")
    assert_nothing_left(project)


def assert_nothing_left(project: Path, *, but_parts: bool = False) -> None:
    assert not list((project / "records").glob("*.lease"))
    parts = project / "workspace/parts"
    if but_parts:
        shutil.rmtree(parts, ignore_errors=True)
    assert not parts.exists()
    assert not list(project.rglob("*.part")) + list(project.rglob("*.tmp"))


def test_workers_on_this_machine(new_project: Make, finished: Path, quick_options: MakeOptions) -> None:
    project = new_project()
    done = reconstruct(project, quick_options("cluster.address=local:2", "mesh.enabled=false"))
    assert_whole(project, dict(done.summary), finished)
    again = reconstruct(project, quick_options("mesh.enabled=false"))
    assert again.stages_run == ()  # the same is up to date without the cluster


@pytest.mark.parametrize("lost", ["worker", "scheduler"])
@pytest.mark.parametrize("stage", SPREAD)
def test_a_worker_or_the_scheduler_is_killed(
    new_project: Make, finished: Path, cluster: Cluster, stage: str, lost: str
) -> None:
    project = new_project()
    worker = cluster.worker("first")
    if lost == "worker":
        cluster.worker("second")
    with run(project, cluster.address) as process:
        wait_until_begun(process, project, stage)
        time.sleep(0.1)
        if lost == "worker":
            kill(worker)
        else:
            kill(cluster.processes[0])
            time.sleep(1)
            cluster.scheduler()
            cluster.worker("second")  # the first has ended with its scheduler, as Dask's do
        assert_whole(project, result_of(process), finished)


def test_no_worker_is_left(new_project: Make, finished: Path, cluster: Cluster) -> None:
    """One line after some patience, and the same command goes on where there are workers again."""
    project = new_project()
    only = cluster.worker("only")
    with run(project, cluster.address, "--set", "cluster.patience=3") as process:
        wait_until_begun(process, project, "features")
        kill(only)
        line = last_line_of(process)
    assert "no worker was there for 3 s" in line
    assert "the same command goes on from here" in line
    assert_nothing_left(project, but_parts=True)
    times = (project / "records/convert.json").stat().st_mtime_ns
    cluster.worker("another")
    with run(project, cluster.address) as process:
        assert_whole(project, result_of(process), finished)
    assert (project / "records/convert.json").stat().st_mtime_ns == times


def test_no_scheduler_answers(new_project: Make) -> None:
    with run(new_project(), "tcp://127.0.0.1:9", "--set", "cluster.patience=1") as process:
        line = last_line_of(process)
    assert "tcp://127.0.0.1:9: no scheduler answers there" in line


def test_stopped_by_hand(new_project: Make, finished: Path, cluster: Cluster) -> None:
    """When the command has ended, no worker writes into the project any more."""
    project = new_project()
    cluster.worker("first")
    with run(project, cluster.address) as process:
        wait_until_begun(process, project, "features")
        time.sleep(0.2)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=LONG)
    assert process.returncode == 130
    assert errors.splitlines()[-1] == "colmap-ihe: stopped; the same command goes on from here"
    assert_nothing_left(project, but_parts=True)
    before = {p: p.stat().st_mtime_ns for p in project.rglob("*")}
    time.sleep(2)
    assert {p: p.stat().st_mtime_ns for p in project.rglob("*")} == before
    with run(project, cluster.address) as process:
        assert_whole(project, result_of(process), finished)


def test_the_command_is_killed(new_project: Make, finished: Path, cluster: Cluster) -> None:
    """The next one waits for what the workers still do for the first, and goes on."""
    project = new_project()
    cluster.worker("first")
    with run(project, cluster.address) as process:
        wait_until_begun(process, project, "dense")
        time.sleep(0.3)
        process.kill()
    assert len(list((project / "records").glob("*.lease"))) == 1
    with run(project, cluster.address) as process:
        assert_whole(project, result_of(process), finished)


def test_local_workers_end_with_the_command(new_project: Make) -> None:
    project = new_project()
    with run(project, "local:2") as process:
        wait_until_begun(process, project, "convert")
        listed = subprocess.run(["ps", "-eo", "ppid=,sid=,pid="], capture_output=True, text=True, check=True)
        rows = [tuple(map(int, line.split())) for line in listed.stdout.splitlines()]
        sessions = {pid for parent, session, pid in rows if parent == process.pid and session == pid}
        workers = [pid for _, session, pid in rows if session in sessions]
        process.kill()
    assert len(workers) > 2
    end = time.monotonic() + LONG
    while any(Path(f"/proc/{pid}").exists() for pid in workers):
        assert time.monotonic() < end
        time.sleep(0.2)


def in_a_room_of_its_own(mount: str) -> tuple[str, ...]:
    """Runs a command with another file system mounted somewhere, which only it sees; skips where that cannot be."""
    there = shutil.which("unshare")
    if not there or subprocess.run([there, "-rm", "true"], check=False, capture_output=True).returncode:
        pytest.skip("no mount of its own can be given to a process here")
    return (there, "-rm", "sh", "-c", f'{mount} && exec "$@"', "sh")


@pytest.mark.parametrize(
    ("mount", "message"),
    [
        ("mount -t tmpfs none {root}", "there is no {project} there"),
        (
            "mount -t tmpfs none {root} && mkdir -p {project}/images",
            "there is no {project} of this run, only another of the same name, there",
        ),
        ("mount -t tmpfs none {images}", "there is no {photograph} there"),
    ],
)
def test_a_worker_does_not_see_the_same_folders(
    new_project: Make, cluster: Cluster, tmp_path: Path, mount: str, message: str
) -> None:
    """Its photographs are not left out one by one, as those that cannot be read are."""
    images = new_project() / "images"
    project = tmp_path / "elsewhere" / "church"
    project.mkdir(parents=True)
    names = {"root": project.parent, "project": project, "images": images}
    photograph = discover(images).captures[0].path
    cluster.worker("blind", before=in_a_room_of_its_own(mount.format(**names)))
    with run(project, cluster.address, "--images", str(images)) as process:
        line = last_line_of(process)
    assert "worker blind on " in line
    assert message.format(**names, photograph=photograph) in line
    assert "under the same paths" in line


@pytest.mark.parametrize("stage", ["features", "matches"])
def test_a_full_disk_on_one_worker(new_project: Make, finished: Path, cluster: Cluster, stage: str) -> None:
    project = new_project()
    if stage == "matches":
        whole = cluster.worker("whole")
        with run(project, cluster.address, "--until", "features") as process:
            result_of(process)
        kill(whole)
    room = project.parent / "room"
    room.mkdir()
    small = in_a_room_of_its_own(f"mount -t tmpfs -o size=100k none {room}")
    full = cluster.worker("full", before=small, env={"TMPDIR": str(room)})
    with run(project, cluster.address) as process:
        line = last_line_of(process)
    assert "worker full on " in line
    assert "the same command goes on from here" in line
    kill(full)
    cluster.worker("roomy")
    with run(project, cluster.address) as process:
        assert_whole(project, result_of(process), finished)


def copied_package(folder: Path) -> Path:
    ignored = shutil.ignore_patterns("__pycache__")
    return shutil.copytree(ROOT / "colmap_ihe", folder / "colmap_ihe", ignore=ignored)


def other_version(folder: Path) -> str:
    libraries = copied_package(folder) / "machine/libraries.py"
    text = libraries.read_text()
    libraries.write_text(text.replace(f'__version__ = "{colmap_ihe.__version__}"', '__version__ = "0.0.1"'))
    there = f"colmap-ihe is 0.0.1 there, expected {colmap_ihe.__version__} as on this machine"
    return f"worker other on .*{there}"


def edited_package(folder: Path) -> str:
    with (copied_package(folder) / "errors.py").open("a") as file:
        file.write("# changed\n")
    return "worker other on .*the code of colmap-ihe is "


def other_library(folder: Path) -> str:
    about = folder / "tifffile-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: tifffile\nVersion: 1.0\n")
    return "worker other on .*tifffile is 1.0 there"


def no_package(folder: Path) -> str:
    hidden = folder / "colmap_ihe.py"
    hidden.write_text("raise ModuleNotFoundError(\"No module named 'colmap_ihe'\")\n")
    return "worker tcp://.*No module named 'colmap_ihe'"


@pytest.mark.parametrize("install", [other_version, edited_package, other_library, no_package])
def test_a_worker_with_other_software_is_refused(
    new_project: Make, cluster: Cluster, tmp_path: Path, install: Callable[[Path], str]
) -> None:
    (folder := tmp_path / "other").mkdir()
    message = install(folder)
    cluster.worker("other", env={"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"})
    with run(new_project(), cluster.address) as process:
        assert re.search(message, last_line_of(process))


@pytest.mark.parametrize("address", ["local", "local:0", "local:many"])
def test_an_address_that_is_none(new_project: Make, quick_options: MakeOptions, address: str) -> None:
    with pytest.raises(OptionError, match=r"expected local:N") as failure:
        reconstruct(new_project(), quick_options(f"cluster.address={address}"))
    assert address in str(failure.value)


def test_without_dask(new_project: Make, quick_options: MakeOptions, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "distributed"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "colmap_ihe.machine.cluster.executor", raising=False)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(CapabilityError, match="needs Dask") as failure:
        reconstruct(new_project(), quick_options("cluster.address=local:2"))
    assert "pip install '.[cluster]'" in failure.value.hint


def test_errors_reach_the_caller_as_they_were(tmp_path: Path) -> None:
    from colmap_ihe.machine.cluster.connect import connected
    from colmap_ihe.machine.progress import SILENT
    from colmap_ihe.project.option_sections import ClusterOptions

    with connected(ClusterOptions(address="local:1"), tmp_path / "records", (), SILENT) as executor:
        assert executor.width == 1
        assert list(executor.map(abs, range(-3, 3))) == [3, 2, 1, 0, 1, 2]
        with pytest.raises(ZeroDivisionError):
            executor.submit(divmod, 1, 0).result(LONG)
        with pytest.raises(ClusterError, match=r"worker local on .*no-such-file"):
            executor.submit(Path("no-such-file").read_bytes).result(LONG)
        left = executor.submit(time.sleep, 1)
    assert left.cancelled()
    assert [p.name for p in (tmp_path / "records").iterdir()] == ["workers.log"]


def test_whole_projects_of_a_batch_run_on_workers(
    new_project: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    first = new_project(8, name="batch-root/north")
    new_project(8, name="batch-root/south")
    root = first.parent
    (first / "project.yaml").write_text("cluster: tcp://127.0.0.1:1\n")
    arguments = ["batch", str(root), "--cluster", "local:2", "--no-dense", "--json", *SETTINGS]
    assert main(arguments) == 0
    said = json.loads(capsys.readouterr().out)
    assert [one["state"] for one in said["projects"]] == ["done", "done"]
    for name in ("north", "south"):
        summary = json.loads((root / name / "report/summary.json").read_text())
        assert summary["registered_images"] == 8
        log = (root / name / "records/batch.log").read_text()
        assert "cluster" not in log  # each by itself, where it ran
    assert main(arguments) == 0  # nothing is left to do
