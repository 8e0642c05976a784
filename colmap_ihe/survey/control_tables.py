"""Read tables of a survey, as spreadsheets and other programs write them, and name each line that cannot be read.

Columns are found by their names, in any order and case. They are divided by commas, semicolons or tabs; beside
semicolons and tabs a comma in a number is taken as its point, as spreadsheets in half of Europe write it.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from colmap_ihe.errors import ControlFileError

_SHOWN = 8  # bad lines that a message names
_T = TypeVar("_T")


@dataclass(frozen=True)
class Row:
    """Hold one line of a table by its columns' names. `problems` collects what is wrong in it."""

    line: int
    values: Mapping[str, str]
    comma_is_point: bool
    problems: list[str]

    def text(self, column: str) -> str:
        """Return what a column holds; a problem if that is nothing."""
        value = self.values.get(column, "").strip()
        if not value:
            self.problems.append(f"line {self.line}: {column} is empty")
        return value

    def number(self, column: str, otherwise: float | None = None, *, positive: bool = False) -> float:
        """Return the number in a column, `otherwise` where it is empty or not there; a problem if it is none."""
        value = self.values.get(column, "").strip()
        if not value and otherwise is not None:
            return otherwise
        expected = "a number above 0" if positive else "a number"
        try:
            number = float(value.replace(",", ".") if self.comma_is_point else value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number) or (positive and number <= 0):
            self.problems.append(f"line {self.line}: {column} is {value!r:.40}, expected {expected}")
        return number


def read_table(
    file: Path, required: Sequence[str], optional: Sequence[str], read: Callable[[Row], _T]
) -> list[_T]:
    """Return what `read` makes of each line, without empty ones and those that begin with #. Raises
    `ControlFileError`, which names all that is wrong, where a column is missing or unknown or a line cannot be read."""
    problems: list[str] = []
    results = [read(row) for row in _rows(file, required, optional, problems)]
    refuse(file, problems)
    return results


def refuse(file: Path, problems: Sequence[str]) -> None:
    """Raise `ControlFileError` if there are problems."""
    if problems:
        more = f"; and {len(problems) - _SHOWN} more" if len(problems) > _SHOWN else ""
        raise ControlFileError(
            f"{file}: {'; '.join(problems[:_SHOWN])}{more}",
            hint="mend these lines, or move the file out of control/; docs/survey.md shows each file",
        )


def text_of(file: Path) -> str:
    """Return the text of a file. Raises `ControlFileError` where it is none."""
    try:
        return file.read_text("utf-8-sig")
    except OSError as error:
        raise ControlFileError(
            f"{file}: cannot be read ({error.strerror})", hint="see that it is a file"
        ) from error
    except UnicodeDecodeError as error:
        raise ControlFileError(
            f"{file}: is not text in UTF-8", hint="save it as CSV in UTF-8 (in Excel: CSV UTF-8)"
        ) from error


def _rows(file: Path, required: Sequence[str], optional: Sequence[str], problems: list[str]) -> Iterator[Row]:
    lines = list(enumerate(text_of(file).splitlines(), start=1))
    start = next((n for n, (_, line) in enumerate(lines) if line.strip(" ,;\t")), None)
    if start is None:
        refuse(file, ["is empty, expected a first line with the names of the columns"])
        return
    head = lines[start][1].lstrip("# ")
    delimiter = max(";\t,", key=head.count)
    columns = [name.strip().casefold() for name in next(csv.reader([head], delimiter=delimiter))]
    _check_columns(file, columns, required, optional)
    for number, line in lines[start + 1 :]:
        if not line.strip(f" {delimiter}") or line.lstrip().startswith("#"):
            continue
        cells = next(csv.reader([line], delimiter=delimiter))
        if len(cells) > len(columns) and any(cell.strip() for cell in cells[len(columns) :]):
            problems.append(f"line {number}: has {len(cells)} values, expected {len(columns)}")
            continue
        yield Row(number, dict(zip(columns, cells, strict=False)), delimiter != ",", problems)


def _check_columns(
    file: Path, columns: Sequence[str], required: Sequence[str], optional: Sequence[str]
) -> None:
    missing = [name for name in required if name not in columns]
    unknown = [name for name in columns if name and name not in (*required, *optional)]
    twice = sorted({name for name in columns if name and columns.count(name) > 1})
    problems = [f"has no column {name}" for name in missing]
    problems += [f"has a column {name!r:.40} that is not used" for name in unknown]
    problems += [f"has the column {name} twice" for name in twice]
    expected = ",".join([*required, *(f"[{name}]" for name in optional)])
    refuse(file, [*problems, f"its first line should be {expected}"] if problems else [])
