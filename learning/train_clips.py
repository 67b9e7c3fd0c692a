"""What trainings on clips have in common, of videos and of activities."""

from __future__ import annotations

import itertools

from learning.clip_examples import ClipExample, ClipExamples
from learning.data import Batches, Draw
from learning.train import NetworkTraining


class ClipTraining(NetworkTraining[ClipExample]):
    """A training on the clips of a data set instead of stills."""

    _examples: ClipExamples
    _held_out: ClipExamples

    def estimate_ahead(self) -> None:
        """On a GPU, compute all initial estimates that the training will ask for; several processes share them."""
        joint, group, config = getattr(self._network, "joint", None), self._group, self._config
        if joint is None or not group.on_cuda:
            return
        order = Batches(len(self._examples), config.batch, seed=config.seed)  # of all processes
        asked = itertools.chain.from_iterable(map(order.batch, range(self.progress.step, config.steps)))
        splits = {self._examples: asked, self._held_out: [Draw(place, 0) for place in range(len(self._held_out))]}
        missing = {each: each.missing(draws, group.rank, group.world_size) for each, draws in splits.items()}
        at_once, done = max(config.batch // group.world_size, 1), 0
        for examples, versions in missing.items():
            for count in examples.estimate_ahead(
                versions, lambda seen: joint(seen.to(group.device)), at_once, self._workers
            ):
                done += count
                self._show("first estimates", done, sum(map(len, missing.values())))
        group.gather(None)  # each needs what the others have computed
