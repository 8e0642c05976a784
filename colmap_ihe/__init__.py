"""colmap-ihe: one grey conversion fitted to the whole set of photographs, in front of COLMAP."""

# zlib before pycolmap, which else binds the system's zlib to its own symbols (docs/decisions/0003).
import zlib  # noqa: F401

from colmap_ihe.errors import KnownError
from colmap_ihe.grey.convert import to_grey
from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.grey.ihe import fit_weights
from colmap_ihe.grey.weights import Weights
from colmap_ihe.grey_folder import convert_folder
from colmap_ihe.options import Options, load_options
from colmap_ihe.pipeline import Reconstruction, reconstruct, status
from colmap_ihe.version import __version__

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
