"""Images of one camera as another one sees them."""

from __future__ import annotations

from typing import Any, Literal, Protocol, overload

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Interpolation, Padding
from kvision._dtype import as_dtype, compute_dtype
from kvision._limits import MAX_REACH
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.geometry._precision import in_full_precision
from kvision.geometry.transform.warp import remap

__all__ = ["reproject_image"]


class RayCamera(Protocol):
    """A camera, or a batch of cameras, with parameters (N,) or (B, N), that maps rays to pixels and back."""

    @property
    def height(self) -> int: ...

    @property
    def width(self) -> int: ...

    @property
    def params(self) -> Tensor: ...

    def project_rays(self, rays: Tensor) -> Tensor: ...

    def unproject_rays(self, pixels: Tensor) -> Tensor: ...


@overload
def reproject_image(
    image: Tensor,
    camera_from: RayCamera,
    camera_to: RayCamera,
    R: Tensor | None = None,
    mode: Interpolation = "bilinear",
    padding_mode: Padding = "zeros",
    antialias: bool = False,
    return_valid: Literal[False] = False,
) -> Tensor: ...
@overload
def reproject_image(
    image: Tensor,
    camera_from: RayCamera,
    camera_to: RayCamera,
    R: Tensor | None = None,
    mode: Interpolation = "bilinear",
    padding_mode: Padding = "zeros",
    antialias: bool = False,
    return_valid: bool = False,
) -> Tensor | tuple[Tensor, Tensor]: ...
def reproject_image(
    image: Tensor,
    camera_from: RayCamera,
    camera_to: RayCamera,
    R: Tensor | None = None,
    mode: Interpolation = "bilinear",
    padding_mode: Padding = "zeros",
    antialias: bool = False,
    return_valid: bool = False,
) -> Tensor | tuple[Tensor, Tensor]:
    """Show images of one camera as another camera in the same place sees the scene, whatever their lenses and directions.

    Each pixel of the result is a ray of `camera_to`, which `camera_from` sees somewhere in its image. This undistorts and rectifies
    images of all lenses, makes views and cube maps of panoramas, and panoramas of fisheye images. Gradients reach the image, the
    parameters of both cameras and the rotation.

    Args:
        image: images (B, C, H, W), floating point or uint8, of the height and width of `camera_from`. One image also serves a batch
            of cameras or rotations.
        camera_from: the camera of the images, one of :mod:`kvision.sensors.camera` but `Orthographic`, for all images or a batch of
            B.
        camera_to: the camera of the result, which has its height and width.
        R: rotations (3, 3) or (B, 3, 3) from `camera_from` to `camera_to`: a ray X of the one is R X of the other, as R1 and R2 of
            :func:`stereo_rectify`. None for none.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection', for rays that `camera_from` has outside of its image.
        antialias: average the pixels that a pixel of the result covers, as :func:`remap` does. Only with 'bilinear'.
        return_valid: also return which pixels show the image.

    Returns:
        (B, C, h, w), of the dtype of `image`; 0, without a gradient, for pixels without a ray, and for rays that the lens of
        `camera_from` does not show. With `return_valid` also a mask (B, h, w).

    Raises:
        TypeError: `image` is not a tensor of real numbers, a camera none with rays, `R` not a floating-point tensor, a flag no
            bool.
        ValueError: a shape is not as in Args, a camera has parallel rays, `mode` or `padding_mode` is unknown, or `antialias` comes
            with another mode than 'bilinear'.

    Example:
        >>> import torch, kvision as K
        >>> from kvision.sensors.camera import EquirectangularModel, PinholeModel
        >>> panorama = EquirectangularModel(K.image.ImageSize(32, 64))
        >>> view = PinholeModel(K.image.ImageSize(24, 24), torch.tensor([12.0, 12.0, 11.5, 11.5]))  # 90 degrees
        >>> to_right = K.geometry.axis_angle_to_rotation_matrix(torch.tensor([[0.0, -torch.pi / 2, 0.0]]))
        >>> columns = torch.arange(64.0).expand(1, 1, 32, 64)
        >>> K.geometry.reproject_image(columns, panorama, view, to_right)[0, 0, 12, ::6]
        tensor([39.7167, 43.1225, 47.9242, 52.5565])
    """
    op = "reproject_image"
    _check.images(op, "image", image)
    _check.flag(op, "antialias", antialias)
    _check.flag(op, "return_valid", return_valid)
    for name, camera in (("camera_from", camera_from), ("camera_to", camera_to)):
        if not (hasattr(camera, "project_rays") and hasattr(camera, "unproject_rays")):
            raise TypeCheckError(
                f"{op}: expected {name} to be a camera of kvision.sensors.camera, got {_check.described(camera)}"
            )
    height, width = image.shape[-2:]
    if (height, width) != (camera_from.height, camera_from.width):
        raise ShapeError(
            f"{op}: expected image of the size of camera_from, {(camera_from.height, camera_from.width)}, got {tuple(image.shape)}",
            actual_shape=image.shape,
        )
    shapes = {"image": image.shape[:1], "camera_from": camera_from.params.shape[:-1]}
    shapes["camera_to"] = camera_to.params.shape[:-1]
    if R is not None:
        _check.floating_trailing_shape(op, "R", R, 3, 3)
        if R.dim() > 3:
            raise ShapeError(f"{op}: expected R of shape (3, 3) or (B, 3, 3), got {tuple(R.shape)}")
        R = as_dtype(_check.to_device_of(op, image, "R", R, of="image"), compute_dtype(image))
        shapes["R"] = R.shape[:-2]
    _check.broadcastable(op, **shapes)
    x, y, has_ray = _source_coords(image, camera_from, camera_to, R)
    inside = has_ray & (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)
    if getattr(camera_from, "is_closed", False):
        result = _remap_closed(image, x, y, mode, padding_mode, antialias)
    else:
        result = remap(image, x, y, mode, padding_mode, antialias=antialias)
    result = torch.where(has_ray[:, None], result, 0)
    return (result, inside.expand(result.shape[0], *inside.shape[1:])) if return_valid else result


@in_full_precision
def _source_coords(
    image: Tensor, camera_from: RayCamera, camera_to: RayCamera, R: Tensor | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Where `camera_from` sees the pixels of `camera_to`, x and y (B or 1, h, w), and which it sees; NaN for others."""
    h, w = camera_to.height, camera_to.width
    like: dict[str, Any] = {"dtype": compute_dtype(image), "device": image.device}
    columns, rows = torch.arange(w, **like).repeat(h), torch.arange(h, **like).repeat_interleave(w)
    pixels = torch.stack([columns, rows], -1)
    if camera_to.params.dim() == 2:
        pixels = pixels.expand(camera_to.params.shape[0], h * w, 2)
    rays = camera_to.unproject_rays(pixels)
    is_ray = rays.detach().isfinite().all(-1)
    rays = torch.where(is_ray[..., None], rays, rays.new_tensor([0.0, 0.0, 1.0]))
    if R is not None:
        rays = rays @ R
    if camera_from.params.dim() == 2 and rays.dim() == 2:
        rays = rays.expand(camera_from.params.shape[0], h * w, 3)
    seen = camera_from.project_rays(rays)
    is_seen = seen.detach().isfinite().all(-1) & is_ray
    x, y = torch.where(is_seen[..., None], seen, torch.nan).reshape(-1, h, w, 2).unbind(-1)
    return x, y, is_seen.reshape(-1, h, w)


def _remap_closed(
    image: Tensor, x: Tensor, y: Tensor, mode: Interpolation, padding_mode: Padding, antialias: bool
) -> Tensor:
    """`remap` of panoramas of the whole sphere, whose columns join, and whose rows go on half a turn away beyond the poles."""
    height, width = image.shape[-2:]
    reach = MAX_REACH if antialias else 2
    left, right, above = min(reach, width), min(reach + (width // 4 if antialias else 0), width), min(reach, height)
    beyond = (image[..., :above, :].flip(-2), image[..., height - above :, :].flip(-2))
    north, south = (rows.roll(width // 2, -1) for rows in beyond)
    padded = torch.cat([north, image, south], -2)
    padded = torch.cat([padded[..., width - left :], padded, padded[..., :right]], -1)
    options: Any = dict(mode=mode, padding_mode=padding_mode, antialias=antialias)
    result = remap(padded, x + left, y + above, **options)
    if not antialias:
        return result
    # Maps jump at the seam, where their differences would say that pixels cover all columns: half of the result is read by maps
    # whose seam is in the middle.
    far = remap(padded, torch.where(x < (width - 1) / 2, x + width, x) + left, y + above, **options)
    is_near = (x - (width - 1) / 2).abs() <= width / 4
    return torch.where(is_near[:, None], result, far)
