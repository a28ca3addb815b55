"""Local affine frames (LAFs): position, scale, orientation and affine shape of features as matrices (B, N, 2, 3).

A frame is [A | c]. A maps the unit circle around 0 to the ellipse of the feature around its center c = (x, y), in pixels.
The frame of scale s and orientation t is s [[cos t, sin t], [-sin t, cos t]]: t is counter-clockwise as seen in the
image. A frame of zeros is an empty slot of a detector; functions leave it as it is.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._ops import without_autocast_and_tf32
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.feature._laf_units import check_lafs, denormalize_laf, normalize_laf, scale_laf_parts
from kvision.feature.patches import extract_patches_from_pyramid, extract_patches_simple
from kvision.geometry._formula import batch_of, of_rows, register_formula
from kvision.geometry.conversions.angles import cos_sin
from kvision.geometry.linalg import root, transform_points

__all__ = [
    "denormalize_laf",
    "ellipse_to_laf",
    "extract_patches_from_pyramid",
    "extract_patches_simple",
    "get_laf_center",
    "get_laf_orientation",
    "get_laf_pts_to_draw",
    "get_laf_scale",
    "laf_from_center_scale_ori",
    "laf_from_three_points",
    "laf_is_filled",
    "laf_is_inside_image",
    "laf_is_valid",
    "laf_to_boundary_points",
    "laf_to_three_points",
    "make_upright",
    "normalize_laf",
    "perspective_transform_lafs",
    "rotate_laf",
    "scale_laf",
    "set_laf_orientation",
]


def _angles_of(op: str, laf: Tensor, degrees: Tensor) -> Tensor:
    """A number (B, N) for each frame, of shape (B, N), (B, N, 1) or (B, N, 1, 1)."""
    _check.numbers(op, "angles_degrees", degrees)
    _check.same_device(op, LAF=laf, angles_degrees=degrees)
    sizes = degrees.shape
    if not 2 <= degrees.dim() <= 4 or sizes[:2] != laf.shape[:2] or sizes[2:].numel() != 1:
        raise ShapeError(
            f"{op}: expected angles_degrees of shape (B, N, 1) for LAF of shape {tuple(laf.shape)}, got {tuple(sizes)}"
        )
    return degrees.reshape(sizes[:2])


# --- parts of a frame -----------------------------------------------------------------------------------------------


def get_laf_center(LAF: Tensor) -> Tensor:
    """Get the centers of frames.

    Args:
        LAF: (B, N, 2, 3). Integers give float32.

    Returns:
        Points (x, y) of shape (B, N, 2), a view.

    Raises:
        TypeCheckError: `LAF` is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.get_laf_center(torch.tensor([[[[2.0, 0, 5], [0, 2, 7]]]]))
        tensor([[[5., 7.]]])
    """
    return check_lafs("get_laf_center", LAF, "LAF")[..., 2]


def get_laf_scale(LAF: Tensor) -> Tensor:
    """Get the scales of frames: sqrt |det A + 1e-10|.

    Args:
        LAF: (B, N, 2, 3). Integers give float32.

    Returns:
        (B, N, 1, 1), in pixels.

    Raises:
        TypeCheckError: `LAF` is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.get_laf_scale(torch.tensor([[[[2.0, 0, 5], [0, 8, 7]]]]))
        tensor([[[[4.]]]])
    """
    return of_rows(_scale, check_lafs("get_laf_scale", LAF, "LAF"), 2)[..., None]


def _determinant(laf: Tensor) -> Tensor:
    return laf[..., 0, 0] * laf[..., 1, 1] - laf[..., 0, 1] * laf[..., 1, 0]


def _scale_reference(laf: Tensor) -> Tensor:
    return root((_determinant(laf) + 1e-10).abs())[..., None]


_scale = register_formula("laf_scale", _scale_reference, lambda *args: (1,))


def get_laf_orientation(LAF: Tensor) -> Tensor:
    """Get the orientations of frames: atan2(a12, a11), counter-clockwise as seen in the image.

    Args:
        LAF: (B, N, 2, 3). Integers give float32.

    Returns:
        Degrees (B, N, 1) in [-180, 180]; 0 with a gradient of 0 where a11 and a12 are 0.

    Raises:
        TypeCheckError: `LAF` is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.get_laf_orientation(torch.tensor([[[[0.0, 2, 5], [-2, 0, 7]]]]))
        tensor([[[90.]]])
    """
    laf = check_lafs("get_laf_orientation", LAF, "LAF")
    return torch.rad2deg(torch.atan2(laf[..., 0, 1], laf[..., 0, 0]))[..., None]


def laf_is_valid(laf: Tensor) -> Tensor:
    """Tell which frames are finite and have an area.

    Args:
        laf: (B, N, 2, 3).

    Returns:
        Bools (B, N): all numbers and the determinant are finite, and the determinant is not 0.

    Raises:
        TypeCheckError: `laf` is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.laf_is_valid(torch.stack([torch.eye(2, 3), torch.zeros(2, 3)])[None])
        tensor([[ True, False]])
    """
    laf = check_lafs("laf_is_valid", laf)
    det = _determinant(as_dtype(laf, compute_dtype(laf)))
    return laf.isfinite().flatten(2).all(2) & det.isfinite() & (det != 0)


def laf_is_filled(laf: Tensor) -> Tensor:
    """Tell which slots of a detector hold a feature: those whose frame is not all zeros.

    Args:
        laf: (B, N, 2, 3).

    Returns:
        Bools (B, N).

    Raises:
        TypeCheckError: `laf` is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.laf_is_filled(torch.stack([torch.eye(2, 3), torch.zeros(2, 3)])[None])
        tensor([[ True, False]])
    """
    return check_lafs("laf_is_filled", laf).flatten(2).any(2)


# --- from parts, and with other parts -------------------------------------------------------------------------------


def laf_from_center_scale_ori(xy: Tensor, scale: Tensor | None = None, ori: Tensor | None = None) -> Tensor:
    """Make frames of centers, scales and orientations.

    Args:
        xy: centers (B, N, 2) in pixels. Integers give float32.
        scale: (B, N, 1, 1); None for 1.
        ori: degrees (B, N, 1), counter-clockwise as seen in the image; None for 0.

    Returns:
        (B, N, 2, 3): [[s cos, s sin, x], [-s sin, s cos, y]].

    Raises:
        TypeCheckError: an argument is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.laf_from_center_scale_ori(torch.tensor([[[5.0, 7.0]]]), torch.full((1, 1, 1, 1), 2.0))
        tensor([[[[2., 0., 5.],
                  [0., 2., 7.]]]])
    """
    op = "laf_from_center_scale_ori"
    _check.shape(op, "xy", xy, "B", "N", 2)
    xy = floats(xy)
    parts: list[Tensor | None] = []
    for name, x, axes in (("scale", scale, 4), ("ori", ori, 3)):
        if x is None:
            parts.append(None)
            continue
        _check.shape(op, name, x, xy.shape[0], xy.shape[1], *(1,) * (axes - 2))
        _check.same_device(op, **{"xy": xy, name: x})
        parts.append(as_dtype(x, xy.dtype).reshape(-1))
    return _from_parts(xy.reshape(-1, 2), *parts).reshape(*xy.shape[:2], 2, 3)


def _from_parts_reference(center: Tensor, scale: Tensor | None, degrees: Tensor | None) -> Tensor:
    n = batch_of(center, scale, degrees)
    c, s = cos_sin(center.new_zeros(1) if degrees is None else degrees)
    k = center.new_ones(1) if scale is None else scale
    rows = [(k * c).expand(n), (k * s).expand(n), center[:, 0].expand(n)]
    rows += [-rows[1] + 0, rows[0], center[:, 1].expand(n)]
    return torch.stack(rows, -1).unflatten(-1, (2, 3))


_from_parts = register_formula("laf_from_parts", _from_parts_reference, lambda *args: (2, 3))


def scale_laf(laf: Tensor, scale_coef: float | Tensor) -> Tensor:
    """Multiply the 2 x 2 parts of frames; centers stay.

    Args:
        laf: (B, N, 2, 3). Integers give float32.
        scale_coef: a number, or a tensor: (B,), (B, N), or what broadcasts with (B, N, 2, 2), such as (B, N, 1, 1).

    Returns:
        (B, N, 2, 3).

    Raises:
        TypeCheckError: `laf` is not a tensor of real numbers, `scale_coef` neither a number nor a tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.scale_laf(torch.ones(1, 1, 2, 3), 0.5)
        tensor([[[[0.5000, 0.5000, 1.0000],
                  [0.5000, 0.5000, 1.0000]]]])
    """
    laf = check_lafs("scale_laf", laf)
    if not isinstance(scale_coef, Tensor):
        scale_coef = _check.scalar("scale_laf", "scale_coef", scale_coef)
        if isinstance(scale_coef, bool) or not isinstance(scale_coef, (int, float)):
            raise TypeCheckError(f"scale_laf: expected scale_coef to be a number or a Tensor, got {scale_coef!r}")
        return scale_laf_parts(laf, float(scale_coef), 1.0, 1.0)
    _check.numbers("scale_laf", "scale_coef", scale_coef)
    _check.same_device("scale_laf", laf=laf, scale_coef=scale_coef)
    sizes = scale_coef.shape
    if sizes not in ((), (1,)):
        sizes = torch.Size((*sizes, *(1,) * (4 - len(sizes))))
        if len(sizes) != 4 or any(n not in (1, m) for n, m in zip(sizes, (*laf.shape[:2], 2, 2))):
            raise ShapeError(
                f"scale_laf: expected scale_coef of shape (B,), (B, N) or (B, N, 1, 1) for laf of shape "
                f"{tuple(laf.shape)}, got {tuple(scale_coef.shape)}"
            )
    coef = as_dtype(scale_coef, laf.dtype).reshape(sizes)
    return torch.cat([laf[..., :2] * coef, laf[..., 2:]], -1)


def _of_peak_reference(peak: Tensor, scale: Tensor, levels_of_octave: float, x: float, y: float) -> Tensor:
    scale = scale * torch.exp2(peak[:, 0] / levels_of_octave)
    rows = [scale * x, 0 * scale, peak[:, 1] * x, 0 * scale, scale * y, peak[:, 2] * y]
    return torch.stack(torch.broadcast_tensors(*rows), -1).unflatten(-1, (2, 3))


_of_peak = register_formula("laf_of_peak", _of_peak_reference, lambda *args: (2, 3))


def laf_of_peak(peak: Tensor, scale: Tensor, levels_of_octave: float, x: float, y: float) -> Tensor:
    """Upright frames (B, N, 2, 3) of peaks (B, N, 4), which are level, x, y and value, of an octave.

    The scale of a frame is scale (B,) of level 0 times 2 ** (level / levels_of_octave). A pixel of the octave is x, y
    pixels of the image.
    """
    batch, count = peak.shape[:2]
    of_each = scale if batch == 1 else scale[:, None].expand(batch, count).reshape(-1)
    return _of_peak(peak.reshape(-1, 4), of_each, levels_of_octave, x, y).reshape(batch, count, 2, 3)


def rotate_laf(LAF: Tensor, angles_degrees: Tensor) -> Tensor:
    """Rotate frames: their orientations grow by angles.

    Args:
        LAF: (B, N, 2, 3). Integers give float32.
        angles_degrees: (B, N, 1), counter-clockwise as seen in the image.

    Returns:
        (B, N, 2, 3): [A R | c] for the rotations R of `angle_to_rotation_matrix`.

    Raises:
        TypeCheckError: an argument is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.rotate_laf(torch.eye(2, 3)[None, None], torch.tensor([[[90.0]]]))
        tensor([[[[ 0.,  1.,  0.],
                  [-1.,  0.,  0.]]]])
    """
    laf = check_lafs("rotate_laf", LAF, "LAF")
    return _of_frames_and_angles(_rotate, laf, _angles_of("rotate_laf", laf, angles_degrees))


def _of_frames_and_angles(operator: object, laf: Tensor, degrees: Tensor) -> Tensor:
    y: Tensor = operator(laf.reshape(-1, 2, 3), as_dtype(degrees, laf.dtype).reshape(-1))  # type: ignore[operator]
    return y.reshape(laf.shape)


def _rotated(laf: Tensor, c: Tensor, s: Tensor) -> Tensor:
    first, second, center = laf.unbind(-1)
    c, s = c[..., None], s[..., None]
    x = first * c - second * s
    return torch.stack([x, first * s + second * c, center.expand_as(x)], -1)


def _rotate_reference(laf: Tensor, degrees: Tensor) -> Tensor:
    return _rotated(laf, *cos_sin(degrees))


_rotate = register_formula("rotate_laf", _rotate_reference, lambda *args: (2, 3))


def set_laf_orientation(LAF: Tensor, angles_degrees: Tensor) -> Tensor:
    """Rotate frames to given orientations.

    Args:
        LAF: (B, N, 2, 3). Integers give float32.
        angles_degrees: (B, N, 1), counter-clockwise as seen in the image.

    Returns:
        (B, N, 2, 3), whose `get_laf_orientation` is `angles_degrees` in [-180, 180].

    Raises:
        TypeCheckError: an argument is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> laf = K.feature.laf_from_center_scale_ori(torch.zeros(1, 1, 2), ori=torch.tensor([[[30.0]]]))
        >>> K.feature.set_laf_orientation(laf, torch.zeros(1, 1, 1)).round(decimals=4) + 0
        tensor([[[[1., 0., 0.],
                  [0., 1., 0.]]]])
    """
    laf = check_lafs("set_laf_orientation", LAF, "LAF")
    return _of_frames_and_angles(_set_orientation, laf, _angles_of("set_laf_orientation", laf, angles_degrees))


def _set_orientation_reference(laf: Tensor, degrees: Tensor) -> Tensor:
    c, s = cos_sin(degrees)
    length = root(laf[..., 0, :2].square().sum(-1))
    has_length = length != 0
    divisor = torch.where(has_length, length, 1)
    old_c = torch.where(has_length, laf[..., 0, 0] / divisor, 1)
    old_s = laf[..., 0, 1] / divisor
    return _rotated(laf, c * old_c + s * old_s, s * old_c - c * old_s)


_set_orientation = register_formula("set_laf_orientation", _set_orientation_reference, lambda *args: (2, 3))


def make_upright(laf: Tensor, eps: float = 1e-9) -> Tensor:
    """Rotate frames to orientation 0: their 2 x 2 parts become lower triangular, the ellipses stay.

    Args:
        laf: (B, N, 2, 3). Integers give float32.
        eps: added to the length of A's first row.

    Returns:
        [U | c] of shape (B, N, 2, 3) with U U^T = A A^T and a positive diagonal. A reflection is lost. Empty slots stay
        empty.

    Raises:
        TypeCheckError: `laf` is not a tensor of real numbers, `eps` not a number.
        ShapeError: a shape is not as in Args.
        ValueCheckError: `eps` is negative.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.make_upright(torch.tensor([[[[0.0, 2, 5], [-3, 0, 7]]]])) + 0
        tensor([[[[2., 0., 5.],
                  [0., 3., 7.]]]])
    """
    laf = check_lafs("make_upright", laf)
    return of_rows(_upright, laf, 2, _check.number("make_upright", "eps", eps, 0))


def _upright_reference(laf: Tensor, eps: float) -> Tensor:
    is_empty = (laf == 0).flatten(1).all(1)[:, None, None]
    A = torch.where(is_empty, torch.eye(2, dtype=laf.dtype, device=laf.device), laf[..., :2])
    first, second = A.unbind(1)
    r = root(first.square().sum(-1)) + eps
    area = (_determinant(A) + 1e-10).abs()
    upper = torch.stack([r, torch.zeros_like(r)], -1)
    lower = torch.stack([(first * second).sum(-1) / r, area / r], -1)
    U = torch.stack([upper, lower], 1)
    return torch.cat([torch.where(is_empty, laf[..., :2], U), laf[..., 2:]], -1)


_upright = register_formula("make_upright", _upright_reference, lambda *args: (2, 3))


# --- ellipses, points, images ---------------------------------------------------------------------------------------


def ellipse_to_laf(ells: Tensor) -> Tensor:
    """Convert ellipses to frames.

    Args:
        ells: (B, N, 5): x, y, a, b, c for a u^2 + 2 b u v + c v^2 = 1 around (x, y). Integers give float32.

    Returns:
        (B, N, 2, 3) with the lower triangular A of A A^T = [[a, b], [b, c]]^-1; infinite or NaN where the equation is
        not that of an ellipse.

    Raises:
        TypeCheckError: `ells` is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.ellipse_to_laf(torch.tensor([[[5.0, 7.0, 0.25, 0.0, 0.0625]]])) + 0
        tensor([[[[2., 0., 5.],
                  [0., 4., 7.]]]])
    """
    _check.shape("ellipse_to_laf", "ells", ells, "B", "N", 5)
    return of_rows(_of_ellipse, floats(ells), 1)


def _of_ellipse_reference(ellipse: Tensor) -> Tensor:
    x, y, a, b, c = ellipse.unbind(-1)
    root_c = c.sqrt()
    slope = b / root_c
    schur = (a - slope * slope).sqrt()
    rows = [1 / schur, torch.zeros_like(x), x, -slope / (root_c * schur), 1 / root_c, y]
    return torch.stack(rows, -1).unflatten(-1, (2, 3))


_of_ellipse = register_formula("ellipse_to_laf", _of_ellipse_reference, lambda *args: (2, 3))


def laf_to_boundary_points(LAF: Tensor, n_pts: int = 50) -> Tensor:
    """Sample the centers and outlines of frames.

    Args:
        LAF: (B, N, 2, 3). Integers give float32.
        n_pts: number of points, at least 1.

    Returns:
        (B, N, n_pts, 2): the center, then a closed curve c + A (sin t, cos t) with t from 0 to 2 pi.

    Raises:
        TypeCheckError: `LAF` is not a tensor of real numbers, `n_pts` not an int.
        ShapeError: a shape is not as in Args.
        ValueCheckError: `n_pts` is less than 1.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.laf_to_boundary_points(torch.eye(2, 3)[None, None], 5).round(decimals=4)[0, 0] + 0
        tensor([[ 0.0000,  0.0000],
                [ 0.0000,  1.0000],
                [ 0.8660, -0.5000],
                [-0.8660, -0.5000],
                [ 0.0000,  1.0000]])
    """
    laf = check_lafs("laf_to_boundary_points", LAF, "LAF")
    (n_pts,) = _check.ints("laf_to_boundary_points", "n_pts", n_pts, 1)
    dtype = compute_dtype(laf)
    angles = torch.linspace(0, 2 * math.pi, n_pts - 1, dtype=dtype, device=laf.device)
    promoted = as_dtype(laf, dtype)
    if laf.is_cpu and not is_compiling():
        return as_dtype(_outline_by_matmul(promoted, angles), laf.dtype)
    first, second, center = promoted[:, :, None].unbind(-1)  # a GPU would round the factors of products to TF32
    outline = center + first * angles.sin()[:, None] + second * angles.cos()[:, None]
    return as_dtype(torch.cat([center, outline], 2), laf.dtype)


@without_autocast_and_tf32
def _outline_by_matmul(laf: Tensor, angles: Tensor) -> Tensor:
    circle = torch.stack([angles.sin(), angles.cos(), torch.ones_like(angles)])
    points = torch.cat([circle.new_tensor([[0.0], [0.0], [1.0]]), circle], 1)
    return (laf @ points).mT.contiguous()  # one product for all frames


def get_laf_pts_to_draw(LAF: Tensor, img_idx: int = 0) -> tuple[list[list[float]], list[list[float]]]:
    """Get the outlines of an image's frames for matplotlib's plot. Waits for the GPU.

    Args:
        LAF: (B, N, 2, 3).
        img_idx: which image of the batch.

    Returns:
        The x and the y coordinates, each a list of 50 lists of N numbers: rows are points of the outlines, the center
        first.

    Raises:
        TypeCheckError: `LAF` is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> x, y = K.feature.laf.get_laf_pts_to_draw(torch.ones(1, 3, 2, 3))
        >>> len(x), len(x[0])
        (50, 3)
    """
    laf = check_lafs("get_laf_pts_to_draw", LAF, "LAF")
    x, y = laf_to_boundary_points(laf[img_idx : img_idx + 1])[0].detach().permute(2, 1, 0).cpu()
    return x.tolist(), y.tolist()


def laf_to_three_points(laf: Tensor) -> Tensor:
    """Convert frames to three points each.

    Args:
        laf: (B, N, 2, 3). Integers give float32.

    Returns:
        (B, N, 2, 3) whose columns are the ends of the axes, c + a1 and c + a2, and the center c.

    Raises:
        TypeCheckError: `laf` is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.laf_to_three_points(torch.tensor([[[[2.0, 0, 5], [0, 3, 7]]]]))
        tensor([[[[ 7.,  5.,  5.],
                  [ 7., 10.,  7.]]]])
    """
    laf = check_lafs("laf_to_three_points", laf)
    center = laf[..., 2:]
    return torch.cat([laf[..., :2] + center, center], -1)


def laf_from_three_points(threepts: Tensor) -> Tensor:
    """Convert three points each to frames, the inverse of `laf_to_three_points`.

    Args:
        threepts: (B, N, 2, 3). Integers give float32.

    Returns:
        (B, N, 2, 3).

    Raises:
        TypeCheckError: `threepts` is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.laf_from_three_points(torch.tensor([[[[7.0, 5, 5], [7, 10, 7]]]]))
        tensor([[[[2., 0., 5.],
                  [0., 3., 7.]]]])
    """
    points = check_lafs("laf_from_three_points", threepts, "threepts")
    center = points[..., 2:]
    return torch.cat([points[..., :2] - center, center], -1)


def laf_is_inside_image(laf: Tensor, images: Tensor, border: int = 0) -> Tensor:
    """Tell which frames have their whole ellipse inside of the image.

    Args:
        laf: (B, N, 2, 3).
        images: (B, C, H, W), for its size.
        border: pixels to stay away from the centers of the outermost pixels.

    Returns:
        Bools (B, N): `border` <= x <= W - 1 - `border` for all points of the ellipse, likewise y. An empty slot is the
        point (0, 0).

    Raises:
        TypeCheckError: an argument is not a tensor of real numbers, `border` not a number.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> laf = torch.tensor([[[[2.0, 0, 5], [0, 2, 7]], [[2, 0, 1], [0, 2, 7]]]])
        >>> K.feature.laf_is_inside_image(laf, torch.zeros(1, 1, 11, 21))
        tensor([[ True, False]])
    """
    laf = check_lafs("laf_is_inside_image", laf)
    _check.images("laf_is_inside_image", "images", images)
    room = _check.number("laf_is_inside_image", "border", border)
    height, width = images.shape[-2:]
    laf = as_dtype(laf, compute_dtype(laf))
    extent = torch.linalg.vector_norm(laf[..., :2], dim=-1)
    lowest, highest = laf[..., 2] - extent, laf[..., 2] + extent
    inside = (lowest >= room).all(-1) & (highest[..., 0] <= width - 1 - room)
    return inside & (highest[..., 1] <= height - 1 - room)


def perspective_transform_lafs(trans_01: Tensor, lafs_1: Tensor) -> Tensor:
    """Map frames by homographies: centers and ends of the axes are mapped as points.

    Args:
        trans_01: (B, 3, 3), from pixels of image 1 to those of image 0.
        lafs_1: frames of image 1, (B, N, 2, 3). Integers give float32.

    Returns:
        Frames of image 0, (B, N, 2, 3). A point whose w has a magnitude of at most 1e-8 is not divided.

    Raises:
        TypeCheckError: an argument is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> homography = torch.diag(torch.tensor([2.0, 4, 1]))[None]
        >>> K.feature.perspective_transform_lafs(homography, torch.tensor([[[[2.0, 0, 5], [0, 2, 7]]]]))
        tensor([[[[ 4.,  0., 10.],
                  [ 0.,  8., 28.]]]])
    """
    op = "perspective_transform_lafs"
    _check.shape(op, "trans_01", trans_01, "B", 3, 3)
    laf = check_lafs(op, lafs_1, "lafs_1")
    _check.same_device(op, trans_01=trans_01, lafs_1=lafs_1)
    if trans_01.shape[0] != laf.shape[0]:
        raise ShapeError(f"{op}: expected trans_01 of shape ({laf.shape[0]}, 3, 3), got {tuple(trans_01.shape)}")
    each = as_dtype(trans_01, laf.dtype)[:, None].expand(*laf.shape[:2], 3, 3)
    return _transform(each.reshape(-1, 3, 3), laf.reshape(-1, 2, 3)).reshape(laf.shape)


def _transform_reference(homography: Tensor, laf: Tensor) -> Tensor:
    center = laf[..., 2:]
    points = torch.cat([laf[..., :2] + center, center], -1).mT
    n = batch_of(homography, laf)
    mapped = transform_points(homography.expand(n, 3, 3), points.expand(n, 3, 2)).mT
    return torch.cat([mapped[..., :2] - mapped[..., 2:], mapped[..., 2:]], -1)


_transform = register_formula("perspective_transform_laf", _transform_reference, lambda *args: (2, 3))
