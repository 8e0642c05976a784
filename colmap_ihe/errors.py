"""What can go wrong, as a small tree.

Every message says what came, what was wanted and what to do; `hint` is that last part. The
command line prints a `KnownError` in one line and exits with 1; anything else is a bug and
keeps its traceback.
"""

from __future__ import annotations


class KnownError(Exception):
    """A failure with a known cause: `str(error)` is the cause, `error.hint` what to do about it."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.hint = hint


class OptionError(KnownError):
    """project.yaml or `--set` holds something that is not an option."""


class PhotographError(KnownError):
    """One photograph cannot be used; the run may go on without it."""


class ProjectError(KnownError):
    """The project folder does not hold what a run needs, or holds what must not be touched."""


class BusyError(ProjectError):
    """Another run is working on the project."""


class WeightsError(KnownError):
    """A weights file or a triplet of weights is not usable."""


class DiskFullError(KnownError):
    """The disk has no room for what is to be written."""


class ShortOfMemoryError(KnownError):
    """Memory ran out."""


class MappingError(KnownError):
    """COLMAP ran, and the photographs do not give a model."""


class NativeError(KnownError):
    """COLMAP or another native library failed."""


class CapabilityError(KnownError):
    """This machine or this installation cannot do what was asked for."""


class ClusterError(KnownError):
    """The cluster, or one of its workers, is not there or not fit for the work."""


class Cancelled(Exception):
    """The user asked to stop. Not a failure: the command line exits with 130."""
