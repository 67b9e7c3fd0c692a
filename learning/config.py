"""The YAML files of learning: what is trained, evaluated or tuned, strict like sim_config.yaml."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import ConfigDict, Field, PrivateAttr, model_validator

from learning.simulate import Augmentation
from simulator import validation
from simulator.config.load import load_model
from simulator.io.files import expanded
from simulator.settings import Range
from simulator.validation import RENAMED, Problem, refusal


class Section(validation.Section):
    """A mapping whose keys are described below each."""

    model_config = ConfigDict(use_attribute_docstrings=True)


class FileSection(Section):
    """The whole of a YAML file; relative paths in it are taken from its folder."""

    _base_dir: Path = PrivateAttr(default_factory=Path.cwd)
    _source: tuple[Path, tuple[str, ...]] | None = PrivateAttr(None)

    @property
    def source(self) -> tuple[Path, tuple[str, ...]] | None:
        """The file and the overrides that it was loaded from, no part of what it says; None where Python made it."""
        return self._source

    def resolve_path(self, text: str | Path) -> Path:
        """Return a path of this file as an absolute one."""
        return expanded(text, self._base_dir)

    def resolve_stack(self, name: str) -> str | Path:
        """Return PSFs as `learning.camera.capture_model` takes them: nominal, captured, or a stack's folder."""
        return name if name in ("nominal", "captured") else self.resolve_path(name)

    def dump(self) -> dict[str, Any]:
        """Return plain data for JSON with all defaults."""
        return self.model_dump(mode="json")


Model = TypeVar("Model", bound=FileSection)


def load_file(model: type[Model], path: Path | str, overrides: Sequence[str] = ()) -> Model:
    """Load a YAML file; see `simulator.config.load.load_model`. Keys of earlier versions are refused with today's names."""
    loaded = load_model(model, path, overrides, _old_names)
    loaded._base_dir, loaded._source = Path(path).resolve().parent, (Path(path), tuple(overrides))
    return loaded


def _old_names(data: Any, path: tuple[str | int, ...] = ()) -> Iterator[Problem]:
    parts = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in parts:
        if key in RENAMED:
            yield Problem((*path, key), f"it is called {RENAMED[key]} now", on_key=True)
        elif (*path, key, value) == ("objective", "picture"):
            yield Problem((key,), "picture is called image now")
        yield from _old_names(value, (*path, key))


Weight = Annotated[float, Range(0, 1e6, below="a weight is not negative")]
Decibels = Annotated[float, Range(0.1, 120, "dB")]


class SplitsConfig(Section):
    """The data sets for training and validation."""

    train: str = Field(min_length=1)
    """folder of the data set whose train split is trained on"""
    validation: str | None = None
    """folder of the data set whose validation split is used; default: the same"""
    cache: bool | str = True
    """keep decoded samples, to save time: in Flatlight's cache folder (true), in another folder, or not (false)"""
    workers: Annotated[int, Range(0, 256)] | Literal["auto"] = "auto"
    """processes that read examples; 0 reads between the steps"""


class DataConfig(SplitsConfig):
    """What is learned from."""

    stack: str = Field("nominal", min_length=1)
    """PSFs that the inversion assumes: nominal, captured (psf.as_captured), or the folder of a stack"""
    noise_db: tuple[Decibels, Decibels] | None = None
    """lowest and highest PSNR of the noise drawn anew for every example, half of them in the upper quarter, where networks
    for all levels lose most; left out: as stored"""
    augment: Augmentation | None = None
    """scenes changed and re-simulated by the data set's own forward model, for every example; left out: as stored"""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.noise_db is not None and self.noise_db[0] > self.noise_db[1]:
            text = f"got {self.noise_db[0]:g} before {self.noise_db[1]:g}; the least comes first: swap them?"
            raise refusal(text, "noise_db")
        return self


class NetworkConfig(Section):
    """Which network, and how big: a size, and what differs from it."""

    name: Literal["flatnet3d", "flatnet2d"] = "flatnet3d"
    """inversion at all depths of the stack, or at the hyperfocal one only"""
    size: Literal["thesis", "compact", "tiny"] = "compact"
    """the numbers below that are left out"""
    body: Literal["naf", "unet"] | None = None
    """what enhances the inversion: NAF blocks (layer normalisation, gates), or the thesis's U-Net (batch normalisation)"""
    filters: Annotated[int, Range(1, 1024)] | None = None
    """channels of the body's first level; each further one has twice as many"""
    blocks: Annotated[int, Range(1, 64)] | None = None
    """NAF blocks on each level and way"""
    levels: Annotated[int, Range(1, 8)] | None = None
    """levels of the body"""
    attention: bool | None = None
    """attention gates on the U-Net's skips"""
    stem: Annotated[int, Range(1, 8)] | None = None
    """pixels per side that the body takes as one: 2 makes it four times cheaper"""
    noise_aware: bool | None = None
    """lambda adapts to the noise level, which is estimated from the measurement and is also an input of the body"""
    joint: bool | None = None
    """also invert all planes jointly, in addition to each on its own"""
    refinements: Annotated[int, Range(0, 10)] | None = None
    """unrolled refinement steps: each inverts and enhances the measurement's residual"""
    repeats: Annotated[int, Range(0, 10)] | None = None
    """how many times the last refinement step is repeated, with shared weights"""
    head: Literal["soft", "linear"] | None = None
    """soft: softmax weights over the planes plus a correction; linear: image and disparity directly"""
    regularisation_lambda: Annotated[float, Range(1e-9, 1e6)] | None = None
    """initial, of the inversion, as a multiple of the PSF's mean spectral power"""
    tikhonov: Annotated[float, Range(0, 1e6)] | None = None
    """initial Tikhonov term: response of the inversion's P at frequency zero; 0 is the Laplacian alone"""

    @property
    def numbers(self) -> dict[str, Any]:
        """The size, and what differs from it: with the name, an architecture."""
        return {"size": self.size, **self.changes}

    @property
    def changes(self) -> dict[str, Any]:
        """What differs from the size; see `learning.models.build_network`."""
        return {
            key: value for key, value in self.model_dump().items() if key not in ("name", "size") and value is not None
        }


class DenoiserNetwork(Section):
    """How big the denoiser is; see `learning.layers.naf.NafNet`."""

    name: Literal["denoiser"] = "denoiser"
    """there is one kind"""
    filters: Annotated[int, Range(1, 1024)] = 16
    """channels of the first level; each further one has twice as many"""
    blocks: Annotated[int, Range(1, 64)] = 1
    """NAF blocks on each level, each way"""
    levels: Annotated[int, Range(1, 8)] = 4
    """how many"""

    @property
    def numbers(self) -> dict[str, Any]:
        """What `learning.models.denoiser.Denoiser` is built with."""
        return self.model_dump(exclude={"name"})


class LossConfig(Section):
    """The loss: the sum of the weighted terms."""

    intensity: Literal["mse", "l1"] = "l1"
    """error of the sRGB codes"""
    perceptual: Literal["none", "vgg", "random_vgg"] = "none"
    """error of VGG-19 features, with trained weights (the file must be present) or random ones"""
    intensity_weight: Weight = 1.0
    """of the error of the codes"""
    multiscale_weight: Weight = 0.0
    """of the error of the codes of light averaged over 2 x 2, 4 x 4 and 8 x 8 pixels: what FLIP sees"""
    perceptual_weight: Weight = 0.1
    """of the error of the features, where there are any"""
    depth_weight: Weight = 1.0
    """of the mean absolute error of the disparity, 0..1"""
    depth_cm_weight: Weight = 0.0
    """of the Huber loss of the depth's error in centimetres"""
    perceptual_seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """of random_vgg; apart from the training's seed, so that all seeds minimise the same loss"""
    invalid_depth: bool = False
    """whether pixels where nothing was seen count in the error of the disparity, as far ones"""

    @model_validator(mode="after")
    def _teaches(self) -> Self:
        weights = [name for name in type(self).model_fields if name.endswith("_weight")]
        if self.perceptual == "none":
            weights.remove("perceptual_weight")
        if not any(getattr(self, name) for name in weights):
            text = f"{', '.join(weights)} are all 0: nothing to learn"
            raise refusal(text)
        return self


class OptimiserConfig(Section):
    """Adam (AdamW where weights decay), and its learning rate over the steps."""

    learning_rate: Annotated[float, Range(1e-9, 10, below="a learning rate is positive")] = 1e-3
    """peak value, after the warm-up"""
    schedule: Literal["cosine", "constant"] = "cosine"
    """after the warm-up: down to zero along half a cosine, or constant"""
    warm_up: Annotated[float, Range(0, 0.9)] = 0.05
    """share of the steps over which the learning rate rises from zero"""
    inversion_rate: Annotated[float, Range(0, 1e6)] = 10.0
    """learning rate of the inversion's P and lambda, as a multiple of the others' (at 1 they hardly move)"""
    freeze_statistics: Annotated[float, Range(0, 1)] = 0.5
    """share of the steps after which batch normalisation (body: unet) freezes its running statistics, as at inference"""
    weight_decay: Annotated[float, Range(0, 1)] = 0.0
    """decay of the convolutions' weights per unit of learning rate (Loshchilov and Hutter 2019)"""
    gradient_clip: Annotated[float, Range(1e-9, 1e9)] | None = None
    """maximum norm of the gradient; larger gradients are scaled down to it"""


class LoopConfig(FileSection):
    """What every training says."""

    name: str = Field(min_length=1)
    """of the method in tables and figures"""
    output: str = Field(min_length=1)
    """folder of the checkpoints, the metrics and the state to go on from"""
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """of the initial weights, the order of the examples and all that is drawn for them, such as their noise"""
    data: SplitsConfig
    network: NetworkConfig | DenoiserNetwork
    optimiser: OptimiserConfig = OptimiserConfig()
    steps: Annotated[int, Range(1, 10**9)]
    """batches to train on; if raised later, the learning rate jumps back up its cosine; every change is recorded"""
    batch: Annotated[int, Range(1, 65536)] = 8
    """examples in a step, of all processes together"""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """of the network's body; all else stays float32. auto takes bfloat16 (autocast), which is faster, on CUDA only"""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """auto takes CUDA where there is some"""
    validate_every: Annotated[int, Range(1, 10**9)] = 500
    """steps between validations"""
    log_every: Annotated[int, Range(1, 10**9)] = 50
    """steps whose mean is one line of metrics.jsonl and one point in TensorBoard"""
    checkpoint_every_s: Annotated[float, Range(0, 1e6, "s")] = 60.0
    """seconds between states that are saved to go on from"""


class TrainConfig(LoopConfig):
    """One training."""

    data: DataConfig
    network: NetworkConfig = NetworkConfig()
    init_from: str | None = None
    """checkpoint (.safetensors) of a network of the same kind to begin with, for fine-tuning"""
    loss: LossConfig = LossConfig()


class DenoiserConfig(LoopConfig):
    """One training of a denoiser: the prior of plug-and-play methods, learned from clean pictures."""

    name: str = Field("denoiser", min_length=1)
    """for its record"""
    network: DenoiserNetwork = DenoiserNetwork()
    batch: Annotated[int, Range(1, 65536)] = 16
    """pictures in a step, of all processes together"""


Count = Annotated[int, Range(1, 10_000_000, below="at least one")]
Classical = Literal["cls", "admm", "pnp"]


def _refuse_folder_names(names: Iterable[str], key: str) -> None:
    for name in names:
        if not re.fullmatch(r"\w[\w .()+-]*", name):
            text = f"got the name {name!r}, expected one that a folder may have: letters, digits, spaces, - or _"
            raise refusal(text, key, name, on_key=True)


class EvaluationData(Section):
    """The test scenes, and what the methods are told of the camera that saw them."""

    test: str | dict[str, str]
    """folder of the data set, whose camera's gain, offset and exposure are known; several by name,
    {colon: out/colon, stomach: out/stomach}, give one table each and a joint one; <set> in any path stands for the name"""
    split: Literal["train", "validation", "test"] = "test"
    """which of its splits"""
    scenes: Count | None = None
    """only the first so many; null takes all"""
    training: str | None = None
    """folder of the data set that the methods were trained or tuned on: the classical ones assume its PSFs"""
    stack: str = "own"
    """PSFs that methods assume: own (a checkpoint's, else nominal), nominal or captured (of training), or a folder"""
    compare_stacks: list[str] = Field(default_factory=list)
    """further PSFs that every method is given once, e.g. [nominal, captured]"""

    @model_validator(mode="after")
    def _known(self) -> Self:
        wanted = [name for name in (self.stack, *self.compare_stacks) if name in ("nominal", "captured")]
        if wanted and self.training is None:
            text = f"{wanted[0]} PSFs are those of the training data set; name its folder in data.training"
            raise refusal(text)
        if not self.test:
            text = f"got {self.test!r}, expected the folder of a data set, or several by name: {{colon: out/colon}}"
            raise refusal(text, "test")
        _refuse_folder_names(() if isinstance(self.test, str) else self.test, "test")
        return self


class MethodConfig(Section):
    """A method: the checkpoints of a network, one per seed, or a classical method with its parameters."""

    name: str = Field(min_length=1)
    """in tables and figures"""
    checkpoints: list[str] | None = None
    """files, one per seed, or names of shipped ones"""
    classical: Classical | None = None
    """instead of checkpoints"""
    tuned: str | None = None
    """what `flatlight tune` wrote; parameters of the nearest noise level"""
    parameters: dict[str, Any] | None = None
    """instead of tuned; {} takes the defaults. The denoiser of pnp is a file, or denoiser, the shipped one"""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.checkpoints is None) == (self.classical is None):
            text = "give either checkpoints (of a network) or classical (cls, admm, pnp)"
            raise refusal(text)
        if self.checkpoints is not None:
            if not self.checkpoints or len(set(self.checkpoints)) < len(self.checkpoints):
                text = "expected at least one file, each of them once"
                raise refusal(text, "checkpoints")
            if self.tuned is not None or self.parameters is not None:
                text = "tuned and parameters belong to classical methods; leave them out"
                raise refusal(text)
        elif (self.tuned is None) == (self.parameters is None):
            text = "a classical method needs either tuned (the file of `flatlight tune`) or parameters"
            raise refusal(text)
        return self


class Timing(Section):
    """How seconds per scene are measured: one scene at a time, the methods in turn, the median of the repeats."""

    repeats: Annotated[int, Range(0, 1000)] = 5
    """after one warm-up run; 0 skips the timing"""
    noise_db: Decibels | None = None
    """level whose parameters are timed; null: as stored"""


class Drawing(Section):
    """Figures beside the table."""

    montage: Annotated[int, Range(0, 100)] = 4
    """scenes side by side with all estimates; 0: none"""


_SET = "<set>"  # in paths: the name of the data set that is evaluated on


class EvaluateConfig(FileSection):
    """The whole file."""

    name: str = Field(min_length=1)
    """title of the report"""
    output: str
    """folder of results, tables and figures"""
    data: EvaluationData
    methods: list[MethodConfig] = Field(min_length=1)
    reference: str | None = None
    """the one that all others are compared with, scene by scene; null: the first"""
    noise_db: list[Decibels] | None = None
    """further levels at which noise is drawn anew from the noiseless measurements; null: only as stored"""
    ablation_scenes: Count | None = None
    """scenes for noise_db and compare_stacks, the first so many; null: all"""
    depth_bins_cm: list[Annotated[float, Range(0.01, 1e6, "cm")]] | None = None
    """edges of the depth bins of the errors; null: eight bins, even in disparity"""
    dark_share: Annotated[float, Range(0, 1)] | None = None
    """also report depth without pixels darker than this share of white; null: not"""
    perceptual: Literal["none", "auto", "lpips"] = "auto"
    """LPIPS: none, where its weight files are (auto), or always, an error without them"""
    batch: Count = 8
    """scenes at a time, except where time is taken"""
    seed: int = Field(0, ge=0)
    """of noise that is drawn anew"""
    time: Timing = Timing()
    figures: Drawing = Drawing()
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """auto takes CUDA where there is some"""
    threads: Count | None = None
    """of torch on the CPU; null leaves them as they are"""

    @property
    def sets(self) -> dict[str, EvaluateConfig]:
        """The same file for each of its data sets alone, by name; without a name where there is only one."""
        test = self.data.test
        return {"": self} if isinstance(test, str) else {name: self._alone(name, test[name]) for name in test}

    def _alone(self, name: str, test: str) -> EvaluateConfig:
        def named(value: Any) -> Any:
            if isinstance(value, dict):
                return {key: named(one) for key, one in value.items()}
            if isinstance(value, list):
                return [named(one) for one in value]
            return value.replace(_SET, name) if isinstance(value, str) else value

        paths = {key: named(getattr(self.data, key)) for key in ("training", "stack", "compare_stacks")}
        methods = [
            method.model_copy(
                update={key: named(getattr(method, key)) for key in ("checkpoints", "tuned", "parameters")}
            )
            for method in self.methods
        ]
        data = self.data.model_copy(update=paths | {"test": named(test)})
        return self.model_copy(update={"data": data, "methods": methods})

    @model_validator(mode="after")
    def _sense(self) -> Self:
        names = [method.name for method in self.methods]
        for at, name in enumerate(names):
            if name in names[:at]:
                text = f"{name!r} is the name of two methods"
                raise refusal(text, "methods", at, "name")
        if self.reference is not None and self.reference not in names:
            text = f"got {self.reference!r}, expected one of the methods: {', '.join(names)}"
            raise refusal(text, "reference")
        edges = self.depth_bins_cm
        if edges is not None and (len(edges) < 2 or any(a >= b for a, b in pairwise(edges))):
            text = "expected at least two depths, increasing"
            raise refusal(text, "depth_bins_cm")
        levels = self.noise_db
        if levels is not None and (not levels or len(set(levels)) < len(levels)):
            text = "expected at least one level, each of them once"
            raise refusal(text, "noise_db")
        if self.data.training is None and any(method.classical for method in self.methods):
            text = "classical methods need data.training, the data set whose PSFs they assume"
            raise refusal(text, "data")
        return self


FEWEST_SCENES = 32


class TuneData(Section):
    """Scenes on which parameters are tuned; never those of the test."""

    validation: Path
    """folder of the data set"""
    split: Literal["validation", "train", "test"] = "validation"
    """its split that is tuned on"""
    scenes: Annotated[int, Range(1, 1_000_000)] = FEWEST_SCENES
    """its first so many samples are used"""
    allow_few_scenes: bool = False
    """whether fewer than 32 may be used; it is recorded"""
    stack: str = "nominal"
    """PSFs that the methods assume: nominal, captured, or a stack's folder"""
    train: Path | None = None
    """data set whose train split gives images their reference white; null: the one above"""

    @model_validator(mode="after")
    def _check_scenes(self) -> TuneData:
        if self.scenes < FEWEST_SCENES and not self.allow_few_scenes:
            text = (
                f"got {self.scenes}, expected at least {FEWEST_SCENES}: parameters tuned on fewer overfit; "
                "allow_few_scenes: true permits it, and the result says so"
            )
            raise refusal(text, "scenes")
        return self


class AxisSection(Section):
    """Candidates of one parameter instead of the method's own, and how far the search may go beyond them."""

    values: list[float | int | str] | None = Field(None, min_length=1)
    """candidates; numbers increase"""
    low: Annotated[float, Range(0, 1e300)] | None = None
    """least value; null: the method's own"""
    high: Annotated[float, Range(0, 1e300, infinite=True)] | None = None
    """greatest; null: the method's own, e.g. 240 iterations"""


class TuneConfig(FileSection):
    """A whole file for `flatlight tune`."""

    output: Path = Path("tuned.json")
    """result with all trials; a run that stopped goes on from there"""
    data: TuneData
    """scenes"""
    methods: list[Classical] = Field(default_factory=lambda: ["cls", "admm"], min_length=1)
    """classical methods"""
    denoiser: str = "denoiser"
    """prior of pnp: a file of `flatlight train-denoiser`, or denoiser, the shipped one"""
    noise_db: list[Decibels | Literal["stored"]] = Field(default_factory=lambda: [20.0, 30.0, 40.0, 50.0], min_length=1)
    """PSNR of the measurements, decibels, each tuned by itself; stored takes them with the noise that they have"""
    objective: Literal["both", "image", "depth"] = "both"
    """minimised error, in units of the constant guess's: depth (RMSE), image (by PSNR), or their sum"""
    search: dict[str, dict[str, AxisSection]] = Field(default_factory=dict)
    """changes of the search space: method, parameter, candidates and limits"""
    seed: Annotated[int, Range(0, 2**63 - 1)] = 0
    """of the noise"""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """auto takes a GPU where there is one"""

    @model_validator(mode="after")
    def _check_methods(self) -> TuneConfig:
        if self.denoiser != "denoiser" and "pnp" not in self.methods:
            text = f"only pnp has one; methods: {', '.join(self.methods)}"
            raise refusal(text, "denoiser", on_key=True)
        for key in ("methods", "noise_db"):
            if len(set(values := getattr(self, key))) < len(values):
                text = f"got {', '.join(map(str, values))}, expected each of them once"
                raise refusal(text, key)
        for name in self.search:
            if name not in self.methods:
                text = f"{name!r} is not tuned here; methods: {', '.join(self.methods)}"
                raise refusal(text, "search", name, on_key=True)
            if "denoiser" in self.search[name]:
                text = "a denoiser is not searched: name one in denoiser, tune for each, and compare the results"
                raise refusal(text, "search", name, "denoiser", on_key=True)
        return self


class SeenAgain(Section):
    """Whose scenes all masks see: data sets of Flatlight; nothing is rendered."""

    train: str = Field(min_length=1)
    """folder of the data set whose train and validation splits are for training and tuning"""
    test: str | None = None
    """folder of the data set whose test split decides; the same when left out"""
    train_scenes: Count = 1000
    """the first so many of the train split"""
    validation_scenes: Count = 64
    """the first so many of the validation split; methods are tuned on 32 of them"""
    test_scenes: Count = 64
    """the first so many of the test split"""


class WarmStart(Section):
    """A trained network that is fine-tuned for each mask; it has the checkpoint's architecture."""

    init_from: str = Field(min_length=1)
    """checkpoint (.safetensors) or name of a shipped one"""
    steps: Annotated[int, Range(0, 10**9)] = 300
    """batches to fine-tune on, for each mask; 0 only replaces its PSFs by the mask's"""
    batch: Annotated[int, Range(1, 65536)] = 8
    """examples in a step"""
    augment: Augmentation | None = Augmentation()
    """scenes changed and re-simulated through the camera with the mask, for every example; null: as stored"""
    loss: LossConfig = LossConfig()
    optimiser: OptimiserConfig = OptimiserConfig()
    validate_every: Annotated[int, Range(1, 10**9)] = 100
    """steps between validations, by which the best one is chosen"""


class SwapConfig(FileSection):
    """Masks judged by what is reconstructed: one camera, the same scenes and light, the same methods."""

    name: str = Field(min_length=1)
    """title of the report"""
    output: str = Field(min_length=1)
    """folder of the data sets, trainings, evaluation and report"""
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """of trainings, tuning and noise that is drawn anew"""
    config: str = Field(min_length=1)
    """configuration (sim_config.yaml) whose camera and depths all masks share"""
    settings: list[str] = Field(default_factory=list)
    """what differs from it for all masks, KEY=VALUE each, as for --set"""
    test_settings: list[str] = Field(default_factory=list)
    """what else differs in the test: PSFs that no method is told of, e.g. psf.model=exact"""
    masks: dict[str, dict[str, Any]] = Field(min_length=1)
    """by name, each as in camera.mask; the others are compared with the first one"""
    scenes: SeenAgain
    network: WarmStart | None = None
    """null: classical methods only"""
    tuned: list[Classical] = Field(default_factory=lambda: ["cls"])
    """classical methods whose parameters are tuned for each mask"""
    untuned: list[Classical] = Field(default_factory=list)
    """classical methods with their default parameters"""
    noise_db: list[Decibels] = Field(default_factory=list)
    """further noise levels: white noise of the same PSNR for all masks, whatever light they pass"""
    perceptual: Literal["none", "auto", "lpips"] = "none"
    """see `EvaluateConfig`"""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """auto takes CUDA where there is some"""

    @model_validator(mode="after")
    def _sense(self) -> Self:
        _refuse_folder_names(self.masks, "masks")
        for key in ("settings", "test_settings"):
            for at, text in enumerate(getattr(self, key)):
                if (name := text.partition("=")[0].strip()) == "camera.mask" or name.split(".")[0] in (
                    "dataset",
                    "scene",
                ):
                    text = f"got {name}, which masks and scenes decide; leave it out"
                    raise refusal(text, key, at)
        for key in ("tuned", "untuned", "noise_db"):
            if len(set(values := getattr(self, key))) < len(values):
                text = f"got {', '.join(map(str, values))}, expected each of them once"
                raise refusal(text, key)
        if self.network is None and not self.tuned + self.untuned:
            text = "nothing reconstructs: give network, or a classical method in tuned or untuned"
            raise refusal(text)
        return self
