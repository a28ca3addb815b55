"""Pyramids."""

import pytest
import torch

import kvision as K
from kvision._modes import BORDER
from kvision.geometry.transform.pyramid import _detail
from op_tests import assert_close
from point_op_tests import Call, PointOpTests, vector
from warp_tests import ResizeTests

G = K.geometry


class TestPyrdown(ResizeTests):
    function = staticmethod(G.pyrdown)
    module = G.PyrDown
    max_size = 7
    small = (1, 2, 4, 6)
    variants = [
        {},
        {"border_type": "replicate", "align_corners": True, "factor": 1.4},
        {"border_type": "constant", "factor": 0.7},
    ]
    errors = [
        ({"border_type": "wrap"}, ValueError, "border_type must be one of"),
        ({"factor": 99.0}, ValueError, "expected factor to leave a pixel"),
        ({"align_corners": None}, TypeError, "align_corners to be a bool"),
    ]


class TestPyrup(ResizeTests):
    function = staticmethod(G.pyrup)
    module = G.PyrUp
    max_size = 7
    variants = [{}, {"border_type": "replicate", "align_corners": True}, {"border_type": "constant"}]
    errors = [({"border_type": "wrap"}, ValueError, "border_type must be one of")]


@pytest.mark.parametrize("border", ["reflect", "constant", "replicate", "circular"])
def test_pyramids_are_a_blur_and_a_resize(border, device):
    x = torch.rand(2, 3, 15, 18, dtype=torch.float64, device=device)
    kernel = torch.tensor([[1.0, 4, 6, 4, 1]], dtype=torch.float64, device=device) / 16

    def blur(x):
        return K.filters.filter2d_separable(x, kernel, kernel, border)

    for align_corners in (False, True):
        down = G.resize(blur(x), (7, 9), align_corners=align_corners)
        assert_close(G.pyrdown(x, border, align_corners), down, 1e-12, 1e-12)
        up = blur(G.resize(x, (30, 36), align_corners=align_corners))
        assert_close(G.pyrup(x, border, align_corners), up, 1e-12, 1e-12)


@pytest.mark.parametrize("border", ["reflect", "constant", "replicate"])
@pytest.mark.parametrize("size", [(5, 7), (24, 136)], ids=str)
def test_details_are_differences(size, border, device, backend):
    options = (False, BORDER[border])
    smaller = torch.rand(2, 3, *size, device=device)
    image = torch.rand(2, 3, *(2 * n for n in size), device=device)
    for dtype in (torch.float32, torch.float64, torch.float16, torch.bfloat16):
        a, b = smaller.to(dtype), image.to(dtype)
        expected = b.float() - G.pyrup(a.float(), border)
        for layout in (torch.contiguous_format, torch.channels_last):
            result = _detail(a.contiguous(memory_format=layout), b, *options)
            rounded = {torch.float16: 1e-3, torch.bfloat16: 8e-3}.get(dtype, 1e-6)
            assert result.dtype == dtype and (result.float() - expected).abs().max() <= rounded
        assert_close(_detail(a, b.mT.contiguous().mT, *options), _detail(a, b, *options), 0, 0)
        moved = torch.empty(b.numel() + 1, dtype=dtype, device=device)[1:].view(b.shape).copy_(b)
        assert_close(
            _detail(a, moved, *options),
            _detail(a, b, *options),
            0,
            1e-2 if dtype == torch.bfloat16 else 2e-3 if dtype == torch.float16 else 2e-6,
        )
    if size != (5, 7):
        return  # derivatives and transforms are of a part of the images
    a, b = (x[:1, :1, :4, :6].double().requires_grad_() for x in (smaller[..., :2, :3], image))
    assert torch.autograd.gradcheck(lambda a, b: _detail(a, b, *options), (a, b))
    assert torch.autograd.gradgradcheck(lambda a, b: _detail(a, b, *options), (a, b))
    each = torch.func.vmap(lambda a, b: _detail(a[None], b[None], *options)[0])(smaller, image)
    assert_close(each, _detail(smaller, image, *options))
    if backend != "reference":
        torch.library.opcheck(torch.ops.kvision.pyramid_detail.default, (a, b, *options))
        with pytest.raises(RuntimeError, match="^pyramid_detail: image differs"):
            torch.ops.kvision.pyramid_detail(smaller, image[..., 1:], *options)


def test_a_pyramid_of_a_constant_is_constant(device):
    x = torch.full((1, 1, 64, 48), 0.37, device=device)
    for level in G.build_pyramid(x, 4):
        assert_close(level, torch.full_like(level, 0.37))
    for detail in G.build_laplacian_pyramid(x, 3)[:-1]:
        assert detail.abs().max() < 1e-6


@pytest.mark.tracing
@pytest.mark.slow
def test_one_laplacian_pyramid_serves_images_that_are_padded_and_others(device):
    class Pyramid(torch.nn.Module):
        def forward(self, x):
            return G.build_laplacian_pyramid(x, 3)

    x = torch.rand(7, 6, 22, 38, device=device)  # padded to 32 x 64
    program = torch.export.export(Pyramid(), (x,), dynamic_shapes=((torch.export.Dim.AUTO,) * 4,)).module()
    for size in ((34, 52), (36, 44), (33, 35), (64, 52), (64, 128)):  # padded, but for the last two
        other = torch.rand(2, 5, *size, device=device)
        for result, expected in zip(program(other), Pyramid()(other), strict=True):
            assert_close(result, expected)


@pytest.mark.tracing
def test_compiled_laplacian_pyramid_of_one_size(device):
    x = torch.rand(1, 1, 8, 10, device=device)  # padded
    torch._dynamo.reset()
    compiled = torch.compile(lambda x: G.build_laplacian_pyramid(x, 2), backend="eager", fullgraph=True)
    assert_close(compiled(x), G.build_laplacian_pyramid(x, 2))


IMAGE = torch.rand(1, 2, 5, 6, generator=torch.Generator().manual_seed(1)).double()
FUNCTIONS = {
    "pyrdown": (G.pyrdown, (IMAGE,)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_gradients(name, device):
    function, args = FUNCTIONS[name]
    args = tuple(a.double().to(device).requires_grad_() for a in args)
    assert torch.autograd.gradcheck(function, args, nondet_tol=1e-9)
    assert torch.autograd.gradgradcheck(function, args, nondet_tol=1e-9)


X, V = torch.rand(2, 3, 4, 5), torch.rand(1, 1, 3, 4, 5)
BAD = [
    (lambda: G.pyrdown(X[0]), ValueError, r"pyrdown: expected input of shape \(B, C, H, W\)"),
    (lambda: G.build_pyramid(X, 0), ValueError, "build_pyramid: expected max_level"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


class TestPyramidOperators(PointOpTests):
    calls = {
        "pyramid_detail": [
            Call(
                (vector(3, 4, 5), vector(3, 8, 10)),
                (False, BORDER["reflect"]),
                broadcasts=False,
                accepted=("around a pixel",),
            )
        ],
    }
