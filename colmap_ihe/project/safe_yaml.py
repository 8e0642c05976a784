"""Read YAML as people write it, and nothing else: bounded in size, depth and what its aliases unfold to."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from colmap_ihe.machine.files import read_at_most

_MOST_BYTES = 1_000_000  # of a file
_MOST_NODES = 100_000  # keys and values, with aliases unfolded
_DEEPEST = 24
_LONGEST = 10_000  # characters of one key or value
_BROKEN = (
    yaml.YAMLError,
    ValueError,  # numbers of thousands of digits, dates that there are not
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    OverflowError,
    RecursionError,
)
"""What PyYAML raises for tags that do not fit their values, and for deep nesting."""


def parse_yaml(text: str) -> Any:
    """Return plain values: nothing in it is run or opened. Raises ValueError, in one line, for what is no YAML,
    unfolds to more than a person writes, or holds characters that are no text."""
    try:
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
            if node is None:
                return None
            _weigh(node, {})
            values = loader.construct_document(node)
        finally:
            loader.dispose()
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except _BROKEN as error:
        raise ValueError(" ".join(str(error).split())[:300] or type(error).__name__) from error
    refuse_no_text(values)
    return values


def read_yaml(path: Path) -> Any:
    """Return `parse_yaml` of a file. Raises ValueError, in one line, where it cannot be read too."""
    try:
        return parse_yaml(read_at_most(path, _MOST_BYTES).decode("utf-8"))
    except OSError as error:
        raise ValueError(error.strerror or str(error)) from error


def refuse_no_text(values: Any) -> None:
    """Raise ValueError for control characters or halves of characters, which no name, path or EXIF can have."""
    for text in _texts(values):
        if any(unicodedata.category(c) in ("Cc", "Cs") and c not in "\t\n\r" for c in text):
            raise ValueError(f"{text!a:.60} holds characters that are no text")


def _texts(values: Any) -> Iterator[str]:
    if isinstance(values, str):
        yield values
    elif isinstance(values, Mapping):
        for key, value in values.items():
            yield from _texts(key)
            yield from _texts(value)
    elif isinstance(values, list | tuple | set):
        for value in values:
            yield from _texts(value)


class _Loader(yaml.SafeLoader):
    """Use PyYAML's own parser, not libyaml's: it raises where the stack of that one would overflow."""

    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self._depth += 1
        if self._depth > _DEEPEST:
            raise ValueError(f"it is nested more than {_DEEPEST} levels deep")
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1


def _weigh(node: yaml.Node, known: dict[int, tuple[int, int] | None]) -> tuple[int, int]:
    """Count the nodes that it unfolds to, and how deep; each is looked at once, however often it is named."""
    found = known.get(id(node), (0, 0))
    if found is None:
        raise ValueError("an alias stands inside of what it names")
    if found[0]:
        return found
    known[id(node)] = None
    count, depth = 1, 0
    if isinstance(node, yaml.ScalarNode):
        if len(node.value) > _LONGEST:
            raise ValueError(f"a value of {len(node.value)} characters, expected at most {_LONGEST}")
    else:
        is_mapping = isinstance(node, yaml.MappingNode)
        parts = [one for pair in node.value for one in pair] if is_mapping else node.value
        for part in parts:
            inner, below = _weigh(part, known)
            count, depth = count + inner, max(depth, below + 1)
            if count > _MOST_NODES:
                raise ValueError(f"its aliases unfold to more than {_MOST_NODES} values")
            if depth > _DEEPEST:
                raise ValueError(f"its aliases unfold to more than {_DEEPEST} levels")
    known[id(node)] = count, depth
    return count, depth
