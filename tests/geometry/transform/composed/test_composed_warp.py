"""Chains of matrices and maps as one warp."""

from __future__ import annotations

from typing import Any

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from kvision._modes import INTERPOLATION, PADDING
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.geometry.transform.composed.composed_warp import MAX_LINKS, composed_coords, composed_warp, link_arguments
from op_tests import OpTests, assert_close


def checked(op: str, input: Any) -> Tensor:
    """The checks that callers make."""
    if not isinstance(input, Tensor) or input.is_complex():
        raise TypeCheckError(f"{op}: expected images")
    if input.dim() != 4 or 0 in input.shape[2:]:
        raise ShapeError(f"{op}: expected images of shape (B, C, H, W)")
    return input if input.is_floating_point() or input.dtype == torch.uint8 else input.float()


def links_of(input: Tensor, links: dict[str, Tensor], size: tuple[int, int]) -> list[Tensor | None]:
    return link_arguments([link.to(input.device) for link in links.values()], size)


def warp_by_links(input, size, mode="bilinear", padding="fill", align_corners=True, fill=None, **links):
    x = checked("warp_by_links", input)
    return composed_warp(
        x, *links_of(x, links, size), fill, list(size), INTERPOLATION[mode], PADDING[padding], align_corners
    )


def homographies(x: Tensor) -> Tensor:
    torch.manual_seed(1)
    change = torch.randn(x.shape[0], 3, 3, dtype=torch.float64)
    return torch.eye(3, dtype=torch.float64) + change * torch.tensor([[0.1, 0.1, 1], [0.1, 0.1, 1], [1e-3, 1e-3, 0.01]])


def shifts(x: Tensor) -> Tensor:
    return homographies(x)[:1] * torch.tensor([[1.0, 0, 1], [0, 1, 1], [0, 0, 0]]) + torch.diag(
        torch.tensor([0, 0, 1.0])
    )


def displacements(x: Tensor) -> Tensor:
    torch.manual_seed(2)
    return torch.randn(x.shape[0], 2, *x.shape[-2:], dtype=torch.float64)


def whole_shifts(x: Tensor) -> Tensor:
    return torch.tensor([[[1.0, 0, 1], [0, 1, -2], [0, 0, 1]]], dtype=torch.float64).repeat(x.shape[0], 1, 1)


def uneven_displacements(x: Tensor) -> Tensor:
    """Not to the middle of two pixels, which is wider in float32 than in float64."""
    return (64 * displacements(x)).floor() / 64 + 1 / 128


def small_map(x: Tensor) -> Tensor:
    torch.manual_seed(3)
    return torch.randn(1, 2, 4, 1, dtype=torch.float64)


class TestComposedWarp(OpTests):
    function = staticmethod(warp_by_links)
    operators = (
        "composed_warp",
        "composed_coords",
        "composed_coords_backward",
        "remap",
        "remap_image_backward",
        "remap_map_backward",
    )
    bytes = True
    max_size = 17
    shape = (3, 3, 13, 18)
    small = (2, 2, 4, 5)
    # Images and maps may have any sizes.
    accepted = tuple(
        f"{name} {change}"
        for name in ("image", *"abcdefgh", "grad")
        for change in ("cut along axis -1", "cut along axis -2")
    )
    variants = [
        {"a": homographies, "b": displacements, "c": shifts, "size": (9, 11)},
        {"a": displacements, "size": (13, 18), "padding": "border"},
        {"a": small_map, "b": displacements, "c": homographies, "size": (7, 20), "padding": "reflection"},
        {"a": homographies, "b": small_map, "size": (7, 20), "fill": lambda x: torch.tensor([[0.3]])},
        {"a": homographies, "b": displacements, "c": homographies, "size": (9, 11), "mode": "bicubic"},
        {"a": whole_shifts, "b": uneven_displacements, "size": (15, 11), "mode": "nearest"},
    ]
    tolerances = {torch.float32: (1e-4, 1e-4), torch.uint8: (0, 1)}  # coordinates are float numbers

    @pytest.fixture(autouse=True)
    def same_bits_where_asked(self, device, request):
        """On CUDA gradients are sums by atomics, unless torch is set to deterministic algorithms."""
        asks = request.function.__name__ in ("test_threads_and_runs_give_the_same_bits", "test_gradcheck")
        torch.use_deterministic_algorithms(device.type == "cuda" and asks, warn_only=True)
        yield
        torch.use_deterministic_algorithms(False)


def in_float64(links: list[Tensor], size: tuple[int, int]) -> Tensor:
    """The coordinates by torch's grid_sample and inverse, link by link."""
    rows, columns = (torch.arange(n, dtype=torch.float64) for n in size)
    points = torch.stack([columns.expand(*size), rows[:, None].expand(*size)], -1).expand(links[0].shape[0], -1, -1, -1)
    for link in reversed(links):
        link = link.double().cpu()
        if link.dim() == 3:
            back = torch.cat([points, torch.ones_like(points[..., :1])], -1) @ torch.linalg.inv(link).mT[:, None]
            points = back[..., :2] / back[..., 2:]
        else:
            half = (torch.tensor([link.shape[3], link.shape[2]], dtype=torch.float64) - 1) / 2
            read = F.grid_sample(link, points / half - 1, padding_mode="border", align_corners=True)
            points = points + read.movedim(1, -1)
    return points.movedim(-1, 1)


@pytest.mark.parametrize("count", [1, 3, MAX_LINKS, MAX_LINKS + 1, 2 * MAX_LINKS + 3])
def test_coordinates_of_chains_of_any_length(count: int, device: torch.device) -> None:
    x = torch.empty(2, 1, 40, 33)
    links = [(0.3 * displacements(x) if i % 2 else homographies(x)).float().to(device) for i in range(count)]
    coords = composed_coords(*link_arguments(links, (21, 30)), [21, 30])
    torch.testing.assert_close(coords.cpu().double(), in_float64(links, (21, 30)), atol=1e-3, rtol=1e-4)


def test_links_that_change_nothing(device: torch.device) -> None:
    """Identity matrices and zero displacements keep all bits of the image."""
    x = torch.rand(2, 3, 70, 45, device=device)
    links = torch.eye(3, device=device)[None], torch.zeros(2, 2, 70, 45, device=device)
    for mode in ("nearest", "bilinear"):
        assert torch.equal(warp_by_links(x, (70, 45), mode, a=links[0], b=links[1], c=links[0]), x)


def test_gradients_of_a_large_result(device: torch.device) -> None:
    """Gradients of all links, for results of more pixels than one block of threads processes."""
    torch.manual_seed(0)
    x = torch.empty(2, 1, 90, 80)
    links = [homographies(x), displacements(x), homographies(x)[:1]]
    weights = torch.rand(2, 2, 101, 97, dtype=torch.float64)
    expected = torch.autograd.grad((in_float64([k.requires_grad_() for k in links], (101, 97)) * weights).sum(), links)
    for dtype, rtol in ((torch.float64, 1e-9), (torch.float32, 1e-3)):
        own = [link.detach().to(dtype).to(device).requires_grad_() for link in links]
        coords = composed_coords(*link_arguments(own, (101, 97)), [101, 97])
        for a, e in zip(torch.autograd.grad((coords * weights.to(coords)).sum(), own), expected):
            assert_close(a.cpu().double(), e, rtol, rtol * float(e.abs().max()))
