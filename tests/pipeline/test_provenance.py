"""Where a model comes from, as W3C PROV."""

from __future__ import annotations

from pathlib import Path

from colmap_ihe.machine.files import read_json
from colmap_ihe.pipeline.provenance import provenance


def test_files_lead_back_to_photographs_stages_and_software() -> None:
    run = {"photographs": {"a.dng": "d1"}, "control": {"points.csv": "d2"}, "versions": {"pycolmap": "4.2.1"}}
    stage = {"options": {}, "seconds": 1.0, "fingerprint": "f"}
    records = {
        "captures": stage,
        "survey": {**stage, "made": {"workspace/metric/images.bin": [1, 2, "d"]}},
    }
    document = provenance(run, records)
    assert document["entity"]["project:images/a.dng"]["project:digest"] == "d1"
    read = {(u["prov:activity"], u["prov:entity"]) for u in document["used"].values()}
    assert read == {
        ("project:stage/captures", "project:images/a.dng"),
        ("project:stage/survey", "project:control/points.csv"),
    }
    assert list(document["wasGeneratedBy"].values()) == [
        {"prov:entity": "project:workspace/metric/images.bin", "prov:activity": "project:stage/survey"}
    ]
    assert list(document["wasInformedBy"].values()) == [
        {"prov:informed": "project:stage/survey", "prov:informant": "project:stage/captures"}
    ]
    versions = document["agent"]["software:colmap-ihe"]["software:versions"]
    assert versions == {"pycolmap": "4.2.1"}


def test_a_run_leaves_it_beside_its_records(finished: Path) -> None:
    document = read_json(finished / "records/provenance.json")
    assert document is not None
    made = {g["prov:entity"] for g in document["wasGeneratedBy"].values()}
    assert "project:workspace/sparse/0/cameras.bin" in made
