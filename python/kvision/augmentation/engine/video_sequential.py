"""Chains of augmentations of videos."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Generator, Tensor, nn

from kvision import _check
from kvision._choices import EachOrOnce, OutputType
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.image_sequential import ImageSequential
from kvision.augmentation.engine.record import ParamItem, Record
from kvision.augmentation.engine.stages import Stage
from kvision.augmentation.inputs import VideoLayout, VideoRankError
from kvision.augmentation.keys import Seed
from kvision.color.frames import Frames

VideoFormat: TypeAlias = Literal["BTCHW", "BCTHW"]


class VideoSequential(ImageSequential):
    """Run augmentations on videos, each frame with the parameters of its video or with its own.

    Args:
        *args: augmentations, or any modules of images.
        data_format: 'BTCHW' or 'BCTHW': the order of the axes of videos.
        same_on_frame: all frames of a video get the same parameters, those of noise included: it stands still. A camera's
            noise, new in each frame, takes a `VideoSequential` of its own with False.
        random_apply: False runs all children in order; True a random number of them in random order; n that many; (n, m) at
            least n and fewer than m.
        random_apply_weights: relative probabilities of the children with `random_apply`.
        if_unsupported_ops: accepted for code written for Kornia; any module may be a child.
        resample: "each" interpolates in every geometric augmentation; "once" multiplies the matrices of neighboring ones and
            interpolates once.
        generator: draws the keys of each call; default: torch's generator.
        output_dtype: type of the results; default: that of the images. Floating-point types have uint8 images in [0, 1].
        memory_format: `torch.channels_last` or `torch.contiguous_format` for the results; default: that of the images.
        return_transform: calls return the videos and the product of the matrices of each frame.

    Raises:
        TypeError: a child is not a module.
        ValueError: `data_format` is unknown.

    Example:
        >>> import torch, kvision as K
        >>> augment = K.augmentation.VideoSequential(K.augmentation.RandomHorizontalFlip(p=1.0))
        >>> augment(torch.tensor([1.0, 2.0]).expand(1, 3, 1, 1, 2)).flatten()
        tensor([2., 1., 2., 1., 2., 1.])
    """

    takes_lists = False

    def __init__(
        self,
        *args: nn.Module,
        data_format: VideoFormat = "BTCHW",
        same_on_frame: bool = True,
        random_apply: int | bool | tuple[int, int] | tuple[int] = False,
        random_apply_weights: Sequence[float] | None = None,
        if_unsupported_ops: str = "raise",
        resample: EachOrOnce = "each",
        generator: Generator | None = None,
        output_dtype: torch.dtype | None = None,
        memory_format: torch.memory_format | None = None,
        return_transform: bool | None = None,
    ) -> None:
        super().__init__(
            *args,
            random_apply=random_apply,
            random_apply_weights=random_apply_weights,
            resample=resample,
            generator=generator,
            output_dtype=output_dtype,
            memory_format=memory_format,
            return_transform=return_transform,
        )
        order = data_format.upper() if isinstance(data_format, str) else data_format
        _check.choice("VideoSequential", "data_format", order, get_args(VideoFormat))
        self.data_format, self.same_on_frame = order, same_on_frame

    # Frames are samples of a batch (B T, C, H, W), and the parameters of a video are repeated for its frames.

    def _layout(self, videos: Any) -> VideoLayout:
        return VideoLayout.of("VideoSequential", self.data_format, videos)

    def transform_tensor(self, input: Tensor) -> Tensor:
        return self._layout(input).frames(input)

    def forward(  # a video has one more axis
        self,
        input: Tensor | tuple[Tensor, Tensor] | Frames,
        params: Sequence[ParamItem] | None = None,
        extra_args: dict[Any, Any] | None = None,
        *,
        seed: Seed = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
        output_type: OutputType = "pt",
    ) -> Any:
        """Augment videos.

        Args:
            input: videos (B, T, C, H, W), or (B, C, T, H, W) as `data_format` says, of a floating-point type or uint8. One
                video as :class:`kvision.color.Frames` (T, 3, H, W), which are read where they are by crops, resizes and
                warps at the start. A pair of videos and matrices (B T, 3, 3) passes the matrices on, as chains with
                `return_transform` do.
            params: the `_params` of an earlier call, to repeat it on these videos.
            extra_args: accepted for code written for Kornia.
            seed: an int, or int64 (B,) with one of a video, from which all parameters follow.
            generator: draws the keys of this call; default: that of the constructor, or torch's.
            return_transform: also return the matrices; default: as the constructor says.
            output_type: "pt" for tensors, "numpy" for arrays of the same axes.

        Returns:
            Videos of the type and the order of axes of `input`; with `return_transform` a pair of them and the matrices
            (B T, 3, 3).

        Raises:
            ValueError: `input` has another number of axes.
        """
        options: dict[str, Any] = {"seed": seed, "generator": generator, "return_transform": return_transform}
        return super().forward(input, params, extra_args, output_type=output_type, **options)

    def _like(self, frames: Frames) -> Tensor:
        like = frames._like()
        video = like[None, None] if frames.is_single else like[None]
        return video.transpose(1, 2) if self.data_format == "BCTHW" else video

    def _time(self, images: Tensor) -> int:
        return images.shape[self.data_format.index("T")]

    def _restored(self, y: Tensor, input: Tensor) -> Tensor:
        return self._layout(input).videos(y)

    def _of_frames(self, context: CallContext) -> CallContext:
        return context._replace(frames=context.time) if self.same_on_frame else context

    def _execute_nested(self, x: Tensor, params: Any, context: CallContext) -> tuple[Tensor, Stage, Record]:
        if context.time == 0 and params is None:
            raise VideoRankError("VideoSequential: expected videos, got the images of another container")
        context = context._replace(frames=1, time=max(context.time, 1))
        return super()._execute_nested(x, params, self._of_frames(context))

    def inverse(
        self, input: Tensor, params: Sequence[ParamItem] | None = None, extra_args: dict[Any, Any] | None = None
    ) -> Tensor:
        """Undo the geometric part of a call, the last one unless parameters are given.

        Args:
            input: videos as that call returned them.
            params: the `_params` of the call.
            extra_args: accepted for code written for Kornia.

        Returns:
            Videos of the size that the input had; 0 where the result has no data of them.
        """
        return super().inverse(input, params)

    def known_pixels(self, output: Tensor, params: Sequence[ParamItem] | None = None) -> Tensor:
        """Which pixels of the videos :meth:`inverse` finds in a result; the others were lost in the call, or in part.

        Args:
            output: videos as that call returned them, of which only the sizes and the device count.
            params: the `_params` of the call.

        Returns:
            bool (B, T, 1, H, W), or (B, 1, T, H, W) as `data_format` says, of the size that the videos had before the call.
        """
        return self._layout(output).videos(super().known_pixels(output, params))
