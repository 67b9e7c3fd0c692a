"""VideoNet: the frames of a clip from one capture of a rolling shutter.

The thesis, section 4.2: EnhanceNet makes the frames of a `ClipNetwork`'s estimates of them. They may then be refined: each
refinement re-simulates the capture, inverts the residual of every frame's rows, and corrects the frames by it (Adler and
Oektem, Learned Primal-Dual Reconstruction, TMI 2018; Aggarwal et al., MoDL, TMI 2019).
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.method import Clock, Estimate, inference, srgb_to_linear
from learning.models.clip_network import ClipNetwork, ClipNetworkMethod, FrameBody, Start, copy_weights
from learning.models.refinement import MOST_RADIANCE
from simulator.errors import InputError


class Film(NamedTuple):
    """What VideoNet makes of captures.

    Attributes:
        image: ``(B, N, 3, h, w)`` sRGB codes, not clipped.
        measured: see `learning.models.clip_network.InvertedClip`.
    """

    image: Tensor
    measured: Tensor


class VideoNet(ClipNetwork):
    """The frames of captures; all is in float32 but the bodies, which autocast may run in bfloat16."""

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
        joint_noise: float,
        joint_correlation: float,
    ) -> None:
        """Build the network for a camera; see `ClipNetwork`, which has the first arguments and errors, for those not here.

        Args:
            capture: the camera, with its timing and the PSFs of one plane.
            initial_estimate: what it begins with.
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
            joint_noise: their noise.
            joint_correlation: of their colours.
        """
        if repeats and not refinements:
            raise InputError("repeats", f"got {repeats} without refinements, expected 0; or take refinements: 1")
        sizes: dict[str, Any] = {"dimensions": dimensions, "body": body, "blocks": blocks}
        sizes |= {"filters": filters, "levels": levels}
        super().__init__(
            capture,
            initial_estimate=initial_estimate,
            measnet=measnet,
            noise_aware=noise_aware,
            joint_iterations=joint_iterations,
            joint_noise=joint_noise,
            joint_correlation=joint_correlation,
            stem=stem,
            **sizes,
        )
        channels = len(capture.stack.channels)
        self.enhancement = FrameBody(self.frames, channels * self.estimates + 3, self.shared, 3, **sizes, stem=1)
        corrections = (
            FrameBody(self.frames, channels + 3, channels + self.shared, 3, **sizes, stem=1) for _ in range(refinements)
        )
        self.refinements = nn.ModuleList(corrections)
        self.repeats = repeats

    def forward(self, measurement: Tensor, start: Tensor | None = None) -> Film:
        """Return the frames of measurements ``(B, C, H, W)``, DN / 2^bits; ``start``: their `initial_estimate`, if known."""
        inverted = self.invert(measurement, start)
        codes = self.codes(inverted.best)
        image = codes + self.enhancement(torch.cat([inverted.frames, codes], dim=2), inverted.shared).to(codes)
        for refinement in (*self.refinements, *list(self.refinements)[-1:] * self.repeats):
            with torch.autocast(codes.device.type, enabled=False):
                of_frames, of_all = self._residuals(image, inverted.light, inverted.noise)
            shared = torch.cat([of_all, inverted.shared], dim=1)
            image = image + refinement(torch.cat([of_frames, image], dim=2), shared).to(image)
        return Film(image[self.image], inverted.measured)

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
        return copy_weights(
            self, found, source, "take a checkpoint of the same size (filters, blocks, levels, body)", wanted
        )

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
        **{"levels": 3, "stem": 1, "refinements": 0, "repeats": 0, "noise_aware": False},
        **{"joint_iterations": 10, "joint_noise": 1.0, "joint_correlation": 0.0},
    },
    "compact": {
        **{"initial_estimate": "joint", "measnet": False, "dimensions": 2, "body": "naf", "filters": 32, "blocks": 1},
        **{"levels": 4, "stem": 2, "refinements": 1, "repeats": 0, "noise_aware": True},
        **{"joint_iterations": 10, "joint_noise": 1.0, "joint_correlation": 0.0},
    },
    "tiny": {
        **{"initial_estimate": "joint", "measnet": True, "dimensions": 2, "body": "naf", "filters": 8, "blocks": 1},
        **{"levels": 2, "stem": 2, "refinements": 1, "repeats": 0, "noise_aware": True},
        **{"joint_iterations": 10, "joint_noise": 1.0, "joint_correlation": 0.0},
    },
}
"""``thesis``: its U-Nets of 32 to 128 filters on zero-filled slivers, blind to the noise. Beyond the thesis, MeasNet is told
the whole capture and which rows were open, EnhanceNet the static inversion and that of each sliver, and both add to what they
begin with."""


class VideoMethod(ClipNetworkMethod[VideoNet]):
    """A VideoNet as a method."""

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the frames of measurements ``(B, C, H, W)``; stages ``joint`` where it begins so, and ``network``."""
        clock = clock or Clock(measurement.device)
        with inference(self.network):
            start = self.initial_estimate(measurement, clock)
            with clock.stage("network"):
                image = self.network(measurement, start).image
        return Estimate(image, torch.zeros_like(image[:, :, :1]))
