"""Chains of augmentations of images with their masks, boxes, key points and class labels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, get_args

import torch
from torch import Generator, Tensor, nn

from kvision import _check
from kvision._choices import EachOrOnce, MatrixMode, OutputType
from kvision.augmentation import labels
from kvision.augmentation.arguments import Arguments, as_given
from kvision.augmentation.engine.call_labels import CallLabels
from kvision.augmentation.engine.chain_executor import check_rigid
from kvision.augmentation.engine.configuration import kept
from kvision.augmentation.engine.image_sequential import ImageSequential
from kvision.augmentation.engine.label_record import LabelRecord, labels_back
from kvision.augmentation.engine.label_settings import LabelSettings, MaskReading
from kvision.augmentation.engine.parts import Parts
from kvision.augmentation.engine.record import ParamItem, Record
from kvision.augmentation.engine.stages import Chain
from kvision.augmentation.engine.video_sequential import VideoSequential
from kvision.augmentation.inputs import (
    VideoLayout,
    as_frames,
    as_output_type,
    as_videos,
    check_matrix,
    check_output_type,
    labels_as_videos,
    parse_names,
)
from kvision.augmentation.keys import Seed
from kvision.augmentation.samples import inverse_at
from kvision.color.frames import Frames
from kvision.constants import AnyDataKey, DataKey, DataKeys
from kvision.core.exceptions import ValueCheckError

_OP = "AugmentationSequential"


class AugmentationSequential(ImageSequential):
    """Run augmentations on images, and move their masks, boxes and key points with them.

    Masks are read at the nearest pixel, whatever their type. Boxes "bbox_xyxy" and "bbox_xywh" are (B, N, 4) with edges of
    pixels as COCO has them: a box over all of an image is (0, 0, W, H). "bbox_xyxy_plus" has the first and the last pixel, (0,
    0, W - 1, H - 1). "bbox" has four corners (B, N, 4, 2), and "keypoints" are (B, N, 2): the center of the first pixel is (0,
    0). A moved box is the smallest upright one around what its outline became; corners move by themselves. "class" is returned as
    it was given. `visible_points` says which points the results show.

    A map, elastic, thin-plate or fisheye, may fold, so that several pixels of the result read the same one of the image. A box is
    then around all pixels that read from inside it, and corners move outward to be so too; only where none does, it is outside
    of the image. A point is where the pixel is that reads nearest to it, or within 1.5 pixels of that, where it is read exactly.

    Without data keys for its arguments, a call takes torchvision's tv_tensors, nested in any way, and returns the same classes:
    images, masks, boxes of the formats XYXY, XYWH and CXCYWH, and key points. Other tensors pass through.

    With a VideoSequential among the children, images are videos (B, T, C, H, W) as its `data_format` says, masks likewise, and
    labels have the axes (B, T) instead of B. Other children give each frame its own parameters.

    With `clip_boxes`, `min_box_area` or `min_box_visibility`, boxes without a part inside the image are removed as well. Lists
    of boxes, of their classes and of masks of instances, one of each box, become shorter. Tensors and arrays keep their shape:
    removed boxes are 0, their classes -1, "" or None. `kept_boxes` says which boxes stayed. "class" and "mask" belong to the
    boxes before them, or else to those after them. Another number of labels than of boxes is an error, but for labels of
    images: one of each image, or fractions in a tensor.

    Args:
        *args: augmentations, other containers, or any modules of images.
        data_keys: what the arguments of a call are, the image first: "input" or "image", "mask", "bbox", "bbox_xyxy",
            "bbox_xyxy_plus", "bbox_xywh", "keypoints", "class"; any of them several times. None: calls take one dict.
        same_on_batch: if not None, that of all children.
        keepdim: if not None, that of all children.
        random_apply: False runs all children in order; True a random number of them in random order; n that many; (n, m) at
            least n and fewer than m.
        random_apply_weights: relative probabilities of the children with `random_apply`.
        transformation_matrix_mode: 'silent' leaves children without a matrix out of the product; 'rigid' refuses them in a
            call; 'skip' has no product: `transform_matrix` is None.
        extra_args: flags of masks: {"mask": {"fill_value": 255}} gives pixels that enter, or are erased,
            the value that a loss ignores; default: 0. {} interpolates masks as the images, {"mask": {}} does not.
        resample: "each" interpolates in every geometric augmentation; "once" multiplies the matrices of neighboring ones,
            composes them with elastic, thin-plate and fisheye maps between them, and interpolates once: beyond a crop is
            the image. Pixels from outside of it are those of the first one that interpolates. With antialiased resizing among
            them, a pixel is the mean of what it covers where that is more than a pixel.
        clip_boxes: cut moved boxes off at the edges of the image; "each" after each child, so that what has left the image does
            not come back.
        min_box_area: moved boxes with fewer pixels inside the image are removed.
        min_box_visibility: moved boxes with a smaller fraction of their area inside the image are removed, 0 to 1.
        generator: draws the keys of each call; default: torch's generator.
        output_dtype: type of the results; default: that of the images. Floating-point types have uint8 images in [0, 1].
        memory_format: `torch.channels_last` or `torch.contiguous_format` for the results; default: that of the images.
        return_transform: the first image of a result is a pair of it and the product of the matrices.
        keys: data keys of further names in dicts, such as {"boxes": "bbox_xyxy", "labels": "class", "pixel_values": "image"}.

    Raises:
        TypeError: a child is not a module; `keys` is not a dict with names.
        ValueError: a key is unknown, or the first is not the image's; `clip_boxes` is another string; `min_box_area` is
            negative, or `min_box_visibility` not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> augment = K.augmentation.AugmentationSequential(
        ...     K.augmentation.RandomHorizontalFlip(p=1.0), data_keys=["input", "mask", "bbox_xyxy", "keypoints"]
        ... )
        >>> image, mask = torch.rand(1, 3, 4, 8), torch.zeros(1, 1, 4, 8, dtype=torch.int64)
        >>> box, point = torch.tensor([[[1.0, 0.0, 3.0, 2.0]]]), torch.tensor([[[0.0, 2.0]]])
        >>> image, mask, box, point = augment(image, mask, box, point)
        >>> box, point
        (tensor([[[5., 0., 7., 2.]]]), tensor([[[7., 2.]]]))
    """

    def __init__(
        self,
        *args: nn.Module,
        data_keys: DataKeys | None = (DataKey.INPUT,),
        same_on_batch: bool | None = None,
        keepdim: bool | None = None,
        random_apply: int | bool | tuple[int, int] | tuple[int] = False,
        random_apply_weights: Sequence[float] | None = None,
        transformation_matrix_mode: MatrixMode = "silent",
        extra_args: dict[Any, dict[str, Any]] | None = None,
        resample: EachOrOnce = "each",
        clip_boxes: bool | Literal["each"] = False,
        min_box_area: float = 0.0,
        min_box_visibility: float = 0.0,
        generator: Generator | None = None,
        output_dtype: torch.dtype | None = None,
        memory_format: torch.memory_format | None = None,
        return_transform: bool | None = None,
        keys: Mapping[str, AnyDataKey] | None = None,
    ) -> None:
        super().__init__(
            *args,
            same_on_batch=same_on_batch,
            keepdim=keepdim,
            random_apply=random_apply,
            random_apply_weights=random_apply_weights,
            resample=resample,
            generator=generator,
            output_dtype=output_dtype,
            memory_format=memory_format,
            return_transform=return_transform,
        )
        _check.choice(_OP, "transformation_matrix_mode", transformation_matrix_mode, get_args(MatrixMode))
        self.data_keys = None if data_keys is None else labels.parse_data_keys(_OP, data_keys)
        if self.data_keys is not None and self.data_keys[0] != DataKey.INPUT:
            raise ValueCheckError(f"{_OP}: expected data_keys to begin with 'input', got {data_keys!r}")
        if not min_box_area >= 0:
            raise ValueCheckError(f"{_OP}: expected min_box_area of 0 or more, got {min_box_area}")
        _check.fraction(_OP, "min_box_visibility", min_box_visibility)
        self._names = parse_names(_OP, keys)
        self._warned: set[str] = set()  # names of entries that pass through
        if clip_boxes not in (False, True, "each"):
            raise ValueCheckError(f"{_OP}: expected clip_boxes to be a bool or 'each', got {clip_boxes!r}")
        self.box_filter = labels.BoxFilter(bool(clip_boxes), min_box_area, min_box_visibility)
        self._clips_each = clip_boxes == "each"
        self.transformation_matrix_mode = transformation_matrix_mode
        self._default_extra_args: dict[Any, dict[str, Any]] = {DataKey.MASK: {"resample": "nearest"}}
        self.extra_args = self._default_extra_args if extra_args is None else extra_args

    def forward(
        self,
        *args: Any,
        params: Sequence[ParamItem] | None = None,
        data_keys: DataKeys | None = None,
        seed: Seed = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
        output_type: OutputType = "pt",
    ) -> Any:
        """Augment images with what belongs to them.

        In a dict, entries are data whose names are those of data keys, "masks", or names of `keys`. A name with a suffix, "mask_2"
        or "image-left", is data if its value is of that kind and the suffix does not end in id, name, path or size. Everything
        else passes through; a tensor that does although its size or name is like that of data is warned about once.

        Args:
            *args: images and labels in the order of the data keys; or one dict. The first image may be
                :class:`kvision.color.Frames`. Images (C, H, W) of different sizes are a list,
                with lists of labels, one of each image: masks (N, H, W) and boxes (N, 4), where N may be 0. The first image may
                be a tuple of it and matrices (B, 3, 3), which are passed on, as chains with `return_transform` do. Images of
                NumPy and PIL and files become floating point in [0, 1]; masks of NumPy and PIL, also those with a palette, keep
                their values.
            params: the `_params` of an earlier call, to repeat it on these images.
            data_keys: keys of this call; default: those of the constructor.
            seed: an int, or int64 (B,) with one of a sample, from which all parameters follow.
            generator: draws the keys of this call; default: that of the constructor, or torch's.
            return_transform: also return the matrices; default: as the constructor says.
            output_type: "pt" for tensors, "numpy" for arrays, images and masks with the channels last, "pil" for images and
                masks as lists of PIL images.

        Returns:
            What was given, moved: one tensor for one key, else a list; a dict for a dict. With `return_transform` the first
            image is a pair of it and the matrices (B, 3, 3). A list of images becomes a batch if the children give all images
            one size, as RandomResizedCrop does, and a list otherwise.

        Raises:
            TypeError: an input has another type than its key says; images are a list, and a child mixes samples.
            ValueError: the number of inputs is not that of the keys; no key is the image's; an input has another shape.
        """
        if output_type != "pt":
            check_output_type(self, output_type)
        arguments = Arguments(self, args, data_keys)
        keys, values = arguments.keys, arguments.values
        image = keys.index(DataKey.INPUT) if DataKey.INPUT in keys else None
        source = values[image] if image is not None and isinstance(values[image], Frames) else None
        if source is not None and image is not None:
            values[image] = source._like()
        before = None if {*map(type, values)} == {Tensor} else arguments.convert(self, image)
        if image is not None and isinstance(values[image], list) and not self._reads_lists():
            images = values[image]
            values[image] = self.transform_tensor(images)
            outputs, record = self._call_list(keys, values, params, seed, generator)
            outputs[image] = self._restored(outputs[image], images)
        else:
            outputs, record = self._call(keys, values, params, seed, generator, before, source)
        self._keep(record)
        if arguments.given is not None:
            outputs = as_given(outputs, arguments.given, keys)
        if image is not None:
            outputs[image] = self._with_matrix(outputs[image], before, return_transform, record)
        if output_type != "pt":
            outputs = [as_output_type(output, output_type, key) for output, key in zip(outputs, keys)]
        return arguments.merged(outputs)

    def _call_of_parts(self, keys: Sequence[DataKey], inputs: Sequence[Any]) -> Callable[..., Any]:
        masks = labels.count_masks(keys, inputs)

        def call(own: list[Any], params: Any, seed: Seed, generator: Generator | None) -> tuple[list[Any], Record]:
            return self._call(list(keys), own, params, seed, generator, None, masks=masks)

        return call

    def _with_labels_of_list(
        self, keys: Sequence[DataKey], inputs: Sequence[Any], y: Any, record: Record, moving: Any
    ) -> list[Any]:
        if len(keys) == 1:
            return [y]
        settings, masks = self._label_settings, labels.count_masks(keys, inputs)
        outputs, first, parts = list(inputs), keys.index(DataKey.INPUT), record.parts
        masks_at = [i for i, key in enumerate(keys) if key == DataKey.MASK]
        moved = {i: moving.moved_masks(inputs[i], settings.masks) for i in masks_at}
        moved = {i: own for i, own in moved.items() if own is not None}
        for i, own in moved.items():
            outputs[i] = own
        moves = moving.moves() if len(moved) == len(masks_at) < len(keys) - 1 else None
        if moves is not None:
            stages, sizes = moves.stages(inputs[first][0].device)
            record.labels = LabelRecord(settings, parts.shape, sizes, masks)
            outputs = record.labels.move(keys, outputs, Chain(stages), masks_at)
            Chain(stages).forget()
        elif len(moved) < len(keys) - 1:
            each = [
                self._with_labels(keys, parts.inputs(rows, keys, outputs), call, settings, masks, list(moved))
                for call, rows in zip(parts.calls, parts.rows)
            ]
            outputs = parts.outputs(keys, inputs, each)
        outputs[first] = y
        return outputs

    @staticmethod
    def _with_labels(
        keys: Sequence[DataKey],
        inputs: Sequence[Any],
        record: Record,
        settings: LabelSettings,
        masks: dict[int, labels.MaskCounts] | None,
        moved_masks_at: Sequence[int] = (),
    ) -> list[Any]:
        """What belongs to the images of a call, moved, and the images as they are."""
        record.labels = LabelRecord(settings, record.shape, record.size, masks)
        outputs = record.labels.move(keys, inputs, record.stages, moved_masks_at)
        record.stages.forget()
        return outputs

    def _call(
        self,
        keys: list[DataKey],
        inputs: list[Any],
        params: Any,
        seed: Seed,
        generator: Generator | None,
        before: Tensor | None,
        source: Frames | None = None,
        masks: dict[int, labels.MaskCounts] | None = None,
    ) -> tuple[list[Any], Record]:
        """The results of a call, and its record."""
        if DataKey.INPUT not in keys:
            if self._record.shape is None and params is None:
                raise ValueCheckError(f"{_OP}: expected one of data_keys to be 'input'")
            return self._move_alone(keys, inputs, params, masks)
        if self.transformation_matrix_mode == "rigid":
            check_rigid(_OP, self)
        first = keys.index(DataKey.INPUT)
        videos = self._video_layout(inputs[first])
        inputs, restore = as_frames(videos, keys, inputs)
        image = inputs[first]
        x = self.transform_tensor(image)
        if before is not None:
            check_matrix(self, before, x)
        settings = self._label_settings if len(keys) > 1 else None
        call_labels = None if settings is None else CallLabels.of(keys, inputs, settings, x)
        time = 0 if videos is None else videos.sizes[1]
        y, record = self._execute(x, params, self._context(seed, generator, time, call_labels, source))
        record.size, record.videos = tuple(y.shape[2:]), videos
        if settings is None:
            outputs = [y]
            record.stages.forget()
        else:
            outputs = self._with_labels(keys, inputs, record, settings, masks)
        for i, (key, value) in enumerate(zip(keys, inputs)):
            if key == DataKey.INPUT and i != first:  # a second image gets the same
                context = self._context(None, None, time)
                z, _ = self._execute(self.transform_tensor(value), self._read_params(record), context)
                outputs[i] = self._restored(z, value)
        outputs[first] = self._restored(y, image)
        return as_videos(videos, outputs, restore), record

    def _move_alone(
        self, keys: list[DataKey], inputs: list[Any], params: Any, masks: dict[int, labels.MaskCounts] | None = None
    ) -> tuple[list[Any], Record]:
        """Labels without their images, moved by the last call or by given parameters."""
        image = _no_image(inputs)
        parts = self._parts_of(params, like=image)
        if parts is not None:
            masks = labels.count_masks(keys, inputs)
            each = parts.each_output(self, keys, inputs, lambda view, own: view._move_alone(keys, own, None, masks))
            moved = Parts(parts.op, parts.rows, [record for _, record in each])
            return parts.outputs(keys, inputs, [outputs for outputs, _ in each]), Record(parts=moved)
        last, record = self._record, self._record_of(image, params).replaced()
        inputs, restore = as_frames(last.videos, keys, inputs)
        outputs = self._with_labels(keys, inputs, record, self._label_settings, masks)
        return as_videos(last.videos, outputs, restore), last.replaced(labels=record.labels)

    @property
    def _label_settings(self) -> LabelSettings:
        extra_args, default = self.extra_args, self._default_extra_args
        reading = MaskReading.of(extra_args)
        return LabelSettings(
            self._clips_each, self.box_filter, reading, extra_args is default, self._may_remove_boxes()
        )

    @kept
    def _may_remove_boxes(self) -> bool:
        filters = (m.box_filter for m in self.modules() if isinstance(m, AugmentationSequential))
        removes = any(getattr(m, "removes_boxes", False) for m in self.modules())
        return removes or any(not rule.does_nothing for rule in filters)

    def _video_layout(self, videos: Any) -> VideoLayout | None:
        """The layout of videos, which containers with a VideoSequential take."""
        own = [child for child in self._modules.values() if isinstance(child, VideoSequential)]
        return VideoLayout.of(_OP, own[0].data_format, videos) if own else None

    # --- labels of the last call ---

    @property
    def kept_boxes(self) -> list[Any]:
        """Which boxes of the last call passed the filter: bool (B, N), or a list of (N,), for each input; empty without one.

        All of an image that a filter inside has not met, by a choice or a chance.
        """
        return self._read_labels(lambda moves: moves.kept_boxes)

    @property
    def visible_points(self) -> list[Any]:
        """Which points of the last call are visible in its results: for each input of key points bool (B, N), or a list of (N,).

        Points outside of the result are not visible, nor are those that were outside of one before it.
        """
        return self._read_labels(LabelRecord.visible_points)

    def _read_labels(self, read: Callable[[LabelRecord], list[Any]]) -> list[Any]:
        """What the labels of the last call say, for each input."""
        record = self._record
        if record.parts is not None and record.labels is None:
            each = [view._read_labels(read) for view in record.parts.views(self)]
            return [record.parts.join(of_input) for of_input in zip(*each)]
        return labels_as_videos(record.videos, [] if record.labels is None else read(record.labels))

    def inverse(
        self,
        *args: Any,
        params: Sequence[ParamItem] | None = None,
        data_keys: DataKeys | None = None,
    ) -> Any:
        """Undo the geometric part of a call, the last one unless parameters are given.

        Args:
            *args: images and labels as that call returned them, in the order of the data keys; or one dict.
            params: the `_params` of the call.
            data_keys: keys of the arguments; default: those of the constructor.

        Returns:
            What was given, moved back to the images before the call; one tensor for one key, else a list or a dict.
        """
        arguments = Arguments(self, args, data_keys, is_inverse=True)
        outputs = self._invert_all(arguments.keys, arguments.values, params)
        if arguments.given is not None:
            outputs = as_given(outputs, arguments.given, arguments.keys)
        return arguments.merged(outputs)

    def _invert_all(self, keys: list[DataKey], inputs: list[Any], params: Any) -> list[Any]:
        first = keys.index(DataKey.INPUT) if DataKey.INPUT in keys else None
        outputs, like = (None, _no_image(inputs)) if first is None else (inputs[first], None)
        parts = self._parts_of(params, outputs, like)
        if parts is not None:
            each = parts.each_output(self, keys, inputs, lambda view, own: view._invert_all(keys, own, None))
            return parts.outputs(keys, inputs, each)
        videos = self._record.videos if first is None else self._video_layout(inputs[first])
        inputs, restore = as_frames(videos, keys, inputs)
        images = _no_image(inputs) if first is None else self.transform_tensor(inputs[first])
        record = self._record_to_invert(images, params)
        return as_videos(videos, [self._moved_back(key, x, record) for key, x in zip(keys, inputs)], restore)

    def _moved_back(self, key: DataKey, value: Any, record: Record) -> Any:
        """Results of a call, or what belongs to them, moved back to the images before it."""
        if key != DataKey.INPUT:
            return labels_back(key, value, record.stages, record.size, record.shape or ())
        return self._restored(inverse_at(self.transform_tensor(value), record.size, record.stages.invert), value)

    def known_pixels(self, output: Tensor, params: Sequence[ParamItem] | None = None) -> Tensor:
        videos = None if isinstance(output, list) else self._video_layout(output)
        known = super().known_pixels(output if videos is None else videos.frames(output), params)
        return known if videos is None else videos.videos(known)


def _no_image(inputs: Sequence[Any]) -> Tensor:
    """An image of no size, for labels that come without theirs, on their device."""
    values = (x for value in inputs for x in (value if isinstance(value, (list, tuple)) else (value,)))
    device = next((x.device for x in values if isinstance(x, Tensor)), "cpu")
    return torch.zeros(1, 1, 1, 1, device=device)
