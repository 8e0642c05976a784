"""Write a table as CSV and as LaTeX."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

_LATEX = {
    "\\": r"\textbackslash{}",
    **{c: f"\\{c}" for c in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}


@dataclass(frozen=True)
class Table:
    """Hold rows of as many texts as there are columns; the first column names the row. `name` is short, for a file."""

    name: str
    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]

    def as_csv(self) -> str:
        """Return the columns and rows as CSV."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([self.columns, *self.rows])
        return text.getvalue()

    def as_latex(self) -> str:
        """Return a tabular in the style of booktabs, with its caption."""
        head, *body = [" & ".join(map(_escaped, row)) + r" \\" for row in (self.columns, *self.rows)]
        caption = rf"\caption{{{_escaped(self.title)}}}"
        begin = [r"\begin{table}", caption, rf"\begin{{tabular}}{{l{'r' * (len(self.columns) - 1)}}}"]
        end = [r"\bottomrule", r"\end{tabular}", r"\end{table}", ""]
        return "\n".join([*begin, r"\toprule", head, r"\midrule", *body, *end])


def _escaped(text: str) -> str:
    return "".join(_LATEX.get(c, c) for c in text)
