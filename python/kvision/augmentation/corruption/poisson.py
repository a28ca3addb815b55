"""Variates of the Poisson distribution from uniform numbers."""

from __future__ import annotations

import torch
from torch import Tensor


def poisson_quantile(u: Tensor, rate: Tensor) -> Tensor:
    """The least count whose cumulative probability is at least `u`, uniform in [0, 1), so that counts have the distribution.

    The expansion of Cornish and Fisher is at most one off from rates of .1 on, below which hardly a count is above 2. The
    distribution itself, a function of the incomplete gamma function, says which way.
    """
    z = torch.special.ndtri(u.clamp(1e-7, 1 - 1e-7))
    count = (rate + rate.sqrt() * z + (z * z - 1) / 6).floor().clamp(min=0)
    count = torch.where(rate < 0.1, count.clamp(max=1), count)
    probability = (count * rate.clamp(min=1e-30).log() - rate - torch.lgamma(count + 1)).exp()
    cumulative = torch.special.gammaincc(count + 1, rate)
    is_above = (count > 0) & (cumulative - probability >= u)
    return count + (cumulative < u).to(count) - is_above.to(count)
