"""Points behind the camera: a mask of them, values as without it, and no gradient."""

import kornia
import pytest
import torch

import kvision as K
from op_tests import assert_close

G, C = K.geometry, K.geometry.camera
POINTS = torch.tensor([[1.0, 2, 4], [3, -1, 0], [1, 1, -2], [2, 1, 1e-9], [1, 0, 0.5]], dtype=torch.float64)
MASK = [True, False, False, False, True]
CAMERA = torch.tensor([[100.0, 0, 32], [0, 110, 24], [0, 0, 1]], dtype=torch.float64)
INTRINSICS = torch.eye(4, dtype=torch.float64)
INTRINSICS[:3, :3] = CAMERA


def pinhole(x: torch.Tensor, m: torch.Tensor, **options):
    size = torch.ones(1, device=x.device)
    turned = torch.diag(torch.tensor([-1.0, 1, -1, 1], dtype=x.dtype, device=x.device))[None]
    return G.PinholeCamera(m[None], turned, size, size).project(x * x.new_tensor([-1, 1, -1]), **options)


CALLS = {
    "project_points": (lambda x, m, **o: G.project_points(x, m, **o), POINTS, CAMERA, MASK),
    "project": (pinhole, POINTS, INTRINSICS, MASK),
    "project_points_z1": (lambda x, m, **o: C.project_points_z1(x, **o), POINTS, CAMERA, MASK),
    "depth_from_disparity": (
        lambda x, m, **o: G.depth_from_disparity(x, m[:1].reshape(()), 2.0, **o),
        torch.tensor([[4.0, 0, -2, 1]], dtype=torch.float64),
        torch.ones(1, dtype=torch.float64),
        [[True, False, False, True]],
    ),
    "distort_points_affine": (
        C.distort_points_affine,
        torch.tensor([[0.5, 1], [torch.inf, 1], [torch.nan, 0]], dtype=torch.float64),
        torch.tensor([100.0, 110, 32, 24], dtype=torch.float64),
        [True, False, False],
    ),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_mask_changes_gradients_alone(name, device):
    call, x, parameters, mask = CALLS[name]
    x, parameters = x.to(device), parameters.to(device)
    leaves = [x.clone().requires_grad_(), parameters.clone().requires_grad_()]
    values, valid = call(*leaves, return_valid=True)
    assert valid.dtype == torch.bool and valid.tolist() == mask and not valid.requires_grad
    assert_close(values.detach(), call(x, parameters))
    assert_close(call(x, parameters, return_valid=True)[0], values.detach())
    grads = torch.autograd.grad(values.sum(), leaves, allow_unused=True)
    assert not grads[0][~valid].any()
    kept = [x[valid][None].requires_grad_() if valid.dim() == 2 else x[valid].requires_grad_(), leaves[1]]
    alone = torch.autograd.grad(call(*kept).sum(), kept, allow_unused=True)
    assert_close(grads[0][valid], alone[0].reshape(grads[0][valid].shape))
    assert (grads[1] is None and alone[1] is None) or torch.allclose(grads[1], alone[1])


def test_values_are_those_of_kornia(device):
    """Also behind the camera, and with finite gradients."""
    x = POINTS.to(device).requires_grad_()
    result = G.project_points(x, CAMERA.to(device))
    assert_close(result.detach().cpu(), kornia.geometry.project_points(POINTS, CAMERA.expand(5, 3, 3)))
    assert torch.autograd.grad(result.sum(), x)[0].isfinite().all()


def test_masks_broadcast(device):
    x, m = torch.rand(5, 3, device=device), CAMERA.float().to(device).expand(4, 1, 3, 3)
    values, valid = G.project_points(x, m, return_valid=True)
    assert values.shape == (4, 5, 2) and valid.shape == (4, 5)
    with pytest.raises(TypeError, match="project_points: expected return_valid to be a bool"):
        G.project_points(x, m, return_valid=1)
