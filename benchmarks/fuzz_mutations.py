"""Sound bytes made unsound: bits, lengths, cuts and splices of any file; and of text what its grammar allows and nobody
writes. Everything follows from a `random.Random`, so that what was found can be made again."""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from colmap_ihe.errors import KnownError

NUMBERS = (0, 1, 2, 3, 8, 127, 128, 255, 256, 32767, 65535, 1 << 16, (1 << 31) - 1, 1 << 31, (1 << 32) - 1)
WORDS = (
    "", "0", "-1", "1e999", "-1e-320", "nan", ".nan", ".inf", "-.inf", "NaN", "Infinity", "null", "~", "true", "yes",
    "9" * 400, "9" * 5000, "1:59:59", "0x" + "f" * 40, "0b1", "1_000", "2016-13-45", "2016-01-01", "1e3", "é" * 30,
    "\0", "\x1b]0;x\x07", "\u202egpj.exe", "\u2028", "\ufeff", "a\nb", "../" * 9 + "etc/passwd", "/etc/passwd",
    "/dev/zero", "~root", "file:///etc/passwd", "javascript:alert(1)", "</script><script>alert(1)</script>",
    "{{7*7}}", "%s%n", "*", "**", "[", "]", "{", "}", "&a", "*a", "<<", "!!python/object/apply:os.system [id]",
    "!!binary aGk=", "!!set {a, b}", "!!timestamp x", "!!int ''", "!!float ''", "!!bool x", "!!omap [a]", "? [a]\n: b",
    "- - - -", "tcp://example.org:8786", "a" * 300, "x/" * 200,
)  # fmt: skip
"""What stands for a value in text."""
VALUES: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 0.5, -0.0, 10**400, -(10**20), 2**31, 2**53, 2**63, 2**64, float("nan"), float("inf"),
    float("-inf"), "", "x", "\0", "\ud800", "../../up", "/etc/passwd", "a\nb", "\u202e", "1" * 5000, "</script>",
    [], {}, [[]], [None], [0] * 300, {"": None}, {"a": {"b": {}}}, [1, "2", None], {"0": 0},
)  # fmt: skip
"""What stands for a value in JSON."""

Mutation = Callable[[bytes, random.Random], bytes]


def cut(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def flipped(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 64))):
        if changed:
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def replaced(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 2, 8))):
        if changed:
            changed[rng.randrange(len(changed))] = rng.choice((0, 10, 32, 127, 255, rng.randrange(256)))
    return bytes(changed)


def numbered(data: bytes, rng: random.Random) -> bytes:
    """With another number in a field of 2, 4 or 8 bytes, as lengths, counts and offsets are."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 3))):
        kind = rng.choice("HIQ")
        size = struct.calcsize(kind)
        if len(changed) >= size:
            number = rng.choice((*NUMBERS, rng.getrandbits(8 * size), len(data))) & ((1 << 8 * size) - 1)
            place = rng.randrange(len(changed) - size + 1)
            struct.pack_into(
                rng.choice("<>") + kind, changed, place & ~1 if rng.random() < 0.7 else place, number
            )
    return bytes(changed)


def spliced(data: bytes, rng: random.Random) -> bytes:
    """With a piece of itself elsewhere again, or taken out."""
    if len(data) < 2:
        return data * 2
    start = rng.randrange(len(data))
    piece = data[start : start + rng.choice((1, 4, 16, 64, 1024))]
    place = rng.randrange(len(data))
    times = rng.choice((0, 1, 1, 2, 50))
    return data[:place] + piece * times + data[place + rng.choice((0, len(piece))) :]


BYTES: Sequence[Mutation] = (cut, flipped, replaced, numbered, spliced)


def worded(data: bytes, rng: random.Random) -> bytes:
    """Text with another word in the place of one of its own."""
    text = data.decode("utf-8", "replace")
    starts = [i for i, c in enumerate(text) if not c.isspace()] or [0]
    for _ in range(rng.choice((1, 1, 2))):
        start = rng.choice(starts)
        end = start
        while end < len(text) and text[end] not in " \n:,[]{}":
            end += 1
        text = text[:start] + rng.choice(WORDS) + text[end:]
        starts = [i for i, c in enumerate(text) if not c.isspace()] or [0]
    return text.encode("utf-8", "surrogatepass")


def lined(data: bytes, rng: random.Random) -> bytes:
    """Text with lines out of place, twice, gone, or further in."""
    lines = data.split(b"\n")
    for _ in range(rng.choice((1, 2, 5))):
        here, there = rng.randrange(len(lines)), rng.randrange(len(lines))
        what = rng.randrange(4)
        if what == 0:
            lines[here], lines[there] = lines[there], lines[here]
        elif what == 1:
            lines.insert(there, lines[here])
        elif what == 2 and len(lines) > 1:
            del lines[here]
        else:
            lines[here % len(lines)] = b"  " + lines[here % len(lines)]
    return b"\n".join(lines)


def nested(data: bytes, rng: random.Random) -> bytes:
    """Deep brackets, in the middle or alone."""
    depth = rng.choice((5, 30, 200, 3000, 60_000))
    opening, closing = rng.choice(
        ((b"[", b"]"), (b"{a: ", b"}"), (b'{"a":', b"}"), (b"- ", b""), (b"? ", b""))
    )
    middle = opening * depth + rng.choice((b"", b"1")) + closing * rng.choice((depth, depth - 1, 0))
    if rng.random() < 0.5:
        return middle
    place = rng.randrange(len(data) + 1)
    return data[:place] + middle + data[place:]


def laughed(data: bytes, rng: random.Random) -> bytes:
    """YAML whose aliases unfold to more than there is room for."""
    levels, width = rng.choice((3, 8, 12, 30)), rng.choice((2, 9, 10))
    rows = ["a0: &a0 [x, x]" if rng.random() < 0.5 else "a0: &a0 {x: 1}"]
    for n in range(1, levels):
        names = ", ".join([f"*a{n - 1}"] * width)
        rows.append(rng.choice((f"a{n}: &a{n} [{names}]", f"a{n}: &a{n} {{<<: [{names}], y{n}: 1}}")))
    inside = rng.choice(("features: {colmap: {x: *a%d}}", "fit: *a%d", "cameras: *a%d", "weights: *a%d")) % (
        levels - 1
    )
    if rng.random() < 0.2:
        rows = ["a: &a [*a]"]
    return ("\n".join([*rows, inside]) + "\n").encode() + (data if rng.random() < 0.3 else b"")


TEXT: Sequence[Mutation] = (*BYTES, worded, worded, worded, worded, lined, lined, nested)
YAML: Sequence[Mutation] = (*TEXT, laughed)


def jsoned(data: bytes, rng: random.Random) -> bytes:
    """JSON with other values, keys and lengths."""
    try:
        values = json.loads(data)
    except (ValueError, RecursionError):
        return worded(data, rng)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        values = with_another(values, rng)
    return json.dumps(values, ensure_ascii=rng.random() < 0.8).encode("utf-8", "surrogatepass")


def with_another(values: Any, rng: random.Random) -> Any:
    """Plain values with another in one place, or one key gone, more or renamed."""
    if not isinstance(values, dict | list) or not values or rng.random() < 0.05:
        return rng.choice(VALUES)
    if isinstance(values, list):
        place = rng.randrange(len(values))
        inner = with_another(values[place], rng)
        how = rng.random()
        rest = values[:place] if how < 0.1 else [*values[:place], inner]
        return rest + (values[place:] if how > 0.95 else values[place + 1 :])
    key = rng.choice(sorted(values))
    how = rng.random()
    changed = dict(values)
    if how < 0.08:
        del changed[key]
    elif how < 0.12:
        changed[str(rng.choice(WORDS))] = changed.pop(key)
    elif how < 0.16:
        changed[str(rng.choice(WORDS))] = rng.choice(VALUES)
    else:
        changed[key] = with_another(values[key], rng)
    return changed


JSON: Sequence[Mutation] = (*TEXT, jsoned, jsoned, jsoned, jsoned, jsoned, jsoned, jsoned, jsoned)


def mutated(samples: Sequence[bytes], mutations: Sequence[Mutation], rng: random.Random) -> bytes:
    """One of the samples after one or several mutations, or now and then noise alone."""
    if rng.random() < 0.01:
        return rng.randbytes(rng.choice((0, 1, 16, 400)))
    data = rng.choice(samples)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(mutations)(data, rng)
    return data


def plain(data: bytes, _rng: random.Random) -> bytes:
    """As it is."""
    return data


Refused = tuple[type[BaseException], ...]


@dataclass(frozen=True)
class Target:
    """`parse` is given the bytes and an empty folder to put them into, and may raise what is in `refuses`: nothing
    else. `made` gives the bytes of an execution."""

    name: str
    samples: Callable[[], Sequence[bytes]]
    mutations: Sequence[Mutation]
    parse: Callable[[bytes, Path], object]
    refuses: Refused = (KnownError,)
    finish: Callable[[bytes, random.Random], bytes] = plain
    share: float = 1.0
    """Of the executions: a tenth for one that takes ten times as long as others."""

    def made(self, samples: Sequence[bytes], rng: random.Random) -> bytes:
        return self.finish(mutated(samples, self.mutations, rng), rng)
