"""A body that is told what to answer, for tests of what stands around it."""

import pytest
import torch


class Recorded(torch.nn.Module):
    """In place of a body: keeps what it is given and returns what it was told."""

    def __init__(self, output):
        super().__init__()
        self.output, self.given = output, None

    def forward(self, image):
        self.given = image
        return self.output


@pytest.fixture
def recorded() -> type[Recorded]:
    """Make one; see `Recorded`."""
    return Recorded
