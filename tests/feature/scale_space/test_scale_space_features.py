"""The strongest features of all octaves by one operator, compared with the detector's modules."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from feature_images import photo
from kvision._ops import operators
from op_tests import assert_close
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests

F = K.feature
SIZES = [26, 36, 13, 18]  # of octaves
REFINEMENT = (5, 0.6, 1, True)


def blobs() -> torch.Tensor:
    """Blobs of clearly different heights (1, 13, 18)."""
    y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in (13, 18)), indexing="ij")
    parts = [h * torch.exp(-((x - u) ** 2 + (y - v) ** 2) / 5) for h, u, v in ((1.0, 4.3, 5.2), (-0.6, 13.1, 6.4))]
    return (sum(parts) * (1 + 0.2 * torch.rand(()).item()))[None]


def options(mode: int, minima: bool) -> tuple:
    windows, sigmas = [9, *([5] * 5), 0, *([5] * 5)], [1.25, 0.9, 1.1, 1.4, 1.8, 2.2]
    blurs = [1.6 * 2 ** (i / 3) for i in range(6)]
    return (SIZES, windows, sigmas, 3, blurs, mode, minima, 4, 2.0, 3.0, 0.5, 0.0, 0.0, *REFINEMENT)


class TestScaleSpaceFeatures(PointOpTests):
    calls = {
        "scale_space_features": [
            Call(
                (blobs,),
                options(mode, minima),
                dtypes=SINGLE_AND_DOUBLE,
                differentiable=False,
                tolerance=200,  # positions are quotients of small differences
                accepted=("count 0", "count 32768", "mode", "next 0"),
            )
            for mode, minima in ((-1, True), (0, False), (1, True))
        ]
    }


def detectors() -> dict[str, torch.nn.Module]:
    dog = {"resp_module": F.BlobDoG(), "scale_space_response": True, "minima_are_also_good": True}
    return {
        "hessian": F.ScaleSpaceDetector(60),
        "hessian of a doubled image": F.ScaleSpaceDetector(
            40, resp_module=F.BlobHessian("diff"), scale_pyr_module=K.ScalePyramid(3, 1.6, 16, True, 2), mr_size=3.0
        ),
        "differences": F.ScaleSpaceDetector(60, edge_threshold=10.0, **dog),
        "few of many": F.ScaleSpaceDetector(7, score_threshold=0.001, **dog),
        "more than there are": F.ScaleSpaceDetector(5000, subpix_module=K.geometry.ConvQuadInterp3d(), **dog),
        "four levels, sharp": F.ScaleSpaceDetector(50, scale_pyr_module=K.ScalePyramid(4, 0.4, 20, False, 3), **dog),
    }


@pytest.mark.native
@pytest.mark.parametrize("name", detectors())
def test_features_are_those_of_the_modules(name, device):
    """The operator equals the modules, which are called one after the other with a mask and where a gradient is wanted."""
    detector = detectors()[name]
    image = torch.cat([photo(96, 110), photo(96, 110).flip(-1), torch.full((1, 1, 96, 110), 0.3)]).to(device)
    calls = []
    operator = operators["scale_space_features"]
    kernel, operator._call_kernel = operator._call_kernel, lambda *args: (calls.append(args), kernel(*args))[1]
    try:
        lafs, responses = detector(image)
        assert len(calls) == 1
        masked = detector(image, torch.ones(1, 1, 96, 110, device=device))
        with_gradient = detector(image.clone().requires_grad_())
        assert len(calls) == 1
    finally:
        operator._call_kernel = kernel
    for others in (masked, with_gradient):
        assert_close(lafs, others[0].detach(), 1e-9, 1e-9)
        assert_close(responses, others[1].detach(), 1e-9, 1e-12)
    assert (responses[:2] != 0).any(1).all() and (responses[2] == 0).all() and (lafs[2] == 0).all()
    with K.backend("reference"):
        expected = detector(image)
    assert_close((lafs, responses), expected, 1e-8, 1e-8)


@pytest.mark.native
@pytest.mark.parametrize("name", ["hessian", "differences"])
def test_features_do_not_depend_on_threads(name):
    """The CPU has the levels of one image for every four threads in memory."""
    image = torch.cat([photo(96, 110), photo(96, 110).flip(-1), photo(96, 110).flip(-2)])
    detector, threads = detectors()[name], torch.get_num_threads()
    expected = [detector(x[None]) for x in image]
    try:
        for n in (1, 2, 5, 16):
            torch.set_num_threads(n)
            lafs, responses = detector(image)
            for i, (laf, response) in enumerate(expected):
                assert torch.equal(lafs[i], laf[0]) and torch.equal(responses[i], response[0])
    finally:
        torch.set_num_threads(threads)


@pytest.mark.native
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16], ids=str)
def test_features_of_narrower_types_are_near(dtype, device):
    image = photo(96, 110).to(device)
    for detector in list(detectors().values())[:3]:
        exact, rounded = detector(image)[0], detector(image.to(dtype))[0]
        assert rounded.dtype == torch.float32
        distances = torch.cdist(rounded[0, :20, :, 2].double(), exact[0, :, :, 2])
        assert (distances.amin(1) < 0.5).double().mean() > (0.95 if dtype == torch.float32 else 0.6)


@pytest.mark.native
def test_a_subclass_of_the_pyramid_is_called(device):
    """The operator serves ScalePyramid only; the modules of a detector with a subclass are called."""

    class Sharper(K.ScalePyramid):
        def forward(self, x):
            octaves, sigmas, distances = super().forward(x)
            return [2 * o for o in octaves], sigmas, distances

    image = photo(64, 70).to(device)
    own, plain = (F.ScaleSpaceDetector(9, scale_pyr_module=c(3, 1.6, 16, False, 2)) for c in (Sharper, K.ScalePyramid))
    assert_close(own(image)[1], 4 * plain(image)[1], 1e-9, 1e-9)
