"""v2's classes of types, values and labels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._tv_tensors import TV_TENSORS, kind_of, plain, wrap
from kvision.tv import argument
from kvision.tv import functional as F
from kvision.tv.inputs import IMAGES, PIXELS
from kvision.tv.transform import Step, Transform, flatten, unflatten

__all__ = [
    "ClampBoundingBoxes", "ClampKeyPoints", "ConvertBoundingBoxFormat", "ConvertImageDtype", "Identity", "Lambda",
    "LinearTransformation", "Normalize", "PILToTensor", "SanitizeBoundingBoxes", "SanitizeKeyPoints",
    "SetClampingMode", "ToDtype", "ToImage", "ToPILImage", "ToPureTensor", "ToTensor", "UniformTemporalSubsample",
]  # fmt: skip


class Identity(Transform, kinds=frozenset()):
    """Return the input.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.Identity()(torch.ones(1))
        tensor([1.])
    """


class Lambda(Transform, kinds={*PIXELS, *TV_TENSORS, "array", "other"}):
    """Apply a function of your own to inputs of some classes.

    Args:
        lambd: the function.
        types: the classes, all by default.

    Example:
        >>> from kvision import tv
        >>> tv.Lambda(lambda x: x + 1, int)((1, 2.0))
        (2, 2.0)
    """

    def __init__(self, lambd: Callable[[Any], Any], *types: type) -> None:
        super().__init__()
        self.lambd, self.types = lambd, types or (object,)

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self.lambd(inpt) if isinstance(inpt, self.types) else inpt

    def extra_repr(self) -> str:
        return f"{getattr(self.lambd, '__name__', '')}, types={[cls.__name__ for cls in self.types]}"


class LinearTransformation(Transform, kinds=IMAGES - {"pil"}, refused={"pil"}):
    """Subtract a mean from flattened images and multiply them by a matrix, such as that of whitening.

    Args:
        transformation_matrix: (D, D), D = C H W.
        mean_vector: (D,).

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.LinearTransformation(torch.eye(12), torch.zeros(12))(torch.zeros(3, 2, 2)).shape
        torch.Size([3, 2, 2])
    """

    transformation_matrix: Tensor
    mean_vector: Tensor

    def __post_init__(self) -> None:
        op, mean, matrix = "LinearTransformation", self.mean_vector, self.transformation_matrix
        _check.shape(op, "mean_vector", mean, "D")
        _check.shape(op, "transformation_matrix", matrix, len(mean), len(mean))
        _check.same_device(op, mean_vector=mean, transformation_matrix=matrix)
        if matrix.dtype != mean.dtype:
            raise ValueError(f"{op}: expected matrix and mean_vector of one dtype, got {matrix.dtype} and {mean.dtype}")

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        x, n = plain(inpt), self.mean_vector.shape[0]
        if x.shape[-3:].numel() != n:
            raise ValueError(f"LinearTransformation: expected images of {n} values, got {tuple(x.shape)}")
        flat = x.reshape(-1, n) - self.mean_vector
        return wrap((flat @ self.transformation_matrix.to(flat.dtype)).reshape(x.shape), inpt)


class Normalize(Transform, function=F.normalize, refused={"pil"}):
    """Subtract means from the channels and divide by standard deviations.

    Args:
        mean: one of each channel.
        std: one of each channel.
        inplace: write into the image.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.Normalize([0.5], [0.25])(torch.ones(1, 1, 1))
        tensor([[[2.]]])
    """

    mean: Sequence[float]
    std: Sequence[float]
    inplace: bool = False

    checks = dict.fromkeys(("mean", "std"), lambda op, name, values: [_check.number(op, name, x) for x in values])

    def _step(self, dtype: torch.dtype, channels: int) -> Step | None:
        fits = dtype == torch.float32 and channels == len(self.mean) == len(self.std) == 3 and max(self.mean) <= 1
        if not fits or self.inplace or not all(self.std):
            return None
        return "Normalize", (("mean", tuple(self.mean)), ("std", tuple(self.std)))


_dtypes = argument.where(argument.anything, lambda v: v and isinstance(v, (dict, torch.dtype)), "a dtype or a dict")


class ToDtype(Transform, function=F.to_dtype, kinds=Transform.kinds - {"pil"}):
    """Convert to another type.

    Args:
        dtype: of images and videos; or a dict by class of input, with "others" for the rest and None for no change.
        scale: white stays white: 255 of uint8 is 1 of float32.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ToDtype(torch.float32, scale=True)(torch.full((1, 1, 1), 255, dtype=torch.uint8))
        tensor([[[1.]]])
    """

    dtype: torch.dtype | dict[Any, torch.dtype | None]
    scale: bool = False

    checks = {"dtype": _dtypes, "scale": _check.switch}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        if isinstance(self.dtype, torch.dtype):
            dtype = self.dtype if kind_of(inpt) in ("tensor", "image", "video") else None
        elif type(inpt) in self.dtype or "others" in self.dtype:
            dtype = self.dtype.get(type(inpt), self.dtype.get("others"))
        else:
            raise ValueError(f"ToDtype: expected a dtype of {type(inpt).__name__}, or of 'others', got {self.dtype}")
        return inpt if dtype is None else super().transform(inpt, {"dtype": dtype})

    def _step(self, dtype: torch.dtype, channels: int) -> Step | None:
        return ("dtype", torch.float32) if self.dtype == torch.float32 and self.scale and dtype == torch.uint8 else None


class ConvertImageDtype(Transform, function=F.convert_image_dtype, kinds=Transform.kinds - {"pil"}):
    """Convert images to another type; white stays white.

    Args:
        dtype: the type.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ConvertImageDtype()(torch.full((1, 1, 1), 255, dtype=torch.uint8))
        tensor([[[1.]]])
    """

    dtype: torch.dtype = torch.float32


class PILToTensor(Transform, function=F.pil_to_tensor, kinds={"pil"}):
    """Copy PIL images into tensors.

    Example:
        >>> import PIL.Image
        >>> from kvision import tv
        >>> tv.PILToTensor()(PIL.Image.new('L', (3, 2))).shape
        torch.Size([1, 2, 3])
    """


class ToTensor(Transform, kinds={"pil", "array"}):
    """Make float tensors in [0, 1] of PIL images and arrays of bytes; those of other types keep their values.

    v2 has deprecated it: :class:`ToImage` and :class:`ToDtype` with `scale=True` say the same in two steps.

    Example:
        >>> import PIL.Image
        >>> from kvision import tv
        >>> tv.ToTensor()(PIL.Image.new('L', (3, 1), 51))
        tensor([[[0.2000, 0.2000, 0.2000]]])
    """

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        x = plain(F.to_image(inpt)).contiguous()
        if x.dtype == torch.uint8:
            return x.to(torch.get_default_dtype()).div(255)
        return x.to(torch.get_default_dtype()) if x.dtype == torch.bool else x


class ToImage(Transform, function=F.to_image, kinds={"tensor", "pil", "array"}):
    """Make tv_tensors.Image of tensors, arrays and PIL images.

    Example:
        >>> import PIL.Image
        >>> from kvision import tv
        >>> tv.ToImage()(PIL.Image.new('L', (3, 2))).shape
        torch.Size([1, 2, 3])
    """


class ToPILImage(Transform, function=F.to_pil_image, kinds={"tensor", "image", "array"}):
    """Make PIL images of tensors and arrays.

    Args:
        mode: PIL's mode, None for the one of the number of channels and the type.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ToPILImage()(torch.zeros(3, 2, 4)).size
        (4, 2)
    """

    mode: str | None = None


class ToPureTensor(Transform, function=plain, kinds=TV_TENSORS):
    """Make plain tensors of tv_tensors.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ToPureTensor()(torch.ones(1))
        tensor([1.])
    """


class UniformTemporalSubsample(Transform, function=F.uniform_temporal_subsample, kinds={"tensor", "video"}):
    """Choose frames at equal distances from videos (*, T, C, H, W).

    Args:
        num_samples: how many.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.UniformTemporalSubsample(2)(torch.zeros(5, 3, 8, 6)).shape
        torch.Size([2, 3, 8, 6])
    """

    num_samples: int


# --- boxes and key points -------------------------------------------------------------------------------------------


class ConvertBoundingBoxFormat(
    Transform, function=F.convert_bounding_box_format, renamed={"format": "new_format"}, kinds={"boxes"}
):
    """Convert boxes to another format.

    Args:
        format: such as "XYXY" or "CXCYWH", or torchvision's BoundingBoxFormat.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ConvertBoundingBoxFormat('XYWH')(torch.ones(1))
        tensor([1.])
    """

    format: Any


class ClampBoundingBoxes(Transform, function=F.clamp_bounding_boxes, kinds={"boxes"}):
    """Cut boxes off at the borders of their canvas.

    Args:
        clamping_mode: "soft", "hard" or None for rotated boxes, "auto" for their own.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ClampBoundingBoxes()(torch.ones(1))
        tensor([1.])
    """

    clamping_mode: str | None = "auto"


class ClampKeyPoints(Transform, function=F.clamp_keypoints, kinds={"points"}):
    """Move key points to the nearest pixel of the canvas.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ClampKeyPoints()(torch.ones(1))
        tensor([1.])
    """


class SetClampingMode(Transform, kinds={"boxes"}):
    """Set how transforms cut boxes off from now on.

    Args:
        clamping_mode: "soft", "hard" or None for not at all.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.SetClampingMode(None)(torch.ones(1))
        tensor([1.])
    """

    clamping_mode: str | None

    checks = {"clamping_mode": argument.one_of(None, "soft", "hard")}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return wrap(plain(inpt).clone(), inpt, clamping_mode=self.clamping_mode)


def labels_in(sample: Any, getter: Any) -> Any:
    """The labels of (images, labels), of (image, target) or of a target: a tensor, or the entry named most like "labels"."""
    if getter != "default":
        return None if getter is None else getter(sample)
    sample = sample[1] if isinstance(sample, (tuple, list)) else sample
    if kind_of(sample) == "tensor":
        return sample
    names = [n for n in sample if isinstance(n, str) and "label" in n.lower()] if isinstance(sample, Mapping) else []
    if not names:
        raise ValueError(
            "labels_getter: expected a dict with labels, or a tuple with labels or such a dict second, got "
            f"{type(sample).__name__}; pass a function, or None for no labels"
        )
    return sample[min(names, key=lambda name: name.lower() != "labels")]


class _Sanitize(Transform):
    """Keep the entries of boxes or key points that are valid, of masks if they are as many as boxes, and of labels."""

    def forward(self, *inputs: Any) -> Any:
        (flat, spec), name, (kind,) = flatten(inputs), type(self).__name__, self.kinds
        labels = labels_in(inputs if len(inputs) > 1 else inputs[0], self.labels_getter)
        labels = [] if labels is None else [labels] if isinstance(labels, Tensor) else labels
        if not isinstance(labels, (tuple, list)) or not all(isinstance(x, Tensor) for x in labels):
            raise ValueError(f"{name}: expected labels_getter to return a tensor, several or None, got {labels!r}")
        entries = next((x for x in flat if kind_of(x) == kind), None)
        if entries is None or self._function is None:
            raise ValueError(f"{name}: expected {kind} in the sample, got none")
        valid = self._function(entries, **self._options_for(entries))[1]
        if any(x.shape[0] != valid.shape[0] for x in labels):
            raise ValueError(f"{name}: expected {valid.shape[0]} labels, got {[x.shape[0] for x in labels]}")
        return unflatten([self._kept(x, kind, valid, labels) for x in flat], spec)

    def _kept(self, x: Any, kind: str, valid: Tensor, labels: Sequence[Tensor]) -> Any:
        if any(x is label for label in labels):
            return x[valid]
        follows = kind_of(x) == "mask" and kind == "boxes" and x.dim() > 0 and x.shape[0] == valid.shape[0]
        return wrap(plain(x)[valid], x) if follows or kind_of(x) == kind else x


class SanitizeBoundingBoxes(_Sanitize, function=F.sanitize_bounding_boxes, kinds={"boxes"}):
    """Remove boxes that are small or leave their canvas, with their labels and masks.

    Args:
        min_size: least width and height.
        min_area: least area.
        labels_getter: "default" finds the entry of a dict named labels, in the second place of a tuple; a function of
            the sample that returns a tensor or several; None for no labels.

    Example:
        >>> from kvision import tv
        >>> tv.SanitizeBoundingBoxes(min_size=2)
        SanitizeBoundingBoxes(min_size=2.0, min_area=1.0, labels_getter=default)
    """

    min_size: float = 1.0
    min_area: float = 1.0
    labels_getter: Any = "default"

    checks = dict.fromkeys(("min_size", "min_area"), lambda op, name, value: _check.number(op, name, value, 1))


class SanitizeKeyPoints(_Sanitize, function=F.sanitize_keypoints, kinds={"points"}):
    """Remove key points, or groups of them, that leave their canvas, with their labels.

    Args:
        labels_getter: "default" finds the entry of a dict named labels, in the second place of a tuple; a function of
            the sample that returns a tensor or several; None for no labels.

    Example:
        >>> from kvision import tv
        >>> tv.SanitizeKeyPoints()
        SanitizeKeyPoints()
    """

    labels_getter: Any = None
