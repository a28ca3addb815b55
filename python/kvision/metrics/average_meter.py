"""A running average."""

from __future__ import annotations

from torch import Tensor


class AverageMeter:
    """Keeps the last value, the sum, the count and the average of a series of values.

    Tensors stay on their device: only reading `avg` waits for it.

    Example:
        >>> import kvision as K
        >>> meter = K.metrics.AverageMeter()
        >>> meter.update(1.0)
        >>> meter.update(4.0, n=2)
        >>> meter.val, meter.sum, meter.count, meter.avg
        (4.0, 9.0, 3, 3.0)
    """

    val: float | Tensor
    sum: float | Tensor
    count: int

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Reset the sum and the count to 0.

        Example:
            >>> import kvision as K
            >>> meter = K.metrics.AverageMeter()
            >>> meter.update(1.0)
            >>> meter.reset()
            >>> meter.count
            0
        """
        self.val, self.sum, self.count = 0, 0, 0

    def update(self, val: float | Tensor, n: int = 1) -> None:
        """Add the average value of `n` samples.

        Example:
            >>> import torch, kvision as K
            >>> meter = K.metrics.AverageMeter()
            >>> meter.update(torch.tensor(2.0), n=3)
            >>> meter.sum
            tensor(6.)
        """
        self.val = val
        self.sum = self.sum + val * n
        self.count += n

    @property
    def avg(self) -> float:
        """The average, 0 before the first value.

        Example:
            >>> import kvision as K
            >>> K.metrics.AverageMeter().avg
            0.0
        """
        return float(self.sum) / self.count if self.count else 0.0
