"""colmap-ihe: one grey conversion fitted to the whole set of photographs, in front of COLMAP."""

# zlib before pycolmap, which else binds the system's zlib to its own symbols (docs/decisions/0003).
import zlib  # noqa: F401
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from colmap_ihe.errors import KnownError
    from colmap_ihe.grey.convert import to_grey
    from colmap_ihe.grey.histogram import Histogram
    from colmap_ihe.grey.ihe import fit_weights
    from colmap_ihe.grey.weights import Weights
    from colmap_ihe.machine.libraries import __version__
    from colmap_ihe.pipeline.convert_folder import convert_folder
    from colmap_ihe.pipeline.reconstruct import Reconstruction, reconstruct
    from colmap_ihe.pipeline.status import status
    from colmap_ihe.project.options import Options
    from colmap_ihe.project.options_file import load_options

__all__ = [
    "Histogram",
    "KnownError",
    "Options",
    "Reconstruction",
    "Weights",
    "__version__",
    "convert_folder",
    "fit_weights",
    "load_options",
    "reconstruct",
    "status",
    "to_grey",
]

_HOMES = {
    "Histogram": "grey.histogram",
    "KnownError": "errors",
    "Options": "project.options",
    "Reconstruction": "pipeline.reconstruct",
    "Weights": "grey.weights",
    "__version__": "machine.libraries",
    "convert_folder": "pipeline.convert_folder",
    "fit_weights": "grey.ihe",
    "load_options": "project.options_file",
    "reconstruct": "pipeline.reconstruct",
    "status": "pipeline.status",
    "to_grey": "grey.convert",
}


def __getattr__(name: str) -> Any:
    """The public names, imported when first asked for: a decoder needs few modules, and not pycolmap's."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
