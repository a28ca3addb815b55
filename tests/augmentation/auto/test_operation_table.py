"""The kernels of policies: what they choose and execute is what torch's and kvision's other operators do."""

import pytest
import torch
from torch import Tensor

from drawn_tests import UNSERVED, call_unserved, has_kernels, random_images, record_kernel
from kvision.augmentation.auto import AugMix, AutoAugment, RandAugment, TrivialAugment, operation_table, policy_base
from kvision.augmentation.auto.operation_table import OPERATIONS, execute_steps
from op_tests import DispatchedOperators, OpTests, assert_close, pairwise

# A value of each operation that has one.
VALUES = {
    "rotate": 25.0,
    "posterize": 3.0,
    "solarize": 0.6,
    "solarize_add": 0.2,
    "color": 1.7,
    "contrast": 1.8,
    "brightness": 0.4,
    "sharpness": 1.9,
    "shear_x": 0.3,
    "shear_y": -0.2,
    "translate_x": -0.2,
    "translate_y": 0.31,
    "translate_x_pixels": 3.4,
    "translate_y_pixels": -7.0,
}
NAMES = tuple(OPERATIONS)
LAYOUTS = {
    "contiguous": lambda x: x,
    "channels_last": lambda x: x.contiguous(memory_format=torch.channels_last),
    "sliced": lambda x: torch.cat([x, x], -1)[..., 1 : 1 + x.shape[-1]],
    "transposed": lambda x: x.mT.contiguous().mT,
    "expanded": lambda x: x[:1].expand_as(x),
    "channels apart": lambda x: x.repeat_interleave(2, 1)[:, ::2],
}
CHANNELS = [3, 1, 4]
# Of one pixel, smaller than a tile, of whole vectors, and large enough that a plane is divided on CUDA.
SIZES = {"one": (1, 1), "column": (9, 1), "odd": (37, 41), "vectors": (32, 64), "large": (97, 132)}


def of_names(*names: str):
    """The arguments of a step, whose samples have these operations by turns."""
    numbers = [OPERATIONS[name].number for name in names]
    values = [VALUES.get(name, 0.0) for name in names]
    return {
        "operation": lambda x: torch.tensor(numbers).repeat(len(x))[: len(x)],
        "value": lambda x: (1000 * torch.tensor(values)).round().int().repeat(len(x))[: len(x)],  # get no gradient
    }


class TestApplyOperation(OpTests):
    operators = ("apply_operation", "apply_operation_backward")
    variants = [
        of_names("rotate", "contrast"),
        of_names("sharpness", "auto_contrast"),
        of_names("color", "translate_y"),
    ]
    channels = 3
    mixed = ("operation", "value")
    accepted = ("operation of torch.int64",)
    small = (2, 3, 4, 5)
    max_size = 12

    @staticmethod
    def function(x: Tensor, operation: Tensor, value: Tensor) -> Tensor:
        x = x if x.is_floating_point() else x.float()
        return operation_table._apply_operation(x, operation.long(), value.float() / 1000)[0]

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the classes that call the operator check its input")


@pytest.fixture
def kernel_calls(monkeypatch):
    return record_kernel(monkeypatch, operation_table, "_apply_operations")


def each_operation(device: torch.device) -> tuple[Tensor, Tensor]:
    """Numbers and values (B, 1): all operations, and none."""
    operation = torch.tensor([-1, *(OPERATIONS[name].number for name in NAMES)], device=device)
    value = torch.tensor([0.0, *(VALUES.get(name, 0.0) for name in NAMES)], device=device)
    return operation[:, None], value[:, None]


def both_ways(x, names, operation, value, serves):
    results = []
    for fused in (False, True):
        serves.append(fused)
        results.append(execute_steps(x, names, operation, value))
    return results


def assert_same_images(fused: Tensor, y: Tensor) -> None:
    """Up to rounding, which may carry single values across a threshold of solarize or a level."""
    assert fused.dtype == y.dtype and fused.shape == y.shape and fused.stride() == y.stride()
    step = {torch.uint8: 1.0, torch.float16: 2e-3, torch.bfloat16: 2e-2}.get(y.dtype, 2e-5)
    error = (fused.float() - y.float()).abs()
    assert (error <= step).float().mean() > 0.9995


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16, torch.uint8], ids=str)
@pytest.mark.parametrize(("size", "layout", "channels"), pairwise(list(SIZES), list(LAYOUTS), CHANNELS))
def test_an_operation_is_that_of_separate_operators(size, channels, layout, dtype, device, backend, kernel_calls):
    calls, serves = kernel_calls
    operation, value = each_operation(device)
    x = LAYOUTS[layout](random_images((len(operation), channels, *SIZES[size]), device, dtype))
    before = x.clone()
    (y, (stage,)), (fused, (fused_stage,)) = both_ways(x, [NAMES], operation, value, serves)
    assert bool(calls) == has_kernels(device, backend)
    assert torch.equal(x, before) and fused.data_ptr() != x.data_ptr()
    assert_close(fused_stage.matrix, stage.matrix, 1e-6, 1e-5)
    step = {torch.uint8: 1.0, torch.float16: 2e-3, torch.bfloat16: 2e-2}.get(dtype, 2e-5)
    for i, name in enumerate(["none", *NAMES]):
        error = (fused[i].float() - y[i].float()).abs()
        if name in ("none", "identity"):
            assert torch.equal(fused[i], x[i])
        # Rounding may carry single values across a threshold or a level.
        elif name in ("solarize", "solarize_add", "posterize", "equalize"):
            assert (error > step).sum() <= 0.002 * error.numel(), name
        else:
            assert (error <= step).all(), name


@pytest.mark.parametrize("steps", [1, 2, 3, 4])
def test_steps_follow_each_other(steps, device, kernel_calls):
    _, serves = kernel_calls
    operation, value = each_operation(device)
    order = torch.stack([torch.randperm(len(operation)) for _ in range(steps)], 1).to(device)
    operation, value = operation[order, 0], value[order, 0]
    x = random_images((len(operation), 3, 40, 56), device, torch.float32)
    names = [NAMES if i % 2 == 0 else tuple(VALUES) for i in range(steps)]
    operation[:, 1::2] = torch.where(value[:, 1::2] == 0, -1, operation[:, 1::2])
    (y, stages), (fused, fused_stages) = both_ways(x, names, operation, value, serves)
    assert (((fused - y).abs() <= 1e-4).float().mean()) > 0.99
    assert len(fused_stages) == len(stages) == steps
    for fused_stage, stage in zip(fused_stages, stages):
        assert_close(fused_stage.matrix, stage.matrix, 1e-6, 1e-5)


def test_stages_are_those_that_move_pixels(device, kernel_calls):
    _, serves = kernel_calls
    x = random_images((3, 3, 8, 9), device, torch.float32)
    operation = torch.tensor([[OPERATIONS["invert"].number, OPERATIONS["rotate"].number]], device=device).expand(3, 2)
    for _, stages in both_ways(
        x, [("invert",), ("rotate", "invert")], operation, torch.full_like(x[:, :2, 0, 0], 9.0), serves
    ):
        assert len(stages) == 1 and not torch.equal(stages[0].matrix.cpu(), torch.eye(3).expand(3, 3, 3))


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_values_that_are_no_numbers_stay_in_their_sample(bad, device, kernel_calls):
    _, serves = kernel_calls
    operation, value = each_operation(device)
    x = random_images((len(operation), 3, 37, 41), device, torch.float32)
    x[:, 1, 20, 21] = bad
    (y, _), (fused, _) = both_ways(x, [NAMES], operation, value, serves)
    same = torch.isclose(fused, y, rtol=0, atol=2e-5, equal_nan=True)
    assert same.float().mean() > 0.9995
    operation[:] = OPERATIONS["auto_contrast"].number
    operation[::2] = -1
    (y, _), (fused, _) = both_ways(x, [NAMES], operation, value, serves)
    assert torch.equal(fused[::2].nan_to_num(), x[::2].nan_to_num())
    assert torch.equal(fused.isnan(), y.isnan())


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
@pytest.mark.parametrize("name", ["auto_contrast", "equalize"])
def test_flat_channels_stay_as_they_are(name, dtype, device):
    x = torch.full((2, 3, 20, 24), 77 if dtype == torch.uint8 else 0.3, dtype=dtype, device=device)
    x[1] = random_images((3, 20, 24), device, dtype)
    operation = torch.full((2, 1), OPERATIONS[name].number, device=device)
    y, _ = execute_steps(x, [(name,)], operation, torch.zeros(2, 1, device=device))
    assert torch.equal(y[0], x[0]) and not torch.equal(y[1], x[1])


@pytest.mark.native  # the reference is the separate operators
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16], ids=str)
@pytest.mark.parametrize(
    ("layout", "size", "channels"), pairwise([*LAYOUTS, "of a sum"], list(SIZES), CHANNELS), ids=str
)
def test_gradients_are_those_of_separate_operators(layout, size, channels, dtype, device):
    operation, value = (t[:, 0] for t in each_operation(device))
    x = random_images((len(operation), channels, *SIZES[size]), device, dtype)
    x = LAYOUTS.get(layout, LAYOUTS["contiguous"])(x).detach().requires_grad_()
    weights = torch.randn(x.shape, generator=torch.Generator().manual_seed(1)).to(x)
    gradients = []
    for step in (operation_table._apply_operation, operation_table._reference):
        y, _ = step(x, operation, value)
        gradients += torch.autograd.grad(y.sum() if layout == "of a sum" else (y * weights).sum(), x)
    fused, expected = gradients
    assert fused.dtype == dtype and fused.is_contiguous()
    step = {torch.float16: 2e-2, torch.bfloat16: 1e-1}.get(dtype, 2e-4)
    for i, name in enumerate(["none", *NAMES]):
        error = (fused[i].float() - expected[i].float()).abs() / expected[i].abs().amax().clamp(min=1).float()
        # Where rounding carries a value across a threshold or a bound, its gradient is another one.
        assert (error > step).sum() <= 0.004 * error.numel(), name


def test_one_operation_for_all_samples_of_a_vmap(device):
    x, (operation, value) = random_images((5, 1, 3, 8, 9), device, torch.float32), each_operation(device)
    for step in zip(operation, value):
        y, _ = torch.func.vmap(operation_table._apply_operation, (0, None, None))(x, *step)
        expected = torch.cat([operation_table._apply_operation(one, *step)[0] for one in x])
        assert_close(y[:, 0], expected, 0.0, 1e-6)


def test_a_policy_with_gradients_is_an_operator_a_step(device, backend):
    if not has_kernels(device, backend):
        pytest.skip("the kernels are not there")
    augment, x = RandAugment(2, 9), random_images((4, 3, 8, 9), device, torch.float32).requires_grad_()
    augment(x, seed=1)
    with DispatchedOperators() as dispatched:
        y = augment(x, seed=1)
        torch.autograd.grad(y.sum(), x)
    own = [name for name in dispatched.names if name.startswith(("apply", "warp", "color"))]
    assert own == ["apply_operation"] * 2 + ["apply_operation_backward"] * 2
    assert_same_images(augment(x.detach(), seed=1), y)


@pytest.mark.parametrize("case", UNSERVED)
def test_calls_that_the_kernel_does_not_serve(case, device, kernel_calls, backend):
    calls, _ = kernel_calls
    augment, x = (
        TrivialAugment([[("invert", 0.0, 0.0)], [("rotate", 10.0, 20.0)]]),
        random_images((9, 3, 8, 9), device, torch.float32),
    )
    call_unserved(case, augment, x)
    assert not calls
    augment(x)
    assert bool(calls) == has_kernels(device, backend)


@pytest.mark.parametrize("make", [AutoAugment, lambda: RandAugment(3, 12), TrivialAugment, AugMix])
def test_choices_are_those_of_torch(make, device, backend, monkeypatch):
    calls, serves = record_kernel(monkeypatch, policy_base, "_choose_operations")
    results = []
    for fused in (False, True):
        serves.append(fused)
        augment = make()
        augment(random_images((500, 3, 4, 5), device, torch.float32), seed=3)
        results.append(augment._record.drawn)
    assert bool(calls) == has_kernels(device, backend)
    drawn, fused = results
    assert torch.equal(drawn.operation, fused.operation)
    # Torch multiplies by a reciprocal on CUDA.
    tolerance = (3e-7, 1e-6) if device.type == "cuda" else (0.0, 0.0)
    assert_close(fused.value, drawn.value, *tolerance)


def test_a_call_is_few_operators(device, backend):
    if not has_kernels(device, backend):
        pytest.skip("the kernels are not there")
    augment, x = RandAugment(2, 9), random_images((4, 3, 8, 9), device, torch.float32)
    augment(x)
    with DispatchedOperators() as dispatched:
        augment(x)
    own = [name for name in dispatched.names if name not in ("empty", "random_", "slice", "unbind")]
    assert own == ["draw_parameters", "choose_operations", "apply_operations"]


def test_a_captured_call_draws_anew(device):
    if device.type != "cuda":
        pytest.skip("CUDA graphs need CUDA")
    augment, x = RandAugment(2, 9), random_images((16, 3, 40, 56), device, torch.float32)
    for _ in range(3):
        augment(x)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        y = augment(x)
    graph.replay()
    before = y.clone()
    graph.replay()
    assert not torch.equal(y, before)
    assert_same_images(y, augment(x, params=augment._params))


def test_arguments_are_checked(device, backend):
    if not has_kernels(device, backend):
        pytest.skip("arguments are checked by the kernels, which are not there")
    x, (operation, value) = random_images((19, 3, 4, 5), device, torch.float32), each_operation(device)
    for arguments, message in (
        ((x[:, :0], operation, value), "images with channels"),
        ((x, operation.int(), value), "operations of shape"),
        ((x, operation[:, 0], value), "operations of shape"),
        ((x, operation[:5], value), "operations of shape"),
        ((x, operation, value.double()), "float32 value"),
        ((x, operation, value[:5]), "float32 value"),
    ):
        with pytest.raises(RuntimeError, match=f"apply_operations: expected .*{message}"):
            torch.ops.kvision.apply_operations(*arguments)
    columns, table = torch.zeros(2, 4, device=device), torch.zeros(3, 1, 5, device=device)
    for *arguments, message in (
        (columns, table[..., :4], "a table of shape"),
        (columns, table[:0], "a table of shape"),
        (columns[:, :3], table, r"columns of shape \(B, 4\)"),
        (columns.double(), table, "float32 columns"),
    ):
        with pytest.raises(RuntimeError, match=f"choose_operations: expected .*{message}"):
            torch.ops.kvision.choose_operations(*arguments, 1, 30.0)
