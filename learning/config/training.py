"""The YAML file of a training: data, network, loss, optimiser, steps."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, TypeAlias, get_args

from pydantic import Field, model_validator

from learning.config.files import Decibels, FileSection, Section, Weight
from learning.simulate import Augmentation
from simulator.errors import InputError
from simulator.settings import Range
from simulator.text import show
from simulator.validation import refusal


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


ClassifierName: TypeAlias = Literal["dronet", "resnet18", "cnn3d", "x3d"]


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


class ClipDataConfig(DataConfig):
    """What is learned from clips."""

    draws: Annotated[int, Range(0, 1000)] = 4
    """how many times each clip is changed, re-simulated and given other noise; these are kept in the cache, with the joint
    estimate, which takes longest. 0: anew for every example"""
    slivers: Annotated[int, Range(1, 2000)] | None = None
    """how many frames are told apart in a capture; left out: as many as the data set's slivers"""


class ActivityDataConfig(ClipDataConfig):
    """What is learned from clips with labels."""

    shuffle_labels: bool = False
    """shuffle the labels of the training clips: accuracy above that of the most frequent class then indicates leakage"""


class NetworkConfig(Section):
    """Which network, and how big: a size, and what differs from it."""

    name: Literal["flatnet3d", "flatnet2d"] = "flatnet3d"
    """inversion at all depths of the stack, or only at the plane in the middle of the disparity range"""
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


class ClipBodyConfig(Section):
    """What all networks for clips have: a body, and joint least squares that it begins with."""

    dimensions: Literal[2, 3] | None = None
    """2: frames are channels of one image; 3: a stack of images"""
    filters: Annotated[int, Range(1, 1024)] | None = None
    """channels of the body's first level; each further one has twice as many"""
    blocks: Annotated[int, Range(1, 64)] | None = None
    """NAF blocks on each level and way"""
    levels: Annotated[int, Range(1, 8)] | None = None
    """levels of the body"""
    joint_iterations: Annotated[int, Range(1, 1000)] | None = None
    """of the joint least squares that it begins with"""
    joint_noise: Annotated[float, Range(0.01, 1000)] | None = None
    """of these: multiple of the measurement's noise that they assume, what their model leaves out being noise, too"""
    joint_correlation: Annotated[float, Range(0, 0.999)] | None = None
    """of these: between any two of the camera's channels; 0 takes them for independent"""

    @property
    def numbers(self) -> dict[str, Any]:
        """The size, and what differs from it: with the name, an architecture; see `learning.models.build_network`."""
        return {key: value for key, value in self.model_dump(exclude={"name"}).items() if value is not None}

    @property
    def changes(self) -> dict[str, Any]:
        """What differs from the size."""
        return {key: value for key, value in self.numbers.items() if key != "size"}


class ClipNetworkConfig(ClipBodyConfig):
    """A network for clips: a size, and what differs from it; the bodies are MeasNet and, of VideoNet, what enhances."""

    size: Literal["thesis", "compact", "tiny"] = "compact"
    """the numbers that are left out"""
    initial_estimate: Literal["slivers", "static", "joint"] | None = None
    """what it begins with: zero-filled slivers (the thesis), one inversion of the whole capture, or joint least squares"""
    measnet: bool | None = None
    """predict what a global shutter would measure of each frame, and invert that as well"""
    body: Literal["naf", "unet"] | None = None
    """NAF blocks (layer normalisation, gates), or the thesis's U-Net (batch normalisation)"""
    stem: Annotated[int, Range(1, 8)] | None = None
    """pixels per side that MeasNet takes as one, in 2D"""
    noise_aware: bool | None = None
    """lambda adapts to the noise level, which is estimated from the measurement and is also an input of what follows"""


class VideoNetworkConfig(ClipNetworkConfig):
    """VideoNet: a size, and what differs from it."""

    name: Literal["videonet"]
    """frames from one capture of a rolling shutter"""
    refinements: Annotated[int, Range(0, 10)] | None = None
    """unrolled refinement steps: each re-simulates the capture, and inverts and enhances the residual"""
    repeats: Annotated[int, Range(0, 10)] | None = None
    """how many times the last refinement step is repeated, with shared weights"""


class Video3DNetworkConfig(ClipBodyConfig):
    """VideoNet3D: a size, and what differs from it."""

    name: Literal["videonet3d"]
    """frames and their depth from one capture of a rolling shutter"""
    size: Literal["compact", "tiny"] = "compact"
    """the numbers that are left out"""
    joint_planes: Annotated[int, Range(2, 1000)] | None = None
    """planes of the joint least squares, or as many as the PSFs have where these are fewer"""


class ActivityNetworkConfig(ClipNetworkConfig):
    """ActivityNet: a size, and what differs from it."""

    name: Literal["activitynet"]
    """what is done in a clip, from one capture of a rolling shutter"""
    classifier: ClassifierName | None = None
    """of the estimated frames: as channels of one image (dronet, the thesis's, and resnet18), or a stack (cnn3d, x3d)"""


class RawClassifierConfig(Section):
    """A classifier of captures without any inversion."""

    name: Literal["raw_classifier"]
    """what is done in a clip, from the capture itself"""
    classifier: Literal["dronet", "resnet18"] = "dronet"
    """of one image; see ActivityNet"""

    @property
    def numbers(self) -> dict[str, Any]:
        """With the name, an architecture."""
        return self.model_dump(exclude={"name"})


class LensClassifierConfig(Section):
    """A classifier of the frames of a camera with a lens."""

    name: Literal["lens_classifier"]
    """what is done in a clip, from the true frames"""
    classifier: ClassifierName = "dronet"
    """which; see ActivityNet"""
    frames: Literal["all", "shuffled", "middle"] = "all"
    """what it looks at: all frames in their order, all in random order, or the one in the middle"""

    @property
    def numbers(self) -> dict[str, Any]:
        """With the name, an architecture."""
        return self.model_dump(exclude={"name"})


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
    """error of the sRGB values"""
    perceptual: Literal["none", "vgg", "random_vgg"] = "none"
    """error of VGG-19 features, with trained weights (the file must be present) or random ones"""
    intensity_weight: Weight = 1.0
    """of that error"""
    multiscale_weight: Weight = 0.0
    """of the mean absolute error of sRGB values of light averaged over 2, 4 and 8 pixels squared, close to what FLIP sees"""
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


class FrameLossConfig(Section):
    """The loss of frames: the sum of the weighted terms."""

    intensity: Literal["mse", "l1"] = "l1"
    """error of the frames' sRGB values"""
    perceptual: Literal["none", "vgg", "random_vgg"] = "none"
    """error of VGG-16 features of the frames, with trained weights (the file must be present) or random ones"""
    intensity_weight: Weight = 5.0
    """of the frames' error"""
    change_weight: Weight = 0.0
    """of the mean absolute error of the differences between neighbouring frames: what a static image gets wrong"""
    multiscale_weight: Weight = 0.0
    """of the mean absolute error of sRGB values of light averaged over 2, 4 and 8 pixels squared, close to what FLIP sees"""
    perceptual_weight: Weight = 0.1
    """of the error of the features, where there are any"""
    perceptual_seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """of random_vgg; apart from the training's seed, so that all seeds minimise the same loss"""

    @model_validator(mode="after")
    def _teaches(self) -> Self:
        if not any(
            (self.intensity_weight, self.multiscale_weight, self.perceptual != "none" and self.perceptual_weight)
        ):
            text = "intensity_weight, multiscale_weight and perceptual_weight are all 0: nothing to learn of the frames"
            raise refusal(text)
        return self


class ClipLossConfig(FrameLossConfig):
    """The loss of clips: the sum of the weighted terms; the thesis's (4.2 to 4.6) is mse with weights 1, 5 and 0.1."""

    measurement_weight: Weight = 1.0
    """of the mean squared error of the global measurements that MeasNet completes, where there is one"""


class Video3DLossConfig(FrameLossConfig):
    """The loss of clips with depth: the sum of the weighted terms."""

    depth_weight: Weight = 1.0
    """of the mean absolute error of the disparity, 0..1, where something was seen"""
    depth_cm_weight: Weight = 0.05
    """of the Huber loss of the depth's error in centimetres"""


class ActivityLossConfig(Section):
    """The loss of recognition: the sum of the weighted terms; the thesis's (4.7, 4.8) has weights 3 and 1."""

    class_weight: Annotated[float, Range(1e-9, 1e9, below="without it nothing is learned of classes")] = 3.0
    """of the cross entropy of the classes"""
    measurement_weight: Weight = 1.0
    """of the mean squared error of the global measurements that MeasNet completes, where there is one"""


LearningRate = Annotated[float, Range(1e-9, 10, below="a learning rate is positive")]


class OptimiserConfig(Section):
    """Adam (AdamW where weights decay), and its learning rate over the steps."""

    learning_rate: LearningRate = 1e-3
    """peak value, after the warm-up"""
    schedule: Literal["cosine", "constant"] = "cosine"
    """after the warm-up: down to zero along half a cosine, or constant"""
    warm_up: Annotated[float, Range(0, 0.9)] = 0.05
    """share of the steps over which the learning rate rises from zero"""
    weight_decay: Annotated[float, Range(0, 1)] = 0.0
    """decay of the convolutions' weights per unit of learning rate (Loshchilov and Hutter 2019)"""
    gradient_clip: Annotated[float, Range(1e-9, 1e9)] | None = None
    """maximum norm of the gradient; larger gradients are scaled down to it"""


class NetworkOptimiserConfig(OptimiserConfig):
    """The optimiser of a network that inverts and enhances."""

    inversion_rate: Annotated[float, Range(0, 1e6)] = 10.0
    """learning rate of the inversion's P and lambda, as a multiple of the others' (at 1 they hardly move)"""
    freeze_statistics: Annotated[float, Range(0, 1)] = 0.5
    """share of the steps after which batch normalisation (of body: unet, and of classifiers) keeps its statistics, as at
    inference"""


class LoopConfig(FileSection):
    """What every training says."""

    name: str = Field(min_length=1)
    """of the method in tables and figures"""
    output: str = Field(min_length=1)
    """folder of the checkpoints, the metrics and the state to go on from"""
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """of the initial weights, the order of the examples and all that is drawn for them, such as their noise; clips that are
    kept (data.draws) are the same for all seeds"""
    data: SplitsConfig
    network: (
        NetworkConfig
        | VideoNetworkConfig
        | Video3DNetworkConfig
        | ActivityNetworkConfig
        | RawClassifierConfig
        | LensClassifierConfig
        | DenoiserNetwork
    )
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
    optimiser: NetworkOptimiserConfig = NetworkOptimiserConfig()
    init_from: str | None = None
    """checkpoint (.safetensors) of a network of the same kind to begin with, for fine-tuning"""
    loss: LossConfig = LossConfig()


class VideoTrainConfig(LoopConfig):
    """One training of a network for clips."""

    data: ClipDataConfig
    network: VideoNetworkConfig
    optimiser: NetworkOptimiserConfig = NetworkOptimiserConfig()
    init_from: str | None = None
    """checkpoint (.safetensors) of a VideoNet or a FlatNet2D to begin with"""
    loss: ClipLossConfig = ClipLossConfig()


class Video3DTrainConfig(LoopConfig):
    """One training of a network for clips and their depth."""

    data: ClipDataConfig
    network: Video3DNetworkConfig
    init_from: str = Field(min_length=1)
    """checkpoint (.safetensors) of the FlatNet3D whose estimates it corrects, or of a VideoNet3D"""
    loss: Video3DLossConfig = Video3DLossConfig()


class ActivityOptimiserConfig(NetworkOptimiserConfig):
    """The optimiser of a classifier."""

    learning_rate: LearningRate = 3e-4


class ActivityTrainConfig(LoopConfig):
    """One training of a network that recognises what is done in a clip."""

    data: ActivityDataConfig
    network: ActivityNetworkConfig | RawClassifierConfig | LensClassifierConfig = Field(discriminator="name")
    optimiser: ActivityOptimiserConfig = ActivityOptimiserConfig()
    init_from: str | None = None
    """of ActivityNet: checkpoint (.safetensors) of a VideoNet, of which inversion and MeasNet are taken, or an ActivityNet;
    of lens_classifier with resnet18: torchvision's weights of ResNet-18, learned from ImageNet (resnet18-f37072fd.pth)"""
    loss: ActivityLossConfig = ActivityLossConfig()

    @model_validator(mode="after")
    def _sense(self) -> Self:
        augment = self.data.augment
        if augment is not None and augment.reverse:
            text = "got true, but played backwards it is another action (picking up becomes putting down); set reverse: false"
            raise refusal(text, "data", "augment", "reverse")
        if augment is not None and augment.still:
            text = f"got {augment.still:g}, but a clip without motion shows no action; set still: 0"
            raise refusal(text, "data", "augment", "still")
        of_torchvision = self.network.name == "lens_classifier" and self.network.classifier == "resnet18"
        if self.init_from is not None and self.network.name != "activitynet" and not of_torchvision:
            unless = ", or take classifier: resnet18" if self.network.name == "lens_classifier" else ""
            text = f"got a file, but this {self.network.name} begins with random weights; leave it out{unless}"
            raise refusal(text, "init_from")
        if self.batch == 1:
            raise refusal("got 1, but classifiers scale what they see over a batch; take 2 or more", "batch")
        return self


_TRAININGS: dict[type[LoopConfig], tuple[type[Section], ...]] = {
    TrainConfig: (NetworkConfig,),
    VideoTrainConfig: (VideoNetworkConfig,),
    Video3DTrainConfig: (Video3DNetworkConfig,),
    ActivityTrainConfig: (ActivityNetworkConfig, RawClassifierConfig, LensClassifierConfig),
}


def training_kind(data: dict[str, Any]) -> type[LoopConfig]:
    """Return what a training's file must be, by the name of its network; an InputError refuses unknown names."""
    network = data.get("network")
    name = network.get("name", "flatnet3d") if isinstance(network, dict) else "flatnet3d"
    kinds = {
        known: kind
        for kind, networks in _TRAININGS.items()
        for each in networks
        for known in get_args(each.model_fields["name"].annotation)
    }
    if not isinstance(name, str) or name not in kinds:
        raise InputError("network.name", f"got {show(name)}, expected one of {', '.join(kinds)}")
    return kinds[name]


class DenoiserConfig(LoopConfig):
    """One training of a denoiser: the prior of plug-and-play methods, learned from clean pictures."""

    name: str = Field("denoiser", min_length=1)
    """for its record"""
    network: DenoiserNetwork = DenoiserNetwork()
    batch: Annotated[int, Range(1, 65536)] = 16
    """pictures in a step, of all processes together"""
