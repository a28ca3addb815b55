import kornia
import pytest
import torch

import kvision as K
from op_tests import OpTests, assert_close
from raw_calls import wrong_calls


def frames(x, count=5, largest=1.0):
    """Frames (B, count, 2, 3) in pixels of `x`: some of a pixel, some larger than the image, some over its border."""
    generator = torch.Generator().manual_seed(0)
    b, (h, w) = x.shape[0], x.shape[-2:]
    scale = 0.6 * (1.5 * largest * min(h, w)) ** torch.rand(b, count, 1, 1, generator=generator, dtype=torch.float64)
    shape = torch.eye(2, dtype=torch.float64) + 0.4 * torch.randn(b, count, 2, 2, generator=generator).double()
    center = torch.rand(b, count, 2, 1, generator=generator, dtype=torch.float64) * torch.tensor([[w], [h]]) - 0.5
    return torch.cat([scale * shape, center], -1)


class PatchTests(OpTests):
    @pytest.fixture(autouse=True)
    def same_bits_where_asked(self, device, request):
        """On CUDA the image gradient is a sum by atomics, unless torch is set to deterministic algorithms."""
        asks = request.function.__name__ in ("test_threads_and_runs_give_the_same_bits", "test_gradcheck")
        torch.use_deterministic_algorithms(device.type == "cuda" and asks, warn_only=True)
        yield
        torch.use_deterministic_algorithms(False)

    def test_empty_lists_of_frames(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        x.requires_grad_()
        laf = kwargs["laf"][:, :0].requires_grad_()
        patches = self.call(x, {**kwargs, "laf": laf})
        assert patches.shape == (x.shape[0], 0, x.shape[1], kwargs["PS"], kwargs["PS"])
        patches.sum().backward()
        assert torch.equal(x.grad, torch.zeros_like(x)) and laf.grad.shape == laf.shape

    @pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
    def test_frames_that_are_not_finite_give_zeros(self, variant, bad, device):
        x, kwargs = self.setup(variant, device, torch.float64)
        whole = kwargs["laf"]
        expected = self.call(x, kwargs)
        broken = whole.clone()
        broken[0, 1, 0, 2], broken[-1, 2, 1, 0] = bad, bad
        leaves = [x.clone().requires_grad_(), broken.requires_grad_()]
        patches = self.call(leaves[0], {**kwargs, "laf": leaves[1]})
        zeros = torch.zeros_like(patches[0, 1])
        assert torch.equal(patches[0, 1], zeros) and torch.equal(patches[-1, 2], zeros)
        assert_close(patches[0, 0], expected[0, 0])
        of_image, of_laf = torch.autograd.grad(patches.sum(), leaves)
        assert of_image.isfinite().all() and of_laf.isfinite().all()
        assert torch.equal(of_laf[0, 1], torch.zeros_like(of_laf[0, 1]))

    def test_huge_finite_frames_are_finite(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        kwargs["laf"] = kwargs["laf"] * 1e30
        leaf = kwargs["laf"].requires_grad_()
        patches = self.call(x, kwargs)
        assert patches.isfinite().all()
        patches.sum().backward()
        assert leaf.grad.isfinite().all()

    def test_normalized_frames(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float64)
        normalized = kornia.feature.normalize_laf(kwargs["laf"], x)
        again = self.call(x, {**kwargs, "laf": normalized, "normalize_lafs_before_extraction": False})
        assert_close(again, self.call(x, kwargs))

    def test_against_kornia(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float64)
        leaves, others = ([t.clone().requires_grad_() for t in (x, kwargs["laf"])] for _ in range(2))
        actual = self.call(leaves[0], {**kwargs, "laf": leaves[1]})
        expected = getattr(kornia.feature, self.function.__name__)(others[0], others[1], PS=kwargs["PS"])
        assert_close(actual, expected, 1e-7, 1e-7)
        weights = torch.rand_like(actual)
        of_actual = torch.autograd.grad((actual * weights).sum(), leaves)
        of_expected = torch.autograd.grad((expected * weights).sum(), others)
        assert_close(of_actual[0], of_expected[0], 1e-6, 1e-6)
        assert_close(of_actual[1], of_expected[1], 1e-5, 1e-5)

    def test_operators_refuse_bad_arguments(self, device, backend, monkeypatch):
        """A window of another size is valid: it only selects other levels."""
        monkeypatch.setattr("raw_calls.wrong_calls", lambda *a: [c for c in wrong_calls(*a) if "window" not in c[0]])
        super().test_operators_refuse_bad_arguments(device, backend)

    def test_errors_of_frames(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        laf = kwargs["laf"]
        for wrong, error in [
            (laf[:1].expand(3, -1, -1, -1), ValueError),
            (laf[..., :2], ValueError),
            (laf[0], ValueError),
            (laf.long(), TypeError),
            (laf.tolist(), TypeError),
        ]:
            with pytest.raises(error, match=f"^{self.function.__name__}: expected laf"):
                self.call(x, {**kwargs, "laf": wrong})


class TestExtractPatchesSimple(PatchTests):
    function = staticmethod(K.feature.extract_patches_simple)
    operators = ("sample_patches", "sample_patches_backward")
    variants = [{"laf": frames, "PS": 6}, {"laf": lambda x: frames(x, 3), "PS": 1}]
    max_size = 9  # the kernel's vectors and blocks are those of a patch
    errors = [({"PS": 0}, ValueError, "expected PS"), ({"PS": 2.5}, TypeError, "expected PS")]

    def test_a_frame_of_half_the_patch_is_a_crop(self, device):
        image = torch.rand(1, 2, 9, 11, device=device)
        laf = torch.tensor([[[[2.5, 0, 5], [0, 2.5, 4]]]], device=device)
        assert_close(K.feature.extract_patches_simple(image, laf, 5)[0, 0], image[0, :, 2:7, 3:8])

    def test_the_border_is_repeated(self, device):
        image = torch.rand(1, 1, 4, 4, device=device)
        laf = torch.tensor([[[[1.0, 0, -50], [0, 1, 1.5]]]], device=device)
        patch = K.feature.extract_patches_simple(image, laf, 2)[0, 0, 0]
        assert_close(patch, image[0, 0, 1:3, :1].expand(2, 2))


class TestExtractPatchesFromPyramid(PatchTests):
    function = staticmethod(K.feature.extract_patches_from_pyramid)
    operators = ("pyramid_patches", "sample_patches", "sample_patches_backward", "resize", "resize_backward")
    uncompiled = ("pyramid_patches",)
    accepted = (
        "border reflect around a pixel",  # of resize_backward, whose result is the pixel
        *("input cut along axis -1", "input cut along axis -2"),  # images of any size have a pyramid
    )
    variants = [{"laf": frames, "PS": 3}]
    max_size = 17  # of up to three levels
    shape = (2, 3, 26, 37)
    small = (1, 1, 8, 9)

    def test_levels_follow_the_scale(self, device):
        """A frame reads the level at which its samples are one to two pixels apart, and the last one if it is larger."""
        image = torch.rand(1, 1, 64, 64, device=device)
        levels = [image]
        for _ in range(3):
            levels.append(K.geometry.pyrdown(levels[-1]))
        for half_side, level in [(2.0, 0), (4.0, 0), (7.9, 0), (8.0, 1), (15.9, 1), (16.0, 2), (32.0, 3), (500.0, 3)]:
            laf = torch.tensor([[[[half_side, 0, 31.5], [0, half_side, 31.5]]]], device=device)
            factor = 2**level
            on_level = torch.cat([laf[..., :2] / factor, (laf[..., 2:] + 0.5) / factor - 0.5], -1)
            expected = K.feature.extract_patches_simple(levels[level], on_level, 8)
            assert_close(K.feature.extract_patches_from_pyramid(image, laf, 8), expected)

    def test_images_smaller_than_a_patch(self, device):
        image = torch.rand(1, 1, 5, 3, device=device)
        laf = frames(image, 4).float().to(device)
        patches = K.feature.extract_patches_from_pyramid(image, laf, 32)
        assert_close(patches, K.feature.extract_patches_simple(image, laf, 32))

    @pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16], ids=str)
    def test_half_images_have_float32_frames(self, dtype, device):
        image = torch.rand(1, 1, 300, 400, device=device)
        laf = frames(image, 20, 0.1).float().to(device).requires_grad_()
        patches = K.feature.extract_patches_from_pyramid(image.to(dtype), laf, 8)
        assert patches.dtype == dtype
        promoted = K.feature.extract_patches_from_pyramid(image.to(dtype).float(), laf, 8)
        assert_close(patches, promoted.to(dtype), 2e-2, 2e-2)
        patches.float().sum().backward()
        assert laf.grad.dtype == torch.float32 and laf.grad.isfinite().all()

    @pytest.mark.native  # references of half types round each level, or none where one operator has them all
    @pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16], ids=str)
    def test_patches_do_not_depend_on_requires_grad(self, dtype, device):
        image = torch.rand(2, 3, 41, 50, device=device).to(dtype)
        laf = frames(image, 20).float().to(device)
        patches = K.feature.extract_patches_from_pyramid(image, laf, 5)
        assert torch.equal(patches, K.feature.extract_patches_from_pyramid(image.requires_grad_(), laf, 5))
