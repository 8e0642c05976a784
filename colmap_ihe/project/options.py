"""Define what a user may set: one frozen model a stage, strict YAML in and out.

The sections are the stages by name, in project.yaml and in `--set stage.option=value` alike. An unknown
key or a wrong type is an `OptionError` that names the file, the key, what came and what was expected.
`colmap:` mappings go to pycolmap's own option classes as they are, which check themselves.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import (
    ConfigDict,
    Field,
    RootModel,
    field_validator,
    model_serializer,
    model_validator,
)

from colmap_ihe.errors import WeightsError
from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.grey.weights import FIXED, triplets
from colmap_ihe.project.option_sections import (
    ClusterOptions,
    DrawingsOptions,
    MachineOptions,
    ReportOptions,
    Section,
    SurveyOptions,
)
from colmap_ihe.project.recipe import Demosaic

ColmapOptions = dict[str, Any]
_Millimetres = Annotated[float, Field(gt=0, le=10_000, allow_inf_nan=False)]


class CapturesOptions(Section):
    strict: bool = False
    """Stop at the first photograph that cannot be used, instead of leaving it out and saying so."""


class DevelopOptions(Section):
    demosaic: Demosaic = "linear"
    """LibRaw's algorithm. `linear` is bilinear, and gives most correct matches."""
    green_equilibrium: bool = True
    """Bring the two greens of a Bayer cell level."""
    find_bad_pixels: bool = False
    """Look for bad pixels over the set, where there are no dark frames to show them."""
    exposure: Literal["as_shot", "normalise"] = "as_shot"
    """`normalise`: RAW as if all were exposed alike, by shutter, aperture and ISO of EXIF."""
    balance: bool = False
    """Bring the mean of each channel of each photograph to that of the set."""
    denoise: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Strength, in standard deviations of the noise; 0 is none."""


class KnownCamera(Section):
    """Hold what is known of a camera whose photographs do not say it."""

    make: Annotated[str, Field(min_length=1)] | None = None
    model: Annotated[str, Field(min_length=1)] | None = None
    focal_length: _Millimetres | None = None
    """In millimetres."""
    sensor_width: _Millimetres | None = None
    """In millimetres, along the longer side of the photograph, of what became its pixels."""
    focal_length_35mm: _Millimetres | None = None
    """The focal length with the same angle of view over the diagonal of 36 x 24 mm, a whole number as in EXIF."""
    override: bool = False
    """Goes over what EXIF says, instead of only filling in what it does not."""

    @field_validator("focal_length_35mm")
    @classmethod
    def _whole_number(cls, value: float | None) -> float | None:
        if value is not None and not value.is_integer():
            raise ValueError("expected a whole number; focal_length and sensor_width are exact")
        return value

    @model_validator(mode="after")
    def _something_known(self) -> KnownCamera:
        if not self.model_fields_set - {"override"}:
            raise ValueError(f"expected some of {', '.join(KnownCamera.model_fields)}")
        return self


class CamerasOptions(RootModel[dict[str, KnownCamera]]):
    """Hold cameras by pattern of the photographs' names; the first that fits a photograph counts for it."""

    model_config = ConfigDict(frozen=True, strict=True)
    root: dict[str, KnownCamera] = Field(default_factory=dict)

    @model_serializer
    def _in_order(self) -> list[tuple[str, dict[str, Any]]]:
        """Return a list, since the order of the patterns counts."""
        return [(pattern, known.model_dump(exclude_none=True)) for pattern, known in self.root.items()]


class FitOptions(Section):
    method: str = "ihe"
    """A name of docs/conversions.md: `ihe`, a fixed triplet, or one of the conversions of other papers."""
    guard: Literal["noise", "none"] = "noise"
    """Of `ihe`. `noise`: only triplets whose detail stands out of their noise about as well as the best one's;
    `none` is the paper to the letter."""
    step: float = 0.01
    """Of the grid of weights: 0.01 is 5,151 triplets, 0.1 is 66."""
    sample: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Of each side of a photograph, nearest neighbour; 0.25 reproduces the paper."""
    weighting: Literal["pixel", "image"] = "pixel"
    recount: bool = True
    """Of RAW: count the likely winners again at full depth, which reads every photograph twice; without it the
    histogram alone decides, as where photographs were counted before and are not read again."""
    weights: str | None = None
    """A weights file of another campaign: nothing is fitted then. In the project's folder, or absolute where the user
    names it."""
    second: str = "auto"
    """A second grey for what the first loses, from the colours of the set. `auto`: where that is enough to matter;
    `none`; or the name of a fixed triplet, as `red`, which is then the second."""
    measure: bool = True
    """Try the grey against COLMAP's default on pairs of the photographs. What guarded IHE fitted to gamma-coded ones is
    taken only if it is clearly better there, and to RAW unless it is clearly worse; without the trial it is taken."""

    @field_validator("method")
    @classmethod
    def _method_is_known(cls, method: str) -> str:
        if method not in CONVERSIONS:
            raise ValueError(f"expected one of {', '.join(CONVERSIONS)}")
        return method

    @field_validator("second")
    @classmethod
    def _second_is_known(cls, second: str) -> str:
        if second not in ("auto", "none", *FIXED):
            raise ValueError(f"expected one of auto, none, {', '.join(FIXED)}")
        return second

    @model_validator(mode="after")
    def _weights_or_method(self) -> FitOptions:
        if self.weights is not None and "method" in self.model_fields_set:
            raise ValueError("expected weights or a method: weights of a file are not fitted")
        return self

    @field_validator("step")
    @classmethod
    def _step_divides_one(cls, step: float) -> float:
        try:
            triplets(step)
        except WeightsError as error:
            raise ValueError(str(error)) from error
        return step


class ConvertOptions(Section):
    tone: Literal["sqrt", "linear", "equalise"] = "sqrt"
    """How linear grey (RAW) becomes 8 bit; gamma-coded photographs keep the tones they have."""
    wallis: bool = False
    """Bring local mean and contrast of the grey images to a target. Local: a colour is then not the same grey."""
    format: Literal["png", "tiff", "jpeg"] = "png"


class CameraOptions(Section):
    mode: Literal["auto", "single", "per_folder", "per_image"] = "auto"
    """`auto`: one camera per make, model, focal length and size in EXIF, as COLMAP groups, and one per size and what
    there is where EXIF lacks some of them, of which COLMAP would give each photograph a camera."""
    model: str = "auto"
    """COLMAP's camera model. `auto`: SIMPLE_RADIAL, as COLMAP, until `sparse.calibration` has chosen one; another is
    kept, and only its principal point is set free."""
    params: tuple[float, ...] | None = None
    """Known calibration in COLMAP's order for `model`, in pixels; where every camera starts from."""
    calibration: str | None = None
    """A calibration file of another run, from which the cameras start that are in it, instead of `model` and `params`.
    In the project's folder, or absolute where the user names it."""
    fixed: bool = False
    """Hold the calibration that was given as it is in all of the mapping; else it is refined."""

    @field_validator("params", mode="before")
    @classmethod
    def _tuple_of_list(cls, value: Any) -> Any:
        if not isinstance(value, list) or None in value:
            return value
        try:
            return tuple(float(v) for v in value)
        except (TypeError, OverflowError) as error:
            raise ValueError("expected a list of numbers") from error

    @model_validator(mode="after")
    def _params_of_a_model(self) -> CameraOptions:
        if self.params is not None and self.model == "auto":
            raise ValueError("camera.params needs camera.model, as SIMPLE_RADIAL for f, cx, cy, k")
        return self

    @model_validator(mode="after")
    def _calibration_or_model(self) -> CameraOptions:
        if self.calibration is not None and (self.params is not None or self.model != "auto"):
            raise ValueError(
                "expected camera.calibration, or camera.model with camera.params: the file has the model of each camera"
            )
        return self


class FeaturesOptions(Section):
    max_image_size: Annotated[int, Field(ge=64, le=100_000)] | None = None
    """Longer side in pixels above which features are found on a smaller copy; None is COLMAP's default."""
    octaves: Literal["auto", "colmap"] = "auto"
    """`auto`: the doubled image is left out where the cap leaves nothing of it; `colmap`: all octaves always."""
    colmap: ColmapOptions = Field(default_factory=dict)
    """For pycolmap.FeatureExtractionOptions."""


class MatchesOptions(Section):
    strategy: Literal["auto", "exhaustive", "sequential", "vocabtree", "spatial"] = "auto"
    """`auto`: exhaustive up to 200 photographs; above, spatial with GPS, else a vocabulary tree of the set."""
    colmap: ColmapOptions = Field(default_factory=dict)
    """For pycolmap.FeatureMatchingOptions."""
    pairing: ColmapOptions = Field(default_factory=dict)
    """For the strategy's own pairing options in pycolmap, as pycolmap.SequentialPairingOptions."""
    verification: ColmapOptions = Field(default_factory=dict)
    """For pycolmap.TwoViewGeometryOptions."""


class SparseOptions(Section):
    mapper: Literal["incremental", "global", "hierarchical"] = "incremental"
    calibration: Literal["auto", "colmap"] = "auto"
    """`auto`: after mapping, the camera model and the principal point as the photographs determine them; `colmap`
    leaves the cameras as the mapper made them."""
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    min_registered: Annotated[float, Field(ge=0, le=1)] = 0.33
    """Share of the photographs that the largest model must hold. With less, or with two photographs of more, a run ends
    before dense stereo, and not as a success; 0: any model will do."""
    colmap: ColmapOptions = Field(default_factory=dict)
    """For the pipeline options of the mapper in pycolmap, as pycolmap.IncrementalPipelineOptions."""


class DenseOptions(Section):
    enabled: bool = True
    backend: Literal["auto", "patchmatch", "sgm"] = "auto"
    """`auto`: PatchMatch where pycolmap finds a CUDA device, else semi-global matching on the CPU."""
    max_image_size: Annotated[int, Field(ge=64, le=100_000)] = 1600
    """Longer side in pixels of the images that dense stereo runs on."""
    colmap: ColmapOptions = Field(default_factory=dict)
    """For pycolmap.StereoFusionOptions."""
    patchmatch: ColmapOptions = Field(default_factory=dict)
    """For pycolmap.PatchMatchOptions."""


class MeshOptions(Section):
    enabled: bool = True
    """Of no account where `dense.enabled` is false: the mesh is made of the dense cloud."""
    faces: Annotated[int, Field(ge=100, le=50_000_000)] = 300_000
    """The most triangles that the mesh is simplified to."""
    texture: Literal["auto"] | bool = "auto"
    """True and `auto`: a textured mesh beside that with vertex colours."""
    texture_size: Annotated[int, Field(ge=256, le=16_384)] = 4096
    """The longest side of the texture in pixels; it is smaller where the photographs show no more."""
    colmap: ColmapOptions = Field(default_factory=dict)
    """For pycolmap.PoissonMeshingOptions."""


class Options(Section):
    """Hold every option of a project; `Options()` has the defaults."""

    captures: CapturesOptions = CapturesOptions()
    cameras: CamerasOptions = CamerasOptions()
    develop: DevelopOptions = DevelopOptions()
    fit: FitOptions = FitOptions()
    convert: ConvertOptions = ConvertOptions()
    camera: CameraOptions = CameraOptions()
    features: FeaturesOptions = FeaturesOptions()
    matches: MatchesOptions = MatchesOptions()
    sparse: SparseOptions = SparseOptions()
    survey: SurveyOptions = SurveyOptions()
    dense: DenseOptions = DenseOptions()
    mesh: MeshOptions = MeshOptions()
    drawings: DrawingsOptions = DrawingsOptions()
    report: ReportOptions = ReportOptions()
    cluster: ClusterOptions = ClusterOptions()
    machine: MachineOptions = MachineOptions()

    @property
    def meshed(self) -> bool:
        return self.dense.enabled and self.mesh.enabled

    def sections(self, *names: str) -> dict[str, Any]:
        """Return option sections as plain values by name."""
        return {name: getattr(self, name).model_dump(mode="json") for name in names}

    def as_yaml(self) -> dict[str, Any]:
        """Return all options as project.yaml would hold them."""
        values = self.model_dump(mode="json")
        if self.fit.weights is not None:  # of which there is no method
            del values["fit"]["method"]
        return {**values, "cameras": dict(values["cameras"])}
