"""The affine matrices of medical volumes, which take voxels (x, y, z) to the patient in millimeters.

Voxels count from 0 at the center of the first one, along the last axis of (B, C, D, H, W) first: x along W, y along H, z along D.
RAS, of NIfTI and nibabel, has x to the patient's right, y to the front, z to the head. LPS, of DICOM and SimpleITK, has x to the
left, y to the back, z to the head.
"""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._ops import with_kernel_casts
from kvision.geometry.conversions.homogeneous import homogeneous
from kvision.geometry.linalg import inverse4x4

__all__ = ["affine_from_spacing", "affine_ras_to_lps", "affine_to_spacing", "voxel_transform"]


def affine_ras_to_lps(affine: Tensor) -> Tensor:
    """Convert the affine matrices of volumes from RAS (NIfTI, nibabel) to LPS (DICOM, SimpleITK), or back.

    Args:
        affine: matrices of shape (*, 4, 4) from voxels (x, y, z, 1) to the patient, in RAS or LPS.

    Returns:
        Matrices of shape (*, 4, 4) from the same voxels to LPS or RAS: the first two rows are negated.

    Raises:
        TypeError: `affine` is not a floating-point tensor.
        ValueError: `affine` is not of shape (*, 4, 4).

    Example:
        >>> import torch, kvision as K
        >>> ras = torch.tensor([[2.0, 0, 0, -90], [0, 2, 0, -126], [0, 0, 2, -72], [0, 0, 0, 1]])
        >>> K.geometry.affine_ras_to_lps(ras)[:, 3]
        tensor([ 90., 126., -72.,   1.])
    """
    _check.floating_trailing_shape("affine_ras_to_lps", "affine", affine, 4, 4)
    return torch.cat([0 - affine[..., :2, :], affine[..., 2:, :]], -2)  # no negative zeros


def affine_from_spacing(spacing: Tensor, origin: Tensor, direction: Tensor | None = None) -> Tensor:
    """The affine matrices of volumes given as spacing, origin and direction, as SimpleITK and DICOM do.

    Args:
        spacing: distances between the centers of voxels, in millimeters, along x, y and z, of shape (*, 3).
        origin: the place of the first voxel's center in the patient, in millimeters, of shape (*, 3).
        direction: the directions of the axes of voxels as columns, of shape (*, 3, 3): SimpleITK's `GetDirection()` as a
            matrix. None for the identity.

    Returns:
        Matrices of shape (*, 4, 4) from voxels (x, y, z, 1) to the patient, in the axes of `origin`: LPS for SimpleITK's.

    Raises:
        TypeError: a tensor is not of floating-point type.
        ValueError: a shape is not as in Args, leading axes do not broadcast, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.affine_from_spacing(torch.tensor([1.0, 1, 3]), torch.tensor([90.0, 126, -72]))
        tensor([[  1.,   0.,   0.,  90.],
                [  0.,   1.,   0., 126.],
                [  0.,   0.,   3., -72.],
                [  0.,   0.,   0.,   1.]])
    """
    op = "affine_from_spacing"
    _check.floating_trailing_shape(op, "spacing", spacing, 3)
    _check.floating_trailing_shape(op, "origin", origin, 3)
    shapes, tensors = {"spacing": spacing.shape[:-1], "origin": origin.shape[:-1]}, [spacing, origin]
    if direction is not None:
        _check.floating_trailing_shape(op, "direction", direction, 3, 3)
        shapes["direction"] = direction.shape[:-2]
        tensors.append(direction)
    _check.broadcastable(op, **shapes)
    _check.same_device(op, **dict(zip(shapes, tensors)))
    return _affine(*tensors)


@with_kernel_casts
def _affine(spacing: Tensor, origin: Tensor, direction: Tensor | None = None) -> Tensor:
    axes = torch.diag_embed(spacing) if direction is None else direction * spacing[..., None, :]
    leading = torch.broadcast_shapes(axes.shape[:-2], origin.shape[:-1])
    return homogeneous(torch.cat([axes.expand(*leading, 3, 3), origin.expand(*leading, 3)[..., None]], -1))


def affine_to_spacing(affine: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Split the affine matrices of volumes into spacing, origin and direction: the inverse of :func:`affine_from_spacing`.

    Args:
        affine: matrices of shape (*, 4, 4) from voxels (x, y, z, 1) to the patient.

    Returns:
        Spacings (*, 3) along x, y and z, which are positive, origins (*, 3), and directions (*, 3, 3) as columns. Directions are
        orthogonal unless `affine` shears; those of an axis of spacing 0 are NaN.

    Raises:
        TypeError: `affine` is not a floating-point tensor.
        ValueError: `affine` is not of shape (*, 4, 4).

    Example:
        >>> import torch, kvision as K
        >>> spacing, origin, direction = K.geometry.affine_to_spacing(torch.diag(torch.tensor([-2.0, 2, 3, 1])))
        >>> spacing, direction.diagonal()
        (tensor([2., 2., 3.]), tensor([-1.,  1.,  1.]))
    """
    _check.floating_trailing_shape("affine_to_spacing", "affine", affine, 4, 4)
    spacing, direction = _spacing(affine)
    return spacing, affine[..., :3, 3].clone(), direction


@with_kernel_casts
def _spacing(affine: Tensor) -> tuple[Tensor, Tensor]:
    axes = affine[..., :3, :3]
    spacing = torch.linalg.vector_norm(axes, dim=-2)
    return spacing, axes / spacing[..., None, :]


def voxel_transform(affine_src: Tensor, affine_dst: Tensor) -> Tensor:
    """The matrices from the voxels of one volume to those of another that shows the same patient.

    `warp_affine3d(volume, voxel_transform(affine_src, affine_dst)[:, :3], size)` resamples a volume on the grid of another, as
    SimpleITK's `Resample` and nibabel's `resample_from_to`.

    Args:
        affine_src: matrices of shape (*, 4, 4) from the voxels (x, y, z, 1) of the source to the patient.
        affine_dst: those of the destination, of shape (*, 4, 4), in the same axes of the patient: both RAS or both LPS.

    Returns:
        Matrices of shape (*, 4, 4) from voxels (x, y, z, 1) of the source to those of the destination.

    Raises:
        TypeError: a tensor is not of floating-point type.
        ValueError: a shape is not as in Args, leading axes do not broadcast, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> fine, coarse = torch.diag(torch.tensor([1.0, 1, 1, 1])), torch.diag(torch.tensor([2.0, 2, 2, 1]))
        >>> K.geometry.voxel_transform(fine, coarse).diagonal()
        tensor([0.5000, 0.5000, 0.5000, 1.0000])
    """
    op = "voxel_transform"
    _check.floating_trailing_shape(op, "affine_src", affine_src, 4, 4)
    _check.floating_trailing_shape(op, "affine_dst", affine_dst, 4, 4)
    _check.same_device(op, affine_src=affine_src, affine_dst=affine_dst)
    _check.leading_axes(op, 2, affine_src=affine_src, affine_dst=affine_dst)
    return _between_voxels(affine_src, affine_dst)


@with_kernel_casts
def _between_voxels(source: Tensor, destination: Tensor) -> Tensor:
    return inverse4x4(destination) @ source
