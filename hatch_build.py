"""Compiles the inner loops of the grey room as the package is built.

The compiler is Zig's, which comes as a wheel, so that an installation from source needs none on the machine.
What it makes is a plain shared library without Python in it: one wheel serves every Python of a platform.
"""

import platform
import re
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SOURCE = "colmap_ihe/grey/kernels.c"
LIBRARY = "colmap_ihe/grey/libkernels.so"
GLIBC = "2.17"


class KernelsHook(BuildHookInterface):
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if self.target_name != "wheel":
            return
        machine = platform.machine()
        linux = sys.platform == "linux"
        target = ["-target", f"{machine}-linux-gnu.{GLIBC}"] if linux else []
        root = Path(self.root)
        command = [
            sys.executable,
            "-m",
            "ziglang",
            "cc",
            "-O3",
            "-Wall",
            "-Wextra",
            "-Werror",
            "-shared",
            "-fPIC",
        ]
        # contraction to fused operations would still be exact: all sums are integers that float32 holds
        subprocess.run([*command, *target, "-o", str(root / LIBRARY), str(root / SOURCE)], check=True)
        other = re.sub(r"[-.]", "_", sysconfig.get_platform())
        tag = f"manylinux_{GLIBC.replace('.', '_')}_{machine}" if linux else other
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{tag}"
        build_data["artifacts"].append(LIBRARY)
