"""Points, lines, rectangles and convex polygons, drawn into an image in place.

Pixel (x, y) covers [x - 0.5, x + 0.5) by [y - 0.5, y + 0.5): coordinates are rounded to the nearest pixel, halves up.
Coordinates and colors may be on another device than the image. The coordinates of points, lines and rectangles are
read on the host, all at once, since they decide how many pixels are written; a polygon's stay on the device.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._constants import on_device
from kvision._torch_compat import largest
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

__all__ = ["draw_convex_polygon", "draw_line", "draw_point2d", "draw_rectangle"]


def draw_point2d(image: Tensor, points: Tensor, color: Any) -> Tensor:
    """Set pixels of `image`, in place, to a color.

    Args:
        image: (C, H, W) or (H, W).
        points: (N, 2) or (2,), as (x, y).
        color: (C,), or one value for all channels.

    Returns:
        `image`.

    Raises:
        TypeCheckError: `image` or `points` is not a tensor.
        ShapeError: `image`, `points` or `color` has another shape.
        ValueCheckError: a point lies outside the image.

    Example:
        >>> import torch, kvision as K
        >>> K.image.draw_point2d(torch.zeros(2, 3), torch.tensor([[2, 0], [1, 1]]), 7)
        tensor([[0., 0., 7.],
                [0., 7., 0.]])
    """
    _check.numbers("draw_point2d", "image", image)
    if image.dim() not in (2, 3):
        raise ShapeError(
            f"draw_point2d: expected image of shape (C, H, W) or (H, W), got {tuple(image.shape)}",
            actual_shape=image.shape,
        )
    planes = image if image.dim() == 3 else image[None]
    colors = _colors("draw_point2d", "color", color, planes)
    _plot(planes, _points("draw_point2d", "points", points, planes), colors)
    return image


def draw_line(image: Tensor, p1: Tensor, p2: Tensor, color: Any) -> Tensor:
    """Draw straight lines into `image`, in place: one pixel a step along the longer axis, both ends included.

    Args:
        image: (C, H, W).
        p1: the starts, (N, 2) or (2,), as (x, y).
        p2: the ends, in the shape of `p1`. Swapping both gives the same pixels.
        color: (C,), or one value for all channels.

    Returns:
        `image`.

    Raises:
        TypeCheckError: `image`, `p1` or `p2` is not a tensor.
        ShapeError: `image`, `p1`, `p2` or `color` has another shape.
        ValueCheckError: an end lies outside the image.

    Example:
        >>> import torch, kvision as K
        >>> K.image.draw_line(torch.zeros(1, 3, 5), torch.tensor([0, 0]), torch.tensor([4, 2]), 1)
        tensor([[[1., 0., 0., 0., 0.],
                 [0., 1., 1., 0., 0.],
                 [0., 0., 0., 1., 1.]]])
    """
    _check.shape("draw_line", "image", image, "C", "H", "W")
    colors = _colors("draw_line", "color", color, image)
    start, end = _points("draw_line", "p1", p1, image), _points("draw_line", "p2", p2, image)
    if p1.shape != p2.shape:
        raise ShapeError(
            f"draw_line: expected p2 of the shape of p1, {tuple(p1.shape)}, got {tuple(p2.shape)}",
            actual_shape=p2.shape,
            expected_shape=p1.shape,
        )
    delta = end - start
    steps = delta.abs().amax(1)
    # Shorter lines repeat their end. In a graph, which has no values, all are as long as the longest possible one.
    is_readable = _check.values_are_readable(steps)
    count = int(steps.amax()) + 1 if is_readable and len(steps) else largest(*image.shape[1:])
    t = torch.minimum(torch.arange(count, device=steps.device), steps[:, None])[..., None]
    # start + t * delta / n, rounded half up in integers: float steps would round an exact half either way.
    n = steps.clamp_min(1)[:, None, None]
    pixels = start[:, None] + (2 * t * delta[:, None] + n).div(2 * n, rounding_mode="floor")
    _plot(image, pixels.flatten(0, 1), colors)
    return image


def draw_rectangle(
    image: Tensor, rectangle: Tensor, color: Any = None, fill: bool | None = None, line_width: int = 1
) -> Tensor:
    """Draw upright rectangles into the images, in place; what lies outside an image is cut off.

    Args:
        image: (B, C, H, W).
        rectangle: (B, N, 4): two opposite corners (x1, y1, x2, y2), both of which belong to the rectangle. Later
            rectangles cover earlier ones.
        color: (B, N, C), (B, N, 1), (C,) or one value for all; black by default.
        fill: fill the rectangles instead of outlining them.
        line_width: thickness of the outline in pixels; it grows inwards.

    Returns:
        `image`.

    Raises:
        TypeCheckError: `image` or `rectangle` is not a tensor.
        ShapeError: `image`, `rectangle` or `color` has another shape.
        ValueCheckError: `line_width` is not a positive int, or a coordinate is NaN.

    Example:
        >>> import torch, kvision as K
        >>> K.image.draw_rectangle(torch.zeros(1, 1, 3, 5), torch.tensor([[[1, 0, 3, 2]]]), 1)[0, 0]
        tensor([[0., 1., 1., 1., 0.],
                [0., 1., 0., 1., 0.],
                [0., 1., 1., 1., 0.]])
    """
    _check.shape("draw_rectangle", "image", image, "B", "C", "H", "W")
    _check.shape("draw_rectangle", "rectangle", rectangle, image.shape[0], "N", 4)
    line_width = _check.scalar("draw_rectangle", "line_width", line_width)
    if not _check.is_int(line_width) or line_width < 1:
        raise ValueCheckError(
            f"draw_rectangle: expected line_width to be an int of at least 1, got {line_width!r}",
            actual_value=line_width,
        )
    colors = _colors("draw_rectangle", "color", 0 if color is None else color, image, rectangle.shape[:2])
    fill = _check.switch("draw_rectangle", "fill", fill)
    corners = _nearest_pixels("draw_rectangle", "rectangle", rectangle)
    if not _check.values_are_readable(corners):
        return image.copy_(_with_rectangles(image, corners.to(image.device), colors, None if fill else line_width))
    for b, boxes in enumerate(corners.tolist()):
        for n, (xa, ya, xb, yb) in enumerate(boxes):
            left, right, top, bottom = min(xa, xb), max(xa, xb) + 1, min(ya, yb), max(ya, yb) + 1
            if fill:
                bands = [(top, bottom, left, right)]
            else:
                bands = [
                    (top, min(top + line_width, bottom), left, right),
                    (max(bottom - line_width, top), bottom, left, right),
                    (top, bottom, left, min(left + line_width, right)),
                    (top, bottom, max(right - line_width, left), right),
                ]
            for y0, y1, x0, x1 in bands:
                image[b, :, max(y0, 0) : max(y1, 0), max(x0, 0) : max(x1, 0)] = colors[b, n, :, None, None]
    return image


def _with_rectangles(image: Tensor, corners: Tensor, colors: Tensor, line_width: int | None) -> Tensor:
    """`image` with rectangles whose values are not known: for each pixel the color of the last one that covers it."""
    if corners.shape[1] == 0:
        return image
    (left, top), (right, bottom) = (extreme.unbind(2) for extreme in corners.unflatten(2, (2, 2)).aminmax(dim=2))
    is_inside, is_inner = [], []
    for first, last, size in ((left, right, image.shape[3]), (top, bottom, image.shape[2])):
        at = torch.arange(size, device=image.device)
        first, last = first[..., None], last[..., None]
        is_inside.append((first <= at) & (at <= last))
        is_inner.append((first + (line_width or 0) <= at) & (at <= last - (line_width or 0)))
    is_drawn, is_empty = (x[:, :, None] & y[..., None] for x, y in (is_inside, is_inner))
    if line_width is not None:
        is_drawn = is_drawn & ~is_empty
    number = torch.arange(corners.shape[1], device=image.device)[:, None, None]
    covering = torch.where(is_drawn, number, -1).amax(1)  # (B, H, W)
    batch = torch.arange(image.shape[0], device=image.device)[:, None, None]
    return torch.where(covering[:, None] >= 0, colors[batch, covering.clamp(min=0)].movedim(-1, 1), image)


def draw_convex_polygon(images: Tensor, polygons: Tensor | Sequence[Tensor], colors: Any) -> Tensor:
    """Fill one convex polygon in each image, in place; what lies outside an image is cut off.

    A pixel is filled when its center is inside the polygon or on its outline; vertices are not rounded. Each row is
    filled from its leftmost to its rightmost crossing with the outline, which closes the gaps of a concave polygon.

    Args:
        images: (B, C, H, W).
        polygons: (B, K, 2), as (x, y), in either sense of rotation; or a list of B tensors (K_i, 2), where one
            without vertices draws nothing.
        colors: (B, C), (B, 1), (C,) or one value for all.

    Returns:
        `images`.

    Raises:
        TypeCheckError: `images` is not a tensor, or `polygons` no tensor and no list of them.
        ShapeError: `images`, `polygons` or `colors` has another shape.

    Example:
        >>> import torch, kvision as K
        >>> triangle = torch.tensor([[[0, 0], [4, 0], [0, 2]]])
        >>> K.image.draw_convex_polygon(torch.zeros(1, 1, 3, 5), triangle, 1)[0, 0]
        tensor([[1., 1., 1., 1., 1.],
                [1., 1., 1., 0., 0.],
                [1., 0., 0., 0., 0.]])
    """
    op = "draw_convex_polygon"
    _check.shape(op, "images", images, "B", "C", "H", "W")
    vertices = _vertices(op, polygons, images)[:, None]  # (B, 1, K, 2)
    values = _colors(op, "colors", colors, images, images.shape[:1])
    if 0 in vertices.shape:
        return images
    x0, y0 = vertices.unbind(-1)
    x1, y1 = vertices.roll(-1, 2).unbind(-1)
    # The x at which the edge from (x0, y0) to (x1, y1) crosses each row: (B, H, K). A horizontal edge adds its start;
    # its end is the start of the next one. Dividing last keeps a crossing exact that falls on a pixel's center.
    y = torch.arange(images.shape[2], device=images.device, dtype=vertices.dtype)[:, None]
    crossing = x0 + (y - y0) * (x1 - x0) / torch.where(y0 == y1, 1, y1 - y0)
    reached = (torch.minimum(y0, y1) <= y) & (y <= torch.maximum(y0, y1))
    left = torch.where(reached, crossing, torch.inf).amin(2, keepdim=True)
    right = torch.where(reached, crossing, -torch.inf).amax(2, keepdim=True)
    x = torch.arange(images.shape[3], device=images.device, dtype=vertices.dtype)
    inside = (left <= x) & (x <= right)
    return images.copy_(torch.where(inside[:, None], values[:, :, None, None], images))


def _vertices(op: str, polygons: Any, images: Tensor) -> Tensor:
    """`polygons` as one floating-point tensor (B, K, 2) on the device of `images`.

    Shorter polygons of a list repeat their last vertex. A polygon without vertices becomes NaN, which no row crosses.
    """
    if isinstance(polygons, (list, tuple)):
        for i, polygon in enumerate(polygons):
            _check.shape(op, f"polygons[{i}]", polygon, "K", 2)
        k = max(map(len, polygons), default=0)
        none = torch.full((1, 2), torch.nan, device=images.device)
        padded = [torch.cat((p, (p[-1:] if len(p) else none).expand(k - len(p), 2))) for p in polygons]
        polygons = torch.stack(padded) if padded else images.new_empty(0, 0, 2)
    _check.shape(op, "polygons", polygons, images.shape[0], "K", 2)
    vertices: Tensor = polygons.to(images.device, torch.promote_types(polygons.dtype, torch.float32))
    return vertices


_FEW = 4  # pixels that are written one by one, which on a GPU takes less time than copying their indices to it


def _plot(image: Tensor, pixels: Tensor, color: Tensor) -> None:
    """Set the pixels (N, 2), as (x, y), of the image (C, H, W) to the color (C,)."""
    is_expanded = 0 in image.stride()  # to which torch assigns by indices alone
    if _check.values_are_readable(pixels) and len(pixels) <= _FEW and not is_expanded:
        for x, y in pixels.tolist():
            image[:, y, x] = color
        return
    x, y = on_device(pixels, image.device).unbind(1)
    image[:, y, x] = color[:, None]


def _points(op: str, name: str, points: Any, image: Tensor) -> Tensor:
    """`points`, (N, 2) or (2,), as pixels (N, 2) on the host, all of them inside the image."""
    _check.is_tensor(op, name, points)
    if points.dim() not in (1, 2) or points.shape[-1] != 2:
        raise ShapeError(
            f"{op}: expected {name} of shape (N, 2) or (2,), got {tuple(points.shape)}", actual_shape=points.shape
        )
    pixels = _nearest_pixels(op, name, points).reshape(-1, 2)
    height, width = image.shape[-2:]
    if not _check.values_are_readable(pixels):
        return pixels
    extremes = pixels if len(pixels) <= _FEW else torch.stack(torch.aminmax(pixels, dim=0))
    if not all(0 <= x < width and 0 <= y < height for x, y in extremes.tolist()):
        x, y = next((x, y) for x, y in pixels.tolist() if not (0 <= x < width and 0 <= y < height))
        raise ValueCheckError(
            f"{op}: expected {name} inside the image, x from 0 to {width - 1} and y from 0 to {height - 1}, "
            f"got ({x}, {y})",
            actual_value=(x, y),
        )
    return pixels


def _nearest_pixels(op: str, name: str, coordinates: Tensor) -> Tensor:
    """`coordinates` on the host, rounded to integers, halves up."""
    _check.numbers(op, name, coordinates)
    coordinates = coordinates.detach().cpu()
    if not coordinates.is_floating_point():
        return coordinates.long()
    if _check.values_are_readable(coordinates) and coordinates.isnan().any():
        raise ValueCheckError(f"{op}: expected {name} without NaN")
    coordinates = coordinates.to(torch.promote_types(coordinates.dtype, torch.float32))  # halves cannot hold x + 0.5
    return (coordinates + 0.5).floor().clamp(-(2**31), 2**31).long()  # the clamp keeps infinities in range


def _colors(op: str, name: str, color: Any, image: Tensor, items: Sequence[int] = ()) -> Tensor:
    """Expand `color`, one for each item, one color or one value, to (*items, C) in the image's dtype and device."""
    try:
        color = torch.as_tensor(color, device=image.device)
    except (TypeError, ValueError, RuntimeError) as error:
        raise TypeCheckError(
            f"{op}: expected {name} to be a Tensor or numbers, got {color!r}", actual_type=type(color)
        ) from error
    _check.numbers(op, name, color)
    shapes = [(), (1,), (image.shape[-3],), (*items, 1), (*items, image.shape[-3])]
    if not any(len(color.shape) == len(shape) and color.shape == shape for shape in shapes):
        listed = " or ".join(dict.fromkeys(map(str, shapes)))
        raise ShapeError(f"{op}: expected {name} of shape {listed}, got {tuple(color.shape)}", actual_shape=color.shape)
    return color.to(image).expand(*items, image.shape[-3])
