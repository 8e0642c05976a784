"""Store what a fit has counted of a set in a file: sets are pooled from such files, and no photograph is read again.

A line that says what it is, a line with a digest of all that follows, a line of JSON, then the colours of each part
of the set as `kernels.packed` writes them, deflated. Nothing in it is run; whatever is not as it was written is
refused.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from isal import isal_zlib

from colmap_ihe.errors import WeightsError
from colmap_ihe.fit.counting import SetCounts
from colmap_ihe.grey import kernels
from colmap_ihe.grey.contrast import Contrast
from colmap_ihe.grey.histogram import Histogram, Sums
from colmap_ihe.grey.weights import Encoding
from colmap_ihe.machine.files import read_at_most, write_bytes
from colmap_ihe.machine.libraries import __version__

SUFFIX = ".histogram"
_KIND, _VERSION = b"colmap-ihe histogram of a set, version ", b"1"
_MOST_BYTES = 1 << 30
_DIGEST = 16  # bytes
_AGAIN = "write it again with `colmap-ihe fit IMAGES --histogram FILE`"


@dataclass(frozen=True)
class StoredCounts:
    """Hold what was counted of a set: `gathered` by encoding, of `sample` of each side of the photographs;
    `development`: the options that these were developed with, in plain values."""

    gathered: Mapping[Encoding, SetCounts]
    sample: float
    development: Mapping[str, Any]
    source: str = field(default="", compare=False)

    def to_bytes(self) -> bytes:
        parts, bodies = [], []
        for encoding in sorted(self.gathered):
            counts = self.gathered[encoding]
            sums = counts.histogram.sums()
            bodies.append(bytes(isal_zlib.compress(sums.cells, 1)))
            measured = [{"key": key, **contrast.as_dict()} for key, contrast in counts.measured]
            sizes = {"bytes": len(sums.cells), "deflated": len(bodies[-1])}
            parts.append({"sums": sums.head(), **sizes, "photographs": counts.keys, "contrast": measured})
        head = {
            "made_by": f"colmap-ihe {__version__}",
            "sample": self.sample,
            "development": dict(self.development),
            "parts": parts,
        }
        rest = b"\n".join([json.dumps(head, sort_keys=True).encode(), b"".join(bodies)])
        return b"\n".join([_KIND + _VERSION, digest_of(rest), rest])


def write_stored(path: Path, stored: StoredCounts) -> None:
    write_bytes(path, stored.to_bytes())


def read_stored(path: Path) -> StoredCounts:
    """Read a histogram of a set. Raises `WeightsError`, naming the file, for what `write_stored` did not write."""
    try:
        return stored_of(read_at_most(path, _MOST_BYTES), str(path))
    except OSError as error:
        raise WeightsError(f"{path}: cannot be read ({error.strerror})", hint=_AGAIN) from error


def stored_of(data: bytes, source: str) -> StoredCounts:
    """Read a histogram of a set from bytes, as `read_stored`."""
    kind, _, rest = data.partition(b"\n")
    if not kind.startswith(_KIND):
        raise WeightsError(f"{source}: not a histogram of a set", hint=_AGAIN)
    if kind != _KIND + _VERSION:
        version = kind[len(_KIND) :].decode("ascii", "replace")
        raise WeightsError(
            f"{source}: a histogram of version {version[:20]!r}, this colmap-ihe reads {_VERSION.decode()}",
            hint=f"{_AGAIN}, or use the colmap-ihe that wrote it",
        )
    digest, _, rest = rest.partition(b"\n")
    if digest != digest_of(rest):
        raise WeightsError(f"{source}: a damaged histogram: it is not as it was written", hint=_AGAIN)
    line, _, bodies = rest.partition(b"\n")
    try:
        return replace(_stored(json.loads(line), bodies), source=source)
    except (  # type: ignore[misc]
        ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError, isal_zlib.IsalError,
    ) as error:  # fmt: skip
        raise WeightsError(f"{source}: not a histogram of a set ({error!s:.200})", hint=_AGAIN) from error


def _stored(head: Mapping[str, Any], bodies: bytes) -> StoredCounts:
    gathered: dict[Encoding, SetCounts] = {}
    at = 0
    for part in head["parts"]:
        size = part["deflated"]
        if type(size) is not int or not 0 <= size <= len(bodies) - at:
            raise ValueError("its parts do not fit into it")
        sums = Sums(**part["sums"], cells=_inflated(bodies[at : at + size], part["bytes"]))
        at += size
        histogram = Histogram(sums.encoding, sums.weighting)
        histogram.add_sums(sums)
        keys = [_text(key) for key in part["photographs"]]
        measured = [(_text(c["key"]), Contrast.from_dict(c, sums.encoding)) for c in part["contrast"]]
        if len(keys) != sums.images or not sums.images or sums.encoding in gathered:
            raise ValueError(f"{len(keys)} names for {sums.images} photographs")
        measured.sort(key=lambda pair: pair[0])
        gathered[sums.encoding] = SetCounts(histogram, sorted(keys), measured)
    if at != len(bodies) or not gathered:
        raise ValueError("its parts do not fill it")
    sample, development = head["sample"], head["development"]
    if type(sample) not in (int, float) or not 0 < sample <= 1 or not isinstance(development, dict):
        raise ValueError(f"{sample=!r:.40}")
    return StoredCounts(gathered, float(sample), development)


def _inflated(deflated: bytes, size: int) -> bytes:
    """Return `size` bytes out of what was deflated. Raises ValueError or IsalError for fewer or more."""
    if type(size) is not int or not 0 <= size <= kernels.PACKED_BYTES * kernels.CELLS:
        raise ValueError(f"{size!r:.40} bytes of cells")
    unpack = isal_zlib.decompressobj()
    cells = bytes(unpack.decompress(deflated, size + 1))
    if len(cells) != size or not unpack.eof or unpack.unused_data:
        raise ValueError(f"{len(cells)} bytes of cells, expected {size}")
    return cells


def _text(value: object) -> str:
    if not isinstance(value, str) or len(value) > 64:
        raise ValueError(f"{value!r:.40}, expected a short text")
    return value


def digest_of(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=_DIGEST).hexdigest().encode()
