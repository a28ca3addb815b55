"""What all generators of random parameters have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from kvision._constants import constant
from kvision.augmentation.columns import draw_columns
from kvision.augmentation.draws import Draw, Request
from kvision.augmentation.engine import settings_changed
from kvision.augmentation.keys import draw_keys
from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.ranges import LearnedUniform

Shape = Sequence[int]


class RandomGeneratorBase(nn.Module):
    """Base of the generators: draws of one augmentation, and the names that its parameters have for users.

    A subclass implements :meth:`draws`, and lists in `fields` how the columns that they give are called: pairs of a name and
    a width, 0 for a column that is a vector (B,). By these names the transforms and color steps of an augmentation refer to
    columns. Those in `hidden` are for them alone. A generator with other parameters than its columns overrides
    :meth:`to_params` and :meth:`to_columns`.

    Example:
        >>> import torch, kvision as K
        >>> class Angle(K.augmentation.random_generator.RandomGeneratorBase):
        ...     fields = (("angle", 0),)
        ...     def draws(self, shape):
        ...         return [K.augmentation.draws.uniform(-10.0, 10.0)]
        >>> Angle()((4, 3, 8, 8))["angle"].shape
        torch.Size([4])
    """

    fields: Sequence[tuple[str, int]] = ()
    hidden: Sequence[str] = ()  # fields that are no parameters
    per_pixel = False  # there are `pixel_params` besides
    draws_channels = False  # numbers of them, which others have not
    has_planes_of_images = True  # as many as images have, or one
    is_exact = False  # in which float32 has the numbers that operators draw for images of float64
    derives = False  # the columns follow from the drawn ones by `derive`
    has_names = True  # False if users see none of the columns, so that given parameters can lack none

    def __init__(self) -> None:
        super().__init__()
        self.device, self.dtype = torch.device("cpu"), torch.float32
        self._has_samplers = False

    def __setattr__(self, name: str, value: Any) -> None:
        settings_changed()
        super().__setattr__(name, value)

    @property
    def _draws_by_name(self) -> bool:
        """Whether :meth:`forward` is a user's, which gives parameters and no columns."""
        return type(self).forward is not RandomGeneratorBase.forward

    def set_rng_device_and_dtype(self, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float32) -> None:
        """Choose where and in which type :meth:`forward` gives parameters. The values do not depend on the device."""
        self.device, self.dtype = torch.device(device), dtype
        self._has_samplers = False

    def make_samplers(self, device: torch.device, dtype: torch.dtype) -> None:
        """Called before the first :meth:`forward`, for generators written for Kornia; there is nothing to prepare here."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        if not self._has_samplers:
            self._has_samplers = True
            self.make_samplers(self.device, self.dtype)
        return super().__call__(*args, **kwargs)

    def draws(self, shape: Shape) -> Sequence[Draw | LearnedUniform]:
        """The draws for images of `shape` (B, C, H, W)."""
        raise NotImplementedError(f"{type(self).__name__}.draws")

    def derive(self, drawn: Tensor, sizes: Tensor, labels: Any) -> Tensor:
        """The columns (B, P), which `fields` name, from drawn ones, where a class has `derives`.

        Args:
            drawn: what `draws` gives.
            sizes: height and width of the images, (B, 2), or (1, 2) for all.
            labels: boxes (B, N, 4) by their edges, 0 for none, or a list of masks (B, C, H, W), or of lists of (N, H, W) of each
                image, as the augmentation says; None if there are none.

        Returns:
            The columns.
        """
        raise NotImplementedError(f"{type(self).__name__}.derive")

    def identity(self, sizes: Tensor) -> Tensor:
        """The derived columns (1, P) of samples that are not chosen, from the size (1, 2) of the images."""
        raise NotImplementedError(f"{type(self).__name__}.identity")

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        """The parameters by name, from their columns (B, P)."""
        params, first = {}, 0
        for name, width in self.fields:
            if name not in self.hidden:
                params[name] = columns[:, first : first + width] if width else columns[:, first]
            first += width or 1
        return params

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        """The columns (B, P) of parameters by name, hidden ones among them: the inverse of :meth:`to_params`."""
        parts = [params[name] if width else params[name][:, None] for name, width in self.fields]
        return torch.cat(parts, 1) if parts else torch.empty(shape[0], 0, device="cpu")

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Any]:
        """Parameters with numbers of their own for each pixel, which come from the noise of the key of a call.

        Those that are drawn where they are used, but for exact ones, are lists for the shape (B, C) of a list with height and
        width of each image.
        """
        return {}

    def forward(self, batch_shape: Shape, same_on_batch: bool = False) -> dict[str, Tensor]:
        """Draw the parameters of a batch with a key from torch's default generator.

        Args:
            batch_shape: shape of the images, (B, C, H, W).
            same_on_batch: the same parameters for all samples.

        Returns:
            The parameters by name, with one entry a sample.
        """
        like = torch.empty(batch_shape[0], device=self.device)
        keys = draw_keys(type(self).__name__, 1, like.device, None, None)
        (columns,) = draw_columns(like, keys, [Request(self.draws(batch_shape), same_on_batch=same_on_batch)])
        values = columns.values
        if self.derives:
            values = self.derive(values, constant(tuple(batch_shape[-2:]), values)[None], None).to(values)
        params = self.to_params(values, batch_shape)
        if self.per_pixel:
            noise = PixelNoise(keys, 0, same_on_batch, like.device)
            params.update(self.pixel_params(values, batch_shape, noise))
        return {
            name: x.to(self.dtype) if isinstance(x, Tensor) and x.is_floating_point() else x
            for name, x in params.items()
        }
