"""Warps of images to another camera's view by the depth of that view."""

from __future__ import annotations

from typing import Any, get_args

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._choices import Linear, Padding
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._modes import INTERPOLATION, INTERPOLATION_NAMES, PADDING, PADDING_NAMES
from kvision._ops import on_cuda, register
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.geometry._intrinsics import camera_matrix_of
from kvision.geometry.camera import PinholeCamera
from kvision.geometry.depth.points import depth_points
from kvision.geometry.grid import create_meshgrid
from kvision.geometry.linalg import adjugate, inverse3x3
from kvision.geometry.transform import remap, sampling
from kvision.geometry.transform.nearest import as_values, of_values

__all__ = ["DepthWarper", "depth_warp", "warp_frame_depth"]

_MODES, _PADDINGS = get_args(Linear), get_args(Padding)

# --- the definition -------------------------------------------------------------------------------------------------


def source_coords(depth: Tensor, projection: Tensor, pixels: Tensor | None = None) -> list[Tensor]:
    """Coordinates u and v, (B, h, w), of the pixels of depth images (B, 1, h, w) in a source image; NaN behind its camera.

    (u, v, 1) is proportional to d A (x, y, 1) + b with `projection` = [A | b], (B, 3, 4). `pixels`, (B or 1, h, w, 3), are other
    (x, y, 1) than those of the depth's own pixels.
    """
    h, w = depth.shape[2:]
    if pixels is None:
        x = torch.arange(w, dtype=depth.dtype, device=depth.device)
        y = torch.arange(h, dtype=depth.dtype, device=depth.device)[:, None]
    else:
        x, y, scale = pixels.to(depth).unbind(-1)
    # Pixels whose values are not finite have no coordinates. They are 0 here, because NaN times a gradient of 0 is NaN.
    finite_depth, finite_projection = depth[:, 0].isfinite(), projection.isfinite().flatten(1).all(1)[:, None, None]
    d, m = torch.where(finite_depth, depth[:, 0], 0), torch.where(finite_projection, projection, 0)[..., None, None]
    last = [m[:, k, 2] if pixels is None else m[:, k, 2] * scale for k in range(3)]
    u, v, z = ((m[:, k, 0] * x + (m[:, k, 1] * y + last[k])) * d + m[:, k, 3] for k in range(3))
    in_front = finite_depth & (z > 0) & (u / z).isfinite() & (v / z).isfinite()
    u, v, z = (torch.where(in_front, value, 1) for value in (u, v, z))
    return [torch.where(in_front, value / z, torch.nan) for value in (u, v)]


def _reference(image, depth, projection, interpolation, padding, align_corners):
    depth, projection = depth.expand(image.shape[0], -1, -1, -1), projection.expand(image.shape[0], -1, -1)
    return sampling.sample(
        image,
        source_coords(depth, projection),
        INTERPOLATION_NAMES[interpolation],
        PADDING_NAMES[padding],
        align_corners,
    )


def _backward(needs, grad, image, depth, projection, *options):
    grads = [None, None, None]
    if needs[0]:
        promoted = grad.to(compute_dtype(grad))
        grads[0] = image_gradient_of(promoted, depth, projection, list(image.shape[2:]), *options).to(grad.dtype)
    if needs[1] or needs[2]:
        coord_grads = _coords_backward(grad, image, depth, projection, *options)
        grads[1:] = (g.sum_to_size(x.shape) for g, x in zip(coord_grads, (depth, projection)))
    return grads


def _image_gradient_reference(grad, depth, projection, size, *options):
    def of_image(image: Tensor) -> Tensor:
        return _reference(image, depth, projection, *options)

    _, vjp_fn = torch.func.vjp(of_image, grad.new_zeros(*grad.shape[:2], *size))
    return vjp_fn(grad)[0]


def _coords_backward_reference(grad, image, depth, projection, *options):
    computes, batch = depth.dtype, grad.shape[0]

    def of_coords(depth: Tensor, projection: Tensor) -> Tensor:
        return _reference(image.to(computes).expand(batch, -1, -1, -1), depth, projection, *options)

    expanded = depth.expand(batch, -1, -1, -1), projection.expand(batch, -1, -1)
    _, vjp_fn = torch.func.vjp(of_coords, *expanded)
    return vjp_fn(grad.to(computes))


depth_warp_of = register(
    "depth_warp",
    _reference,
    fake=lambda image, depth, *rest: (*image.shape[:2], *depth.shape[2:]),
    backward=_backward,
)
image_gradient_of = register(
    "depth_warp_image_backward",
    _image_gradient_reference,
    fake=lambda grad, depth, projection, size, *options: grad.new_empty(*grad.shape[:2], *size),
    gradients="grad: depth_warp(image=grad_grad); depth, projection: reference",
    nondeterministic=on_cuda,
)
_coords_backward = register(
    "depth_warp_coords_backward",
    _coords_backward_reference,
    fake=lambda grad, image, depth, projection, *options: [
        depth.new_empty(grad.shape[0], *depth.shape[1:]),
        projection.new_empty(grad.shape[0], 3, 4),
    ],
    casts_outputs=True,
)

# --- from one camera to another -------------------------------------------------------------------------------------


def _reprojection_reference(camera_to, pose_to, camera_from, pose_from, pinhole):
    to, source = (_pinhole(k) if pinhole else k for k in (camera_to, camera_from))
    rotation, translation = pose_to[:, :3, :3], pose_to[:, :3, 3:]
    if pose_from is not None:
        rotation = rotation @ pose_from[:, :3, :3].mT
        translation = translation - rotation @ pose_from[:, :3, 3:]
    A, b = to @ rotation @ inverse3x3(source), to @ translation
    batch = b.shape[0] if A.shape[0] == 1 else A.shape[0]
    return torch.cat([A.expand(batch, -1, -1), b.expand(batch, -1, -1)], 2)


def _pinhole(camera: Tensor) -> Tensor:
    """A camera matrix (B, 3, 3) reduced to its focal lengths and principal point."""
    fx, fy, cx, cy = (camera[:, i, j] for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return camera_matrix_of(fx, fy, cx, cy)


def _reprojection_backward_reference(grad, *args):
    *tensors, pinhole = args
    batch = grad.shape[0]
    if tensors[3] is None:
        tensors[3] = torch.eye(4, dtype=grad.dtype, device=grad.device)[None]
    each = [x.expand(batch, -1, -1) for x in tensors]
    _, vjp_fn = torch.func.vjp(lambda *x: _reprojection_reference(*x, pinhole), *each)
    k = each[2]
    determinant = _pinhole(k).diagonal(dim1=1, dim2=2).prod(1) if pinhole else (k[:, 0] * adjugate(k)[..., 0]).sum(1)
    return tuple(torch.where((determinant == 0)[:, None, None], 0, g) for g in vjp_fn(grad))


# The projection (B, 3, 4) from pixels of one camera (B, 3, 3) to those of another, as `source_coords` takes it.
# Poses are (B, 4, 4). The first pose is the identity where it is None.
_reprojection = register(
    "reprojection",
    _reprojection_reference,
    fake=lambda *args: (next((x.shape[0] for x in args[:4] if x is not None and x.shape[0] != 1), 1), 3, 4),
    gradients="camera_to, pose_to, camera_from, pose_from: reprojection_backward",
)
register(
    "reprojection_backward",
    _reprojection_backward_reference,
    fake=lambda grad, *args: [(grad.shape[0], side, side) for side in (3, 4, 3, 4)],
)


# --- functions ------------------------------------------------------------------------------------------------------


def _warped(
    op: str, image: Tensor, depth: Tensor, projection: Tensor, mode: Linear, padding: str, align: bool
) -> Tensor:
    """Warp `image` (B, C, H, W) by `depth` (B, 1, h, w) and `projection` (B, 3, 4). Batches of 1 broadcast."""
    source, image = image, floats(as_values(image, mode))
    batch = max(image.shape[0], depth.shape[0], projection.shape[0]) if image.shape[0] else 0
    if image.shape[0] == 1 and batch > 1:
        image = image.expand(batch, -1, -1, -1)
    depth = sampling.cast_to_image(op, image, "depth", depth)
    projection = sampling.cast_to_image(op, image, "projection", projection)
    number = PADDING["fill" if padding == "zeros" else padding]
    warped: Tensor = depth_warp_of(image, depth, projection, INTERPOLATION[mode], number, align)
    return of_values(warped, source, mode)


def warp_frame_depth(
    image_src: Tensor,
    depth_dst: Tensor,
    src_trans_dst: Tensor,
    camera_matrix: Tensor,
    normalize_points: bool = False,
    camera_matrix_src: Tensor | None = None,
) -> Tensor:
    """Warp images of a source camera into a destination camera, by the destination's depth map.

    In one pass, without points or a grid. Bilinear; 0 outside of the image and for points behind the source's camera.

    Args:
        image_src: images (B, C, H, W) of the source. Integers are computed in float32.
        depth_dst: depth (B, 1, h, w) of the destination, z.
        src_trans_dst: (B, 4, 4), points of the destination's frame to the source's.
        camera_matrix: (B, 3, 3), of both cameras; its focal lengths and principal point are used.
        normalize_points: depth is the distance from the camera, not z.
        camera_matrix_src: (B, 3, 3), of the source's camera where it is another; `camera_matrix` is then the destination's.

    Returns:
        (B, C, h, w), of the type of `image_src`.

    Raises:
        TypeError: an argument does not have its documented type.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> image, motion = torch.arange(4.0).expand(1, 1, 2, 4), torch.eye(4)[None].clone()
        >>> motion[0, 0, 3] = 1
        >>> K.geometry.warp_frame_depth(image, torch.ones(1, 1, 2, 4), motion, torch.eye(3)[None])[0, 0, 0]
        tensor([1., 2., 3., 0.])
    """
    op = "warp_frame_depth"
    _check.images(op, "image_src", image_src)
    _check.shape(op, "depth_dst", depth_dst, "B", 1, "H", "W")
    _check.images(op, "depth_dst", depth_dst)
    _check.shape(op, "src_trans_dst", src_trans_dst, "B", 4, 4)
    _check.shape(op, "camera_matrix", camera_matrix, "B", 3, 3)
    _check.flag(op, "normalize_points", normalize_points)
    if camera_matrix_src is not None:
        _check.shape(op, "camera_matrix_src", camera_matrix_src, "B", 3, 3)
    _check.same_device(op, image_src=image_src, depth_dst=depth_dst)
    dtype = compute_dtype(image_src)
    motion, camera = (
        as_dtype(_check.to_device_of(op, image_src, name, x, of="image_src"), dtype)
        for name, x in (("src_trans_dst", src_trans_dst), ("camera_matrix", camera_matrix))
    )
    if motion.shape[0] != 1:
        camera = sampling.cast_to_image(op, motion, "camera_matrix", camera)
    camera_src = camera
    if camera_matrix_src is not None:
        camera_src = as_dtype(
            _check.to_device_of(op, image_src, "camera_matrix_src", camera_matrix_src, of="image_src"), dtype
        )
        batches = {"src_trans_dst": motion, "camera_matrix": camera, "camera_matrix_src": camera_src}
        _check.broadcastable(op, **{name: x.shape[:1] for name, x in batches.items()})
    if normalize_points:
        depth_dst = depth_dst.to(dtype)
        if depth_dst.shape[0] == 1:
            depth_dst = depth_dst.expand(camera.shape[0], -1, -1, -1)
        cameras = sampling.cast_to_image(op, depth_dst, "camera_matrix", camera)
        depth_dst = depth_points(depth_dst, cameras, True, False)[:, 2:]
    projection = _reprojection(camera_src, motion, camera, None, True)
    return _warped(op, image_src, depth_dst, projection, "bilinear", "zeros", True)


class DepthWarper(nn.Module):
    """Warp images of a destination camera into a source camera, by the source's depth map.

    First :meth:`compute_projection_matrix` with the source's camera, then call it. Points behind the destination's
    camera are outside of its image.

    Args:
        pinhole_dst: the destination's cameras, one for all images or one for each.
        height: of the source's images.
        width: of the source's images.
        mode: 'bilinear' or 'nearest'.
        padding_mode: what is outside of the image: 'zeros', its 'border' or its 'reflection'.
        align_corners: the reflection is about the centers of the outermost pixels, not their outer edges.

    Raises:
        TypeError: an argument does not have its documented type.
        ValueError: the mode is unknown; called before the source's camera is finite_depth.

    Example:
        >>> import torch, kvision as K
        >>> size = torch.tensor([4.0])
        >>> here = K.geometry.PinholeCamera(torch.eye(4)[None], torch.eye(4)[None], size, size)
        >>> there = here.clone()
        >>> there.tx = 1.0
        >>> warper = K.DepthWarper(there, 4, 4).compute_projection_matrix(here)
        >>> warper(torch.ones(1, 1, 4, 4), torch.arange(4.0).expand(1, 1, 4, 4))[0, 0, 0]
        tensor([1., 2., 3., 0.])
    """

    def __init__(
        self,
        pinhole_dst: PinholeCamera,
        height: int,
        width: int,
        mode: Linear = "bilinear",
        padding_mode: Padding = "zeros",
        align_corners: bool = True,
    ) -> None:
        super().__init__()
        op = type(self).__name__
        _check_camera(op, "pinhole_dst", pinhole_dst)
        (self.height,), (self.width,) = _check.ints(op, "height", height, 1), _check.ints(op, "width", width, 1)
        _check.choice(op, "mode", mode, _MODES)
        _check.choice(op, "padding_mode", padding_mode, _PADDINGS)
        _check.flag(op, "align_corners", align_corners)
        self.mode = mode
        self.padding_mode = padding_mode
        self.align_corners = align_corners
        self._pinhole_dst = pinhole_dst
        self._grid: Tensor | None = None
        self._projection: Tensor | None = None

    def extra_repr(self) -> str:
        return (
            f"height={self.height}, width={self.width}, mode={self.mode!r}, padding_mode={self.padding_mode!r}, "
            f"align_corners={self.align_corners}"
        )

    def compute_projection_matrix(self, pinhole_src: PinholeCamera) -> DepthWarper:
        """Set the source's camera, and compute the map from its pixels to the destination's; returns the warper itself."""
        _check_camera(type(self).__name__, "pinhole_src", pinhole_src)
        there, here = self._pinhole_dst, pinhole_src
        cameras = there.intrinsics[:, :3, :3], there.extrinsics, here.intrinsics[:, :3, :3], here.extrinsics
        self._projection = _reprojection(*(x.to(compute_dtype(cameras[0])) for x in cameras), False)
        return self

    @property
    def grid(self) -> Tensor:
        """The source's pixels (1, H, W, 3) as (x, y, 1): those of the depth map, unless others are set."""
        if self._grid is not None:
            return self._grid
        like = self._pinhole_dst.intrinsics
        pixels = create_meshgrid(self.height, self.width, False, like.device, like.dtype)
        return torch.nn.functional.pad(pixels, (0, 1), value=1.0)

    @grid.setter
    def grid(self, pixels: Tensor) -> None:
        op = type(self).__name__
        _check.shape(op, "grid", pixels, "B", self.height, self.width, 3)
        _check.floating(op, "grid", pixels)
        self._grid = pixels

    @property
    def projection(self) -> Tensor:
        """(B, 3, 4): [A | b], with (u, v, 1) proportional to d A (x, y, 1) + b for a source's pixel at depth d."""
        if self._projection is None:
            raise ValueCheckError(
                f"{type(self).__name__}: call compute_projection_matrix with the source's camera first"
            )
        return self._projection

    def compute_subpixel_step(self) -> Tensor:
        """The step of inverse depth, at 1, that moves the center of the image by half a pixel in the camera that sees it
        move most.

        Source: R. Szeliski and D. Scharstein, "Symmetric sub-pixel stereo matching" (2002).
        """
        projection, step = self.projection, 0.01
        ray = projection[:, :, 0] * (self.width / 2) + projection[:, :, 1] * (self.height / 2) + projection[:, :, 2]
        before, after = (ray + (1 + d) * projection[:, :, 3] for d in (-step, step))
        moved = after[:, :2] / after[:, 2:] - before[:, :2] / before[:, 2:]
        return (step / moved.norm(dim=1)).min()

    def warp_grid(self, depth_src: Tensor) -> Tensor:
        """Sampling coordinates (B, H, W, 2) as (x, y) of the pixels of a source's depth (B, 1, H, W). -1 and 1 are the centers of
        the outermost pixels of an image of the warper's size. NaN behind the camera."""
        depth_src = self._checked(depth_src)
        projection = self.projection.to(depth_src.dtype)
        batch = max(depth_src.shape[0], projection.shape[0])
        coords = source_coords(depth_src.expand(batch, -1, -1, -1), projection.expand(batch, -1, -1), self._grid)
        sizes = (self.width, self.height)
        return torch.stack([2 * p / (n - 1) - 1 if n > 1 else p - 1 for p, n in zip(coords, sizes)], -1)

    def _checked(self, depth: Any) -> Tensor:
        _check.shape(type(self).__name__, "depth_src", depth, "B", 1, self.height, self.width)
        return floats(depth)

    def forward(self, depth_src: Tensor, patch_dst: Tensor) -> Tensor:
        """Warp images `patch_dst` (B, C, h, w) by depth (B, 1, H, W): (B, C, H, W)."""
        depth_src = self._checked(depth_src)
        op, projection = type(self).__name__, self.projection
        _check.images(op, "patch_dst", patch_dst)
        _check.same_device(op, depth_src=depth_src, patch_dst=patch_dst, projection=projection)
        if self._grid is not None:
            dtype = floats(patch_dst).dtype
            x, y = source_coords(depth_src, projection.to(depth_src.dtype), self._grid)
            return remap(patch_dst, x.to(dtype), y.to(dtype), self.mode, self.padding_mode, self.align_corners)
        return _warped(op, patch_dst, depth_src, projection, self.mode, self.padding_mode, self.align_corners)


def _check_camera(op: str, name: str, camera: Any) -> None:
    if not isinstance(camera, PinholeCamera):
        raise TypeCheckError(f"{op}: expected {name} to be a PinholeCamera, got {type(camera).__name__}")


def depth_warp(
    pinhole_dst: PinholeCamera,
    pinhole_src: PinholeCamera,
    depth_src: Tensor,
    patch_dst: Tensor,
    height: int,
    width: int,
    align_corners: bool = True,
) -> Tensor:
    """Warp images of a destination camera into a source camera, by the source's depth map: :class:`DepthWarper` in one call.

    Args:
        pinhole_dst: the destination's cameras.
        pinhole_src: the source's cameras.
        depth_src: (B, 1, H, W).
        patch_dst: images (B, C, h, w). Integers are computed in float32.
        height: H.
        width: W.
        align_corners: as :class:`DepthWarper` has it.

    Returns:
        (B, C, H, W), of the type of `patch_dst`; 0 outside of the images.

    Raises:
        TypeError: an argument does not have its documented type.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> size = torch.tensor([4.0])
        >>> camera = K.geometry.PinholeCamera(torch.eye(4)[None], torch.eye(4)[None], size, size)
        >>> image = torch.rand(1, 3, 4, 4)
        >>> torch.equal(K.geometry.depth_warp(camera, camera, torch.ones(1, 1, 4, 4), image, 4, 4), image)
        True
    """
    warper = DepthWarper(pinhole_dst, height, width, align_corners=align_corners)
    return warper.compute_projection_matrix(pinhole_src)(depth_src, patch_dst)
