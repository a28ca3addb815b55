"""A pass over images together with the draws of the columns that it reads: one kernel where no gradient is wanted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import torch
from torch import Tensor, is_grad_enabled

from kvision._hints import look_at_range
from kvision._ops import FastPath
from kvision._torch_compat import below_autograd, function_caller, in_forward_ad
from kvision.augmentation.columns import DrawPlan
from kvision.augmentation.keys import Keys
from kvision.augmentation.warp_and_color import Pass
from kvision.augmentation.warp_and_color_list import warp_and_color_list
from kvision.color.program import _DTYPES
from kvision.enhance.posterize import SPLIT
from kvision.geometry.transform.lists.arguments import check_list

# Types of images whose parameters and sampling coordinates are computed in float32.
COMPUTED_IN_FLOAT32 = (torch.float32, torch.float16, torch.bfloat16, torch.uint8)

_draw_warp_and_color = FastPath("draw_warp_and_color", COMPUTED_IN_FLOAT32)
_draw_list_warp_and_color = FastPath("draw_list_warp_and_color", COMPUTED_IN_FLOAT32)
_draw_sized_parameters = FastPath("draw_sized_parameters", COMPUTED_IN_FLOAT32)
_draw_warp_and_color_to_list = FastPath("draw_warp_and_color_to_list", COMPUTED_IN_FLOAT32)


def _want_gradients(images: Sequence[Tensor]) -> bool:
    """Whether a gradient of an image of a list is wanted: none of bytes, of which it takes the host longer to ask."""
    return is_grad_enabled() and images[0].is_floating_point() and any([image.requires_grad for image in images])


class DrawnPass:
    """Draws and a pass over images of one shape and type that reads the drawn columns."""

    def __init__(self, draws: DrawPlan, image_pass: Pass, shape: Sequence[int], dtype: torch.dtype) -> None:
        self.draws, self.image_pass = draws, image_pass
        in_doubles = image_pass.plan[0] == _DTYPES.index(torch.float64)
        takes_images = (
            len(shape) == 4
            and not (image_pass.has_contrast and shape[1] not in (1, 3))
            and not (image_pass.splits and dtype in SPLIT)  # for which posterization has other numbers
        )
        self.has_kernel = (
            takes_images
            and draws.learned is None
            and image_pass.resampling is None
            and not image_pass.chain
            and not in_doubles
        )
        self._plan: tuple[Tensor, Tensor] | None = None

    def run(self, x: Tensor, keys: Keys) -> tuple[Tensor, Tensor, Tensor]:
        """The result, the matrices (B, 3, 3) of the warp, which do not carry gradients, and the columns."""
        if self.has_kernel and _draw_warp_and_color.serves(x):
            y, matrix, columns = self._call(_draw_warp_and_color.kernel, x, x, keys)
            return y, matrix, columns
        columns = self.draws.draw(x, keys)
        y, matrix = self.image_pass.run(x, columns)
        return y, matrix, columns

    def run_list(self, images: list[Tensor], keys: Keys) -> tuple[Tensor, Tensor, Tensor, Tensor] | None:
        """The same of images (C, H, W) of different sizes, of which the first draws are, and the sizes (B, 2), on the CPU; None
        where no kernel does it all.
        """
        x = images[0].detach()
        if not self.has_kernel or not _draw_list_warp_and_color.serves(x) or in_forward_ad():
            return None

        def call(images: list[Tensor]) -> tuple[Tensor, ...]:
            results: tuple[Tensor, ...] = self._call(_draw_list_warp_and_color.kernel, images, x, keys)
            return results

        try:
            if _want_gradients(images):
                y, matrix, columns, sizes = _call_with_gradients(call, self.image_pass, *images)
            else:
                y, matrix, columns, sizes, _ = call(images)
            return y, matrix, columns, sizes
        except RuntimeError:
            check_list("lists", "images", images)  # which says more
            raise

    def _call(self, kernel: Any, images: Any, x: Tensor, keys: Keys) -> Any:
        if self._plan is None:
            self._plan = self._packed()
            if self.image_pass.clamps:
                look_at_range(x)
        return kernel(images, self.draws.keys_of(keys), keys.seeds_on(x.device), *self._plan)

    def draw(self, x: Tensor, keys: Keys) -> tuple[Tensor, tuple[Tensor, Tensor], None]:
        """The columns, the result with the matrices, and no links: what draws together with the first step give."""
        y, matrix, columns = self.run(x, keys)
        return columns, (y, matrix), None

    def _packed(self) -> tuple[Tensor, Tensor]:
        """The plan and the numbers of the kernel.

        The plan is the length of the plan of the draws, and that plan; how many of the numbers belong to the draws; the length
        of the size of the result, and that size; the plan of the pass.
        """
        draws, image_pass = self.draws, self.image_pass
        plan = [
            len(draws.plan),
            *draws.plan,
            len(draws.numbers),
            len(image_pass.size),
            *image_pass.size,
            *image_pass.plan,
        ]
        return packed(plan, [*draws.numbers, *image_pass.numbers])


class _WithGradients(torch.autograd.Function):
    """Draws and a pass over a list that makes it a batch, whose gradients are those of the pass with these columns."""

    @staticmethod
    def forward(ctx: Any, call: Callable[..., tuple[Tensor, ...]], image_pass: Pass, *images: Tensor) -> Any:
        with below_autograd():
            y, matrix, columns, sizes, means = call(list(images))
        ctx.save_for_backward(*images, y, matrix, columns, means)
        ctx.image_pass = image_pass
        ctx.mark_non_differentiable(matrix, columns, sizes)
        return y, matrix, columns, sizes

    @staticmethod
    def backward(ctx: Any, grad: Tensor, *_: Any) -> Any:
        *images, y, matrix, columns, means = ctx.saved_tensors
        arguments = ctx.image_pass.arguments(images[0][None], columns)
        wanted = (True, False, False)
        of_images = warp_and_color_list.backward(wanted, [grad], (y, matrix, means), images, *arguments)[0]
        needs = ctx.needs_input_grad[2:]
        return None, None, *(own if need else None for own, need in zip(of_images, needs))


_call_with_gradients = function_caller(_WithGradients)


_NO_KEYS = torch.empty(0, dtype=torch.int64, device="cpu")


class SizedDraws:
    """Draws for images (C, H, W) of different sizes, and these sizes: to ask each image takes Python longer than all else.

    `listed` are draws by their positions, whose numbers are `linear` (3, N) functions of the size of an image: a constant, and the
    factors of height and width, float64 on the CPU.
    """

    def __init__(self, draws: DrawPlan, listed: Sequence[int], linear: Tensor) -> None:
        self.draws, self.linear = draws, linear
        plan = [len(draws.plan), *draws.plan, len(draws.numbers), len(listed), *listed]
        self._plan = packed(plan, draws.numbers)

    def run(self, images: list[Tensor], keys: Keys) -> tuple[Tensor, Tensor] | None:
        """The columns, and the sizes (B, 2) on the CPU; None where no kernel draws them."""
        if not _draw_sized_parameters.serves(images[0]):
            return None
        own = self.draws.keys_of(keys), keys.seeds_on(images[0].device)
        try:
            columns, sizes = _draw_sized_parameters.kernel(images, *own, self.linear, *self._plan)
        except RuntimeError:
            check_list("lists", "images", images)  # which says more
            raise
        return columns, sizes


class NumbersOfSizes(Protocol):
    """Numbers that depend on the sizes of images: an object and no function, because a graph keeps it."""

    def of_each(self, images: Sequence[Tensor]) -> Tensor:
        """The numbers (B, N) of each image, float64 on the CPU."""


class DrawnListPass:
    """Draws as those of SizedDraws, and a pass over the images, whose results are a list, that reads the drawn columns.

    `numbers` are `linear` as there, or what gives those of each image. The last two are
    height and width of the results if these have others than the images.
    """

    def __init__(
        self,
        draws: DrawPlan,
        listed: Sequence[int],
        numbers: Tensor | NumbersOfSizes,
        changes_sizes: bool,
        image_pass: Pass,
        shape: Sequence[int],
        dtype: torch.dtype,
    ) -> None:
        self.of_batch, self.listed, self.numbers = DrawnPass(draws, image_pass, shape, dtype), listed, numbers
        self.changes_sizes = changes_sizes
        self._plan: tuple[Tensor, Tensor] | None = None

    def serves(self, images: list[Tensor]) -> bool:
        """Whether a kernel does it all."""
        x = images[0]
        if not self.of_batch.has_kernel or not _draw_warp_and_color_to_list.serves(x) or in_forward_ad():
            return False
        return not _want_gradients(images)

    def run(self, images: list[Tensor], keys: Keys | None) -> tuple[list[Tensor], Tensor, Tensor]:
        """The results, the columns, and the sizes (B, 2) of the images on the CPU; `keys` are None where nothing is drawn."""
        x, draws, image_pass = images[0], self.of_batch.draws, self.of_batch.image_pass
        if self._plan is None:
            plan = [len(draws.plan), *draws.plan, len(draws.numbers), len(self.listed), *self.listed]
            plan += [1, int(self.changes_sizes)] if image_pass.warps else [0]
            self._plan = packed([*plan, *image_pass.plan], [*draws.numbers, *image_pass.numbers])
            if image_pass.clamps:
                look_at_range(x)
        own = (_NO_KEYS, None) if keys is None else (draws.keys_of(keys), keys.seeds_on(x.device))
        try:
            is_linear = isinstance(self.numbers, Tensor)
            numbers = self.numbers if isinstance(self.numbers, Tensor) else self.numbers.of_each(images)
            call = _draw_warp_and_color_to_list.kernel
            *results, _, columns, sizes = call(images, *own, numbers, is_linear, *self._plan)
        except RuntimeError:
            check_list("lists", "images", images)  # which says more
            raise
        return results, columns, sizes


def packed(plan: Sequence[int], numbers: Sequence[float]) -> tuple[Tensor, Tensor]:
    """A plan and its numbers as tensors, because torch converts the entries of lists one by one."""
    return (
        torch.tensor(plan, dtype=torch.int64, device="cpu"),
        torch.tensor(numbers, dtype=torch.float64, device="cpu"),
    )
