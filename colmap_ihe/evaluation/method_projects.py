"""Name the methods of a comparison, and make the project of each below `compare/`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import yaml

from colmap_ihe.colmap.calibration_file import CalibratedCamera, write_calibration
from colmap_ihe.errors import OptionError
from colmap_ihe.evaluation.tables import PAPER, SECOND
from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.machine.files import link_or_copy_folder, write_bytes
from colmap_ihe.project.folder import Project
from colmap_ihe.project.option_sections import ClusterOptions
from colmap_ihe.project.options import Options

_CALIBRATION = "camera-calibration.yaml"
"""The copy of the calibration file that was given, in the project of each method."""


def check_names(methods: Sequence[str]) -> None:
    """Raise `OptionError` for a name that is no method."""
    for method in methods:
        if method not in (*CONVERSIONS, PAPER, SECOND) or method == "auto":
            raise OptionError(
                f"no method is called {method!r}",
                hint=f"the methods are {', '.join(m for m in CONVERSIONS if m != 'auto')}, {PAPER}, {SECOND}",
            )


def options_of(method: str, options: Options) -> Options:
    """Return the options of the project of a method: a second grey has `SECOND` alone."""
    guard = {"ihe": "noise", SECOND: "noise", PAPER: "none"}.get(method, options.fit.guard)
    fit = options.fit.model_copy(
        update={
            "method": "ihe" if method in (PAPER, SECOND) else method,
            "guard": guard,
            "measure": False,
            "weights": None,
            "second": options.fit.second if method == SECOND else "none",
        }
    )
    camera = options.camera
    if camera.calibration is not None:
        camera = camera.model_copy(update={"calibration": _CALIBRATION})
    return options.model_copy(update={"fit": fit, "camera": camera, "cluster": ClusterOptions()})


def project_of(
    compared: Project,
    common: Project,
    method: str,
    options: Options,
    calibration: Sequence[CalibratedCamera],
) -> Project:
    """Make the project of a method: its options, and links to all that the user's holds besides photographs. All
    methods share what does not depend on the grey: means of calibration frames, digests of photographs."""
    project = Project.at(common.root / method, compared.images)
    project.records.mkdir(parents=True, exist_ok=True)
    for given in (compared.masks, compared.calibration):
        if given.is_dir():
            link_or_copy_folder(given, project.root / given.name)
    if options.camera.calibration is not None:
        write_calibration(project.root / _CALIBRATION, calibration)
    write_bytes(project.options_file, yaml.safe_dump(options.as_yaml(), sort_keys=False).encode())
    common.masters.mkdir(parents=True, exist_ok=True)
    if not project.masters.exists():
        with suppress(OSError):  # a disk without links: then each method finds them for itself
            project.masters.symlink_to(common.masters, target_is_directory=True)
    for digests in sorted(common.root.glob(f"*/{project.digests_file.relative_to(project.root)}")):
        if not project.digests_file.exists():
            write_bytes(project.digests_file, digests.read_bytes())
    return project
