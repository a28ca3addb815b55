"""Color maps and their application to images."""

from __future__ import annotations

import math

import pytest
import torch

import kvision as K
from kvision.core.exceptions import DeviceError, ShapeError, TypeCheckError, ValueCheckError
from op_tests import assert_close, instruction_set
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, vector

C = K.color


@pytest.mark.parametrize("count", [1, 2, 32, 64, 256])
@pytest.mark.parametrize("name", C.ColorMapType.list())
def test_tables_are_kornias(name, count):
    kornia = pytest.importorskip("kornia")
    table = C.ColorMap(name, count, dtype=torch.float64)
    theirs = kornia.color.ColorMap(name, count, dtype=torch.float64)
    tolerance = 1e-4 if name == "pink" else 1e-6  # pink's own are rounded to four digits
    torch.testing.assert_close(table.colors, theirs.colors, rtol=0, atol=tolerance)
    assert len(table) == count and table.name == name
    assert torch.equal(C.ColorMap(C.ColorMapType[name], count, dtype=torch.float64).colors, table.colors)


def test_custom_colors():
    table = C.ColorMap([(0.0, 0.0, 0.0), (1.0, 0.5, 0)], num_colors=4)
    assert table.name == "custom" and table.colors.dtype == torch.float32
    assert table.colors.T.tolist() == [[0, 0, 0], [0.25, 0.125, 0], [0.75, 0.375, 0], [1, 0.5, 0]]


@pytest.mark.parametrize("count", [1, 2, 3, 64, 256])
def test_levels_are_kornias(count, device):
    kornia = pytest.importorskip("kornia")
    table, theirs = C.ColorMap("turbo", count, device=device), kornia.color.ColorMap("turbo", count, device=device)
    levels = torch.arange(256, dtype=torch.uint8, device=device).view(1, 1, 16, 16)
    for x in (levels, levels.int(), levels.float() / 255, levels.float(), torch.rand(2, 3, 5, 6, device=device)):
        assert_close(C.apply_colormap(x, table), kornia.color.apply_colormap(x, theirs), 0, 1e-6)


def test_levels_map_to_colors(device):
    """The first and the last color are for 0 and 1 alone."""
    table = C.ColorMap([[i / 4, 0, 0] for i in range(5)], 5, device=device)
    values = [-1, 0, 1e-6, 0.33, 0.34, 0.66, 0.67, 0.999, 1]
    shown = C.apply_colormap(torch.tensor(values, device=device).view(1, 1, -1), table)
    assert (shown[0, 0, 0] * 4).tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4]


def test_no_gradient_goes_to_the_image():
    table, x = C.ColorMap("jet"), torch.rand(1, 1, 4, 5, requires_grad=True)
    assert not C.apply_colormap(x, table).requires_grad
    table.colors.requires_grad_()
    assert C.apply_colormap(x, table).requires_grad


def test_range_is_decided_channel_by_channel(device):
    table = C.ColorMap("jet", device=device)
    x = torch.rand(2, 2, 4, 5, device=device)
    levels = x * torch.tensor([1.0, 255.0], device=device).view(1, 2, 1, 1)
    assert_close(
        C.apply_colormap(levels, table),
        C.apply_colormap(levels / levels.amax((2, 3), keepdim=True).ge(1).mul(254).add(1), table),
    )
    integers = torch.tensor([[[0, 1, 255, 300, -3]]], device=device)
    assert_close(C.apply_colormap(integers, table), C.apply_colormap((integers / 255).clamp(0, 1), table))


def test_nan_stays_in_its_pixel(device):
    table = C.ColorMap("hot", device=device)
    for scale in (1, 255):
        x = torch.rand(1, 2, 4, 5, device=device) * scale
        x[0, 1, 0, 0] = scale
        spoiled = x.clone()
        spoiled[0, 1, 2, 3] = math.nan
        expected = C.apply_colormap(x, table)
        expected[0, 3:, 2, 3] = math.nan
        assert_close(C.apply_colormap(spoiled, table), expected)


def test_shapes_types_and_gradients(device):
    table = C.ColorMap("viridis", 8, device=device, dtype=torch.float64)
    x = torch.rand(2, 3, 4, 5, device=device)
    y = C.apply_colormap(x, table)
    assert y.shape == (2, 9, 4, 5) and y.dtype == torch.float64
    assert_close(C.apply_colormap(x[0], table), y[:1])
    assert C.apply_colormap(x[:0], table).shape == (0, 9, 4, 5)
    assert C.apply_colormap(x[:, :0], table).shape == (2, 0, 4, 5)
    assert_close(torch.func.vmap(lambda s: C.apply_colormap(s, table))(x[:, None]), y[:, None])
    compiled = torch.compile(lambda s: C.apply_colormap(s, table), fullgraph=True, backend="aot_eager")
    assert_close(compiled(x), y)
    assert_close(C.apply_colormap(x.half(), table), C.apply_colormap(x.half().float(), table))
    table.colors.requires_grad_()
    C.apply_colormap(x, table).sum().backward()
    assert table.colors.grad.sum() == 9 * x[:, 0].numel()


def test_module(device):
    table = C.ColorMap("jet", 16)
    module = C.ApplyColorMap(table).to(device)
    x = torch.rand(2, 1, 4, 5, device=device)
    assert_close(module(x).cpu(), C.apply_colormap(x.cpu(), table))
    assert repr(module) == "ApplyColorMap(ColorMap('jet', num_colors=16))" and not module.state_dict()


def test_errors(device):
    table = C.ColorMap("jet", device=device)
    x = torch.rand(2, 3, 4, 5, device=device)
    for call, error, text in [
        (lambda: C.ColorMap("nojet"), ValueCheckError, "ColorMap: base must be one of autumn, bone, .*; got 'nojet'"),
        (lambda: C.ColorMap(3), TypeCheckError, "ColorMap: expected base"),
        (lambda: C.ColorMap([]), ValueCheckError, "ColorMap: expected base"),
        (lambda: C.ColorMap([(1, 2)]), ValueCheckError, "ColorMap: expected base"),
        (lambda: C.ColorMap([(1, 2, "3")]), TypeCheckError, "ColorMap: expected base"),
        (lambda: C.ColorMap("jet", 0), ValueCheckError, "ColorMap: expected num_colors"),
        (lambda: C.ColorMap("jet", 2.0), TypeCheckError, "ColorMap: expected num_colors"),
        (lambda: C.ColorMap("jet", dtype=torch.int32), TypeCheckError, "ColorMap: expected dtype"),
        (lambda: C.apply_colormap(None, table), TypeCheckError, "apply_colormap: expected input_tensor"),
        (lambda: C.apply_colormap(x[0, 0], table), ShapeError, "apply_colormap: expected input_tensor of shape"),
        (lambda: C.apply_colormap(x, "jet"), TypeCheckError, "apply_colormap: expected colormap"),
        (
            lambda: C.apply_colormap(x, C.ColorMap("jet", device="meta")),
            DeviceError,
            "apply_colormap: expected all tensors",
        ),
        (lambda: C.ApplyColorMap("jet"), TypeCheckError, "ApplyColorMap: expected colormap"),
    ]:
        with pytest.raises(error, match=f"^{text}"):
            call()


def test_vmap_over_tables(device):
    x = torch.rand(2, 3, 2, 4, 5, device=device)
    tables = torch.rand(2, 3, 7, device=device)

    def shown(x, colors):
        table = C.ColorMap("jet", 7)
        table.colors = colors
        return C.apply_colormap(x, table)

    assert_close(torch.func.vmap(shown)(x, tables), torch.stack([shown(*each) for each in zip(x, tables)]))


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_instruction_sets(isa, device, backend):
    if device.type != "cpu" or backend == "reference":
        pytest.skip("instruction sets are those of the CPU's kernels")
    x = torch.rand(2, 3, 7, 21) * 1.2 - 0.1
    x[0, 0, 0, :2] = torch.tensor([torch.nan, torch.inf])
    table = C.ColorMap("jet", 9)
    with K.backend("reference"):
        expected = C.apply_colormap(x, table)
    with instruction_set(isa):
        assert_close(C.apply_colormap(x, table), expected)


def test_operator(device, backend):
    if backend == "reference":
        pytest.skip("of the kernels")
    x, white = torch.rand(2, 3, 4, 5, device=device), torch.ones(2, 3, device=device)
    torch.library.opcheck(torch.ops.kvision.apply_colormap.default, (x, white, torch.rand(1, 3, 6, device=device)))


class TestColormapOperators(PointOpTests):
    calls = {
        "apply_colormap": [
            Call(
                (vector(3, 4, 5), lambda: torch.ones(3), vector(3, 6)),
                broadcasts=False,
                differentiable=False,
                dtypes=SINGLE_AND_DOUBLE,
                accepted=(" cut along axis -1", "another batch"),
            )
        ],
    }
