"""Fuzzes every parser of outside bytes: each must return, or raise what it documents, within seconds and little memory.

    python benchmarks/fuzz.py --executions 5000 --seed 1
    python benchmarks/fuzz.py --only EXIF --replay 1234

Each parser runs in a process of its own under limits of memory and time. What follows from a seed and a number can be
made again: `--replay N` runs that one and shows its traceback.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

SECONDS = 10  # for one execution
MEMORY = 2 << 30  # bytes that a process may take beyond what it has when it begins
_TRIES = 40  # processes of one parser that may die


def main() -> None:
    parser = argparse.ArgumentParser(description="fuzz every parser of outside bytes")
    parser.add_argument("--executions", type=int, default=5000, metavar="N", help="of each parser (5000)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", metavar="NAME", help="parsers whose name holds this")
    parser.add_argument("--replay", type=int, metavar="N", help="run this execution alone, here")
    parser.add_argument("--child", metavar="NAME", help=argparse.SUPPRESS)
    parser.add_argument("--first", type=int, default=0, help=argparse.SUPPRESS)
    parsed = parser.parse_args()
    if parsed.child:
        _child(parsed)
        return
    from fuzz_targets import TARGETS

    chosen = [t for t in TARGETS if not parsed.only or parsed.only in t.name]
    if parsed.replay is not None:
        (target,) = chosen
        _replay(target.name, parsed.seed, parsed.replay)
        return
    began, all_wrong, total = time.monotonic(), 0, 0
    print("| parser | executions | refused | accepted | wrong |\n|---|---|---|---|---|")
    for target in chosen:
        wanted, start = max(1, round(parsed.executions * target.share)), time.monotonic()
        found = _run(target.name, parsed.seed, wanted)
        took = time.monotonic() - start
        wrong = sum(found["wrong"].values())
        executions = found["refused"] + found["accepted"] + wrong
        total, all_wrong = total + executions, all_wrong + wrong
        print(
            f"| {target.name} | {executions:,} | {found['refused']:,} | {found['accepted']:,} | {wrong} |",
            flush=True,
        )
        print(f"  {took:.0f} s", file=sys.stderr, flush=True)
        for words, count in found["wrong"].items():
            print(f"  {count} x {words} (--replay {found['places'][words]})", file=sys.stderr, flush=True)
    print(f"| all | {total:,} | | | {all_wrong} |")
    print(f"\nseed {parsed.seed}, {time.monotonic() - began:.0f} s", file=sys.stderr)
    sys.exit(1 if all_wrong else 0)


def _run(name: str, seed: int, executions: int) -> dict[str, Any]:
    """One parser in processes of its own: the next begins behind the execution that ended the one before."""
    total: dict[str, Any] = {"refused": 0, "accepted": 0, "wrong": Counter(), "places": {}}
    first = 0
    for _ in range(_TRIES):
        with TemporaryDirectory(prefix="fuzz-") as folder:
            command = [
                sys.executable,
                __file__,
                f"--child={name}",
                "--seed",
                str(seed),
                "--first",
                str(first),
            ]
            command += ["--executions", str(executions)]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
            state = Path(folder, "state.json")
            found = json.loads(state.read_text()) if state.exists() else {}
            place = Path(folder, "at")
            at, refused, accepted = (
                (int(n) for n in place.read_text().split()) if place.exists() else (-1, 0, 0)
            )
        total["refused"] += refused
        total["accepted"] += accepted
        for words, count in found.get("wrong", {}).items():
            total["wrong"][words] += count
            total["places"].setdefault(words, found["places"][words])
        if found.get("over"):
            return total
        if at < 0:
            raise SystemExit(f"{name} did not begin:\n{done.stderr[-3000:]}")
        died_of = (
            signal.Signals(-done.returncode).name if done.returncode < 0 else f"exit status {done.returncode}"
        )
        words = f"took more than {SECONDS} s" if died_of == "SIGALRM" else f"ended its process ({died_of})"
        total["wrong"][words] += 1
        total["places"].setdefault(words, at)
        first = at + 1
        if first >= executions:
            return total
    return total


def _child(parsed: argparse.Namespace) -> None:
    from fuzz_targets import TARGETS

    (target,) = [t for t in TARGETS if t.name == parsed.child]
    warnings.simplefilter("ignore")
    samples = list(target.samples())
    found: dict[str, Any] = {"refused": 0, "accepted": 0, "wrong": {}, "places": {}}
    _limit_memory()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # which ends the process, be it deep in a library
    at = os.open("at", os.O_CREAT | os.O_RDWR)

    def one(number: int, data: bytes) -> None:
        os.pwrite(at, f"{number:012} {found['refused']:012} {found['accepted']:012}".encode(), 0)
        signal.alarm(SECONDS)
        outcome = outcome_of(target, data, Path("work"))
        signal.alarm(0)
        if outcome in ("refused", "accepted"):
            found[outcome] += 1
        else:
            found["wrong"][outcome] = found["wrong"].get(outcome, 0) + 1
            found["places"].setdefault(outcome, number)
            _save(found)

    for number in range(parsed.first, parsed.executions):
        one(number, target.made(samples, random.Random(f"{parsed.seed}/{target.name}/{number}")))
    os.pwrite(at, f"{parsed.executions:012} {found['refused']:012} {found['accepted']:012}".encode(), 0)
    _save(found | {"over": True})
    os._exit(0)  # decoders of the parsers are nobody's any more


def _save(found: dict[str, Any]) -> None:
    Path("state.tmp").write_text(json.dumps(found))
    Path("state.tmp").replace("state.json")


def outcome_of(target: Any, data: bytes, folder: Path) -> str:
    """ "accepted", "refused", or in words what should not have been raised, and where."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    try:
        target.parse(data, folder.absolute())
    except target.refuses as error:
        if "\n" in str(error).strip():
            return f"a message of several lines: {str(error)[:80]!r}"
        return "refused"
    except Exception as error:  # noqa: BLE001  whatever else it is, it is wrong
        place = [f for f in traceback.extract_tb(error.__traceback__) if "colmap_ihe" in f.filename][-1:]
        where = f" in {Path(place[0].filename).name}, line {place[0].lineno}" if place else ""
        return f"{type(error).__name__}: {str(error)[:90]!r}{where}"
    return "accepted"


def _replay(name: str, seed: int, number: int) -> None:
    from fuzz_targets import TARGETS

    (target,) = [t for t in TARGETS if t.name == name]
    data = target.made(list(target.samples()), random.Random(f"{seed}/{name}/{number}"))
    print(f"{len(data)} bytes, {data[:300]!r}")
    with TemporaryDirectory(prefix="fuzz-") as folder:
        target.parse(data, Path(folder))


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    size = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (size, size))


if __name__ == "__main__":
    main()
