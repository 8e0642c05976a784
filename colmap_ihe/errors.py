"""Name what can go wrong, as a small tree.

Every message says what came, what was expected and what to do; `hint` is that last part. The command line prints a
`KnownError` in one line and exits with 1; anything else is a bug and keeps its traceback.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class KnownError(Exception):
    """Report a failure with a known cause: `str(error)` is the cause, `error.hint` what to do about it."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.hint = hint


class OptionError(KnownError):
    """Report something in project.yaml or `--set` that is not an option."""


class PhotographError(KnownError):
    """Report a photograph that cannot be used; the run may go on without it."""


class ProjectError(KnownError):
    """Report a project folder that lacks what a run needs, or holds what must not be touched."""


class BusyError(ProjectError):
    """Report that another run works on the project."""


class WeightsError(KnownError):
    """Report a weights file or a triplet of weights that cannot be used."""


class CalibrationFileError(KnownError):
    """Report a calibration file that cannot be used."""


class ControlFileError(KnownError):
    """Report a file of surveyed points, positions or scale bars that cannot be used."""


class DiskFullError(KnownError):
    """Report a disk without room for what is to be written."""


class ShortOfMemoryError(KnownError):
    """Report that memory ran out."""


class MappingError(KnownError):
    """Report that COLMAP ran, and the photographs do not give a model."""


class NativeError(KnownError):
    """Report that COLMAP or another native library failed."""


class CapabilityError(KnownError):
    """Report that this machine or this installation cannot do what was asked for."""


class ClusterError(KnownError):
    """Report that the cluster, or one of its workers, is not there or not fit for the work."""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a hint that names the word most like `word`, empty if none is like it."""
    near = get_close_matches(word, list(known), n=1)
    return f"did you mean {near[0]}?" if near else ""


class Cancelled(Exception):
    """End the work because the user asked to. Not a failure: the command line exits with 130."""
