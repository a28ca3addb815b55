import math

import cv2
import kornia
import numpy as np
import pytest
import torch

import kvision as K
from op_tests import assert_close
from patch_tests import SquarePatchTests, of_patches


class TestSIFTDescriptor(SquarePatchTests):
    kind = K.feature.SIFTDescriptor
    function = staticmethod(of_patches(K.feature.SIFTDescriptor))
    operators = ("sift", "sift_backward")
    variants = [
        {"num_spatial_bins": 2},
        {"num_spatial_bins": 2, "rootsift": False},
        {"num_ang_bins": 5, "num_spatial_bins": 3, "clipval": 0.3, "rootsift": False},
    ]
    errors = [
        ({"num_ang_bins": 1}, ValueError, "expected num_ang_bins"),
        ({"num_spatial_bins": 2.0}, TypeError, "expected num_spatial_bins"),
        ({"num_spatial_bins": 40}, ValueError, "expected patch_size to fit 40 spatial bins, got 12"),
        ({"clipval": -1}, ValueError, "expected clipval"),
        ({"rootsift": 1}, TypeError, "expected rootsift"),
    ]
    # Roots of small entries: an error of float32 in the entry is as large as the entry.
    tolerances = {torch.float32: (2e-3, 5e-5), torch.float16: (5e-3, 5e-3)}

    @pytest.mark.parametrize("patch_size", [16, 32, 41, 64])
    @pytest.mark.parametrize("rootsift", [True, False])
    def test_against_kornia(self, patch_size, rootsift, device):
        x = torch.rand(4, 1, patch_size, patch_size, device=device, dtype=torch.float64)
        leaves = [x.clone().requires_grad_() for _ in range(2)]
        ours, theirs = (
            module(patch_size, rootsift=rootsift).to(device, torch.float64)(leaf)
            for module, leaf in zip((K.feature.SIFTDescriptor, kornia.feature.SIFTDescriptor), leaves)
        )
        assert_close(ours, theirs, 1e-4, 1e-6)
        weights = torch.rand_like(ours)
        of_ours, of_theirs = (torch.autograd.grad((y * weights).sum(), x)[0] for y, x in zip((ours, theirs), leaves))
        assert_close(of_ours, of_theirs, 1e-3, 1e-4)

    def test_kernels_against_kornia(self, device):
        for size in (16, 32, 41):
            ours, theirs = K.feature.SIFTDescriptor(size), kornia.feature.SIFTDescriptor(size)
            assert_close(ours.get_pooling_kernel(), theirs.get_pooling_kernel())
            assert_close(ours.get_weighting_kernel(), theirs.get_weighting_kernel())

    def test_flat_patches(self, device):
        flat = torch.ones(1, 1, 32, 32, device=device)
        assert_close(K.feature.SIFTDescriptor(32, rootsift=False)(flat), torch.zeros(1, 128, device=device))
        assert_close(K.feature.SIFTDescriptor(32)(flat), torch.full((1, 128), 1e-5, device=device))

    def test_double_precision(self, device):
        """Angles of float64 are not those of float32: the polynomials of the kernels have enough terms."""
        x = torch.rand(8, 1, 41, 41, device=device, dtype=torch.float64)
        module = K.feature.SIFTDescriptor(41, rootsift=False).to(device, torch.float64)
        with K.backend("reference"):
            expected = module(x)
        assert (module(x) - expected).abs().max() < 1e-13

    def test_directions(self, device):
        """A ramp has one angular bin: that of its direction, from x to y."""
        for a in range(8):
            t = 2 * math.pi * a / 8
            y, x = torch.meshgrid(*[torch.arange(32.0, device=device)] * 2, indexing="ij")
            ramp = math.cos(t) * x + math.sin(t) * y
            descriptor = K.feature.SIFTDescriptor(32, rootsift=False)(ramp[None, None]).reshape(8, 4, 4)
            assert (descriptor[a, 1:3, 1:3] > 0.99 * descriptor[:, 1:3, 1:3].sum(0)).all()


@pytest.mark.parametrize("bins, cells", [(8, 4), (5, 3), (4, 1)])
def test_layouts(bins, cells, device):
    x = torch.rand(3, 2, bins * cells**2, device=device)
    opencv = K.feature.convert_sift_descriptor_layout(x, "kornia", "opencv", bins, cells)
    for y in range(cells):
        for i in range(cells):
            for a in range(bins):
                expected = x[..., (a * cells + y) * cells + i]
                assert torch.equal(opencv[..., (y * cells + i) * bins + (-a) % bins], expected)
    assert torch.equal(K.feature.convert_sift_descriptor_layout(opencv, "opencv", "kornia", bins, cells), x)
    assert torch.equal(K.feature.convert_sift_descriptor_layout(x, "opencv", "opencv", bins, cells), x)
    theirs = kornia.feature.convert_sift_descriptor_layout(x, "kornia", "opencv", bins, cells)
    assert torch.equal(opencv, theirs)


@pytest.mark.parametrize(
    "args, error",
    [
        ((torch.rand(128), "Kornia", "opencv"), ValueError),
        ((torch.rand(128), "kornia", None), ValueError),
        ((torch.rand(127), "kornia", "opencv"), ValueError),
        ((torch.tensor(1.0), "kornia", "opencv"), ValueError),
        (([1.0] * 128, "kornia", "opencv"), TypeError),
        ((torch.rand(128), "kornia", "opencv", 8.0), TypeError),
        ((torch.rand(128), "kornia", "opencv", 0), ValueError),
    ],
)
def test_errors_of_layouts(args, error):
    with pytest.raises(error, match="^convert_sift_descriptor_layout: "):
        K.feature.convert_sift_descriptor_layout(*args)


def test_the_layout_of_opencv_is_opencvs(device):
    """Descriptors of an image by cv2.SIFT at an upright key point have the entries of ours in the same order."""
    generator = np.random.default_rng(0)
    noise = generator.random((120, 120)).astype(np.float32)
    image = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 3), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    # 4 x 4 spatial bins of 3 sigma pixels; a patch of 32 pixels has bins of 8.
    sigma = 4.0
    keypoint = cv2.KeyPoint(60.0, 60.0, 2 * sigma, 0.0, 1.0, 0)
    _, theirs = cv2.SIFT_create().compute(image, [keypoint])
    half_side = 3 * sigma * 2
    laf = torch.tensor([[[[half_side, 0, 60.0], [0, half_side, 60.0]]]], device=device)
    x = torch.from_numpy(image)[None, None].float().to(device) / 255
    patch = K.feature.extract_patches_simple(x, laf, 32)[0]
    ours = K.feature.SIFTDescriptor(32, rootsift=False)(patch)
    opencv = torch.from_numpy(theirs).to(device)
    opencv = opencv / opencv.norm()
    cosine = {
        layout: float((K.feature.convert_sift_descriptor_layout(ours, "kornia", layout) * opencv).sum())
        for layout in ("kornia", "opencv")
    }
    assert cosine["opencv"] > 0.9 and cosine["opencv"] > cosine["kornia"] + 0.2, cosine


def smooth_images(batch, height, width, device, dtype=torch.float64):
    noise = torch.rand(batch, 1, height // 8, width // 8, device=device, dtype=dtype)
    return torch.nn.functional.interpolate(noise, size=(height, width), mode="bicubic")


class TestDenseSIFTDescriptor:
    @pytest.mark.parametrize(
        "options",
        [
            {},
            {"rootsift": False, "spatial_bin_size": 5, "stride": 2, "padding": 3},
            {"num_ang_bins": 6, "num_spatial_bins": 2, "spatial_bin_size": 1, "padding": 0, "clipval": 0.4},
        ],
    )
    def test_against_kornia(self, options, device):
        image = smooth_images(2, 33, 41, device)
        leaves = [image.clone().requires_grad_() for _ in range(2)]
        ours, theirs = (
            module(**options).to(device, torch.float64)(leaf)
            for module, leaf in zip((K.feature.DenseSIFTDescriptor, kornia.feature.DenseSIFTDescriptor), leaves)
        )
        assert_close(ours, theirs, 1e-5, 1e-6)
        weights = torch.rand_like(ours)
        of_ours, of_theirs = (torch.autograd.grad((y * weights).sum(), x)[0] for y, x in zip((ours, theirs), leaves))
        assert_close(of_ours, of_theirs, 1e-3, 1e-3 * float(of_theirs.abs().max()))

    def test_members_against_kornia(self, device):
        image = smooth_images(1, 24, 24, device)
        ours, theirs = K.feature.DenseSIFTDescriptor(), kornia.feature.DenseSIFTDescriptor().to(device, torch.float64)
        assert_close(ours.get_pooling_kernel(), theirs.get_pooling_kernel().cpu().float())
        assert_close(ours.get_gradient_histograms(image), theirs.get_gradient_histograms(image), 1e-5, 1e-6)

    @pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32], ids=str)
    def test_types(self, dtype, device):
        image = smooth_images(1, 24, 24, device).to(dtype)
        descriptors = K.feature.DenseSIFTDescriptor()(image)
        assert descriptors.dtype == dtype
        assert_close(descriptors, K.feature.DenseSIFTDescriptor()(image.double()).to(dtype), 1e-2, 1e-2)

    def test_gradcheck_and_flat_images(self, device):
        dense = K.feature.DenseSIFTDescriptor(4, 2, 2, rootsift=False)
        image = torch.rand(1, 1, 5, 6, device=device, dtype=torch.float64, requires_grad=True)
        assert torch.autograd.gradcheck(dense, image)
        flat = torch.ones(1, 1, 9, 9, device=device, requires_grad=True)
        descriptors = dense(flat)
        assert not descriptors.any()
        assert not torch.autograd.grad(descriptors.sum(), flat)[0].any()

    def test_small_and_empty_images(self, device):
        dense = K.feature.DenseSIFTDescriptor(padding=0)
        assert dense(torch.rand(0, 1, 20, 20, device=device)).shape == (0, 128, 9, 9)
        assert dense(torch.rand(1, 1, 12, 13, device=device)).shape == (1, 128, 1, 2)
        with pytest.raises(ValueError, match="^DenseSIFTDescriptor: expected input of at least 12 pixels a side"):
            dense(torch.rand(1, 1, 11, 20, device=device))

    @pytest.mark.parametrize("wrong, error", [(torch.rand(1, 3, 20, 20), ValueError), ([1.0], TypeError)])
    def test_errors(self, wrong, error):
        with pytest.raises(error, match="^DenseSIFTDescriptor: "):
            K.feature.DenseSIFTDescriptor()(wrong)


class TestSIFTDescriptorFromPyramid:
    def scene(self, device, count=12):
        """Images with frames of all scales; one is empty, one is not finite, one has no area."""
        image = smooth_images(2, 161, 213, device)
        center = torch.rand(2, count, 2, device=device, dtype=torch.float64) * torch.tensor([213.0, 161], device=device)
        scale = 4 * 10 ** torch.rand(2, count, 1, 1, device=device, dtype=torch.float64)
        angle = 360 * torch.rand(2, count, 1, device=device, dtype=torch.float64)
        laf = K.feature.laf_from_center_scale_ori(center, scale, angle)
        laf[..., 0] *= 1.3
        laf[0, 3], laf[1, 2, 0, 0], laf[1, 5, :, 1] = 0, torch.nan, 0
        return image, laf

    @pytest.mark.parametrize(
        "options",
        [{}, {"spatial_bin_size": 5, "rootsift": False, "num_ang_bins": 6, "num_spatial_bins": 3, "clipval": 0.3}],
    )
    def test_against_kornia(self, options, device):
        image, laf = self.scene(device)
        ours = K.feature.SIFTDescriptorFromPyramid(**options)
        theirs = kornia.feature.SIFTDescriptorFromPyramid(**options).to(device, torch.float64)
        assert_close(ours(image, laf), theirs(image, laf), 1e-5, 1e-6)
        frames, descriptors = ours.orient_and_describe(image, laf)
        their_frames, their_descriptors = theirs.orient_and_describe(image, laf)
        # Where two bins are nearly as large, either may be the peak.
        same = (frames - their_frames).nan_to_num().abs().amax((2, 3)) < 1e-3
        assert same.double().mean() > 0.9
        assert_close(descriptors[same], their_descriptors[same], 1e-3, 1e-4)

    def test_frames_without_area_give_zeros_and_stay(self, device):
        image, laf = self.scene(device)
        frames, descriptors = K.feature.SIFTDescriptorFromPyramid().orient_and_describe(image, laf)
        for b, i in ((0, 3), (1, 2), (1, 5)):
            assert not descriptors[b, i].any()
            assert_close(frames[b, i], laf[b, i])
        lengths = descriptors.norm(dim=-1)
        assert ((lengths - 1).abs() < 1e-6).sum() == lengths.numel() - 3

    def test_gradients_are_finite(self, device):
        image, laf = self.scene(device)
        leaves = image.requires_grad_(), laf.requires_grad_()
        frames, descriptors = K.feature.SIFTDescriptorFromPyramid().orient_and_describe(*leaves)
        for grad in torch.autograd.grad(frames.nan_to_num().sum() + descriptors.square().sum(), leaves):
            assert grad.isfinite().all() and grad.any()

    def test_no_frames(self, device):
        image, laf = self.scene(device)
        frames, descriptors = K.feature.SIFTDescriptorFromPyramid().orient_and_describe(image, laf[:, :0])
        assert frames.shape == (2, 0, 2, 3) and descriptors.shape == (2, 0, 128)

    def test_errors(self, device):
        image, laf = self.scene(device)
        for args, error in [
            ((image, laf[:1]), ValueError),
            ((image.expand(-1, 3, -1, -1), laf), ValueError),
            ((image, laf[..., :2]), ValueError),
            ((image, laf.tolist()), TypeError),
        ]:
            with pytest.raises(error, match="^SIFTDescriptorFromPyramid: "):
                K.feature.SIFTDescriptorFromPyramid()(*args)
