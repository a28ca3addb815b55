"""v2's classes of types, values and labels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._torch_compat import tree_flatten, tree_unflatten
from kvision._tv_tensors import TV_TENSORS, kind_of, plain, wrap
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

    kinds = frozenset({"tensor", "image", "video"})

    def __init__(self, transformation_matrix: Tensor, mean_vector: Tensor) -> None:
        super().__init__()
        _check.shape("LinearTransformation", "mean_vector", mean_vector, "D")
        n = mean_vector.shape[0]
        _check.shape("LinearTransformation", "transformation_matrix", transformation_matrix, n, n)
        for name in ("device", "dtype"):
            if getattr(transformation_matrix, name) != getattr(mean_vector, name):
                raise ValueError(f"LinearTransformation: expected matrix and mean_vector of one {name}")
        self.transformation_matrix, self.mean_vector = transformation_matrix, mean_vector

    def check_inputs(self, flat_inputs: list[Any]) -> None:
        refuse_pil("LinearTransformation", flat_inputs)

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        x, n = plain(inpt), self.mean_vector.shape[0]
        if x.shape[-3:].numel() != n:
            raise ValueError(f"LinearTransformation: expected images of {n} values, got {tuple(x.shape)}")
        flat = x.reshape(-1, n) - self.mean_vector
        return wrap((flat @ self.transformation_matrix.to(flat.dtype)).reshape(x.shape), inpt)


def refuse_pil(op: str, flat: list[Any]) -> None:
    if any(kind_of(x) == "pil" for x in flat):
        raise TypeError(f"{op}: expected tensors, got a PIL image; put ToImage before")


class Normalize(Transform):
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

    def __init__(self, mean: Sequence[float], std: Sequence[float], inplace: bool = False) -> None:
        super().__init__()
        self.mean, self.std = (
            [_check.number("Normalize", name, x) for x in values] for name, values in (("mean", mean), ("std", std))
        )
        self.inplace = inplace

    def check_inputs(self, flat_inputs: list[Any]) -> None:
        refuse_pil("Normalize", flat_inputs)

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.normalize, inpt, self.mean, self.std, self.inplace)

    def _step(self, dtype: torch.dtype, channels: int) -> Step | None:
        fits = dtype == torch.float32 and channels == len(self.mean) == len(self.std) == 3 and max(self.mean) <= 1
        if not fits or self.inplace or not all(self.std):
            return None
        return "Normalize", (("mean", tuple(self.mean)), ("std", tuple(self.std)))


class ToDtype(Transform):
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

    kinds = Transform.kinds - {"pil"}

    def __init__(self, dtype: torch.dtype | dict[Any, torch.dtype | None], scale: bool = False) -> None:
        super().__init__()
        if not isinstance(dtype, (dict, torch.dtype)):
            raise ValueError(f"ToDtype: expected dtype to be a torch.dtype or a dict of them, got {dtype!r}")
        if dtype == {}:
            raise ValueError("ToDtype: expected dtype to name a class, got {}")
        self.dtype, self.scale = dtype, scale

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        if isinstance(self.dtype, torch.dtype):
            dtype = self.dtype if kind_of(inpt) in ("tensor", "image", "video") else None
        elif type(inpt) in self.dtype or "others" in self.dtype:
            dtype = self.dtype.get(type(inpt), self.dtype.get("others"))
        else:
            raise ValueError(f"ToDtype: expected a dtype of {type(inpt).__name__}, or of 'others', got {self.dtype}")
        return inpt if dtype is None else self._call_kernel(F.to_dtype, inpt, dtype=dtype, scale=self.scale)

    def _step(self, dtype: torch.dtype, channels: int) -> Step | None:
        return ("dtype", torch.float32) if self.dtype == torch.float32 and self.scale and dtype == torch.uint8 else None


class ConvertImageDtype(Transform):
    """Convert images to another type; white stays white.

    Args:
        dtype: the type.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ConvertImageDtype()(torch.full((1, 1, 1), 255, dtype=torch.uint8))
        tensor([[[1.]]])
    """

    kinds = Transform.kinds - {"pil"}

    def __init__(self, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.dtype = dtype

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.to_dtype, inpt, dtype=self.dtype, scale=True)


class PILToTensor(Transform):
    """Copy PIL images into tensors.

    Example:
        >>> import PIL.Image
        >>> from kvision import tv
        >>> tv.PILToTensor()(PIL.Image.new('L', (3, 2))).shape
        torch.Size([1, 2, 3])
    """

    kinds = frozenset({"pil"})

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return F.pil_to_tensor(inpt)


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


class ToImage(Transform):
    """Make tv_tensors.Image of tensors, arrays and PIL images.

    Example:
        >>> import PIL.Image
        >>> from kvision import tv
        >>> tv.ToImage()(PIL.Image.new('L', (3, 2))).shape
        torch.Size([1, 2, 3])
    """

    kinds = frozenset({"tensor", "pil", "array"})

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return F.to_image(inpt)


class ToPILImage(Transform):
    """Make PIL images of tensors and arrays.

    Args:
        mode: PIL's mode, None for the one of the number of channels and the type.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ToPILImage()(torch.zeros(3, 2, 4)).size
        (4, 2)
    """

    kinds = frozenset({"tensor", "image", "array"})

    def __init__(self, mode: str | None = None) -> None:
        super().__init__()
        self.mode = mode

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return F.to_pil_image(plain(inpt) if isinstance(inpt, Tensor) else inpt, self.mode)


class ToPureTensor(Transform):
    """Make plain tensors of tv_tensors.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ToPureTensor()(torch.ones(1))
        tensor([1.])
    """

    kinds = TV_TENSORS

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return plain(inpt)


class UniformTemporalSubsample(Transform):
    """Choose frames at equal distances from videos (*, T, C, H, W).

    Args:
        num_samples: how many.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.UniformTemporalSubsample(2)(torch.zeros(5, 3, 8, 6)).shape
        torch.Size([2, 3, 8, 6])
    """

    kinds = frozenset({"tensor", "video"})

    def __init__(self, num_samples: int) -> None:
        super().__init__()
        (self.num_samples,) = _check.ints("UniformTemporalSubsample", "num_samples", num_samples, 1)

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return F.uniform_temporal_subsample(inpt, self.num_samples)


# --- boxes and key points -------------------------------------------------------------------------------------------


class ConvertBoundingBoxFormat(Transform):
    """Convert boxes to another format.

    Args:
        format: such as "XYXY" or "CXCYWH", or torchvision's BoundingBoxFormat.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ConvertBoundingBoxFormat('XYWH')(torch.ones(1))
        tensor([1.])
    """

    kinds = frozenset({"boxes"})

    def __init__(self, format: Any) -> None:
        super().__init__()
        self.format = format

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return F.convert_bounding_box_format(inpt, new_format=self.format)


class ClampBoundingBoxes(Transform):
    """Cut boxes off at the borders of their canvas.

    Args:
        clamping_mode: "soft", "hard" or None for rotated boxes, "auto" for their own.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ClampBoundingBoxes()(torch.ones(1))
        tensor([1.])
    """

    kinds = frozenset({"boxes"})

    def __init__(self, clamping_mode: str | None = "auto") -> None:
        super().__init__()
        self.clamping_mode = clamping_mode

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return F.clamp_bounding_boxes(inpt, clamping_mode=self.clamping_mode)


class ClampKeyPoints(Transform):
    """Move key points to the nearest pixel of the canvas.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ClampKeyPoints()(torch.ones(1))
        tensor([1.])
    """

    kinds = frozenset({"points"})

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return F.clamp_keypoints(inpt)


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

    kinds = frozenset({"boxes"})

    def __init__(self, clamping_mode: str | None) -> None:
        super().__init__()
        if clamping_mode not in (None, "soft", "hard"):
            raise ValueError(f"SetClampingMode: clamping_mode must be one of None, soft, hard; got {clamping_mode!r}")
        self.clamping_mode = clamping_mode

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return wrap(plain(inpt).clone(), inpt, clamping_mode=self.clamping_mode)


def labels_in(sample: Any) -> Any:
    """The labels of (images, labels), of (image, target) or of a target: a tensor, or the entry named most like "labels"."""
    sample = sample[1] if isinstance(sample, (tuple, list)) else sample
    if kind_of(sample) == "tensor":
        return sample
    if not isinstance(sample, Mapping):
        raise ValueError(
            f"labels_getter: expected a dict or a tuple with labels or a dict second, got {type(sample).__name__}"
        )
    names = [name for name in sample if isinstance(name, str)]
    matches = [name for name in names if name.lower() == "labels"] + [name for name in names if "label" in name.lower()]
    if not matches:
        raise ValueError(
            f"labels_getter: expected an entry named labels among {names}; pass a function, or None for no labels"
        )
    return sample[matches[0]]


def labels_getter_of(labels_getter: Any) -> Callable[[Any], Any]:
    if labels_getter == "default":
        return labels_in
    if labels_getter is None:
        return lambda _: None
    if callable(labels_getter):
        return labels_getter
    raise ValueError(f"labels_getter: expected 'default', a function or None, got {labels_getter!r}")


class _Sanitize(Transform):
    """Keep the valid entries of what `kind` says, of masks if they are as many, and of labels."""

    kind = ""

    def __init__(self, labels_getter: Any) -> None:
        super().__init__()
        self.labels_getter = labels_getter
        self._labels_getter = labels_getter_of(labels_getter)

    def _valid(self, x: Any) -> Tensor:
        raise NotImplementedError

    def forward(self, *inputs: Any) -> Any:
        sample, name = inputs if len(inputs) > 1 else inputs[0], type(self).__name__
        labels = self._labels_getter(sample)
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
        SanitizeBoundingBoxes(labels_getter=default, min_size=2, min_area=1.0)
    """

    kind = "boxes"

    def __init__(self, min_size: float = 1.0, min_area: float = 1.0, labels_getter: Any = "default") -> None:
        super().__init__(labels_getter)
        if min(min_size, min_area) < 1:
            raise ValueError(
                f"SanitizeBoundingBoxes: expected min_size and min_area of at least 1, got {min_size}, {min_area}"
            )
        self.min_size, self.min_area = min_size, min_area

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

    kind = "points"

    def __init__(self, labels_getter: Any = None) -> None:
        super().__init__(labels_getter)

    def _valid(self, x: Any) -> Tensor:
        return F.sanitize_keypoints(x)[1]
