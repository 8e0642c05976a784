"""What several rooms' tests share: a small demo with known truth, and what the road makes of it.

Rendering and reconstructing happen once a session; tests get copies, which they may spoil.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from browser import chromium, headless
from hypothesis import settings
from small_demo import DEMO_SIZE, DEMO_VIEWS, PHOTOGRAPHS, QUICK, ROOT

import colmap_ihe  # noqa: F401  before pycolmap
from colmap_ihe.evaluation.demo.render import render_demo
from colmap_ihe.machine import decoder_pool as decoders
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.project.options import Options
from colmap_ihe.project.options_file import load_options

if TYPE_CHECKING:
    from playwright.sync_api import Browser

settings.register_profile("house", deadline=None, derandomize=True, database=None)
settings.register_profile("many", settings.get_profile("house"), max_examples=24_000)  # of scripts/test-slow
settings.load_profile("house")

FAULTS = """
# Stands for a decoder with a bug: what it does to a JPEG is the JPEG's comment.
import os, signal, time
import simplejpeg
decode = simplejpeg.decode_jpeg

def decode_jpeg(data, *more, **named):
    if b"do: crash" in data:
        os.kill(os.getpid(), signal.SIGSEGV)
    if b"do: hang" in data:
        while True:
            pass
    if b"do: exit" in data:
        print("out of luck", file=__import__("sys").stderr, flush=True)
        os._exit(3)
    if b"do: eat" in data:
        eaten = [bytearray(1 << 26) for _ in range(1 << 16)]
    if b"do: late" in data:  # what it was counted with is lost as it is handed over
        from colmap_ihe.photographs.colour_counts import ColourCounter
        ColourCounter.handed_over = lambda _: os.kill(os.getpid(), signal.SIGSEGV)
    if b"do: surprise" in data:
        raise LookupError("a surprise")
    return decode(data, *more, **named)

simplejpeg.decode_jpeg = decode_jpeg
"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    pytest.importorskip("playwright", reason="playwright is not installed")
    if chromium() is None:
        pytest.skip("no Chromium is installed")
    with headless() as started:
        yield started


@pytest.fixture
def faulty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """New decoders do what the comment of a JPEG says."""
    (tmp_path / ".hook").mkdir()
    (tmp_path / ".hook/sitecustomize.py").write_text(FAULTS, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path / '.hook'}{os.pathsep}{ROOT}")
    decoders.end_idle()
    yield
    decoders.end_idle()


@pytest.fixture(scope="session")
def photographs() -> Path:
    """The folder of real photographs; skips where it is missing."""
    if not PHOTOGRAPHS.is_dir():
        pytest.skip(f"the real photographs are not here: no folder {PHOTOGRAPHS}")
    return PHOTOGRAPHS.resolve()


@pytest.fixture(scope="session")
def small_demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight views of the portico, each as RAW and JPEG; not to be written to."""
    folder = tmp_path_factory.mktemp("small-demo")
    render_demo(folder, views=DEMO_VIEWS, size=DEMO_SIZE)
    return folder


@pytest.fixture(scope="session")
def quick_options() -> Callable[..., Options]:
    """Options that are quick on the small demo, with further `stage.option=value` over them."""

    def make(*assignments: str) -> Options:
        return load_options(None, [*QUICK, *assignments])

    return make


@pytest.fixture
def new_project(small_demo: Path, tmp_path: Path) -> Callable[..., Path]:
    """`new_project(views=8, suffixes=(".jpg",), name="project")`: a project that nothing was run on."""

    def make(views: int = DEMO_VIEWS, suffixes: tuple[str, ...] = (".jpg",), name: str = "project") -> Path:
        project = tmp_path / name
        (project / "images").mkdir(parents=True)
        for number in range(1, views + 1):
            for suffix in suffixes:
                file = f"portico_{number:02}{suffix}"
                shutil.copy2(small_demo / "images" / file, project / "images" / file)
        return project

    return make


@pytest.fixture(scope="session")
def _finished(small_demo: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    project = tmp_path_factory.mktemp("finished") / "project"
    shutil.copytree(small_demo / "images", project / "images", ignore=shutil.ignore_patterns("*.dng"))
    done = reconstruct(project, load_options(None, QUICK))
    return project, dict(done.summary)


@pytest.fixture
def finished(_finished: tuple[Path, dict[str, Any]], tmp_path: Path) -> Path:
    """A copy of a project that was reconstructed with `quick_options()`, dense cloud and all."""
    return Path(shutil.copytree(_finished[0], tmp_path / "finished"))


@pytest.fixture
def finished_summary(_finished: tuple[Path, dict[str, Any]]) -> dict[str, Any]:
    """What the run that made `finished` returned."""
    return _finished[1]
