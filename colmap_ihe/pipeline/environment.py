"""What a result may depend on besides photographs and options: software, processor, environment. Nothing in it says
whose machine it is."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.native import cuda_devices, pycolmap
from colmap_ihe.machine import threads
from colmap_ihe.machine.libraries import __version__, code_digest, library_versions, package_version

_PACKAGES = (
    *("numpy", "opencv-python-headless", "pillow", "simplejpeg", "isal", "tifffile", "threadpoolctl"),
    *("xatlas", "trimesh"),
    *("PyWavelets", "colour-science", "scipy"),  # of extras, where they are
)
_CPU_INFO = Path("/proc/cpuinfo")
_INSTRUCTIONS = re.compile(r"(sse4|avx|fma|f16c|bmi|amx|asimd|sve|neon)\w*")
_VARIABLES = re.compile(r"(OMP|GOMP|KMP|MKL|OPENBLAS|NPY|OPENCV|CUDA|GLOG|PYTHONHASHSEED|MALLOC)(_\w+)?")
_PLAIN = re.compile(r"[\w.,:;=+ -]{0,80}")
_GIT_SECONDS = 5.0


def versions() -> dict[str, str]:
    """By name, of everything that computes, as far as it is installed."""
    packages = {name: package_version(name) for name in _PACKAGES}
    return {
        "colmap-ihe": __version__,
        "code of colmap-ihe": code_digest(),
        "python": platform.python_version(),
        **library_versions("pycolmap", "opencv", "rawpy", "libraw"),
        "COLMAP": pycolmap.COLMAP_version.removeprefix("COLMAP "),
        **{name: version for name, version in packages.items() if version is not None},
    }


def machine() -> dict[str, Any]:
    """What libraries choose their code by, and how many threads they have."""
    about = _CPU_INFO.read_text(encoding="utf-8", errors="replace") if _CPU_INFO.exists() else ""
    words = {line.partition(":")[0].strip(): line.partition(":")[2].strip() for line in about.splitlines()}
    flags = words.get("flags", words.get("Features", "")).split()
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "libc": " ".join(platform.libc_ver()).strip(),
        "processor": words.get("model name", platform.processor()),
        "instructions": sorted(flag for flag in flags if _INSTRUCTIONS.fullmatch(flag)),
        "linear algebra": threads.blas_libraries(),
        "cuda devices": cuda_devices(),
        "cores": threads.cores(),
    }


def variables() -> dict[str, str]:
    """Those of the environment that libraries listen to. A value that may hold a path is not told."""
    heard = {name: value for name, value in os.environ.items() if _VARIABLES.fullmatch(name)}
    return {name: heard[name] if _PLAIN.fullmatch(heard[name]) else "(not told)" for name in sorted(heard)}


def commit() -> str | None:
    """Of the clone that this package runs from, and whether files in it were changed; None elsewhere."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    said = []
    with suppress(OSError, subprocess.SubprocessError):  # no git, or not its owner's
        for question in (["rev-parse", "HEAD"], ["status", "--porcelain", "--", "colmap_ihe"]):
            asked = ["git", "-C", str(root), *question]
            said.append(
                subprocess.run(asked, capture_output=True, text=True, check=True, timeout=_GIT_SECONDS)
            )
    if len(said) < 2:
        return None
    return said[0].stdout.strip() + (" with changes" if said[1].stdout.strip() else "")
