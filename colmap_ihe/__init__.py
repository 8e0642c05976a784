"""Fit one grey conversion to a whole set of photographs, in front of COLMAP."""

# zlib before pycolmap, which else binds the system's zlib to its own symbols (docs/decisions/0003).
import zlib  # noqa: F401
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from colmap_ihe.errors import KnownError as KnownError
    from colmap_ihe.grey.convert import to_grey as to_grey
    from colmap_ihe.grey.histogram import Histogram as Histogram
    from colmap_ihe.grey.ihe import fit_weights as fit_weights
    from colmap_ihe.grey.weights import Weights as Weights
    from colmap_ihe.machine.libraries import __version__ as __version__
    from colmap_ihe.pipeline.convert_folder import convert_folder as convert_folder
    from colmap_ihe.pipeline.reconstruct import Reconstruction as Reconstruction
    from colmap_ihe.pipeline.reconstruct import reconstruct as reconstruct
    from colmap_ihe.pipeline.status import status as status
    from colmap_ihe.project.options import Options as Options
    from colmap_ihe.project.options_file import load_options as load_options

_MODULES = {
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
__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for: a decoder needs few modules, and not pycolmap's."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
