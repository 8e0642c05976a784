"""What the images are built from: every package pinned, on every Python, and services that exist."""

from __future__ import annotations

import re
from itertools import chain

import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from small_demo import ROOT

PINS = [
    Requirement(line)
    for line in (ROOT / "docker/constraints.txt").read_text(encoding="utf-8").splitlines()
    if line and not line.startswith("#")
]
PROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def listed(start: str) -> list[Requirement]:
    """The requirements in the list that begins with `start` in pyproject.toml."""
    found = re.search(re.escape(start) + r"\[(.*?)\]\n", PROJECT, re.DOTALL)
    assert found is not None, start
    return [Requirement(text) for text in re.findall(r'"([^"]+)"', found[1])]


def extras() -> dict[str, list[Requirement]]:
    section = PROJECT.split("[project.optional-dependencies]")[1].split("\n[")[0]
    names = re.findall(r"^(\w+) = \[", section, re.M)
    return {name: listed(f"\n{name} = ") for name in names if name not in ("docs", "test")}


def test_all_that_an_image_may_hold_is_pinned_for_every_python() -> None:
    wanted = [*listed("\nrequires = "), *listed("\ndependencies = "), Requirement("pycolmap-cuda12")]
    wanted += chain.from_iterable(extras().values())
    assert len(wanted) > 15
    for python in ("3.10", "3.11", "3.12", "3.13"):
        where = {"python_version": python, "python_full_version": f"{python}.1", "sys_platform": "linux"}
        pinned = {
            canonicalize_name(pin.name): str(pin.specifier).removeprefix("==")
            for pin in PINS
            if pin.marker is None or pin.marker.evaluate(where)
        }
        for one in wanted:
            version = pinned.get(canonicalize_name(one.name))
            assert version is not None, f"{one.name} is not pinned for Python {python}: run scripts/pin-image"
            assert one.specifier.contains(version), f"{one} is pinned to {version}: run scripts/pin-image"


def test_both_images_are_built_alike() -> None:
    for name in ("Dockerfile", "Dockerfile.cuda"):
        text = (ROOT / "docker" / name).read_text(encoding="utf-8")
        assert text.count("FROM ") - text.count("# FROM") >= 2
        assert "PIP_CONSTRAINT=/src/docker/constraints.txt" in text
        assert "\nUSER surveyor\n" in text and "HEALTHCHECK" in text and '"colmap-ihe", "doctor"' in text
        (default,) = re.findall(r"^ARG EXTRAS=(.*)$", text, re.M)
        assert set(default.split(",")) <= set(extras())


def test_services_share_an_image_and_a_folder() -> None:
    compose = yaml.safe_load((ROOT / "docker/compose.yaml").read_text(encoding="utf-8"))
    services = compose["services"]
    assert set(services) == {"scheduler", "worker", "batch"}
    assert len({service["image"] for service in services.values()}) == 1
    assert len({str(service["volumes"]) for service in services.values()}) == 1
    assert services["batch"]["command"][:2] == ["batch", "/projects"]
    build = services["worker"]["build"]
    assert (ROOT / "docker" / build["context"] / build["dockerfile"]).is_file()
    assert "cluster" in build["args"]["EXTRAS"].split(",")
