"""Sound files made unsound: bits, lengths, cuts and splices of any bytes; of text what its grammar allows and nobody
writes. Hypothesis draws the mutations and the seed of their choices."""

from __future__ import annotations

import json
import resource
import shutil
import signal
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from random import Random
from types import FrameType
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from colmap_ihe.errors import KnownError

SECONDS = 10  # for one execution
MEMORY = 2 << 30  # bytes that this process may take beyond what it has
SHARE = 0.25  # of the examples of the profile: each is several mutations
NUMBERS = (0, 1, 2, 3, 8, 127, 128, 255, 256, 32767, 65535, 1 << 16, (1 << 31) - 1, 1 << 31, (1 << 32) - 1)
WORDS = (
    "", "0", "-1", "1e999", "-1e-320", "nan", ".nan", ".inf", "-.inf", "NaN", "Infinity", "null", "~", "true", "yes",
    "9" * 400, "9" * 5000, "1:59:59", "0x" + "f" * 40, "0b1", "1_000", "2016-13-45", "2016-01-01", "1e3", "é" * 30,
    "\0", "\x1b]0;x\x07", "\u202egpj.exe", "\u2028", "\ufeff", "a\nb", "../" * 9 + "etc/passwd", "/etc/passwd",
    "/dev/zero", "~root", "file:///etc/passwd", "javascript:alert(1)", "</script><script>alert(1)</script>",
    "{{7*7}}", "%s%n", "*", "**", "[", "]", "{", "}", "&a", "*a", "<<", "!!python/object/apply:os.system [id]",
    "!!binary aGk=", "!!set {a, b}", "!!timestamp x", "!!int ''", "!!float ''", "!!bool x", "!!omap [a]", "? [a]\n: b",
    "- - - -", "tcp://example.org:8786", "a" * 300, "x/" * 200, "../up", "link/up",
)  # fmt: skip
"""What stands for a value in text."""
VALUES: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 0.5, -0.0, 10**400, -(10**20), 2**31, 2**53, 2**63, 2**64, float("nan"), float("inf"),
    float("-inf"), "", "x", "\0", "\ud800", "../../up", "/etc/passwd", "a\nb", "\u202e", "1" * 5000, "</script>",
    [], {}, [[]], [None], [0] * 300, {"": None}, {"a": {"b": {}}}, [1, "2", None], {"0": 0},
)  # fmt: skip
"""What stands for a value in JSON."""

Mutation = Callable[[bytes, Random], bytes]


def cut(data: bytes, rng: Random) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def flipped(data: bytes, rng: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 64)) if data else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def replaced(data: bytes, rng: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 2, 8)) if data else 0):
        changed[rng.randrange(len(changed))] = rng.choice((0, 10, 32, 127, 255, rng.randrange(256)))
    return bytes(changed)


def numbered(data: bytes, rng: Random) -> bytes:
    """With another number in a field of 2, 4 or 8 bytes, as lengths, counts and offsets are."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 3))):
        kind = rng.choice("HIQ")
        size = struct.calcsize(kind)
        if len(changed) >= size:
            number = rng.choice((*NUMBERS, rng.getrandbits(8 * size), len(data))) & ((1 << 8 * size) - 1)
            place = rng.randrange(len(changed) - size + 1)
            struct.pack_into(rng.choice("<>") + kind, changed, place & ~rng.choice((0, 1, 1)), number)
    return bytes(changed)


def spliced(data: bytes, rng: Random) -> bytes:
    """With a piece of itself elsewhere again, or taken out."""
    if len(data) < 2:
        return data * 2
    start, place = rng.randrange(len(data)), rng.randrange(len(data))
    piece = data[start : start + rng.choice((1, 4, 16, 64, 1024))]
    return data[:place] + piece * rng.choice((0, 1, 1, 2, 50)) + data[place + rng.choice((0, len(piece))) :]


def worded(data: bytes, rng: Random) -> bytes:
    """Text with another word in the place of one of its own."""
    text = data.decode("utf-8", "replace")
    for _ in range(rng.choice((1, 1, 2))):
        start = rng.choice([i for i, c in enumerate(text) if not c.isspace()] or [0])
        end = next((i for i in range(start, len(text)) if text[i] in " \n:,[]{}"), len(text))
        text = text[:start] + rng.choice(WORDS) + text[end:]
    return text.encode("utf-8", "surrogatepass")


def lined(data: bytes, rng: Random) -> bytes:
    """Text with lines out of place, twice, gone, or further in."""
    lines = data.split(b"\n")
    for _ in range(rng.choice((1, 2, 5))):
        line = lines.pop(rng.randrange(len(lines)))
        again = rng.choice(([line], [line, line], [], [b"  " + line]))
        place = rng.randrange(len(lines) + 1)
        lines[place:place] = again or ([] if lines else [b""])
    return b"\n".join(lines)


def nested(data: bytes, rng: Random) -> bytes:
    """Deep brackets, in the middle or alone."""
    depth = rng.choice((5, 30, 200, 3000, 60_000))
    kinds = ((b"[", b"]"), (b"{a: ", b"}"), (b'{"a":', b"}"), (b"- ", b""), (b"? ", b""))
    opening, closing = rng.choice(kinds)
    middle = opening * depth + rng.choice((b"", b"1")) + closing * rng.choice((depth, depth - 1, 0))
    place = rng.randrange(len(data) + 1)
    return rng.choice((middle, data[:place] + middle + data[place:]))


def laughed(data: bytes, rng: Random) -> bytes:
    """YAML whose aliases unfold to more than there is room for."""
    levels, width = rng.choice((3, 8, 12, 30)), rng.choice((2, 9, 10))
    rows = [rng.choice(("a0: &a0 [x, x]", "a0: &a0 {x: 1}"))]
    for n in range(1, levels):
        names = ", ".join([f"*a{n - 1}"] * width)
        rows.append(rng.choice((f"a{n}: &a{n} [{names}]", f"a{n}: &a{n} {{<<: [{names}], y{n}: 1}}")))
    if rng.randrange(5) == 0:
        rows = ["a: &a [*a]"]
    key = rng.choice(("features: {colmap: {x: *a%d}}", "fit: *a%d", "cameras: *a%d", "weights: *a%d"))
    return ("\n".join([*rows, key % (levels - 1)]) + "\n").encode() + rng.choice((b"", b"", data))


def jsoned(data: bytes, rng: Random) -> bytes:
    """JSON with other values, keys and lengths."""
    try:
        values = json.loads(data)
    except (ValueError, RecursionError):
        return worded(data, rng)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        values = _with_another(values, rng)
    return json.dumps(values, ensure_ascii=rng.randrange(5) > 0).encode("utf-8", "surrogatepass")


def _with_another(values: Any, rng: Random) -> Any:
    """Plain values with another in one place, or one key gone, more or renamed."""
    if not isinstance(values, dict | list) or not values or rng.randrange(20) == 0:
        return rng.choice(VALUES)
    kind = rng.randrange(20)
    if isinstance(values, list):
        place = rng.randrange(len(values))
        inner = [] if kind < 2 else [_with_another(values[place], rng)]
        return [*values[:place], *inner, *values[place + (kind != 2) :]]
    key = rng.choice(sorted(values))
    changed = dict(values)
    if kind < 2:
        del changed[key]
    elif kind == 2:
        changed[rng.choice(WORDS)] = changed.pop(key)
    elif kind == 3:
        changed[rng.choice(WORDS)] = rng.choice(VALUES)
    else:
        changed[key] = _with_another(values[key], rng)
    return changed


BYTES: Sequence[Mutation] = (cut, flipped, replaced, numbered, spliced)
TEXT: Sequence[Mutation] = (*BYTES, *(worded,) * 4, lined, lined, nested)
YAML: Sequence[Mutation] = (*TEXT, laughed)
JSON: Sequence[Mutation] = (*TEXT, *(jsoned,) * 8)


@st.composite
def spoilt(draw: st.DrawFn, samples: Sequence[bytes], mutations: Sequence[Mutation]) -> bytes:
    """One of the samples after one or several mutations, or now and then noise alone."""
    if draw(st.integers(0, 99)) == 99:
        return draw(st.binary(max_size=400))
    data, rng = draw(st.sampled_from(samples)), draw(st.randoms(use_true_random=True))
    for mutation in draw(st.lists(st.sampled_from(mutations), min_size=1, max_size=3)):
        data = mutation(data, rng)
    return data


def parser(
    samples: Callable[[Path], Sequence[bytes]],
    mutations: Sequence[Mutation],
    *,
    refuses: tuple[type[Exception], ...] = (KnownError,),
    seal: Mutation = lambda data, _: data,
    share: float = 1.0,
) -> Callable[[Callable[[bytes, Path], object]], Callable[[Path], None]]:
    """Makes a test of a function that has `data` parsed, with an empty folder to do it in: samples are taken; what the
    loaded profile of Hypothesis makes of them is taken, or refused in a line by what is in `refuses`, within seconds
    and little memory. `seal` gives data lengths and digests that fit. `share` of the executions of others."""

    def test_of(parse: Callable[[bytes, Path], object]) -> Callable[[Path], None]:
        @pytest.mark.fuzz
        @pytest.mark.filterwarnings("ignore::hypothesis.errors.HypothesisWarning")  # of large data
        def test(tmp_path: Path) -> None:
            sound = samples(tmp_path)
            assert settings.default is not None
            count = round(settings.default.max_examples * SHARE * share)

            @settings(max_examples=count, suppress_health_check=list(HealthCheck))
            @given(spoilt(sound, mutations), st.randoms(use_true_random=True))
            def is_taken_or_refused(data: bytes, rng: Random) -> None:
                _is_taken(parse, seal(data, rng), tmp_path / "work", refuses)

            taken = [_is_taken(parse, seal(data, Random(0)), tmp_path / "work", refuses) for data in sound]
            assert any(taken)
            is_taken_or_refused()

        return test

    return test_of


def file(name: str, read: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    """Has `data` read from a file of that name."""

    def parse(data: bytes, folder: Path) -> object:
        (folder / name).write_bytes(data)
        return read(folder / name)

    return parse


class TooLong(BaseException):
    """No parser catches it."""


def _is_taken(
    parse: Callable[[bytes, Path], object], data: bytes, folder: Path, refuses: tuple[type[Exception], ...]
) -> bool:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    try:
        with _limits():
            parse(data, folder)
    except refuses as error:
        assert "\n" not in str(error).strip()
        return False
    except TooLong as error:
        raise TooLong(f"more than {SECONDS} s, at {error}, for {data[:300]!r}") from None
    return True


@contextmanager
def _limits() -> Iterator[None]:
    def stop(_: int, frame: FrameType | None) -> None:
        raise TooLong(str(frame))

    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, hard))
    signal.signal(signal.SIGALRM, stop)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        resource.setrlimit(resource.RLIMIT_AS, (before, hard))
