"""Cameras as objects: Kornia's, and what a batch of cameras does."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.geometry.vector import Vector2, Vector3
from kvision.sensors import camera as C
from op_tests import assert_close

SIZE = K.image.ImageSize(480, 640)
PARAMS = {
    "PINHOLE": [328.0, 330, 320, 240],
    "BROWN_CONRADY": [328.0, 330, 320, 240, -0.1, 0.02, 1e-3, -2e-3, 1e-3, 0.01, 0, 0],
    "KANNALA_BRANDT_K3": [328.0, 330, 320, 240, 0.05, -0.01, 1e-3, 0],
    "ORTHOGRAPHIC": [328.0, 330, 320, 240],
}
KINDS = list(PARAMS)


def rand(*shape: int) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) - 0.5


def params_of(kind: str, cameras: int = 0, device: Any = "cpu") -> Tensor:
    params = torch.tensor(PARAMS[kind], dtype=torch.float64, device=device)
    return params * torch.linspace(1.0, 1.2, cameras, device=device).double()[:, None] if cameras else params


@pytest.mark.parametrize("kind", KINDS)
def test_equals_kornia(kind: str) -> None:
    theirs = pytest.importorskip("kornia.sensors.camera")
    vectors = pytest.importorskip("kornia.geometry.vector")
    size = pytest.importorskip("kornia.image").ImageSize(480, 640)
    for shape, cameras in (((3,), 0), ((5, 3), 0), ((2, 5, 3), 0), ((4, 3), 4)):
        points = rand(*shape) + torch.tensor([0.0, 0, 2])
        params = params_of(kind, cameras)
        ours = C.CameraModel(SIZE, C.CameraModelType[kind], params)
        his = theirs.CameraModel(size, theirs.CameraModelType[kind], params)
        pixels = ours.project(Vector3(points)).data
        assert_close(pixels, his.project(vectors.Vector3(points)).data, 1e-9, 1e-9)
        back = ours.unproject(Vector2(pixels), points[..., 2]).data
        # Kornia's inverses of lenses are steps of an iteration.
        tolerance = 1e-9 if kind in ("PINHOLE", "ORTHOGRAPHIC") else 1e-3
        assert_close(back, his.unproject(vectors.Vector2(pixels), points[..., 2]).data, tolerance, tolerance)
        assert_close(ours.matrix(), his.matrix())
        assert_close(ours.K(), his.K())
        assert (ours.height, ours.width) == (his.height, his.width)


@pytest.mark.parametrize("kind", KINDS)
def test_points_of_a_batch_belong_to_its_cameras(kind: str, device: torch.device) -> None:
    params = params_of(kind, 3, device)
    model = C.CameraModel(SIZE, C.CameraModelType[kind], params)
    for shape in ((3, 3), (3, 1, 3), (3, 3, 3), (3, 2, 4, 3)):
        points = rand(*shape).to(device) + torch.tensor([0.0, 0, 2], device=device)
        each = [C.CameraModel(SIZE, C.CameraModelType[kind], p) for p in params]
        pixels = model.project(Vector3(points)).data
        assert_close(pixels, torch.stack([m.project(Vector3(x)).data for m, x in zip(each, points)]), 1e-12, 1e-12)
        depth = points[..., 2]
        assert_close(model.unproject(Vector2(pixels), depth).data, points, 1e-5, 1e-5)
        back = torch.stack([m.unproject(Vector2(x), d).data for m, x, d in zip(each, pixels, depth)])
        assert_close(model.unproject(Vector2(pixels), depth).data, back, 1e-12, 1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_gradients(kind: str) -> None:
    params, points = params_of(kind, 2).requires_grad_(), (rand(2, 3) + torch.tensor([0.0, 0, 2])).requires_grad_()

    def there_and_half_back(params: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
        model = C.CameraModel(SIZE, C.CameraModelType[kind], params)
        pixels = model.project(Vector3(points))
        return pixels.data, model.unproject(pixels, 0.5 * points[:, 2]).data

    assert torch.autograd.gradcheck(there_and_half_back, (params, points), eps=1e-6, atol=1e-3, rtol=1e-4)


def test_scale() -> None:
    model = C.PinholeModel(SIZE, params_of("PINHOLE"))
    half = model.scale(0.5)
    assert half.params.tolist() == [164, 165, 160, 120] and half.image_size == K.image.ImageSize(240, 320)
    assert model.scale(0.5, pixel_centers=True).params.tolist() == [164, 165, 159.75, 119.75]
    factor = torch.tensor(2.0, dtype=torch.float64, requires_grad=True)
    model.scale(factor).params.sum().backward()
    assert factor.grad is not None and factor.grad.item() == sum(PARAMS["PINHOLE"])


def test_copies_and_text() -> None:
    import copy
    import pickle

    model = C.CameraModel(SIZE, C.CameraModelType.PINHOLE, torch.tensor([1.0, 2, 3, 4]))
    for again in (copy.deepcopy(model), pickle.loads(pickle.dumps(model))):
        assert repr(again) == repr(model)
    assert repr(model) == "CameraModel(ImageSize(height=480, width=640), PinholeModel, tensor([1., 2., 3., 4.]))"


def test_errors() -> None:
    with pytest.raises(
        ValueError, match=r"BrownConradyModel: expected params .* n one of 8, 9, 12, 16, 18, got \(10,\)"
    ):
        C.BrownConradyModel(SIZE, torch.rand(10))
    with pytest.raises(ValueError, match=r"PinholeModel: expected params of shape \(4,\) or \(B, 4\), got \(2, 1, 4\)"):
        C.PinholeModel(SIZE, torch.rand(2, 1, 4))
    with pytest.raises(TypeError, match="PinholeModel: expected image_size to be an ImageSize, got tuple"):
        C.PinholeModel((480, 640), torch.rand(4))
    with pytest.raises(TypeError, match="CameraModel: expected model_type to be a CameraModelType, got str"):
        C.CameraModel(SIZE, "PINHOLE", torch.rand(4))
    model = C.PinholeModel(SIZE, torch.rand(4))
    with pytest.raises(TypeError, match="Z1Projection.project: expected points to be a Vector3, got Tensor"):
        model.project(torch.rand(3))
    with pytest.raises(ValueError, match="unproject: expected leading axes that broadcast, got"):
        model.unproject(Vector2(torch.rand(5, 2)), torch.rand(4))
    with pytest.raises(ValueError, match="expected leading axes that broadcast"):
        C.PinholeModel(SIZE, torch.rand(2, 4)).project(Vector3(torch.rand(3, 5, 3)))
