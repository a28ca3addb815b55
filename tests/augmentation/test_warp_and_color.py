"""Passes over images: a warp by a chain of transforms, then a program of color steps."""

import pytest
import torch

import kvision as K
from kvision.augmentation.columns import name_columns
from kvision.augmentation.transforms import Transform
from kvision.augmentation.warp_and_color import SAME, ColorPart, ColorStep, Output, Resampling, make_pass
from kvision.core.exceptions import ShapeError, TypeCheckError
from op_tests import OpTests, assert_close

A = K.augmentation


def apply_pass(input, columns=None, chain=None, size=(), resampling=None, parts=(), output=SAME):
    """The operator with the checks of its callers."""
    if not isinstance(input, torch.Tensor) or not (input.is_floating_point() or input.dtype == torch.uint8):
        if not isinstance(input, torch.Tensor) or input.is_complex():
            raise TypeCheckError("apply_pass: expected images")
        input = input.float()
    if input.dim() != 4 or 0 in input.shape[2:]:
        raise ShapeError("apply_pass: expected images of shape (B, C, H, W)")
    return make_pass(chain, size, resampling, parts, output).run(input, columns)[0]


# Columns: angle, translation, box of a crop, factors, an angle of hue, an order.
def columns(x):
    torch.manual_seed(4)
    batch, (h, w) = x.shape[0], x.shape[-2:]
    rest = torch.tensor([[10.0, 1.3, -0.7, 0.0, 0.0, 0.9 * w, 0.8 * h, 0.9, 1.1, 1.2, 0.1]], dtype=torch.float64)
    drawn = rest.expand(batch, -1) * (1 + 0.05 * torch.rand(batch, 11, dtype=torch.float64))
    # Between integers, so that numerical derivatives do not change a step.
    orders = torch.tensor([[2.0, 0, 1, 3], [-1, 3, 2, 1], [0, 1, 2, 3]], dtype=torch.float64) + 0.25
    return torch.cat([drawn, orders[torch.arange(batch) % 3]], 1)


def columns_of_windows(x):
    """The same, with boxes that are not halfway between pixels in any type."""
    drawn = columns(x)
    drawn[:, 3:7] = drawn[:, 3:7].floor() + 0.25
    return drawn


FIELDS = [("angle", 0), ("translation", 2), ("window", 4), ("factors", 3), ("radians", 0), ("order", 4)]
NAMES = name_columns(FIELDS)
TURN = [Transform.affine((8.0, 6.0), angle="angle", translation="translation")._bound(NAMES)]
CROP = [Transform("crop", "window", 9, 7, 0)._bound(NAMES), Transform.affine((4.0, 3.0))]
LINEAR, NEAREST = Resampling("bilinear", "border", False), Resampling("nearest", "zeros")
FILLED = Resampling("bilinear", "fill", True, 0.3)
WINDOWS, CUBIC_WINDOWS = (Resampling(mode, "border", False, antialias=True) for mode in ("bilinear", "bicubic"))
BRIGHT = ColorStep("scale_shift", "factors[0]", 0.0, 1.0)
CONTRAST, SATURATION = ColorStep("contrast", "factors[1]"), ColorStep("saturation_gray", "factors[2]")


def part(*steps, names=NAMES, order=None):
    return ColorPart([step._bound(names) for step in steps], order and [column.position for column in names[order]])


JITTER = part(BRIGHT, CONTRAST, SATURATION, ColorStep("hue", "radians"), order="order")
PLAIN = part(SATURATION, ColorStep("scale_shift", "factors[0]", 0.1))
NORMALIZE = ColorPart([ColorStep("standardize_rgb", 0.5, 0.4, 0.3, 0.3, 0.2, 0.4)])


class TestWarpAndColor(OpTests):
    function = staticmethod(apply_pass)
    operators = ("warp_and_color", "warp_and_color_backward", "transform_matrix_backward")
    channels = 3
    small = (2, 3, 4, 5)
    bytes = True
    # A warp takes images of any size to any other.
    accepted = ("image cut along axis -1", "image cut along axis -2")
    max_size = 17
    shape = (3, 3, 13, 18)
    variants = [
        {"columns": columns, "chain": CROP, "size": (7, 9), "resampling": LINEAR, "parts": (PLAIN, NORMALIZE)},
        {"columns": columns, "chain": TURN, "size": (13, 18), "resampling": LINEAR, "parts": (JITTER,)},
        {"columns": columns, "chain": TURN, "size": (11, 6), "resampling": FILLED},
        {"columns": columns, "parts": (JITTER, NORMALIZE)},
        {"columns": columns, "chain": CROP, "size": (7, 9), "resampling": NEAREST, "parts": (PLAIN,)},
        {"columns": columns_of_windows, "chain": CROP, "size": (7, 9), "resampling": WINDOWS, "parts": (JITTER,)},
        {"columns": columns_of_windows, "chain": CROP, "size": (4, 19), "resampling": CUBIC_WINDOWS, "parts": (PLAIN,)},
        {"columns": columns, "chain": CROP, "size": (7, 9), "resampling": LINEAR, "parts": (JITTER, NORMALIZE)},
    ]
    # Between the warp and the program, what is sampled is rounded to the type of the images.
    tolerances = {torch.float16: (1e-2, 1e-2), torch.bfloat16: (8e-2, 8e-2), torch.uint8: (0.0, 2.0)}

    def input(self, shape, dtype, device):
        """Colors away from grays, from ties of their channels and from the bounds, where gradients jump."""
        x = torch.rand(shape, dtype=torch.float64)
        if shape[-3] == 3:
            x = 0.25 + 0.1 * x + torch.tensor([0.2, 0.0, 0.4], dtype=torch.float64)[:, None, None]
        return (255 * x).to(dtype).to(device) if dtype == torch.uint8 else x.to(dtype).to(device)


def crop_and_flip(size, names):
    box = Transform("crop", "window", float(size[1]), float(size[0]), 0)._bound(names)
    return box, Transform.affine(((size[1] - 1) / 2, (size[0] - 1) / 2), scale="scale")._bound(names)


def pipeline(**options):
    return A.AugmentationSequential(
        A.RandomResizedCrop((24, 20)),
        A.RandomHorizontalFlip(),
        A.ColorJitter(0.2, 0.2, 0.2, 0.1),
        A.Normalize((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)),
        **options,
    )


def one_by_one(augment, x, seed):
    torch.manual_seed(seed)
    for child in augment.children():
        x = child(x)
    return x


@pytest.mark.parametrize(
    "make",
    [
        pipeline,
        lambda: A.ImageSequential(A.RandomAffine(30.0, (0.1, 0.1), p=0.6), A.RandomGrayscale(p=0.5)),
        lambda: A.ImageSequential(
            A.ColorJitter(0.3, 0.3, 0.3, 0.1, p=0.5), A.RandomVerticalFlip(), A.RandomInvert(p=0.5)
        ),
        lambda: A.ImageSequential(
            A.RandomHorizontalFlip(), A.RandomRotation(20.0), A.ColorJitter(contrast=0.4), A.ColorJitter(contrast=0.4)
        ),
        lambda: A.ImageSequential(A.RandomCrop((17, 15), padding=2, fill=0.4), A.Normalize(0.4, 0.3)),
    ],
)
def test_equals_separate_calls(make, device):
    augment, x = make(), torch.rand(6, 3, 32, 27, device=device)
    for seed in range(3):  # the second call finds its plan
        torch.manual_seed(seed)
        y = augment(x)
        assert_close(y, one_by_one(augment, x, seed), 1e-5, 2e-5)
        assert_close(augment(x, params=augment._params), y, 1e-5, 2e-5)


# Sizes of results: vectors and none, more columns than a warp of threads, fewer rows than the parts of a sample; the last one
# is too large for kernels that keep a sample.
@pytest.mark.native
@pytest.mark.parametrize("size", [(7, 9), (32, 64), (33, 47), (100, 36), (1, 1), (250, 252), (300, 300)], ids=str)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8])
@pytest.mark.parametrize("channels", [1, 3])
def test_joined_equals_warp_then_program(channels, dtype, size, device):
    """What one kernel computes is what the warp and the program compute one after the other."""
    (h, w), batch = (45, 52), 5
    generator = torch.Generator().manual_seed(size[1])
    # A box, signs of flips, factors and a hue, an order.
    drawn = torch.rand(batch, 10, generator=generator)
    drawn[:, :4] = torch.stack(
        [12 * drawn[:, 0] - 2, 9 * drawn[:, 1] - 2, 9 + 30 * drawn[:, 2], 5 + 30 * drawn[:, 3]], 1
    )
    drawn[:, 4:6] = (drawn[:, 4:6] - 0.5).sign()
    drawn[:, 6:9] = 0.8 + 0.4 * drawn[:, 6:9]
    drawn[:, 9] = drawn[:, 9] / 5 - 0.1
    orders = torch.tensor([[2, 0, 1, 3], [-1, 3, 2, 1], [0, 1, 2, 3], [3, -1, 0, 2], [1, 0, 2, 3]])
    drawn = torch.cat([drawn, orders], 1).to(device)
    names = name_columns([("window", 4), ("scale", 2), ("factors", 3), ("radians", 0), ("order", 4)])
    box, flip = crop_and_flip(size, names)
    if channels == 3:
        steps = [BRIGHT, CONTRAST, SATURATION, ColorStep("hue", "radians")]
        normalize = NORMALIZE
    else:
        steps = [BRIGHT, CONTRAST, ColorStep("gamma", "factors[2]", 1.0), BRIGHT]
        normalize = ColorPart([ColorStep("standardize", 0.4, 0.3)])
    with_mean, without = part(*steps, names=names, order="order"), part(steps[0], steps[2], steps[3], names=names)
    x = torch.rand(batch, channels, h, w, generator=generator)
    x = ((255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype)).to(device)
    results = (
        Output(torch.float32),
        Output(torch.float32, torch.channels_last),
        Output(torch.float16, torch.channels_last),
    )
    for parts, padding, output in (
        ((with_mean, normalize), "border", results[0]),
        ((with_mean,), "reflection", results[1]),
        ((with_mean,), "zeros", results[2]),
        ((without, normalize), "zeros", results[0]),
        ((without,), "fill", results[1]),
        ((without,), "border", results[2]),
    ):
        resampling = Resampling("bilinear", padding, padding == "reflection", 0.25)
        warp = make_pass([box, flip], size, resampling)
        program, joined = (
            make_pass(None, (), None, parts, output),
            make_pass([box, flip], size, resampling, parts, output),
        )
        for images in (x, x.contiguous(memory_format=torch.channels_last), x[..., 3:, 2:-1], x[:0]):
            of_images = drawn[: images.shape[0]]
            y = joined.run(images, of_images)[0]
            expected = program.run(warp.run(images, of_images)[0], of_images)[0]
            assert y.dtype == expected.dtype and y.shape == expected.shape and y.stride() == expected.stride()
            if not len(y):
                continue
            difference = (y.float() - expected.float()).abs()
            # What is sampled may be rounded to another neighbor.
            step = {torch.float32: 2e-5, torch.float16: 1e-2, torch.uint8: 0.06}[dtype]
            assert difference.max() <= max(step, 4e-3 if y.dtype == torch.float16 else 0.0)
            assert (difference > 1e-3).float().mean() < 0.01


@pytest.mark.parametrize("size", [(7, 9), (64, 80), (33, 47), (1, 1)], ids=str)
@pytest.mark.parametrize("padding", ["zeros", "border", "reflection"])
def test_gradients_of_warps_that_keep_rows(padding, size, device):
    """They equal those of the reference, for gradients of all layouts and for expanded scalars."""
    generator = torch.Generator().manual_seed(size[0])
    batch, (h, w) = 4, (37, 50)
    drawn = torch.rand(batch, 8, generator=generator)
    drawn[:, :4] *= torch.tensor([12.0, 9, 30, 20])
    drawn[:, 2:4] += 9
    drawn[:, 4:6] = (drawn[:, 4:6] - 0.5).sign()
    drawn[:, 6:] = 0.8 + 0.4 * drawn[:, 6:]
    drawn = torch.cat([drawn, torch.tensor([[2, 0, 1], [-1, -1, 2], [0, 1, 2], [1, 2, 0]])], 1).to(device)
    names = name_columns([("window", 4), ("scale", 2), ("factors", 2), ("order", 3)])
    box, flip = crop_and_flip(size, names)
    jitter = part(BRIGHT, CONTRAST, ColorStep("saturation_gray", "factors[0]"), names=names, order="order")
    for parts, channels in (((), 4), ((jitter, NORMALIZE), 3), ((NORMALIZE,), 3)):
        own = make_pass([box, flip], size, Resampling("bilinear", padding, padding == "reflection"), parts)
        x = (0.1 + 0.6 * torch.rand(batch, channels, h, w, generator=generator)).to(device).requires_grad_()
        y = own.run(x, drawn)[0]
        with K.backend("reference"):
            expected = own.run(x, drawn)[0]
        dense = torch.rand(y.shape, generator=generator).to(device)
        for grad in (
            dense,
            dense.contiguous(memory_format=torch.channels_last),
            dense.repeat_interleave(2, 3)[..., ::2],
            torch.full((1, 1, 1, 1), 0.7, device=device).expand_as(y),
        ):
            (result,) = torch.autograd.grad(y, x, grad, retain_graph=True)
            (expected_grad,) = torch.autograd.grad(expected, x, grad, retain_graph=True)
            assert_close(result, expected_grad, 1e-4, 1e-4)


# (15, 17) is not made of vectors of pixels, and (300, 300) does not fit the shared memory of a cluster.
@pytest.mark.native
@pytest.mark.parametrize("size", [(2, 2), (20, 36), (64, 64), (224, 224), (15, 17), (300, 300)], ids=str)
def test_contrast_of_many_samples(size, device):
    """Results and gradients of jitter equal those of the reference; samples that are not chosen stay as they are."""
    if device.type == "cpu" and max(size) > 100:
        pytest.skip("the CPU has no shared memory to exceed")
    augment = A.ColorJitter(0.2, 0.2, 0.2, 0.1, p=0.7)
    torch.manual_seed(3)
    x = (0.3 + 0.4 * torch.rand(9, 3, *size, device=device)).requires_grad_()
    y = augment(x)
    chosen = augment._params["batch_prob"] > 0.5
    assert 0 < chosen.sum() < 9 and torch.equal(y[~chosen], x[~chosen])
    with K.backend("reference"):
        promoted = x.detach().double().requires_grad_()
        expected = augment(promoted, params=augment._params)
    assert_close(y, expected.float(), 1e-5, 1e-5)
    dense = torch.rand(y.shape, device=device)
    one = torch.full((1, 1, 1, 1), 0.7, device=device).expand_as(y)
    for grad in (dense, dense.contiguous(memory_format=torch.channels_last), one):
        (result,) = torch.autograd.grad(y, x, grad, retain_graph=True)
        (expected_grad,) = torch.autograd.grad(expected, promoted, grad.double(), retain_graph=True)
        close = torch.isclose(result.double(), expected_grad, 1e-3, 1e-4)
        assert (~close).double().mean() < 1e-4  # hue has a kink where two channels are equal
        (again,) = torch.autograd.grad(y, x, grad, retain_graph=True)
        assert torch.equal(again, result)


@pytest.mark.parametrize("size", [(24, 20), (23, 21)], ids=str)
def test_joined_keeps_what_is_not_finite(size, device):
    """A tap of weight 0 contributes nothing, whatever it is."""
    x = torch.rand(3, 3, 24, 21, device=device)
    x[0, 0, 5, 7], x[1, 1, 0, 3], x[2, :, 23, 20] = float("inf"), float("nan"), -float("inf")
    boxes = torch.tensor([[0.0, 0, size[1], size[0]], [0, 0, 21, 24], [0.5, 1, 13, 11]], device=device)
    chain = [Transform("crop", "window", float(size[1]), float(size[0]), 0)._bound(name_columns([("window", 4)]))]
    shift = ColorPart([ColorStep("scale_shift", 0.5, 0.25)])
    warped = make_pass(chain, size, LINEAR).run(x, boxes)[0]
    y = make_pass(chain, size, LINEAR, (shift,)).run(x, boxes)[0]
    assert torch.equal(y.isfinite(), warped.isfinite()) and torch.equal(y.isnan(), warped.isnan())
    assert not y.isfinite().all()
    moved = min(size[1], 21)
    assert torch.equal(y[0, ..., :moved], 0.5 * x[0, :, : size[0], :moved] + 0.25)


@pytest.mark.parametrize("size", [(24, 20), (2, 2), (1, 5), (5, 1)])
@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.uint8])
def test_joined_flips_are_exact(dtype, size, device):
    """Moves by whole pixels read the last pixels of rows and columns, which have no next one."""
    x = (torch.rand(3, 3, *size, device=device) * (255 if dtype == torch.uint8 else 1)).to(dtype)
    steps = A.RandomHorizontalFlip(p=1.0), A.RandomVerticalFlip(p=1.0), A.RandomBrightness((1.0, 1.0), p=1.0)
    for images in (x, x.contiguous(memory_format=torch.channels_last)):
        assert torch.equal(A.ImageSequential(*steps)(images), x.flip(-1, -2))


def test_pipeline_takes_three_launches_at_most(device):
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    augment, x = pipeline(), torch.rand(32, 3, 64, 64, device=device)
    augment(x)
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as profile:
        augment(x)
        torch.cuda.synchronize()
    kernels = [e.name for e in profile.events() if e.device_type == torch.autograd.DeviceType.CUDA]
    assert 0 < len(kernels) <= 3, kernels  # draws, matrices, warp with program


@pytest.mark.parametrize("memory_format", [None, torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.uint8])
@pytest.mark.parametrize("stored", [torch.uint8, torch.float32])
def test_results_have_the_requested_type_and_layout(stored, dtype, memory_format, device):
    x = torch.randint(0, 256, (4, 3, 32, 32), dtype=torch.uint8, device=device)
    x = x if stored == torch.uint8 else x.float() / 255
    augment = pipeline(output_dtype=dtype, memory_format=memory_format)
    torch.manual_seed(1)
    y = augment(x)
    assert y.dtype == dtype and y.shape == (4, 3, 24, 20)
    assert y.is_contiguous(memory_format=memory_format or torch.contiguous_format)
    torch.manual_seed(1)
    expected = pipeline()(x.float() / 255 if stored == torch.uint8 else x)
    if dtype == torch.uint8:
        assert_close(y, (255 * expected).round().clamp(0, 255).to(torch.uint8), 0, 10)
    else:
        # The crop rounds bytes to bytes, and the deviations divide by a fifth.
        rtol, atol = (0.0, 0.05) if stored == torch.uint8 else (2e-3, 2e-3)
        assert_close(y.float(), expected, rtol, atol)


@pytest.mark.parametrize(
    "make", [lambda **o: A.ImageSequential(**o), lambda **o: A.ImageSequential(torch.nn.Identity(), **o)]
)
def test_type_of_results_without_passes(make, device):
    x = torch.randint(0, 256, (2, 3, 8, 9), dtype=torch.uint8, device=device)
    y = make(output_dtype=torch.float32, memory_format=torch.channels_last)(x)
    assert_close(y, x.float() / 255)
    assert y.is_contiguous(memory_format=torch.channels_last)


def test_type_of_results_behind_masks(device):
    """What reads masks runs by itself, also as the last one."""
    x, masks = torch.rand(2, 3, 8, 9, device=device), torch.ones(2, 1, 8, 9, dtype=torch.int64, device=device)
    options = {"output_dtype": torch.float16, "memory_format": torch.channels_last}
    y, _ = A.AugmentationSequential(A.RandomTransplantation(p=1.0), data_keys=["input", "mask"], **options)(x, masks)
    assert y.dtype == torch.float16 and y.is_contiguous(memory_format=torch.channels_last)


def test_types_of_results_are_checked():
    with pytest.raises(TypeError, match="ImageSequential: expected output_dtype to be uint8 or a floating-point type"):
        A.ImageSequential(output_dtype=torch.int32)
    with pytest.raises(ValueError, match="ImageSequential: expected memory_format to be"):
        A.ImageSequential(memory_format=torch.channels_last_3d)


def test_changed_settings_are_noticed(device):
    """Plans are kept from call to call until a setting changes, in any of the ways to change one."""
    x = torch.rand(4, 3, 16, 16, device=device)
    flip, crop = A.RandomHorizontalFlip(p=1.0), A.RandomResizedCrop((8, 8))
    affine_, jitter = A.RandomAffine(0.0, p=1.0), A.ColorJitter(brightness=(1.0, 1.0))
    augment = A.ImageSequential(flip, affine_, jitter)
    assert_close(augment(x), x.flip(-1), 1e-5, 1e-5)
    flip.p = 0.0
    assert_close(augment(x), x, 1e-5, 1e-5)
    affine_.flags["padding_mode"] = K.constants.SamplePadding.BORDER
    affine_._param_generator = A.RandomAffine((90.0, 90.0))._param_generator
    assert_close(augment(x), x.rot90(1, (2, 3)), 1e-5, 1e-5)
    jitter.apply_transform = lambda input, *_: input + 1
    assert_close(augment(x), x.rot90(1, (2, 3)) + 1, 1e-5, 1e-5)
    augment.append(crop)
    assert augment(x).shape == (4, 3, 8, 8)
    augment[0] = A.RandomVerticalFlip(p=1.0)
    flip.p = 1.0
    assert augment(torch.rand(2, 3, 20, 20, device=device)).shape == (2, 3, 8, 8)


def test_gradients_of_learned_ranges(device):
    """Of an augmentation in a pass with others, they equal those of separate calls."""
    grads = []
    x = torch.rand(3, 3, 16, 16, device=device)
    for joined in (True, False):
        angle = torch.nn.Parameter(torch.tensor([-20.0, 20.0], device=device))
        bright = torch.nn.Parameter(torch.tensor([0.8, 1.2], device=device))
        augment = A.ImageSequential(A.RandomRotation(angle, p=1.0), A.ColorJitter(brightness=bright))
        torch.manual_seed(3)
        y = augment(x) if joined else one_by_one(augment, x, 3)
        grads.append(torch.autograd.grad((y**2).sum(), [angle, bright]))
    for joined, alone in zip(*grads):
        assert_close(joined, alone, 1e-4, 1e-4)


BYTE_STEPS = {
    "solarize": lambda: A.RandomSolarize((0.3, 0.7), (-0.4, 0.4), p=0.7),
    "brightness": lambda: A.RandomBrightness((0.2, 1.8)),
    "contrast": lambda: A.RandomContrast((0.2, 3.0)),
    "gamma": lambda: A.RandomGamma((0.3, 3.0), p=0.7),
    "invert": lambda: A.RandomInvert(p=0.5),
    "chain": lambda: A.ImageSequential(
        A.RandomSolarize(p=0.7), A.RandomBrightness((0.7, 1.3)), A.RandomGamma((0.5, 2.0))
    ),
}


@pytest.mark.parametrize("name", BYTE_STEPS)
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
def test_tables_of_bytes(name: str, channels: int, layout: torch.memory_format, device: torch.device) -> None:
    """Steps that map each value by itself run as tables on large images of bytes; small images have the same results."""
    augment = BYTE_STEPS[name]()
    for batch, height, width in ((5, 64, 67), (1, 130, 257), (0, 64, 64)):
        x = torch.randint(0, 256, (batch, channels, height, width), generator=torch.Generator().manual_seed(height))
        x = x.byte().to(device, memory_format=layout)
        y = augment(x, seed=3)
        assert y.dtype == torch.uint8 and (batch == 0 or y.is_contiguous(memory_format=layout))
        expected = (255 * augment(x.float() / 255, seed=3)).round().clamp(0, 255)
        assert (y - expected).abs().max() <= 1 if batch else y.shape == x.shape
        if batch:
            assert (y != expected).float().mean() < 0.02  # ties
            small = augment(x[..., :4, :4].contiguous(), seed=3)  # without a table
            assert torch.equal(y[..., :4, :4], small)
    rows = x.new_tensor(range(256)).expand(3, channels, 256, 256)  # all values, strides of 0
    assert torch.equal(augment(rows, seed=5), augment(rows.clone(), seed=5))
