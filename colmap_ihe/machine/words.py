"""Put counts and lists of names into sentences."""

from __future__ import annotations

from collections.abc import Collection
from itertools import islice

SHOWN = 5
"""Names of a list that a sentence holds."""


def listed(names: Collection[str], shown: int = SHOWN, separator: str = ", ") -> str:
    """Return the first names, and how many more there are: "a, b and 3 more"."""
    first = separator.join(islice(names, shown))
    more = len(names) - shown
    return f"{first}{separator.rstrip(', ')} and {more} more" if more > 0 else first


def counted(count: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun: "1 photograph", "2 photographs"."""
    return f"{count} {noun if count == 1 else plural or noun + 's'}"
