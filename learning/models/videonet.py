"""VideoNet: the frames of a clip from one capture of a rolling shutter.

The thesis, section 4.2: MeasNet completes the slivers of a capture to what a global shutter would have measured of each
frame, a learned inversion (equation 4.1) makes an image of each, EnhanceNet makes the frames of these. Instead of zero-filled
slivers it may begin with the static inversion of the whole capture or with joint least squares over space and time, and
refine what it found: each refinement re-simulates the capture, inverts the residual of every frame's rows, and corrects the
frames by it (Adler and Oektem, Learned Primal-Dual Reconstruction, TMI 2018; Aggarwal et al., MoDL, TMI 2019).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, NamedTuple, Self

import torch
from torch import Tensor, nn

from learning.camera import CaptureModel, check_one_plane
from learning.layers.inversion import RegularisedInversion, WienerInversion
from learning.layers.multiscale import MultiScaleNetwork
from learning.layers.naf import NafNet
from learning.layers.noise import level_image, noise_ratio
from learning.layers.padding import check_measurement
from learning.layers.space_time import JOINT, JointLeastSquares
from learning.layers.unet import UNet
from learning.method import Clock, Estimate, check_choices, inference, linear_to_srgb, srgb_to_linear, threads_for
from learning.models.refinement import MOST_RADIANCE
from simulator.errors import InputError

Start = Literal["slivers", "static", "joint"]
STARTS = ("slivers", "static", "joint")
_BORDER = 8
"""Pixels around the image that are estimated, too: all that a narrow stop leaves of the field. Re-simulations and inversions
take what lies farther out for dark."""
_NOISE_WEIGHT = 30.0
_WIENER = 1.0  # noise to signal at which the learned filter of global measurements begins
_FAINTEST = 1e-4  # root mean square of a capture by which it is divided, at least: of full scale


class Film(NamedTuple):
    """What VideoNet makes of captures.

    Attributes:
        image: ``(B, N, 3, h, w)`` sRGB codes, not clipped.
        measured: ``(B, N, C, H, W)``, MeasNet's guess of what a global shutter would have measured of each frame, less the
            offset, DN / 2^bits; empty without MeasNet.
    """

    image: Tensor
    measured: Tensor


class FrameBody(nn.Module):
    """A network over the frames of a clip: as channels of one image (2D), or as a stack of images (3D)."""

    def __init__(
        self,
        frames: int,
        own: int,
        shared: int,
        outputs: int,
        *,
        dimensions: Literal[2, 3],
        body: Literal["naf", "unet"],
        blocks: int,
        filters: int,
        levels: int,
        stem: int,
    ) -> None:
        """Build it for so many channels of each frame, channels that all frames share, and outputs of each frame.

        See `NafNet` and `UNet` for the sizes; at first the outputs are 0.
        """
        super().__init__()
        self.frames, self.flat = frames, dimensions == 2
        many = frames if self.flat else 1
        inputs = many * own + shared
        sizes: dict[str, Any] = {"filters": filters, "levels": levels, "stem": stem, "dimensions": dimensions}
        if body == "naf":
            self.body: MultiScaleNetwork = NafNet(inputs, many * outputs, blocks=blocks, **sizes)
        else:
            self.body = UNet(inputs, many * outputs, **sizes)
        nn.init.zeros_(self.body.head.weight)

    def forward(self, own: Tensor, shared: Tensor) -> Tensor:
        """Return ``(B, N, outputs, h, w)`` of ``own`` ``(B, N, own, h, w)`` and ``shared`` ``(B, shared, h, w)``."""
        if self.flat:
            return self.body(torch.cat([own.flatten(1, 2), shared], dim=1)).unflatten(1, (self.frames, -1))
        alike = shared[:, :, None].expand(-1, -1, self.frames, -1, -1)
        return self.body(torch.cat([own.transpose(1, 2), alike], dim=1)).transpose(1, 2)


class VideoNet(nn.Module):
    """The frames of captures; all is in float32 but the bodies, which autocast may run in bfloat16.

    Attributes:
        joint: gives the estimate that it begins with, where that is joint least squares; else None.
    """

    weights: Tensor
    colours: Tensor
    to_camera: Tensor

    def __init__(
        self,
        capture: CaptureModel,
        *,
        initial_estimate: Start,
        measnet: bool,
        dimensions: Literal[2, 3],
        body: Literal["naf", "unet"],
        filters: int,
        blocks: int,
        levels: int,
        stem: int,
        refinements: int,
        noise_aware: bool,
        repeats: int,
        joint_iterations: int,
    ) -> None:
        """Build the network for a camera.

        Args:
            capture: the camera, with its timing and the PSFs of one plane.
            initial_estimate: what it begins with: each sliver inverted by itself, closed rows left dark (with MeasNet, the
                inversions of what it completes, as in the thesis); the static inversion of the whole capture; or joint least
                squares.
            measnet: complete the capture to a global measurement of each frame, and invert these, too.
            dimensions: 2: frames are channels; 3: a stack.
            body: NAF blocks, or the thesis's U-Net.
            filters: of the bodies' first level.
            blocks: of NAF blocks on each level and way.
            levels: how many.
            stem: pixels per side that MeasNet takes as one; in 2D.
            refinements: how many, each with weights of its own.
            noise_aware: lambda adapts to the noise level, which is an input of the bodies, too.
            repeats: of the last refinement, with its weights.
            joint_iterations: of the joint least squares.

        Raises:
            InputError: the camera of stills, a stack of several planes, or sizes that make no sense.
        """
        super().__init__()
        check_choices(("initial_estimate", initial_estimate, STARTS), ("body", body, ("naf", "unet")))
        if capture.timing is None:
            raise InputError(
                "capture", "got the camera of stills, but VideoNet is for clips; take flatnet3d or flatnet2d"
            )
        check_one_plane(capture, "VideoNet")
        if body == "unet" and blocks != 1:
            raise InputError("blocks", f"got {blocks} with body: unet, which has none; take 1, or body: naf")
        if repeats and not refinements:
            raise InputError("repeats", f"got {repeats} without refinements, expected 0; or take refinements: 1")
        image, whole, capture = capture.scene_shape, capture, capture.with_border(_BORDER)
        self.image, self.frames = capture.middle(image), capture.frames
        self.start, self.noise_aware = initial_estimate, noise_aware
        options: dict[str, Any] = {"regularisation_lambda": 0.3, "tikhonov": 1.0}
        options["noise_weight"] = _NOISE_WEIGHT if noise_aware else None
        self.inversion = RegularisedInversion(capture, **options)
        steps: dict[str, Any] = dict(JOINT) | {"iterations": joint_iterations}
        # It knows the whole field: light from beyond the border, taken for the border's, would spoil it.
        bordered = replace(whole, scene_shape=capture.scene_shape)
        self.joint = JointLeastSquares(bordered, **steps) if initial_estimate == "joint" else None
        channels = len(capture.stack.channels)
        rows = torch.from_numpy(capture.row_shares)[:, None, :, None]
        numbers = {
            "weights": rows,  # of light as if all rows had the same exposure
            "colours": torch.linalg.pinv(torch.from_numpy(capture.scene_to_camera)),
            "to_camera": torch.from_numpy(capture.scene_to_camera),
        }
        for name, values in numbers.items():
            self.register_buffer(name, values.to(torch.get_default_dtype()), persistent=False)
        sizes: dict[str, Any] = {"dimensions": dimensions, "body": body, "blocks": blocks}
        sizes |= {"filters": filters, "levels": levels}
        self.measnet = self.wiener = None
        if measnet:
            inside = stem if dimensions == 2 else 1
            self.measnet = FrameBody(
                self.frames, 2 * channels + 1, channels + noise_aware, channels, **sizes, stem=inside
            )
            self.wiener = WienerInversion(capture, noise_to_signal=_WIENER)
        self.enhancement = FrameBody(
            self.frames, channels * (1 + measnet) + 3, channels + noise_aware, 3, **sizes, stem=1
        )
        corrections = (
            FrameBody(self.frames, channels + 3, 2 * channels + noise_aware, 3, **sizes, stem=1)
            for _ in range(refinements)
        )
        self.refinements = nn.ModuleList(corrections)
        self.repeats = repeats

    def forward(self, measurement: Tensor, start: Tensor | None = None) -> Film:
        """Return the frames of measurements ``(B, C, H, W)``, DN / 2^bits; ``start`` is what `begin` gives, where known."""
        first = self.inversion
        check_measurement(measurement, first.offset, first.rows, first.columns)
        with torch.autocast(measurement.device.type, enabled=False):
            light = first.light(measurement)
            noise = noise_ratio(light) if self.noise_aware else None
            static = first.volume(first.spectrum(light), noise)[:, 0]
            frames = self._begun(measurement, light, static, noise) if start is None else start
        level = [] if noise is None else [level_image(noise, static)]
        own, base = [frames], frames
        measured = light.new_zeros(0)
        if self.measnet is not None and self.wiener is not None:
            measured = self._completed(light, frames, noise)
            with torch.autocast(light.device.type, enabled=False):
                inverted = self.wiener.scene(measured)
            own.append(inverted)
            base = inverted if self.start == "slivers" else frames
        with torch.autocast(light.device.type, enabled=False):
            radiance = torch.einsum("ac,bnchw->bnahw", self.colours, base).clamp(0, MOST_RADIANCE)
            codes = linear_to_srgb(radiance, 1.0, clip=False)
        image = codes + self.enhancement(torch.cat([*own, codes], dim=2), torch.cat([static, *level], dim=1)).to(codes)
        for refinement in (*self.refinements, *list(self.refinements)[-1:] * self.repeats):
            with torch.autocast(light.device.type, enabled=False):
                of_frames, of_all = self._residuals(image, light, noise)
            shared = torch.cat([of_all, static, *level], dim=1)
            image = image + refinement(torch.cat([of_frames, image], dim=2), shared).to(image)
        return Film(image[self.image], measured)

    def begin(self, measurement: Tensor) -> Tensor | None:
        """Return the joint least squares ``(B, N, C, h, w)`` that it begins with, to be kept; None for any other start."""
        return None if self.joint is None else self.joint(measurement)

    def take(self, known: nn.Module, source: str) -> list[str]:
        """Put the weights of another network of this kind, or of a FlatNet2D, into this one, and say what was taken.

        A FlatNet2D gives what lies between the first and the last convolution of its body to EnhanceNet.

        Raises:
            InputError: weights of other shapes, naming the ``source``; the network stays as it was.
        """
        own, found = self.state_dict(), known.state_dict()
        wanted: list[str] = []
        if not isinstance(known, VideoNet):
            body = "enhancement.body."
            ends = (body + self.enhancement.body.first_weight.removesuffix("weight"), f"{body}head.")
            known_body = {name.replace("enhancement.", body): name for name in found if name.startswith("enhancement.")}
            found = {name: found[other] for name, other in known_body.items() if not name.startswith(ends)}
            wanted = [name for name in own if name.startswith(body) and not name.startswith(ends)]
        missing = [name for name in found if name not in own or own[name].shape != found[name].shape]
        missing += [name for name in wanted if name not in found]
        if missing or not found:
            what = (
                f"{missing[0]} differs in shape, or exists in only one of the two"
                if missing
                else "it has nothing of this network"
            )
            raise InputError(source, f"{what}; take a checkpoint of the same size (filters, blocks, levels, body)")
        self.load_state_dict(own | found)
        return [f"copied {len(found)} of {len(own)} tensors"]

    def _begun(self, measurement: Tensor, light: Tensor, static: Tensor, noise: Tensor | None) -> Tensor:
        """Return the first estimate, ``(B, N, C, h, w)``, linear, 1 for white."""
        if self.start == "joint":
            found = self.begin(measurement)
            assert found is not None
            return found
        if self.start == "static":
            return static[:, None].expand(-1, self.frames, -1, -1, -1)
        # As dark as few rows are: multiplied up to the light of all, as `SliverInversion` does, they trained to 0.3 dB less.
        return self._inverted(light[:, None] * self.weights, noise)

    def _inverted(self, light: Tensor, noise: Tensor | None) -> Tensor:
        """Return the static inversion of each of ``(B, N, C, H, W)``."""
        every = None if noise is None else noise.repeat_interleave(light.shape[1], dim=0)
        spectrum = self.inversion.spectrum(light.flatten(0, 1))
        return self.inversion.volume(spectrum, every)[:, 0].unflatten(0, light.shape[:2])

    def _seen(self, frames: Tensor) -> Tensor:
        """Return what a global shutter would measure of frames ``(B, N, C, h, w)``, light ``(B, N, C, H, W)``."""
        return self.inversion.reproject(frames.flatten(0, 1)[:, None]).unflatten(0, frames.shape[:2])

    def _completed(self, light: Tensor, frames: Tensor, noise: Tensor | None) -> Tensor:
        """Return what MeasNet takes for the global measurements of the frames, without their offset."""
        assert self.measnet is not None
        with torch.autocast(light.device.type, enabled=False):
            unit = light.square().mean(dim=(1, 2, 3), keepdim=True).sqrt().clamp_min(_FAINTEST)
            slivers = light[:, None] * self.weights
            known = slivers if self.start == "slivers" else self._seen(frames)
            masks = self.weights.expand(len(light), -1, 1, -1, light.shape[-1])
            own = torch.cat([known / unit[:, None], slivers / unit[:, None], masks], dim=2)
            shared = torch.cat([light / unit, *([] if noise is None else [level_image(noise, light)])], dim=1)
        added = self.measnet(own, shared)
        return known + unit[:, None] * added.to(known)

    def _residuals(self, image: Tensor, light: Tensor, noise: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return the inverted residuals of each frame's rows ``(B, N, C, h, w)`` and of all rows ``(B, C, h, w)``."""
        linear = srgb_to_linear(image, 1.0, clip=False).clamp(0, MOST_RADIANCE)
        frames = torch.einsum("ca,bnahw->bnchw", self.to_camera, linear)
        residual = light - (self._seen(frames) * self.weights).sum(dim=1)
        shares = self.weights / self.weights.mean(dim=2, keepdim=True)
        every = self._inverted(torch.cat([residual[:, None] * shares, residual[:, None]], dim=1), noise)
        return every[:, :-1], every[:, -1]


VIDEO_SIZES: dict[str, dict[str, Any]] = {
    "thesis": {
        **{"initial_estimate": "slivers", "measnet": True, "dimensions": 2, "body": "unet", "filters": 32, "blocks": 1},
        **{"levels": 3, "stem": 1, "refinements": 0, "repeats": 0, "noise_aware": False, "joint_iterations": 10},
    },
    "compact": {
        **{"initial_estimate": "joint", "measnet": False, "dimensions": 2, "body": "naf", "filters": 32, "blocks": 1},
        **{"levels": 4, "stem": 2, "refinements": 1, "repeats": 0, "noise_aware": True, "joint_iterations": 10},
    },
    "tiny": {
        **{"initial_estimate": "joint", "measnet": True, "dimensions": 2, "body": "naf", "filters": 8, "blocks": 1},
        **{"levels": 2, "stem": 2, "refinements": 1, "repeats": 0, "noise_aware": True, "joint_iterations": 10},
    },
}
"""``thesis``: its U-Nets of 32 to 128 filters on zero-filled slivers, blind to the noise. Beyond the thesis, MeasNet is told
the whole capture and which rows were open, EnhanceNet the static inversion and that of each sliver, and both add to what they
begin with."""


class VideoMethod:
    """A VideoNet as a method; see `learning.method.Method`. Its weights and device may change between reconstructions."""

    def __init__(self, name: str, network: VideoNet, capture: CaptureModel) -> None:
        self.name, self.network, self.capture = name, network, capture

    def to(self, device: torch.device | str) -> Self:
        """Move the network to a device, and return this."""
        self.network.to(device)
        return self

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the frames of measurements ``(B, C, H, W)``; stages ``joint`` where it begins so, and ``network``."""
        clock = clock or Clock(measurement.device)
        with inference(self.network):
            start = None
            if self.network.joint is not None:
                with clock.stage("joint"), threads_for(measurement[0].numel() * self.capture.frames):
                    start = self.network.begin(measurement)
            with clock.stage("network"):
                image = self.network(measurement, start).image
        return Estimate(image, torch.zeros_like(image[:, :, :1]))
