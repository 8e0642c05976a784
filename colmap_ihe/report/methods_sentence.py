"""Say for a methods section what was done to the photographs: no more than was, and no other thing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.grey.weights import is_rec709
from colmap_ihe.project.options import Options
from colmap_ihe.report.tables import weights_in_words

CITATION = (
    "Intensity histogram equalisation, a colour-to-grey conversion strategy improving photogrammetric reconstruction"
    " of urban architectural heritage (2016)"
)
_IHE = "intensity histogram equalisation (IHE)"
_DEFAULT = "COLMAP's default grey, Rec.709"
_OF_LINEAR = "Rec.709 after white balance"
_OF_AUTO = {"ihe": f"{_IHE} with a guard against noise", "ihe of the paper": _IHE, "rec709": _DEFAULT}


def methods_sentence(summary: Mapping[str, Any], options: Options, pycolmap_version: str) -> str:
    """Return the sentence, from `summary.summarise` of the run."""
    driven = f"with COLMAP (pycolmap {pycolmap_version}) driven by colmap-ihe"
    done = f", and reconstructed {driven}" if summary["registered_images"] is not None else " by colmap-ihe"
    return (
        f"The photographs were converted to grey by {_conversion(summary, options)}{_second(summary)}{done}"
        f"{_cameras(summary)}{_dense(summary)}."
    )


def citation(summary: Mapping[str, Any], options: Options) -> str:
    """Return the paper of IHE where IHE had a say in the grey, else nothing."""
    auto = options.fit.method == "auto" and (summary["tried"] or {}).get("chosen", "").startswith("ihe")
    fitted = options.fit.method == "ihe" and options.fit.weights is None
    return CITATION if auto or fitted else ""


def is_default(summary: Mapping[str, Any]) -> bool:
    """Tell whether the grey of the set is that which COLMAP makes of colour by itself."""
    every = summary["weights_by_encoding"]
    return bool(every) and all(
        encoding == "coded" and weights is not None and is_rec709(weights)
        for encoding, weights in every.items()
    )


def _conversion(summary: Mapping[str, Any], options: Options) -> str:
    """Name the conversion, with the weights of each kind of photograph."""
    method = options.fit.method
    return f"{_scope(summary, method)}, {_how(summary, options)}{_weights(summary)}"


def _scope(summary: Mapping[str, Any], method: str) -> str:
    if method in CONVERSIONS and CONVERSIONS[method].scope == "image":
        return "a conversion that is fitted to each photograph by itself"
    if len(summary["weights_by_encoding"]) > 1:
        return "one conversion for all raw photographs and another for all gamma-coded ones"
    return "one conversion for the whole set"


def _how(summary: Mapping[str, Any], options: Options) -> str:
    fit = options.fit
    if fit.weights is not None:
        return "with weights that were given and not fitted to these photographs"
    if fit.method == "auto":
        return _best_of_trial(summary["tried"] or {})
    if fit.method != "ihe":
        return _DEFAULT if fit.method == "rec709" else f"the method {fit.method}"
    if fit.guard != "noise":
        return _IHE
    if (summary["tried"] or {}).get("fitted"):
        return _kept_by_trial(summary["tried"])
    if is_default(summary):
        return f"{_DEFAULT}, which of the weights that a guard against noise admits came out best by {_IHE}"
    return f"{_IHE} with a guard against noise"


def _kept_by_trial(tried: Mapping[str, Any]) -> str:
    fitted, confirmed = f"{_IHE} with a guard against noise", tried.get("held_out") or tried
    default = _OF_LINEAR if "after white balance" in tried["in_words"] else _DEFAULT
    if tried.get("reason") or not confirmed["pairs"]:
        return f"{default}, since there were too few pairs of photographs to try the weights of {fitted} on"
    pairs = f"{len(confirmed['pairs'])} pairs of the photographs"
    was = "were clearly worse" if default == _OF_LINEAR else "were not clearly better"
    return f"{default}, since the weights of {fitted} {was} on {pairs}"


def _best_of_trial(tried: Mapping[str, Any]) -> str:
    name, pairs = str(tried.get("chosen", "ihe")), len(tried.get("pairs", ()))
    grey = _OF_AUTO.get(name, f"the candidate {name}")
    if not pairs:
        return f"{grey}, since no pair of photographs was there to try others on"
    on = f"{pairs} pair{'s' if pairs > 1 else ''} of the photographs"
    if name == "rec709":
        return f"{grey}: no other candidate was clearly better on {on}"
    return f"{grey}, of all candidates that with most verified matches on {on}"


def _weights(summary: Mapping[str, Any]) -> str:
    every = {kind: w for kind, w in summary["weights_by_encoding"].items() if w is not None}
    if len(every) == 1 and len(summary["weights_by_encoding"]) == 1:
        return f" ({weights_in_words(next(iter(every.values())))})"
    kinds = {"linear": "raw", "coded": "gamma-coded"}
    named = [f"{kinds[kind]}: {weights_in_words(w)}" for kind, w in sorted(every.items())]
    return f" ({'; '.join(named)})" if named else ""


def _second(summary: Mapping[str, Any]) -> str:
    """Name the second grey, where there is one."""
    second = summary["second_grey"]
    if second is None:
        return ""
    weights = " ".join(f"{weight:+.2f} {name}" for weight, name in zip(second["weights"], "RGB", strict=True))
    return f", with a second grey of the set ({weights}) for features and stereo where the first shows little detail"


def _cameras(summary: Mapping[str, Any]) -> str:
    """Name the camera models of those that were calibrated by the photographs."""
    models = sorted({c["model"] for c in summary["cameras"] or () if c["by"] == "calibration"})
    if not models:
        return ""
    named = f"camera model{'s' if len(models) > 1 else ''} {' and '.join(models)}"
    return f", with cameras calibrated by the photographs themselves ({named})"


def _dense(summary: Mapping[str, Any]) -> str:
    if not summary["dense_points"] or summary["dense_backend"] != "sgm":
        return ""
    return "; depth maps are by semi-global matching on the CPU, and were fused by COLMAP"
