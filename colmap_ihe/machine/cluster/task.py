"""Describe what a worker runs: a function, on terms that it checks first: the same software, and the same folders."""

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
from colmap_ihe.machine.cluster.lease import held
from colmap_ihe.machine.libraries import __version__, code_digest, library_versions, package_version, pycolmap
from colmap_ihe.machine.progress import stoppable

GO_ON = "the same command goes on from here"
SAME_ENVIRONMENT = "install the same environment on every worker; see docs/cluster.md"
_PACKAGES = ("numpy", "pillow", "simplejpeg", "isal", "tifffile", "pydantic", "dask", "distributed")
_OPTIONAL = ("PyWavelets", "colour-science")


@lru_cache(maxsize=1)
def environment() -> tuple[tuple[str, str], ...]:
    """Return name and version of all that a result may depend on, the digest of this package's code among it."""
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
    """Hold what a worker must have: the lease of the run, the paths in `needs`, and the client's environment."""

    lease: Path
    needs: tuple[Path, ...]
    environment: tuple[tuple[str, str], ...]

    def check(self, worker: str) -> None:
        """Raise `ClusterError` that names the worker and what differs there or is missing."""
        installed = dict(environment())
        for name, expected in self.environment:
            if installed.get(name) != expected:
                raise ClusterError(
                    f"worker {worker}: {name} is {installed.get(name)} there, expected {expected} as on this machine",
                    hint=SAME_ENVIRONMENT,
                )
        folder = self.lease.parent.parent
        for path in (folder, self.lease, *self.needs):
            if not path.exists():
                missing = (
                    path if path != self.lease else f"{folder} of this run, only another of the same name,"
                )
                raise ClusterError(
                    f"worker {worker}: there is no {missing} there",
                    hint="workers need the project's folder and the photographs under the same paths as here",
                )


@dataclass(frozen=True)
class Task:
    """Hold a call of `function` for a worker."""

    terms: Terms
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    keywords: dict[str, Any]

    def __call__(self) -> Any:
        """Return what `function` returns. Errors name the worker, those of a photograph do not. Raises `Cancelled`
        when the run is over."""
        _check_once(self.terms)
        try:
            with held(self.terms.lease) as over, stoppable(over):
                return self.function(*self.arguments, **self.keywords)
        except PhotographError:
            raise
        except KnownError as error:
            raise type(error)(f"worker {_this_worker()}: {error}", error.hint) from error
        except OSError as error:
            file = f"{error.filename}: " if error.filename else ""
            raise ClusterError(
                f"worker {_this_worker()}: {file}{error.strerror or error}", hint=GO_ON
            ) from error


@lru_cache(maxsize=64)
def _check_once(terms: Terms) -> None:
    terms.check(_this_worker())


def check_terms(terms: Terms, dask_worker: Any = None) -> None:
    """Call `Terms.check` on a worker; `Client.run` passes the worker in `dask_worker`."""
    terms.check(_with_machine(dask_worker.name))


def _this_worker() -> str:
    from distributed import get_worker  # only workers have to have it

    return _with_machine(get_worker().name)


def _with_machine(name: object) -> str:
    return f"{name} on {socket.gethostname()}"
