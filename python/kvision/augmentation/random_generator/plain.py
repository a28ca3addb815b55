"""Generators of uniform parameters, and the distributions that code written for Kornia builds generators of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.distributions import Distribution, Uniform

from kvision.augmentation import ranges
from kvision.augmentation.draws import Draw
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape

__all__ = ["DistributionWithMapper", "PlainUniformGenerator", "ProbabilityGenerator", "UniformDistribution"]


class PlainUniformGenerator(RandomGeneratorBase):
    """Draws one uniform parameter (B,) for each of some ranges.

    Args:
        *samplers: (range, name, center, bounds): a pair, or a number s for center - s to center + s within the bounds.
            A center of None takes pairs only, bounds of None are none.
        identity: the values of samples that are not chosen; default: 0.
        op: the name in messages of errors; default: that of the class.

    Returns:
        The parameters (B,) by name.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import kvision as K
        >>> draw = K.augmentation.random_generator.PlainUniformGenerator(((2.0, 2.0), "factor", None, None))
        >>> draw((3, 1, 4, 4))
        {'factor': tensor([2., 2., 2.])}
    """

    def __init__(
        self, *samplers: Sequence[Any], identity: Sequence[float] | None = None, op: str | None = None
    ) -> None:
        super().__init__()
        self._ranges = []
        for value, name, center, bounds in samplers:
            (value,) = ranges.keep_parameters(self, **{name: value})
            limits = (-float("inf"), float("inf")) if bounds is None else (float(bounds[0]), float(bounds[1]))
            center = None if center is None else float(center)
            self._ranges.append(ranges.parse(op or type(self).__name__, name, value, center=center, bounds=limits))
        self.fields = tuple((name, 0) for _, name, _, _ in samplers)
        self._identity = identity or [0.0] * len(samplers)

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [r.uniform(identity=identity) for r, identity in zip(self._ranges, self._identity)]


class ProbabilityGenerator(RandomGeneratorBase):
    """Draws which samples are augmented.

    Args:
        p: probability of each sample.

    Returns:
        probs (B,): 1 or 0.

    Raises:
        ValueError: `p` is not within 0 and 1.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.ProbabilityGenerator(p=1.0)((3, 1, 4, 4))
        {'probs': tensor([1., 1., 1.])}
    """

    def __init__(self, p: float = 0.5) -> None:
        super().__init__()
        ranges.parse("ProbabilityGenerator", "p", (p, p), bounds=(0.0, 1.0))
        self.p = float(p)

    def draws(self, shape: Shape) -> Sequence[Draw]:
        return [Draw("uniform", (0.0, 1.0, 0.0))]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"probs": (columns[:, 0] < self.p).float()}


class UniformDistribution(Uniform):
    """torch's uniform distribution, whose bounds may be equal.

    Args:
        low: lowest value.
        high: highest value.
        validate_args: whether samples are checked; default: no.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.UniformDistribution(1.0, 1.0).sample()
        tensor(1.)
    """

    def __init__(self, low: Any, high: Any, validate_args: bool | None = None) -> None:
        super().__init__(low, high, validate_args=bool(validate_args))


class DistributionWithMapper(Distribution):
    """A distribution whose samples are mapped by a function.

    Args:
        dist: the distribution.
        map_fn: the function, of a tensor; None for none.

    Example:
        >>> import torch, kvision as K
        >>> one = torch.distributions.Uniform(1.0, 1.0 + 1e-7)
        >>> K.augmentation.random_generator.DistributionWithMapper(one, lambda x: 2 * x).sample().round()
        tensor(2.)
    """

    def __init__(self, dist: Distribution, map_fn: Callable[[Tensor], Tensor] | None = None) -> None:
        self.dist, self.map_fn = dist, map_fn

    def rsample(self, sample_shape: Sequence[int] = torch.Size()) -> Tensor:  # torch's default
        out = self.dist.rsample(torch.Size(sample_shape))
        return out if self.map_fn is None else self.map_fn(out)

    def sample(self, sample_shape: Sequence[int] = torch.Size()) -> Tensor:  # torch's default
        out = self.dist.sample(torch.Size(sample_shape))
        return out if self.map_fn is None else self.map_fn(out)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.dist, name)
