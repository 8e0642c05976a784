"""Read and write weights in a file, for photographs that are to have the same grey."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from colmap_ihe.errors import WeightsError
from colmap_ihe.grey.convert import to_grey
from colmap_ihe.grey.weights import Grey, grey_from_dict
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.project.safe_yaml import read_yaml


def write_weights(file: Path, grey: Grey) -> None:
    text = yaml.safe_dump(grey.as_dict(), sort_keys=False, default_flow_style=None)
    write_bytes(file, text.encode())


def read_weights(file: Path) -> Grey:
    """Read a weights file, as `fit -o` writes it. Raises `WeightsError`."""
    hint = "write one with `colmap-ihe fit IMAGES -o weights.yaml`"
    try:
        values = read_yaml(file)
    except ValueError as error:
        raise WeightsError(f"{file}: cannot be read ({error})", hint=hint) from error
    if isinstance(values, dict) and values.get("weights") is None and "parameters" in values:
        return _read_formula(file, values)
    triplet = values.get("weights") if isinstance(values, dict) else None
    if not isinstance(triplet, list) or len(triplet) != 3 or {type(w) for w in triplet} - {int, float}:
        content = triplet if isinstance(values, dict) else values
        raise WeightsError(
            f"{file}: not a weights file, it holds {content!r:.60}; expected `weights: [r, g, b]`, three numbers",
            hint=hint,
        )
    try:
        return grey_from_dict(values, str(file))
    except WeightsError as error:
        if str(file) in str(error):
            raise
        raise WeightsError(f"{file}: {error}", hint=error.hint) from error


def _read_formula(file: Path, values: dict[str, Any]) -> Grey:
    """Read the conversion that is no triplet, tried on a few pixels."""
    grey = grey_from_dict(values, str(file))
    dark = np.zeros((8, 8, 3), np.uint8 if grey.encoding == "coded" else np.uint16)
    try:
        to_grey(dark, grey)
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise WeightsError(
            f"{file}: {grey.method!r} with {values['parameters']!r:.60} is no conversion of a set",
            hint="write one with `colmap-ihe fit IMAGES --method NAME -o weights.yaml`",
        ) from error
    return grey
