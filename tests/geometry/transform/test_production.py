"""What all geometric transforms have in common on a GPU."""

import pytest
import torch

import kvision as K
from op_tests import does_not_wait

G = K.geometry
QUAD = torch.tensor([[[1.3, 1.1], [5.2, 0.7], [4.9, 3.8], [0.9, 4.2]]])


def test_nothing_waits_for_the_device(device):
    """Small tensors are filled in where they are used, not copied there."""
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    x, v = torch.rand(1, 3, 12, 14, device=device), torch.rand(1, 1, 4, 5, 6, device=device)
    angle, box = torch.tensor([25.0], device=device), QUAD.to(device)
    M, box3d = torch.eye(3, device=device)[None], G.bbox_generator3d(*torch.ones(6, 1, device=device))
    noise = torch.zeros(1, 2, 12, 14, device=device)
    calls = (
        lambda: G.rotate(x, angle),
        lambda: G.warp_perspective(x, M, (5, 5), padding_mode="fill", fill_value=0.5),
        lambda: G.resize(x, (5, 20), antialias=True),
        lambda: G.build_laplacian_pyramid(x, 2),
        lambda: G.ScalePyramid(min_size=4)(x),
        lambda: G.crop_and_resize(x, box, (6, 6)),
        lambda: G.center_crop(x, (5, 8)),
        lambda: G.rot180(x),
        lambda: G.elastic_transform2d(x, noise, (3, 3), (1.0, 1.0)),
        lambda: G.rotate3d(v, angle, angle, angle),
        lambda: G.center_crop3d(v, (2, 3, 3)),
        lambda: G.crop_and_resize3d(v, box3d, (2, 2, 2)),
    )
    does_not_wait(device, calls)
