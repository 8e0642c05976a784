"""Pack arrays of whole numbers as text for the viewer, which unpacks them in `viewer/data.js`.

Each column is stored as differences from row to row. They are made unsigned (0, -1, 1, -2 become 0, 1, 2, 3), cut into
bytes, all lowest bytes first, and compressed by zlib. Neighbouring vertices and triangles differ little, so most bytes
are near zero.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

_LEVEL = 6  # of zlib: 9 takes four times as long for 2 % less


def packed(values: NDArray[np.integer[Any]]) -> dict[str, Any]:
    """Return (N,) or (N, K) whole numbers below 2**30 for JSON: `data` in base64, `width` K, `bytes` of each."""
    columns = np.asarray(values, np.int64)
    columns = columns.reshape(len(values), columns.shape[1] if columns.ndim > 1 else 1)
    differences = np.diff(columns, axis=0, prepend=0)
    unsigned = np.where(differences < 0, -2 * differences - 1, 2 * differences).T
    size = max(1, (int(unsigned.max(initial=0)).bit_length() + 7) // 8)
    planes = [((unsigned >> (8 * n)) & 255).astype(np.uint8).tobytes() for n in range(size)]
    data = base64.b64encode(zlib.compress(b"".join(planes), _LEVEL)).decode("ascii")
    return {"data": data, "width": columns.shape[1], "bytes": size}
