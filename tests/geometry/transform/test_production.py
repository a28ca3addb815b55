"""Tests of all geometric transforms on a GPU."""

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import on
from op_tests import does_not_wait
from point_op_tests import CUBE, SQUARE

G = K.geometry
QUAD = torch.tensor([[[1.3, 1.1], [5.2, 0.7], [4.9, 3.8], [0.9, 4.2]]])


def test_does_not_synchronize_with_the_device(device):
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


ANGLE, PAIR = torch.tensor([30.0]), torch.tensor([[1.5, 2.0]])
BOX, BOX3D = 2 * SQUARE[None].float(), 2 * CUBE[None].float()
LAUNCHES = {
    "rotate": (lambda x, a, p: K.geometry.rotate(x, a), 1),
    "rotate about": (lambda x, a, p: K.geometry.rotate(x, a, p), 1),
    "translate": (lambda x, a, p: K.geometry.translate(x, p), 1),
    "scale": (lambda x, a, p: K.geometry.scale(x, p), 1),
    "shear": (lambda x, a, p: K.geometry.shear(x, p), 1),
    "Affine": (lambda x, a, p: K.geometry.Affine(a, p, p, p, p)(x), 1),
    "crop_and_resize": (lambda x, a, p: K.geometry.crop_and_resize(x, on(x.device, BOX), (4, 5)), 1),
    "center_crop": (lambda x, a, p: K.geometry.center_crop(x, (4, 6)), 1),
    "rotate3d": (lambda x, a, p: K.geometry.rotate3d(x[None], a, a, a), 1),
    "crop_and_resize3d": (lambda x, a, p: K.geometry.crop_and_resize3d(x[None], on(x.device, BOX3D), (4, 5, 6)), 1),
    "center_crop3d": (lambda x, a, p: K.geometry.center_crop3d(x[None], (2, 4, 6)), 1),
    "get_affine_matrix2d": (lambda x, a, p: K.geometry.get_affine_matrix2d(p, p, p, a, a, a), 1),
    "get_perspective_transform": (lambda x, a, p: K.geometry.get_perspective_transform(x[0, :, :4, :2], x[0, :, 4:8, :2]), 3),
    "rotation_matrix_to_axis_angle": (lambda x, a, p: K.geometry.rotation_matrix_to_axis_angle(x[0, :, :3, :3]), 2),
}  # fmt: skip


@pytest.mark.parametrize("call", LAUNCHES)
def test_launches(call, device, backend):
    """A transform of images makes its matrix while it warps; parts of larger tensors are copied together first."""
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    from torch.utils._python_dispatch import TorchDispatchMode

    launched = []

    class Recorder(TorchDispatchMode):
        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            result = func(*args, **(kwargs or {}))
            values = result if isinstance(result, (tuple, list)) else [result]
            inputs = [a.untyped_storage().data_ptr() for a in args if isinstance(a, Tensor)]
            if any(v.numel() and v.untyped_storage().data_ptr() not in inputs for v in values):
                launched.append(str(func))
            return result

    f, most = LAUNCHES[call]
    given = [x.to(device) for x in (torch.rand(1, 3, 9, 9), ANGLE, PAIR)]
    f(*given)
    with Recorder():
        f(*given)
    assert len(launched) <= most, launched
