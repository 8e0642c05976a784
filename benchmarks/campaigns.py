"""Use the weights of one campaign on the photographs of another: how far they fall short, and what the user is told.

    python benchmarks/campaigns.py [coded] [linear] [recount]

Each set is cut into two halves, every other photograph: weights of one half on the other are what must not be warned
of. `linear` is the demo's RAW and RAW made of three photographs of fountain-p11 in several exposures and lights;
`recount` compares linear weights from the histogram alone with those counted at full depth.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from guard_sets import DATA, raw_set

from colmap_ihe.commandline.bars import print_table
from colmap_ihe.evaluation.demo.render import render_demo
from colmap_ihe.fit.fit_set import fit_captures
from colmap_ihe.fit.weights_file import misfit, warnings_of
from colmap_ihe.grey.ihe import flatness
from colmap_ihe.grey.weights import Weights
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.discover import Capture, discover
from colmap_ihe.project.options import FitOptions


@dataclass(frozen=True)
class Campaign:
    name: str
    site: str
    captures: Sequence[Capture]


def halves(name: str, captures: Sequence[Capture]) -> list[Campaign]:
    return [Campaign(f"{name} {n + 1}/2", name, captures[n::2]) for n in range(2)]


def table(title: str, campaigns: Sequence[Campaign], options: FitOptions) -> None:
    with local_executor() as executor:
        fits = [fit_captures(c.captures, options, executor, SILENT, strict=True) for c in campaigns]
    rows = []
    for of, fit in zip(campaigns, fits, strict=True):
        weights = fit.main
        assert isinstance(weights, Weights)
        for on, other in zip(campaigns, fits, strict=True):
            if of is on:
                continue
            gathered = other.gathered[weights.encoding]
            found = misfit(weights, gathered, options)
            told = warnings_of(weights, gathered, options)
            words = ", ".join(f"{w:.2f}" for w in weights.triplet)
            numbers = ["-" if v is None else f"{v:.3f}" for v in asdict(found).values()]
            kind = "same" if of.site == on.site else "other"
            rows.append((kind, of.name, words, on.name, *numbers, "warned" if told else ""))
    rows.sort(key=lambda row: (row[0] != "same", row[4]))
    columns = ("set", "weights of", "r, g, b", "on", "contrast", "levels", "clipped", "range", "told")
    print_table(title, rows, columns)


def recount(campaigns: Sequence[Campaign]) -> None:
    rows = []
    with local_executor() as executor:
        for campaign in campaigns:
            for guard in ("noise", "none"):
                full, cells = (
                    fit_captures(
                        campaign.captures,
                        FitOptions.model_validate({"guard": guard, "recount": again}),
                        executor,
                        SILENT,
                        strict=True,
                    )
                    for again in (True, False)
                )
                assert isinstance(full.main, Weights)
                assert isinstance(cells.main, Weights)
                histogram = cells.gathered["linear"].histogram
                ratio = flatness(histogram, cells.main.triplet) / flatness(histogram, full.main.triplet)
                rows.append(
                    (campaign.name, guard, str(full.main.triplet), str(cells.main.triplet), f"{ratio:.4f}")
                )
    columns = ("campaign", "guard", "full depth", "histogram alone", "levels, the latter over the former")
    print_table("linear weights without reading photographs again", rows, columns)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", default=["coded", "linear", "recount"])
    parsed = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        render_demo(folder / "demo", views=8, size=(752, 500))
        demo = discover(folder / "demo" / "images").captures
        raw = [c for c in demo if c.kind == "raw"]
        if "coded" in parsed.parts:
            for capture in raw:
                capture.path.unlink()
            coded = halves("demo", discover(folder / "demo" / "images").captures)
            for name in ("fountain-p11", "sceaux", "sacre-coeur"):
                coded += halves(name, discover(DATA / name).captures)
            for guard in ("noise", "none"):
                options = FitOptions.model_validate({"guard": guard})
                table(f"JPEG, guard {guard}", coded, options)
            render_demo(folder / "again", views=8, size=(752, 500))
            raw = [c for c in discover(folder / "again" / "images").captures if c.kind == "raw"]
        if {"linear", "recount"} & set(parsed.parts):
            linear = halves("demo", raw)
            for name, gains, iso, exposure in (
                ("ISO 400", "a", 400, 1.0),
                ("ISO 1600", "a", 1600, 1.0),
                ("half the light", "a", 400, 0.5),
                ("a quarter of it", "a", 400, 0.25),
                ("twice the light", "a", 400, 2.0),
                ("tungsten", "tungsten", 400, 1.0),
            ):
                raw_set("fountain-p11", folder / name, gains, iso, exposure)
                site = "fountain" if "light" not in name and gains == "a" and "quarter" not in name else name
                linear.append(Campaign(f"fountain, {name}", site, discover(folder / name).captures))
            if "linear" in parsed.parts:
                table("RAW, guard noise", linear, FitOptions())
            if "recount" in parsed.parts:
                recount(linear)


if __name__ == "__main__":
    main()
