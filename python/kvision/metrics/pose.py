"""Errors of camera poses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from kvision import _check
from kvision._ops import without_autocast_and_tf32
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError


def angle_error_mat(R1: Tensor, R2: Tensor) -> Tensor:
    """Compute the angle of the rotation from one rotation matrix to another.

    Args:
        R1: rotation matrices (*, 3, 3), floating point.
        R2: rotation matrices in the same shape.

    Returns:
        Degrees (*), from 0 to 180, precise at small and at large angles.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: not (*, 3, 3), or different shapes.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> rotation = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        >>> K.metrics.angle_error_mat(torch.eye(3), rotation)
        tensor(90.)
    """
    _check_pair("angle_error_mat", "R1", R1, "R2", R2, (3, 3))
    relative = _relative_rotation(R1, R2)
    skew = relative - relative.transpose(-2, -1)
    axis = torch.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], -1)  # times twice the sine
    return _degrees(axis, relative.diagonal(dim1=-2, dim2=-1).sum(-1) - 1)


@without_autocast_and_tf32
def _relative_rotation(R1: Tensor, R2: Tensor) -> Tensor:
    return R1.transpose(-2, -1) @ R2


def angle_error_vec(v1: Tensor, v2: Tensor) -> Tensor:
    """Compute the angle between vectors.

    Args:
        v1: vectors (*, 3) of any length above 0, floating point.
        v2: vectors in the same shape.

    Returns:
        Degrees (*), from 0 to 180; NaN for a vector of length 0.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: not (*, 3), or different shapes.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.angle_error_vec(torch.tensor([1.0, 0.0, 0.0]), torch.tensor([0.0, 5.0, 0.0]))
        tensor(90.)
    """
    _check_pair("angle_error_vec", "v1", v1, "v2", v2, (3,))
    v1, v2 = (v / v.abs().amax(-1, keepdim=True) for v in (v1, v2))  # squares neither overflow nor vanish
    return _degrees(torch.linalg.cross(v1, v2), (v1 * v2).sum(-1))


def _degrees(sine: Tensor, cosine: Tensor) -> Tensor:
    """The angle whose sine is the length of a vector; NaN where an input is NaN. A length of 0 has the gradient 0."""
    return torch.rad2deg(torch.atan2(torch.linalg.vector_norm(sine, dim=-1), cosine))


def translation_ate(t: Tensor, t_gt: Tensor) -> Tensor:
    """Compute the distance of translations from the true ones.

    Args:
        t: (*, 3), floating point.
        t_gt: in the same shape.

    Returns:
        (*), or (1,) for a single translation.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: not (*, 3), or different shapes.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.translation_ate(torch.tensor([[3.0, 4.0, 0.0]]), torch.zeros(1, 3))
        tensor([5.])
    """
    _check_pair("translation_ate", "t", t, "t_gt", t_gt, (3,))
    return torch.atleast_1d(torch.linalg.vector_norm(t - t_gt, dim=-1))


def pose_errors(P: Tensor, P_gt: Tensor, fold_translation: bool = True) -> dict[str, Tensor]:
    """Compute the angles between the rotations and between the directions of translation of camera poses.

    Args:
        P: poses (3 or 4, 4) or (B, 3 or 4, 4), the rotation in front and the translation in the last column.
        P_gt: true poses in the same shape.
        fold_translation: directions have no sign, so that their angle is at most 90 degrees.

    Returns:
        "R_err", "t_err" and the larger one of both, "max_err", in degrees (B,).

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> P = torch.eye(3, 4) + torch.tensor([[0.0, 0.0, 0.0, 1.0]])
        >>> K.metrics.pose_errors(P, P)["max_err"]
        tensor([0.])
    """
    _check.numbers("pose_errors", "P", P)
    _check.numbers("pose_errors", "P_gt", P_gt)
    _check.flag("pose_errors", "fold_translation", fold_translation)
    if P.dim() not in (2, 3) or P.shape[-2] not in (3, 4) or P.shape[-1] != 4:
        raise ShapeError(
            f"pose_errors: expected P of shape (3 or 4, 4) or (B, 3 or 4, 4), got {tuple(P.shape)}",
            actual_shape=P.shape,
        )
    _check_pair("pose_errors", "P", P, "P_gt", P_gt, tuple(P.shape[-2:]))
    P, P_gt = P.reshape(-1, *P.shape[-2:]), P_gt.reshape(-1, *P.shape[-2:])
    rotation = angle_error_mat(P[:, :3, :3], P_gt[:, :3, :3])
    translation = angle_error_vec(P[:, :3, 3], P_gt[:, :3, 3])
    if fold_translation:
        translation = torch.minimum(translation, 180 - translation)
    return {"R_err": rotation, "t_err": translation, "max_err": torch.maximum(rotation, translation)}


def _check_pair(op: str, name: str, x: Tensor, other_name: str, other: Tensor, last: tuple[int, ...]) -> None:
    for n, value in ((name, x), (other_name, other)):
        _check.numbers(op, n, value)
        _check.floating(op, n, value)
        if value.shape[value.dim() - len(last) :] != last or value.dim() < len(last):
            want = ", ".join(map(str, last))
            raise ShapeError(f"{op}: expected {n} of shape (*, {want}), got {tuple(value.shape)}")
    if x.dtype != other.dtype:
        raise TypeCheckError(
            f"{op}: expected {other_name} of type {x.dtype}, got {other.dtype}", actual_type=other.dtype
        )
    _check.same_shape(op, **{name: x, other_name: other})
    _check.same_device(op, **{name: x, other_name: other})


def auc_from_errors(errors: Tensor, thresholds: float | Sequence[float] = (1, 3, 5, 10)) -> dict[float, float]:
    """Compute the area under the curve of recall over error, up to each threshold, as a percentage of it.

    The recall at an error is the fraction of errors up to it. The curve is linear from (0, 0) to the first error and
    from each error to the next one, and constant from the last error below the threshold on.

    Args:
        errors: at least 0, of any shape.
        thresholds: a number or several, above 0.

    Returns:
        For each threshold its percentage, NaN if an error is NaN. It waits for the device.

    Raises:
        TypeCheckError: errors is not a tensor; thresholds are not numbers.
        ValueCheckError: negative errors; no thresholds, or some not above 0.

    Source: P.-E. Sarlin et al., "SuperGlue" (2020).

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.auc_from_errors(torch.zeros(3), 5)
        {5.0: 100.0}
    """
    _check.numbers("auc_from_errors", "errors", errors)
    requested = thresholds if isinstance(thresholds, (tuple, list)) else (thresholds,)
    limits = [_check.number("auc_from_errors", "thresholds", t) for t in requested]
    if not limits or not min(limits) > 0:
        raise ValueCheckError(f"auc_from_errors: expected thresholds above 0, got {thresholds!r}")
    values = sorted(errors.double().flatten().tolist())
    if any(math.isnan(e) for e in values):
        return dict.fromkeys(limits, math.nan)
    if values and values[0] < 0:
        raise ValueCheckError("auc_from_errors: expected errors of at least 0, got negative ones")
    return {limit: 100 * _area([e for e in values if e < limit], len(values), limit) / limit for limit in limits}


def _area(errors: list[float], count: int, limit: float) -> float:
    area = previous = 0.0
    for i, error in enumerate(errors):
        area += (error - previous) * (i + 0.5) / count  # the mean of the recalls on both sides
        previous = error
    return area + (limit - previous) * len(errors) / max(1, count)
