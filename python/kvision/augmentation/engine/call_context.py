"""What the children of a container have in common in one call."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor, nn

from kvision.augmentation.engine.call_labels import CallLabels
from kvision.augmentation.engine.configuration import Plans
from kvision.augmentation.engine.stages import Stage
from kvision.augmentation.keys import Keys, Seed, check_seeds, draw_keys, frame_seeds
from kvision.augmentation.warp_and_color import SAME, Output, make_pass
from kvision.color.frames import Frames


class CallContext(NamedTuple):
    """What the children of a container have in common in one call: the randomness they draw from, and what is asked of results."""

    op: str
    seed: Seed
    generator: Generator | None  # of the call: it replaces those of all modules
    once: bool  # one resampling for neighboring geometric augmentations
    plans: Plans  # of the container
    output: Output = SAME  # the type and layout of the results
    frames: int = 1  # how many neighboring samples share their parameters: the frames of a video
    position: int = 0  # of the first child in the chain, under a seed
    time: int = 0  # how many neighboring samples are the frames of a video; 0 for images
    has_labels: bool = False  # which follow the images, so that maps are kept for them
    labels: CallLabels | None = None  # of the images, for draws that read them
    default_generator: Generator | None = None  # of the container, for children without one of their own
    is_certain: bool = False  # children are executed for all samples, whatever their probabilities say
    # (B,) on the CPU: the number of the only child that a sample gets, of a run which then is certain; None where it gets all.
    owners: Tensor | None = None
    source: Frames | None = None  # of which the images are, before the first child; these have no values then

    @classmethod
    def of_module(cls, op: str, seed: Seed, generator: Generator | None, plans: Plans | None = None) -> CallContext:
        """That of a module by itself, without a container."""
        return cls(op, seed, generator, False, plans or Plans())

    def generator_of(self, module: nn.Module) -> Generator | None:
        """The generator that draws for a module; None for torch's."""
        return self.generator or getattr(module, "generator", None) or self.default_generator

    def inside(self, module: Any, once: bool, plans: Plans, output: Output) -> CallContext:
        """For the children of a container that is a child."""
        labels = None if self.labels is None else self.labels.inside(module._label_settings)
        own = (self.frames, self.position, self.time, self.has_labels, labels, self.generator_of(module))
        inside = CallContext(self.op, self.seed, self.generator, once, plans, output, *own)  # faster than _replace
        return inside if self.source is None else inside._replace(source=self.source)

    def after(self, stages: Sequence[Stage]) -> CallContext:
        """For what comes after stages, with the labels that they leave."""
        if self.labels is None or not stages:
            return self
        return self._replace(labels=self.labels.after(stages))

    def converted(self, x: Tensor) -> Tensor:
        """A result in the type and the layout that are asked for."""
        return x if self.output == SAME else make_pass(None, output=self.output).run(x, None)[0]

    def check_seeds(self, keys: Keys | None, samples: int) -> None:
        """Raise unless keys are those of as many samples."""
        if keys is not None and keys.seeds is not None:
            check_seeds(self.op, keys, samples)

    @property
    def seed_of_samples(self) -> Seed:
        """The seed of a call; seeds of videos as those of their frames, where these have parameters of their own."""
        if isinstance(self.seed, Tensor) and self.seed.dim() == 1 and self.time > 0 and self.frames == 1:
            return frame_seeds(self.seed, self.time)
        return self.seed

    def keys(self, modules: Sequence[Any], x: Tensor, known: Keys | None = None) -> Keys:
        """A key of each augmentation, each from its generator; `known` are those of the first ones, if they have been drawn."""
        if self.seed is not None:
            return known or draw_keys(self.op, len(modules), x.device, self.seed_of_samples, None)
        if known is None and (self.generator is not None or not any([module.generator for module in modules])):
            return draw_keys(self.op, len(modules), x.device, None, self.generator or self.default_generator)
        generators = [self.generator_of(module) for module in modules[0 if known is None else len(known.keys) :]]
        each = [draw_keys(self.op, 1, x.device, None, generator).keys for generator in generators]
        parts = each if known is None else [known.keys, *each]
        on_device = next((part.device for part in parts if part.is_cuda), parts[0].device)
        return Keys(torch.cat([part.to(on_device) for part in parts]))
