"""Read the pairs of photographs that the user chose: a file of two names a line, as COLMAP's lists of pairs."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

from colmap_ihe.errors import OptionError
from colmap_ihe.machine.files import read_at_most

_LINE_END = re.compile("\r\n|\r|\n")  # and not the separators of lines that a name may hold
_MOST_BYTES = 100_000_000
_LONGEST = 10_000  # characters of a line: of names that a file can have, two are shorter


def read_pairs(file: Path, names: Collection[str]) -> set[frozenset[str]]:
    """Return the pairs in `file`, each of two of `names`, which may hold spaces.

    Empty lines and those that begin with # do not count. Raises `OptionError`, which names the line.
    """
    hint = "two names of photographs a line, as below images/, with a space between"
    try:
        lines = _LINE_END.split(read_at_most(file, _MOST_BYTES).decode("utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise OptionError(f"{file}: cannot be read ({reason})", hint=hint) from error
    photographs = set(names)
    chosen = set()
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if text and not text.startswith("#"):
            pair = _pair(text, photographs) if len(text) <= _LONGEST else None
            if pair is None:
                raise OptionError(f"{file}: line {number}, {text!r:.80}, is not two photographs", hint=hint)
            chosen.add(pair)
    if not chosen:
        raise OptionError(f"{file}: names no pair", hint=hint)
    return chosen


def _pair(text: str, photographs: set[str]) -> frozenset[str] | None:
    for at, letter in enumerate(text):
        if letter.isspace():
            pair = frozenset((text[:at].strip(), text[at:].strip()))
            if len(pair) == 2 and pair <= photographs:
                return pair
    return None
