"""Compiles the inner loops of the grey room as the package is built.

The compiler is Zig's, which comes as a wheel, so that an installation from source needs none on the machine.
What it makes is a plain shared library without Python in it: one wheel serves every Python of a platform. It has one
name on all of them, as ctypes loads it by its path. `scripts/wheels` names other platforms than this one's.
"""

import os
import platform
import re
import subprocess
import sys
import sysconfig
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SOURCE = "colmap_ihe/grey/kernels.c"
LIBRARY = "colmap_ihe/grey/libkernels.so"
PLATFORM = "COLMAP_IHE_PLATFORM"  # in the environment: one of TARGETS
TARGETS = {
    "manylinux_2_17_x86_64": "x86_64-linux-gnu.2.17",
    "manylinux_2_17_aarch64": "aarch64-linux-gnu.2.17",
    "musllinux_1_2_x86_64": "x86_64-linux-musl",
    "musllinux_1_2_aarch64": "aarch64-linux-musl",
    "macosx_11_0_arm64": "aarch64-macos.11.0",
    "macosx_11_0_x86_64": "x86_64-macos.11.0",
    "win_amd64": "x86_64-windows-gnu",
    "win_arm64": "aarch64-windows-gnu",
}
"""Zig's names by the tags of wheels."""
SYSTEMS = {"linux": "manylinux_2_17", "musl": "musllinux_1_2", "darwin": "macosx_11_0", "win32": "win"}


def this_platform() -> str:
    """Return the tag of the machine itself: a Python of two architectures has a tag for both, and the library one."""
    musl = sys.platform == "linux" and platform.libc_ver()[0] != "glibc"
    return f"{SYSTEMS.get('musl' if musl else sys.platform, sys.platform)}_{platform.machine().lower()}"


class KernelsHook(BuildHookInterface):
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if self.target_name != "wheel":
            return
        tag = os.environ.get(PLATFORM) or this_platform()
        target = ["-target", TARGETS[tag]] if tag in TARGETS else []
        # contraction to fused operations would still be exact: all sums are integers that float32 holds
        strict = ["-O3", "-Wall", "-Wextra", "-Werror"]
        command = [sys.executable, "-m", "ziglang", "cc", *strict, "-shared", "-fPIC", "-s", *target]
        # names as seen from the root, for macOS writes the library's own into it
        subprocess.run([*command, "-o", LIBRARY, SOURCE], cwd=self.root, check=True)
        if not target:
            tag = re.sub(r"[-.]", "_", sysconfig.get_platform())
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{tag}"
        build_data["artifacts"].append(LIBRARY)
