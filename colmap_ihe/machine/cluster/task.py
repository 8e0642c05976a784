"""What a worker runs: a function, on terms that it checks first: the same software, and the same folders."""

from __future__ import annotations

import platform
import socket
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from colmap_ihe.errors import ClusterError, KnownError, PhotographError
from colmap_ihe.machine import cancel
from colmap_ihe.machine.cluster.lease import held
from colmap_ihe.machine.libraries import __version__, code_digest, library_versions, package_version, pycolmap

_PACKAGES = ("numpy", "pillow", "simplejpeg", "isal", "tifffile", "pydantic", "dask", "distributed")
_OPTIONAL = ("PyWavelets", "colour-science")
_SAME = "install the same environment on every worker; see docs/cluster.md"


@lru_cache(maxsize=1)
def environment() -> tuple[tuple[str, str], ...]:
    """Name and version of everything that a result may depend on, this package's own content among it."""
    return (
        ("Python", ".".join(platform.python_version_tuple()[:2])),
        ("colmap-ihe", __version__),
        *library_versions("pycolmap", "opencv", "rawpy", "libraw").items(),
        *((name, metadata.version(name)) for name in _PACKAGES),
        *((name, package_version(name) or "not installed") for name in _OPTIONAL),
        ("pycolmap with CUDA", str(pycolmap.has_cuda)),
        ("the code of colmap-ihe", code_digest()),
    )


@dataclass(frozen=True)
class Terms:
    """What a worker must have: the environment of the client, the lease of its run, and the paths in `needs`."""

    lease: Path
    needs: tuple[Path, ...]
    environment: tuple[tuple[str, str], ...]

    def check(self, worker: str) -> None:
        """Raises `ClusterError` that names this worker and what is not as it has to be."""
        here = dict(environment())
        for name, wanted in self.environment:
            if here.get(name) != wanted:
                raise ClusterError(
                    f"worker {worker}: {name} is {here.get(name)} there, and {wanted} where it was asked from",
                    hint=_SAME,
                )
        folder = self.lease.parent.parent
        for path in (folder, self.lease, *self.needs):
            if not path.exists():
                seen = path if path != self.lease else f"{folder} of this run, only another of the same name,"
                raise ClusterError(
                    f"worker {worker}: there is no {seen} there",
                    hint="workers need the project's folder and the photographs under the same paths as here",
                )


@dataclass(frozen=True)
class Task:
    """A call of `function` on a worker."""

    terms: Terms
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    keywords: dict[str, Any]

    def __call__(self) -> Any:
        """As the function. Errors name the worker; those of a photograph do not. Raises `Cancelled` when the run
        is over."""
        _checked(self.terms)
        try:
            with held(self.terms.lease) as over, cancel.stoppable(over):
                return self.function(*self.arguments, **self.keywords)
        except PhotographError:
            raise
        except KnownError as error:
            raise type(error)(f"worker {this_worker()}: {error}", error.hint) from error
        except OSError as error:
            place = f"{error.filename}: " if error.filename else ""
            raise ClusterError(
                f"worker {this_worker()}: {place}{error.strerror or error}",
                hint="the same command goes on from here",
            ) from error


@lru_cache(maxsize=64)
def _checked(terms: Terms) -> None:
    terms.check(this_worker())


def check_terms(terms: Terms, dask_worker: Any = None) -> None:
    """As `Terms.check`, for `Client.run`, which says in `dask_worker` where it is."""
    terms.check(_named(dask_worker.name))


def this_worker() -> str:
    """The name that Dask knows this worker by, and its machine."""
    from distributed import get_worker  # only workers have to have it

    return _named(get_worker().name)


def _named(name: object) -> str:
    return f"{name} on {socket.gethostname()}"
