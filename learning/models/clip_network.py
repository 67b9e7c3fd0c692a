"""What networks for the clips of a rolling shutter begin with: estimates of every frame from one capture.

The thesis, section 4.2: MeasNet completes the slivers of a capture to what a global shutter would have measured of each
frame, a learned inversion (equation 4.1) makes an image of each. Instead of zero-filled slivers they may begin with the
static inversion of the whole capture or with joint least squares over space and time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, Generic, Literal, NamedTuple, Protocol, Self, TypeVar

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
from learning.method import Clock, check_choices, linear_to_srgb, threads_for
from learning.models.refinement import MOST_RADIANCE
from simulator.errors import InputError

Start = Literal["slivers", "static", "joint"]
STARTS = ("slivers", "static", "joint")
_BORDER = 8
"""Pixels around the image that are estimated, too: all that a narrow stop leaves of the field. Re-simulations and inversions
take what lies farther out for dark."""
_NOISE_WEIGHT = 30.0
_WIENER = 1.0  # noise to signal at which the learned filter of global measurements begins
FAINTEST = 1e-4
"""Least light of a capture by which it is divided, of full scale."""


def check_clips(capture: CaptureModel, name: str) -> None:
    """Raise an InputError where a camera's captures are stills, while what is called ``name`` is for clips."""
    if capture.timing is None:
        reason = f"got the camera of stills, but {name} is for clips; take data with scene.frames, or flatnet3d"
        raise InputError("capture", reason)


def camera_codes(colours: Tensor, light: Tensor) -> Tensor:
    """Return sRGB codes ``(..., 3, h, w)``, not clipped above white, of light in the camera's channels.

    ``colours`` ``(3, C)`` takes the channels to linear sRGB.
    """
    radiance = torch.einsum("ac,...chw->...ahw", colours, light).clamp(0, MOST_RADIANCE)
    return linear_to_srgb(radiance, 1.0, clip=False)


class InvertedClip(NamedTuple):
    """What is known of captures before a network's own part; estimates are light in the camera's channels, 1 for white.

    Attributes:
        light: ``(B, C, H, W)``, the captures less their offset.
        noise: ``(B, C)``, noise to signal; None of networks that are blind to it.
        frames: ``(B, N, E C, h, w)``, E estimates of every frame: the first one, then those from MeasNet.
        best: ``(B, N, C, h, w)``, that of them which a network adds to.
        shared: the static inversion, and the noise as an image, ``(B, C, h, w)`` or one channel more.
        measured: ``(B, N, C, H, W)``, MeasNet's guess of what a global shutter would have measured of each frame, less the
            offset, DN / 2^bits; empty without MeasNet.
    """

    light: Tensor
    noise: Tensor | None
    frames: Tensor
    best: Tensor
    shared: Tensor
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


class ClipNetwork(nn.Module):
    """The part that comes first; all of it is in float32 but MeasNet, which autocast may run in bfloat16.

    Attributes:
        joint: gives the estimate that it begins with, where that is joint least squares; else None.
        border: pixels around the image that its estimates have more, of each side.
        estimates: how many it makes of every frame, E.
        shared: channels of the images that all frames share.
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
        noise_aware: bool,
        joint_iterations: int,
        joint_noise: float,
        joint_correlation: float,
        **body: Any,
    ) -> None:
        """Build it for a camera.

        Args:
            capture: the camera, with its timing and the PSFs of one plane.
            initial_estimate: what it begins with: each sliver inverted by itself, closed rows left dark (with MeasNet, the
                inversions of what it completes, as in the thesis); the static inversion of the whole capture; or joint least
                squares.
            measnet: complete the capture to a global measurement of each frame, and invert these, too.
            noise_aware: lambda adapts to the noise level, which is an input of the bodies, too.
            joint_iterations: of the joint least squares.
            joint_noise: their noise.
            joint_correlation: of their colours.
            **body: of MeasNet, see `FrameBody`.

        Raises:
            InputError: the camera of stills, a stack of several planes, or sizes that make no sense.
        """
        super().__init__()
        check_choices(("initial_estimate", initial_estimate, STARTS), ("body", body["body"], ("naf", "unet")))
        name = type(self).__name__
        check_clips(capture, name)
        check_one_plane(capture, name)
        if body["body"] == "unet" and body["blocks"] != 1:
            raise InputError("blocks", f"got {body['blocks']} with body: unet, which has none; take 1, or body: naf")
        image, whole, capture = capture.scene_shape, capture, capture.with_border(_BORDER)
        self.image, self.frames = capture.middle(image), capture.frames
        self.start, self.noise_aware = initial_estimate, noise_aware
        options: dict[str, Any] = {"regularisation_lambda": 0.3, "tikhonov": 1.0}
        options["noise_weight"] = _NOISE_WEIGHT if noise_aware else None
        self.inversion = RegularisedInversion(capture, **options)
        steps: dict[str, Any] = dict(JOINT) | {"iterations": joint_iterations, "noise": joint_noise}
        steps |= {"correlation": joint_correlation}
        # It knows the whole field: light from beyond the border, taken for the border's, would spoil it.
        bordered = replace(whole, scene_shape=capture.scene_shape)
        self.joint = JointLeastSquares(bordered, **steps) if initial_estimate == "joint" else None
        channels = len(capture.stack.channels)
        self.estimates, self.shared = 1 + measnet, channels + noise_aware
        rows = torch.from_numpy(capture.row_shares)[:, None, :, None]
        numbers = {
            "weights": rows,  # of light as if all rows had the same exposure
            "colours": torch.linalg.pinv(torch.from_numpy(capture.scene_to_camera)),
            "to_camera": torch.from_numpy(capture.scene_to_camera),
        }
        for name, values in numbers.items():
            self.register_buffer(name, values.to(torch.get_default_dtype()), persistent=False)
        self.measnet = self.wiener = None
        if measnet:
            sizes: dict[str, Any] = body | {"stem": body["stem"] if body["dimensions"] == 2 else 1}
            self.measnet = FrameBody(self.frames, 2 * channels + 1, self.shared, channels, **sizes)
            self.wiener = WienerInversion(capture, noise_to_signal=_WIENER)

    def invert(self, measurement: Tensor, start: Tensor | None = None) -> InvertedClip:
        """Invert measurements ``(B, C, H, W)``, DN / 2^bits; ``start`` is their `initial_estimate`, where known."""
        first = self.inversion
        check_measurement(measurement, first.offset, first.rows, first.columns)
        with torch.autocast(measurement.device.type, enabled=False):
            light = first.light(measurement)
            noise = noise_ratio(light) if self.noise_aware else None
            static = first.volume(first.spectrum(light), noise)[:, 0]
            frames = self._first_estimate(measurement, light, static, noise) if start is None else start
        shared = torch.cat([static, *([] if noise is None else [level_image(noise, static)])], dim=1)
        if self.measnet is None or self.wiener is None:
            return InvertedClip(light, noise, frames, frames, shared, light.new_zeros(0))
        measured = self._completed(light, frames, noise)
        with torch.autocast(light.device.type, enabled=False):
            inverted = self.wiener.scene(measured)
        best = inverted if self.start == "slivers" else frames
        return InvertedClip(light, noise, torch.cat([frames, inverted], dim=2), best, shared, measured)

    def initial_estimate(self, measurement: Tensor) -> Tensor | None:
        """Return the joint least squares ``(B, N, C, h, w)`` that it begins with, to be kept; None for any other start."""
        return None if self.joint is None else self.joint(measurement)

    def codes(self, light: Tensor) -> Tensor:
        """Return `camera_codes` of this camera."""
        with torch.autocast(light.device.type, enabled=False):
            return camera_codes(self.colours, light)

    def _first_estimate(self, measurement: Tensor, light: Tensor, static: Tensor, noise: Tensor | None) -> Tensor:
        """Return the first estimate, ``(B, N, C, h, w)``, linear, 1 for white."""
        if self.start == "joint":
            found = self.initial_estimate(measurement)
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
            unit = light.square().mean(dim=(1, 2, 3), keepdim=True).sqrt().clamp_min(FAINTEST)
            slivers = light[:, None] * self.weights
            known = slivers if self.start == "slivers" else self._seen(frames)
            masks = self.weights.expand(len(light), -1, 1, -1, light.shape[-1])
            own = torch.cat([known / unit[:, None], slivers / unit[:, None], masks], dim=2)
            shared = torch.cat([light / unit, *([] if noise is None else [level_image(noise, light)])], dim=1)
        added = self.measnet(own, shared)
        return known + unit[:, None] * added.to(known)


def copy_weights(
    network: nn.Module, found: Mapping[str, Tensor], source: str, cure: str, wanted: Iterable[str] = ()
) -> list[str]:
    """Put another network's weights in the places of the same names, and say how many; those of ``wanted`` must be there.

    Raises:
        InputError: weights of other names or shapes, naming the ``source``, with the ``cure``; the network stays as it was.
    """
    own = network.state_dict()
    differing = [name for name in found if name not in own or own[name].shape != found[name].shape]
    differing += [name for name in wanted if name not in found]
    if differing or not found:
        first = (
            f"{min(differing)} differs in shape, or exists in only one of the two" if differing else "it has none of it"
        )
        raise InputError(source, f"{first}; {cure}")
    network.load_state_dict(own | dict(found))
    return [f"copied {len(found)} of {len(own)} tensors"]


class HasInitialEstimate(Protocol):
    """A network that may begin with what can be kept; see `ClipNetwork`."""

    @property
    def joint(self) -> nn.Module | None:
        """The module that computes the initial estimate, or None."""
        ...

    def initial_estimate(self, measurement: Tensor) -> Tensor | None:
        """Return the initial estimate, or None."""
        ...

    def to(self, device: torch.device | str) -> Any:
        """Move the network to a device."""
        ...


Network = TypeVar("Network", bound=HasInitialEstimate)


class ClipNetworkMethod(Generic[Network]):
    """What such networks have in common as a `learning.method.Method`; weights and device may change between calls."""

    def __init__(self, name: str, network: Network, capture: CaptureModel) -> None:
        self.name, self.network, self.capture = name, network, capture

    def to(self, device: torch.device | str) -> Self:
        """Move the network to a device, and return this."""
        self.network.to(device)
        return self

    def initial_estimate(self, measurement: Tensor, clock: Clock) -> Tensor | None:
        """Return what the network begins with; stage ``joint`` where joint least squares have a part in it."""
        if self.network.joint is None:
            return None
        with clock.stage("joint"), threads_for(measurement[0].numel() * self.capture.frames):
            return self.network.initial_estimate(measurement)
