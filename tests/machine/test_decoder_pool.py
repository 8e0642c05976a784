"""Decoders in processes of their own: what one photograph does to them, and what is left afterwards."""

from __future__ import annotations

import gc
import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from processes import children, is_gone, soon

from colmap_ihe.errors import Cancelled, CapabilityError, PhotographError
from colmap_ihe.machine import decoder_pool as decoders
from colmap_ihe.machine import decoder_process, memory, system
from colmap_ihe.machine import decoder_wire as wire
from colmap_ihe.machine.decoder_process import Decoder
from colmap_ihe.machine.executor import in_order
from colmap_ihe.photographs.decode import PhotographHeader, decode_photograph, read_photograph, read_size
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.exif.metadata import read_metadata
from colmap_ihe.photographs.preview import decode_small, small_picture


def colours(seed: int = 1, size: tuple[int, int] = (96, 128)) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (*size, 3), np.uint8)


def capture(file: Path, pixels: NDArray[np.uint8], **more: Any) -> Capture:
    Image.fromarray(pixels).save(file, **more)
    return Capture(file.name, file, "coded", file.stem)


def jpeg(folder: Path, does: str = "", seed: int = 1) -> Capture:
    """A JPEG of noise whose comment is `does`."""
    return capture(folder / f"{does or 'sound'}-{seed}.jpg", colours(seed), comment=f"do: {does}".encode())


def png(folder: Path, seed: int = 1, size: tuple[int, int] = (96, 128)) -> Capture:
    return capture(folder / f"{seed}-{size[0]}x{size[1]}.png", colours(seed, size))


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_pixels_and_words_are_those_of_this_process(tmp_path: Path) -> None:
    for shot in (jpeg(tmp_path), png(tmp_path)):
        near, far = decode_photograph(shot), read_photograph(shot)
        np.testing.assert_array_equal(near.rgb, far.rgb)
        assert (near.encoding, near.profile) == (far.encoding, far.profile)
        assert read_size(shot) == PhotographHeader(128, 96)
        np.testing.assert_array_equal(small_picture(shot, 64), decode_small(shot, 64))
    far.rgb[0, 0] = 7  # an array like any other


@pytest.mark.parametrize(
    ("does", "said"),
    [
        ("crash", "the decoder crashed on it (SIGSEGV)"),
        ("exit", "crashed on it (out of luck)"),
        ("surprise", "surprise-1.jpg: cannot be read (LookupError: a surprise)"),
    ],
)
@pytest.mark.usefixtures("faulty")
def test_what_goes_wrong_is_of_one_photograph_only_and_leaves_nothing(
    tmp_path: Path, does: str, said: str
) -> None:
    sound = read_photograph(jpeg(tmp_path)).rgb
    gc.collect()
    files, processes = open_files(), len(children())
    for _ in range(3):
        with pytest.raises(PhotographError) as caught:
            read_photograph(jpeg(tmp_path, does))
        assert f"{does}-1.jpg: " in str(caught.value)
        assert said in str(caught.value)
        assert caught.value.hint
        np.testing.assert_array_equal(read_photograph(jpeg(tmp_path)).rgb, sound)
    del caught, sound
    gc.collect()
    assert open_files() <= files
    assert len(children()) == processes
    decoders.end_idle()
    assert open_files() < files


@pytest.mark.usefixtures("faulty")
def test_a_hang_ends_after_its_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read_size(jpeg(tmp_path))
    monkeypatch.setattr(decoder_process, "SECONDS", 0.5)
    monkeypatch.setattr(decoder_process, "SECONDS_A_MEGAPIXEL", 0)
    with pytest.raises(PhotographError, match=r"hang-1\.jpg: the decoder did not finish within 0 seconds"):
        read_photograph(jpeg(tmp_path, "hang"))
    monkeypatch.setattr(decoder_process, "SECONDS", 60)
    assert read_photograph(jpeg(tmp_path)).rgb.shape == (96, 128, 3)


@pytest.mark.slow
@pytest.mark.usefixtures("faulty")
def test_memory_has_an_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available", lambda: 1)
    monkeypatch.setattr(decoder_process, "_HEADER_MEMORY", 1 << 27)
    before = len(children())
    read_size(jpeg(tmp_path))
    with pytest.raises(PhotographError, match=r"eat-1\.jpg: not enough memory to decode it"):
        read_photograph(jpeg(tmp_path, "eat"))
    assert read_photograph(jpeg(tmp_path)).rgb.shape == (96, 128, 3)  # by the same one, which lived
    assert len(children()) == before + 1


def test_an_idle_decoder_that_was_killed_is_no_photographs_fault(tmp_path: Path) -> None:
    capture = png(tmp_path)
    decoders.end_idle()
    before = set(children())
    read_photograph(capture)
    (decoder,) = set(children()) - before
    os.kill(decoder, signal.SIGKILL)
    assert soon(lambda: is_gone(decoder))
    assert read_photograph(capture).rgb.shape == (96, 128, 3)
    assert decoder not in children()


def test_arrays_outlive_further_reads_and_give_their_memory_back(tmp_path: Path) -> None:
    captures = [png(tmp_path, seed) for seed in range(6)]
    read_photograph(captures[0])
    before, mapped = len(children()), shared_mappings()
    held = [read_photograph(c).rgb for c in captures]
    for seed, rgb in enumerate(held):
        np.testing.assert_array_equal(rgb, colours(seed))
    assert len(children()) == before  # one thread, one decoder
    part = held[2][10:20, 5:9, 1]
    expected = part.copy()
    del rgb, held
    for capture in captures:
        read_photograph(capture)
    np.testing.assert_array_equal(part, expected)  # a view alone keeps its memory
    del part
    read_photograph(captures[0])
    assert shared_mappings() <= mapped


def test_any_number_of_arrays_may_be_held(tmp_path: Path) -> None:
    captures = [png(tmp_path, seed) for seed in range(4)]
    files = open_files()
    held = [read_photograph(captures[n % 4]).rgb for n in range(150)]
    assert open_files() - files < 80
    for number, rgb in enumerate(held):
        np.testing.assert_array_equal(rgb, colours(number % 4))


def shared_mappings() -> int:
    return Path("/proc/self/maps").read_text(encoding="utf-8").count("memfd:colmap-ihe")


def test_a_larger_photograph_after_a_smaller_one(tmp_path: Path) -> None:
    for size in ((96, 128), (300, 200), (64, 70), (300, 201)):
        capture = png(tmp_path, 3, size)
        np.testing.assert_array_equal(read_photograph(capture).rgb, colours(3, size))


def test_memory_given_back_is_used_again(tmp_path: Path) -> None:
    capture = png(tmp_path)
    held = read_photograph(capture).rgb
    decoders.release_memory()
    np.testing.assert_array_equal(held, colours())  # not while somebody looks at it
    del held
    decoders.release_memory()
    np.testing.assert_array_equal(read_photograph(capture).rgb, colours())


def test_threads_have_a_decoder_each(tmp_path: Path) -> None:
    captures = [png(tmp_path, seed) for seed in range(4)]
    decoders.end_idle()
    before = len(children())
    with ThreadPoolExecutor(3) as executor:
        found = list(executor.map(lambda n: read_photograph(captures[n % 4]).rgb, range(60)))
    for number, rgb in enumerate(found):
        np.testing.assert_array_equal(rgb, colours(number % 4))
    assert 1 <= len(children()) - before <= 3


@pytest.mark.usefixtures("faulty")
def test_a_run_that_stops_does_not_wait_for_a_slow_decoder(tmp_path: Path) -> None:
    captures = [jpeg(tmp_path), jpeg(tmp_path, "hang"), jpeg(tmp_path, "hang", 2), jpeg(tmp_path, "hang", 3)]
    read_size(captures[0])
    begun, stopped = threading.Event(), []

    def read(capture: Capture) -> None:
        if capture.name == "hang-1.jpg":
            begun.set()
        try:
            read_photograph(capture)
        except Cancelled:
            stopped.append(capture.name)
            raise

    with ThreadPoolExecutor(2) as executor:
        results = in_order(executor, read, captures)
        next(results)
        assert begun.wait(60)
        began = time.monotonic()
        results.close()
    assert time.monotonic() - began < 5
    assert "hang-1.jpg" in stopped


def test_where_no_decoder_can_be_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decoders.end_idle()
    for executable, reason in (("/bin/false", "exit status 1"), ("/no/such/python", "No such file")):
        monkeypatch.setattr(sys, "executable", executable)
        with pytest.raises(CapabilityError, match=reason):
            read_photograph(png(tmp_path))
    monkeypatch.undo()
    assert read_photograph(png(tmp_path)).rgb.shape == (96, 128, 3)


def test_where_no_more_files_can_be_opened(tmp_path: Path) -> None:
    capture = png(tmp_path)
    decoders.end_idle()
    files, (soft, hard) = open_files(), resource.getrlimit(resource.RLIMIT_NOFILE)
    free = [n for n in range(soft) if not Path(f"/proc/self/fd/{n}").exists()]
    for most in free[:5]:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
        try:
            with pytest.raises(CapabilityError, match="Too many open files"):
                read_photograph(capture)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        assert open_files() == files
    assert read_photograph(capture).rgb.size


def test_a_metadata_reader_that_crashes_loses_the_metadata_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def crash(*_: object, **__: object) -> None:
        raise PhotographError("a.jpg: the decoder crashed on it (SIGSEGV)")

    monkeypatch.setattr(Decoder, "ask", crash)
    assert "the decoder crashed on it" in read_metadata(tmp_path / "a.jpg", "coded").problem


def test_a_decoder_is_small() -> None:
    code = "import sys, colmap_ihe.photographs.decoder_main; print(*sys.modules)"
    modules = subprocess.check_output([sys.executable, "-c", code], text=True).split()
    assert not {"pycolmap", "pydantic", "rich", "yaml"} & set(modules)


READ = """
import sys, threading, time
from pathlib import Path
from colmap_ihe.photographs.decode import read_photograph, read_size
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.machine import decoder_pool as decoders
file = Path(sys.argv[1])
capture = Capture(file.name, file, "coded", file.stem)
read_size(capture)
def read():
    try:
        read_photograph(capture)
    except Exception as error:
        print("ended:", error, flush=True)
"""


def script(code: str, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-c", READ + code, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize("does", ["hang", ""])
@pytest.mark.usefixtures("faulty")
def test_no_decoder_outlives_a_run_that_was_killed(tmp_path: Path, does: str) -> None:
    code = "threading.Thread(target=read).start(); time.sleep(.3); print('go', flush=True); time.sleep(99)"
    with script(code, str(jpeg(tmp_path, does).path)) as process:
        assert process.stdout is not None
        process.stdout.readline()
        (decoder,) = children(process.pid)
        process.send_signal(signal.SIGKILL)
        process.communicate()
    assert soon(lambda: is_gone(decoder))


def test_a_run_that_ends_leaves_no_decoder_and_no_warning(tmp_path: Path) -> None:
    code = "read()\nfrom subprocess import run\nprint(decoders._pool.idle[0]._process.pid)"
    with script(code, str(jpeg(tmp_path).path)) as process:
        out, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")
    assert is_gone(int(out))


@pytest.mark.posix
def test_a_forked_process_starts_decoders_of_its_own(tmp_path: Path) -> None:
    code = """
import os, warnings
warnings.simplefilter("ignore")
read()
mine = decoders._pool.idle[0]._process.pid
child = os.fork()
if not child:
    read()
    theirs = decoders._pool.idle[0]._process.pid
    decoders.end_idle()
    os._exit(0 if theirs != mine else 1)
print(os.waitpid(child, 0)[1], decoders._pool.idle[0]._process.status(), flush=True)
read()
print(mine == decoders._pool.idle[0]._process.pid)
"""
    with script(code, str(jpeg(tmp_path).path)) as process:
        out, errors = process.communicate(timeout=60)
    assert (out.split(), errors) == (["0", "None", "True"], "")


@pytest.mark.usefixtures("faulty")
def test_ctrl_c_while_a_decoder_hangs(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for seed in (1, 2, 3):
        jpeg(tmp_path / "in", "hang", seed)
    command = [sys.executable, "-m", "colmap_ihe.cli", "fit", str(tmp_path / "in")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        while "fit" not in process.stderr.readline():
            assert process.poll() is None
        assert soon(lambda: bool(children(process.pid)))
        pids = children(process.pid)
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        began = time.monotonic()
        _, errors = process.communicate(timeout=30)
    assert process.returncode == 130, errors
    assert time.monotonic() - began < 10
    assert "Traceback" not in errors
    assert soon(lambda: all(map(is_gone, pids)))


def test_messages_arrive_whole() -> None:
    ours, theirs = Pipe()
    message = {"exif": "0123456789abcdef" * 50000, "name": "a\udcffb ü", "numbers": [1, 2.5], "none": None}
    with ours, theirs:
        sender = threading.Thread(target=wire.send, args=(ours, message))
        sender.start()
        assert wire.receive(theirs) == (message, None)
        sender.join()
        os.write(ours.fileno(), b"\0\0\0\x09{}")
        ours.close()
        assert wire.receive(theirs) is None


def test_a_message_that_claims_to_be_huge_is_refused() -> None:
    ours, theirs = Pipe()
    with ours, theirs:
        os.write(ours.fileno(), b"\x7f\xff\xff\xff")
        with pytest.raises(ValueError, match="more than 268435456 bytes"):
            wire.receive(theirs)


@pytest.mark.posix
def test_a_message_whose_rest_does_not_come_ends_the_wait() -> None:
    ours, theirs = Pipe()
    with ours, theirs:
        system.bound_reads(theirs.fileno(), 1)
        os.write(ours.fileno(), b"\0\0\0\x09{}")
        with pytest.raises(BlockingIOError):
            wire.receive(theirs)


@pytest.mark.posix
def test_a_file_that_does_not_come_is_refused() -> None:
    ours, theirs = Pipe()
    with ours, theirs:
        ours.send_bytes(b'{"has_file": true}')
        os.write(ours.fileno(), b"x")
        with pytest.raises(ValueError, match="no file came"):
            wire.receive(theirs)


@pytest.mark.parametrize("folder", [False, True])
def test_arrays_come_without_a_name_or_by_a_file(tmp_path: Path, folder: bool) -> None:
    """Linux sends memory; elsewhere both sides map a file, whose name is gone once both have it."""
    place = tmp_path if folder else None
    writer, reader = wire.SharedArrayWriter(place), wire.SharedArrayReader(place)
    held = []
    for seed in range(3):
        message, fd = writer.put([colours(seed), np.arange(5, dtype=np.int64)])
        assert (fd is None) == folder
        held.append(reader.arrays(message, None if fd is None else os.dup(fd)))
        writer.sent()
        assert not list(tmp_path.iterdir())
        writer.leave()  # for they are in use
    for seed, (pixels, numbers) in enumerate(held):
        np.testing.assert_array_equal(pixels, colours(seed))
        assert numbers.tolist() == [0, 1, 2, 3, 4]
    if folder:  # which a cleaner of temporary files took
        tmp_path.rmdir()
        assert writer.put([colours()])[0]["file"] == 4
    with pytest.raises(ValueError, match="lost on the way"):
        wire.SharedArrayReader(tmp_path).arrays({"arrays": [{}], "is_new": True, "file": 7}, None)


@pytest.mark.parametrize(
    "about",
    [
        {"shape": [1000, 1000, 3], "dtype": "uint8", "is_new": True},
        {"shape": [-4, -4, 3], "dtype": "uint8", "is_new": True},
        {"shape": [4, 4, 3], "dtype": "object", "is_new": True},
        {"shape": [4, 4, 3], "dtype": "uint8", "is_new": False},
    ],
)
def test_an_array_that_is_not_what_its_message_says_is_refused(about: wire.Message) -> None:
    writer, reader = wire.SharedArrayWriter(), wire.SharedArrayReader()
    _, fd = writer.put([np.zeros((8, 8, 3), np.uint8)])
    assert fd is not None
    with pytest.raises((ValueError, KeyError)):
        reader.arrays({"arrays": [about], "is_new": about["is_new"]}, os.dup(fd))
    writer.leave()


def test_what_a_decoder_says_of_the_photograph_is_plain(tmp_path: Path) -> None:
    """JSON both ways: nothing that comes from a decoder is run."""
    exif = Image.Exif()
    exif[0x010F] = "Acme"
    assert read_metadata(capture(tmp_path / "a.png", colours(), exif=exif).path, "coded").make == "Acme"
    with decoders.one_decoder() as decoder:
        json.dumps(decoder.ask({"call": "", "name": "a.png", "memory": 1 << 30}, "a.png", 60))
