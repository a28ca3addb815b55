"""ONNX programs of torch.onnx.export(dynamo=True) give the numbers of the call, as onnxruntime computes them."""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.export import Dim

import kvision as K
from benchmarks.sample_calls import public_functions
from op_tests import assert_close

pytestmark = pytest.mark.programs

OPSET = 20
# What has height and width as part of the program: the number of pixels that an antialiased resize averages depends on them, and
# the border that JPEG adds. Warps of volumes have the batch, too.
FIXED_SIZE = {"resize": (3, 32, 40), "jpeg_codec_differentiable": (3, 32, 40), "warp_perspective3d": (2, 32, 40)}
LIBRARIES = ("onnx", "onnxscript", "onnxruntime")


def identity_nearby(batch: int) -> Tensor:
    """Matrices (B, 3, 3) that bend images a little."""
    return torch.eye(3) + torch.tensor([[0.02, 0.1, 2.3], [-0.1, 0.03, 1.4], [2e-4, -3e-4, 0.0]]) * torch.rand(
        batch, 1, 1
    )


def identity_nearby3d(batch: int) -> Tensor:
    """Matrices (B, 4, 4) that bend volumes a little."""
    return torch.eye(4) + torch.tensor([0.05, 0.05, 0.05, 1e-3])[:, None] * torch.rand(batch, 4, 4)


# Name -> the call, and its tensors for a batch and a size of images.
Sizes = tuple[int, int, int]
CALLS: dict[str, tuple[Callable[..., Any], Callable[[Sizes], list[Tensor]]]] = {}


def images(sizes: Sizes, count: int = 1) -> list[Tensor]:
    b, h, w = sizes
    return [torch.rand(b, 3, h, w) for _ in range(count)]


def call(name: str, tensors: Callable[[Sizes], list[Tensor]] = images) -> Callable[..., Any]:
    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        CALLS[name] = function, tensors
        return function

    return add


MEAN, STD = torch.tensor([0.49, 0.45, 0.41]), torch.tensor([0.23, 0.22, 0.22])
call("gaussian_blur2d")(lambda x: K.filters.gaussian_blur2d(x, (5, 7), (1.5, 2.0)))
call("sobel")(lambda x: K.filters.sobel(x))
call("median_blur")(lambda x: K.filters.median_blur(x, (3, 5)))
call("filter2d", lambda s: [*images(s), torch.rand(1, 3, 5)])(lambda x, kernel: K.filters.filter2d(x, kernel))
call("canny")(lambda x: K.filters.canny(x))
call("rgb_to_grayscale")(lambda x: K.color.rgb_to_grayscale(x))
call("rgb_to_hsv")(lambda x: K.color.rgb_to_hsv(x))
call("rgb_to_lab")(lambda x: K.color.rgb_to_lab(x))
call("adjust_hue")(lambda x: K.enhance.adjust_hue(x, 0.3))
call("normalize")(lambda x: K.enhance.normalize(x, MEAN, STD))
call("equalize")(lambda x: K.enhance.equalize(x))
call("warp_affine", lambda s: [*images(s), identity_nearby(s[0])[:, :2]])(
    lambda x, matrix: K.geometry.warp_affine(x, matrix, x.shape[-2:], padding_mode="border")
)
call("warp_perspective", lambda s: [*images(s), identity_nearby(s[0])])(
    lambda x, matrix: K.geometry.warp_perspective(x, matrix, x.shape[-2:], mode="bicubic")
)
call("remap", lambda s: [*images(s), 40 * torch.rand(s), 30 * torch.rand(s)])(lambda x, u, v: K.geometry.remap(x, u, v))
call("resize")(lambda x: K.geometry.resize(x, (17, 21), antialias=True))
call("pyrdown")(lambda x: K.geometry.pyrdown(x))
call("ssim", lambda s: images(s, 2))(lambda x, y: K.metrics.ssim(x, y, 11))
call("total_variation")(lambda x: K.losses.total_variation(x))
call("dilation")(lambda x: K.morphology.dilation(x, torch.ones(3, 5)))
call("extract_tensor_patches")(lambda x: K.contrib.extract_tensor_patches(x, 8, 4))
# Those whose references were written for what ONNX has.
call("max_blur_pool2d")(lambda x: K.filters.max_blur_pool2d(x, (3, 4)))
call("jpeg_codec_differentiable", lambda s: [*images(s), 50 + 20 * torch.rand(s[0])])(
    lambda x, quality: K.enhance.jpeg_codec_differentiable(x, quality)
)
call("warp_perspective3d", lambda s: [torch.rand(s[0], 2, 5, *s[1:]), identity_nearby3d(s[0])])(
    lambda x, matrix: K.geometry.warp_perspective3d(x, matrix, (4, 20, 24))
)
call("charbonnier_loss", lambda s: images(s, 2))(lambda x, y: K.losses.charbonnier_loss(x, y, reduction="none"))
call("cart2pol", lambda s: [torch.randn(s) * torch.tensor(10.0) ** torch.randint(-30, 30, s) for _ in range(2)])(
    lambda x, y: K.geometry.cart2pol(x, y)
)


class Module(nn.Module):
    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__()
        self.function = function

    def forward(self, *tensors: Tensor) -> Any:
        return self.function(*tensors)


def exported(
    module: nn.Module, tensors: list[Tensor], path: Path, **options: Any
) -> Callable[[list[Tensor]], list[Tensor]]:
    """The module in a file of ONNX, as a function that onnxruntime computes."""
    onnxruntime = pytest.importorskip("onnxruntime")
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(module, tuple(tensors), dynamo=True, opset_version=OPSET, verbose=False, **options)
    assert {node.domain for node in program.model.graph.all_nodes()} <= {"", "pkg.torch.__subgraph__"}
    program.save(path)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])

    def run(values: list[Tensor]) -> list[Tensor]:
        inputs = {entry.name: value.numpy() for entry, value in zip(session.get_inputs(), values)}
        return [torch.from_numpy(result) for result in session.run(None, inputs)]

    return run


def results(value: Any) -> list[Tensor]:
    return [value] if isinstance(value, Tensor) else list(value)


@pytest.mark.slow
@pytest.mark.tracing
@pytest.mark.parametrize("name", CALLS)
def test_program_gives_the_numbers_of_the_call(name: str, tmp_path: Path) -> None:
    """With free batch, height and width: at the size of the example and at another one."""
    for library in LIBRARIES:
        pytest.importorskip(library, reason="torch.onnx.export needs onnx and onnxscript, its programs onnxruntime")
    function, tensors = CALLS[name]
    example, other = tensors((2, 32, 40)), tensors(FIXED_SIZE.get(name, (3, 26, 34)))
    free = tuple(
        {i: Dim.DYNAMIC for i, (n, m) in enumerate(zip(x.shape, y.shape)) if n != m} for x, y in zip(example, other)
    )
    run = exported(Module(function), example, tmp_path / "program.onnx", dynamic_shapes=(free,))
    for values in (example, other):
        assert_close(run(values), results(function(*values)), 1e-4, 1e-4 if name == "rgb_to_lab" else 1e-5)


@pytest.mark.slow
@pytest.mark.tracing
def test_a_model_with_layers_and_a_chosen_backend(tmp_path: Path) -> None:
    for library in LIBRARIES:
        pytest.importorskip(library)
    layers = nn.Sequential(nn.Conv2d(3, 3, 3), K.filters.GaussianBlur2d((3, 3), (1.0, 1.0)), K.filters.Sobel()).eval()
    (image,) = images((2, 20, 24))
    assert_close(exported(layers, [image], tmp_path / "program.onnx")([image]), [layers(image).detach()])
    with (
        pytest.raises(torch.onnx.OnnxExporterError, match="gaussian_blur2d"),
        K.backend("native"),
    ):  # as asked: no references
        exported(layers, [image], tmp_path / "program.onnx")


@pytest.mark.slow
@pytest.mark.tracing
def test_antialiasing_of_free_sizes_is_refused() -> None:
    """The number of pixels that are averaged would be that of the example: programs failed when they ran.

    torch answers the refusal by another way of tracing, which keeps the operator, so that its last words are about that.
    """
    for library in LIBRARIES:
        pytest.importorskip(library)
    shapes = ({2: Dim("height", min=16), 3: Dim("width", min=16)},)
    with pytest.raises(Exception, match="resize: ONNX of antialias=True|No ONNX function found for .*kvision.resize"):
        torch.onnx.export(K.geometry.Resize((8, 9), antialias=True), (torch.rand(1, 3, 32, 40),), dynamic_shapes=shapes)


def test_the_page_names_public_functions() -> None:
    """docs/onnx.md has functions that are there, once each, and the numbers of its first sentence."""
    page = (Path(__file__).parents[2] / "docs/onnx.md").read_text()
    failing = re.findall(r"^\| `([\w.]+)` \|", page, re.MULTILINE)
    agreeing = [
        f"{module}.{name}"
        for module, names in re.findall(r"^\*\*(\w+):\*\* (.*)$", page, re.MULTILINE)
        for name in re.findall(r"`(\w+)`", names)
    ]
    every = [*failing, *agreeing]
    assert len(set(every)) == len(every) and set(every) <= set(public_functions())
    assert f"takes {len(agreeing)} of {len(every)} public functions" in page
