"""v2's classes of types, values and labels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._torch_compat import tree_flatten, tree_unflatten
from kvision._tv_tensors import TV_TENSORS, kind_of, plain, wrap
from kvision.tv import argument
from kvision.tv import functional as F
from kvision.tv.inputs import PIXELS
from kvision.tv.transform import Step, Transform


class Identity(Transform):
    """Return the input.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.Identity()(torch.ones(1))
        tensor([1.])
    """

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return inpt


class Lambda(Transform):
    """Apply a function of your own to inputs of some classes.

    Args:
        lambd: the function.
        types: the classes, all by default.

    Example:
        >>> from kvision import tv
        >>> tv.Lambda(lambda x: x + 1, int)((1, 2.0))
        (2, 2.0)
    """

    kinds = frozenset({*PIXELS, *TV_TENSORS, "array", "other"})

    def __init__(self, lambd: Callable[[Any], Any], *types: type) -> None:
        super().__init__()
        self.lambd, self.types = lambd, types or (object,)

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self.lambd(inpt) if isinstance(inpt, self.types) else inpt

    def extra_repr(self) -> str:
        return f"{getattr(self.lambd, '__name__', '')}, types={[cls.__name__ for cls in self.types]}"


class LinearTransformation(Transform):
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

    kinds = frozenset({"tensor", "image", "video"})
    refused = frozenset({"pil"})

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


def _dtypes(op: str, name: str, value: Any) -> Any:
    if not isinstance(value, (dict, torch.dtype)) or value == {}:
        raise ValueError(f"{op}: expected {name} to be a torch.dtype or a dict of them, got {value!r}")
    return value


class Normalize(Transform, function=F.normalize):
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

    refused = frozenset({"pil"})
    checks = dict.fromkeys(("mean", "std"), lambda op, name, values: [_check.number(op, name, x) for x in values])

    def _step(self, dtype: torch.dtype, channels: int) -> Step | None:
        fits = dtype == torch.float32 and channels == len(self.mean) == len(self.std) == 3 and max(self.mean) <= 1
        if not fits or self.inplace or not all(self.std):
            return None
        return "Normalize", (("mean", tuple(self.mean)), ("std", tuple(self.std)))


class ToDtype(Transform, function=F.to_dtype):
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

    kinds = Transform.kinds - {"pil"}
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


class ConvertImageDtype(Transform, function=F.to_dtype):
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

    kinds = Transform.kinds - {"pil"}

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"scale": True}


class PILToTensor(Transform, function=F.pil_to_tensor):
    """Copy PIL images into tensors.

    Example:
        >>> import PIL.Image
        >>> from kvision import tv
        >>> tv.PILToTensor()(PIL.Image.new('L', (3, 2))).shape
        torch.Size([1, 2, 3])
    """

    kinds = frozenset({"pil"})


class ToTensor(Transform):
    """Make float tensors in [0, 1] of PIL images and arrays of bytes; those of other types keep their values.

    v2 has deprecated it: :class:`ToImage` and :class:`ToDtype` with `scale=True` say the same in two steps.

    Example:
        >>> import PIL.Image
        >>> from kvision import tv
        >>> tv.ToTensor()(PIL.Image.new('L', (3, 1), 51))
        tensor([[[0.2000, 0.2000, 0.2000]]])
    """

    kinds = frozenset({"pil", "array"})

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        x = F.pil_to_tensor(inpt) if kind_of(inpt) == "pil" else plain(F.to_image(inpt))
        x = x.contiguous()
        if x.dtype == torch.uint8:
            return x.to(torch.get_default_dtype()).div(255)
        return x.to(torch.get_default_dtype()) if x.dtype == torch.bool else x


class ToImage(Transform, function=F.to_image):
    """Make tv_tensors.Image of tensors, arrays and PIL images.

    Example:
        >>> import PIL.Image
        >>> from kvision import tv
        >>> tv.ToImage()(PIL.Image.new('L', (3, 2))).shape
        torch.Size([1, 2, 3])
    """

    kinds = frozenset({"tensor", "pil", "array"})


class ToPILImage(Transform, function=F.to_pil_image):
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

    kinds = frozenset({"tensor", "image", "array"})


class ToPureTensor(Transform, function=plain):
    """Make plain tensors of tv_tensors.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ToPureTensor()(torch.ones(1))
        tensor([1.])
    """

    kinds = TV_TENSORS


class UniformTemporalSubsample(Transform, function=F.uniform_temporal_subsample):
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

    kinds = frozenset({"tensor", "video"})


# --- boxes and key points -------------------------------------------------------------------------------------------


class ConvertBoundingBoxFormat(Transform, function=F.convert_bounding_box_format):
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

    kinds = frozenset({"boxes"})

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"new_format": self.format}


class ClampBoundingBoxes(Transform, function=F.clamp_bounding_boxes):
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

    kinds = frozenset({"boxes"})

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"clamping_mode": self.clamping_mode}


class ClampKeyPoints(Transform, function=F.clamp_keypoints):
    """Move key points to the nearest pixel of the canvas.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ClampKeyPoints()(torch.ones(1))
        tensor([1.])
    """

    kinds = frozenset({"points"})


class SetClampingMode(Transform):
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

    kinds = frozenset({"boxes"})
    checks = {"clamping_mode": argument.choice_of((None, "soft", "hard"))}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return wrap(plain(inpt).clone(), inpt, clamping_mode=self.clamping_mode)


def labels_in(sample: Any) -> Any:
    """The labels of (images, labels), of (image, target) or of a target: a tensor, or the entry named most like "labels"."""
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


def labels_getter_of(labels_getter: Any) -> Callable[[Any], Any]:
    if labels_getter is None or callable(labels_getter):
        return labels_getter or (lambda _: None)
    if labels_getter != "default":
        raise ValueError(f"labels_getter: expected 'default', a function or None, got {labels_getter!r}")
    return labels_in


class _Sanitize(Transform):
    """Keep the valid entries of what `kind` says, of masks if they are as many, and of labels."""

    kind = ""

    def _valid(self, x: Any) -> Tensor:
        raise NotImplementedError

    def forward(self, *inputs: Any) -> Any:
        sample, name = inputs if len(inputs) > 1 else inputs[0], type(self).__name__
        labels = labels_getter_of(self.labels_getter)(sample)
        labels = [] if labels is None else [labels] if isinstance(labels, Tensor) else labels
        if not isinstance(labels, (tuple, list)) or not all(isinstance(x, Tensor) for x in labels):
            raise ValueError(f"{name}: expected labels_getter to return a tensor, several or None, got {labels!r}")
        flat, spec = tree_flatten(sample)
        entries = [x for x in flat if kind_of(x) == self.kind]
        if not entries:
            raise ValueError(f"{name}: expected {self.kind} in the sample, got none")
        valid = self._valid(entries[0])
        if any(x.shape[0] != valid.shape[0] for x in labels):
            raise ValueError(f"{name}: expected {valid.shape[0]} labels, got {[x.shape[0] for x in labels]}")
        return tree_unflatten([self._kept(x, valid, labels) for x in flat], spec)

    def _kept(self, x: Any, valid: Tensor, labels: Sequence[Tensor]) -> Any:
        kind, is_label = kind_of(x), any(x is label for label in labels)
        follows = kind == "mask" and self.kind == "boxes" and x.dim() > 0 and x.shape[0] == valid.shape[0]
        if kind != self.kind and not is_label and not follows:
            return x
        return x[valid] if is_label else wrap(plain(x)[valid], x)


class SanitizeBoundingBoxes(_Sanitize):
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

    kind = "boxes"
    checks = dict.fromkeys(("min_size", "min_area"), lambda op, name, value: _check.number(op, name, value, 1))

    def _valid(self, x: Any) -> Tensor:
        return F.sanitize_bounding_boxes(x, min_size=self.min_size, min_area=self.min_area)[1]


class SanitizeKeyPoints(_Sanitize):
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

    kind = "points"

    def _valid(self, x: Any) -> Tensor:
        return F.sanitize_keypoints(x)[1]
