import kornia
import pytest
import torch
from torch.nn.functional import interpolate

import kvision as K
from op_tests import assert_close
from patch_tests import SquarePatchTests, of_patches


class TestPatchAffineShapeEstimator(SquarePatchTests):
    kind = K.feature.PatchAffineShapeEstimator
    function = staticmethod(of_patches(K.feature.PatchAffineShapeEstimator))
    operators = ("affine_shape", "affine_shape_backward")
    variants = [{}, {"eps": 0.0}]
    errors = [({"eps": -1}, ValueError, "expected eps"), ({"eps": "small"}, TypeError, "expected eps")]

    def test_against_kornia(self, device):
        for n in (19, 32):
            x = torch.rand(6, 1, n, n, device=device, dtype=torch.float64)
            x = x + torch.linspace(0, 3, n, device=device) * (1 + torch.linspace(0, 1, n, device=device)[:, None])
            leaves = [x.clone().requires_grad_() for _ in range(2)]
            ours = K.feature.PatchAffineShapeEstimator(n)(leaves[0])
            theirs = kornia.feature.PatchAffineShapeEstimator(n).to(device, torch.float64)(leaves[1])
            assert_close(ours, theirs, 1e-6, 1e-6)
            of_ours, of_theirs = (
                torch.autograd.grad(y[..., 1].sum(), leaf)[0] for y, leaf in zip((ours, theirs), leaves)
            )
            assert_close(of_ours, of_theirs, 1e-5, 1e-6)

    def test_mirrored_patches_have_mirrored_ellipses(self, device):
        """A negative b is not a small one."""
        x = torch.rand(4, 1, 19, 19, device=device, dtype=torch.float64) + torch.linspace(0, 9, 19, device=device)
        x = x + torch.linspace(0, 2, 19, device=device)[:, None]
        estimator = K.feature.PatchAffineShapeEstimator(19)
        sign = torch.tensor([1.0, -1.0, 1.0], device=device, dtype=torch.float64)
        assert_close(estimator(x.flip(-1)), estimator(x) * sign)
        thin = 1e-4 * x  # c is below eps, b is negative in one of the two
        estimator = K.feature.PatchAffineShapeEstimator(19, eps=5e-13)
        assert_close(estimator(thin.flip(-1)), estimator(thin) * sign)

    @pytest.mark.parametrize("axis", [2, 3])
    def test_flat_and_one_directional_patches_are_circles(self, axis, device):
        circle = torch.tensor([[[1.0, 0.0, 1.0]]], device=device)
        estimator = K.feature.PatchAffineShapeEstimator(19)
        assert torch.equal(estimator(torch.zeros(1, 1, 19, 19, device=device)), circle)
        ramp = torch.linspace(0, 1, 19, device=device).reshape(1, 1, 1, 19).expand(1, 1, 19, 19).transpose(3, axis)
        assert torch.equal(estimator(ramp.contiguous()), circle)

    def test_is_invariant_to_contrast_and_brightness(self, variant, device):
        super().test_is_invariant_to_contrast_and_brightness(variant, device)

    def test_nan_stays_in_its_window(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        x[0, 0, 6, 7] = torch.nan
        output = self.call(x, kwargs)
        self.check(output[1:], self.expected(x, kwargs)[1:])
        assert output[0].isnan().any()


class TestLAFAffineShapeEstimator:
    def scene(self, device, batch=2, count=5):
        image = interpolate(
            torch.rand(batch, 1, 12, 12, device=device, dtype=torch.float64), size=(96, 96), mode="bicubic"
        )
        center = torch.rand(batch, count, 2, device=device, dtype=torch.float64) * 48 + 24
        scale = torch.full((batch, count, 1, 1), 12.0, device=device, dtype=torch.float64)
        angle = 360 * torch.rand(batch, count, 1, device=device, dtype=torch.float64) - 180
        return K.feature.laf_from_center_scale_ori(center, scale, angle), image

    @pytest.mark.parametrize("preserve", [True, False])
    def test_against_kornia(self, preserve, device):
        laf, image = self.scene(device)
        ours = K.feature.LAFAffineShapeEstimator(19, preserve_orientation=preserve)(laf, image)
        theirs = kornia.feature.LAFAffineShapeEstimator(19, preserve_orientation=preserve).to(device, torch.float64)
        expected = theirs(laf, image)
        # Kornia takes a negative b for a small one, and then a circle.
        assert_close(ours, expected, 1e-5, 1e-5)

    def test_centers_scales_and_orientations_stay(self, device):
        laf, image = self.scene(device)
        adapted = K.feature.LAFAffineShapeEstimator()(laf, image)
        for property in (K.feature.get_laf_center, K.feature.get_laf_scale, K.feature.get_laf_orientation):
            assert_close(property(adapted), property(laf), 1e-6, 1e-6)
        assert not torch.allclose(adapted, laf)

    def test_frames_without_area_stay(self, device):
        laf, image = self.scene(device)
        laf[0, 1] = 0
        laf[1, 2, 0, 0] = torch.nan
        laf[1, 3, :, 1] = 0
        for preserve in (True, False):
            leaf = laf.clone().requires_grad_()
            image = image.detach().requires_grad_()
            adapted = K.feature.LAFAffineShapeEstimator(preserve_orientation=preserve)(leaf, image)
            if preserve:
                assert_close(adapted[0, 1], laf[0, 1])
                assert_close(adapted[1, 2:4], laf[1, 2:4])
            assert adapted[1, 2, :, 2].isfinite().all()
            of_image, of_laf = torch.autograd.grad(adapted.nan_to_num().sum(), (image, leaf))
            assert of_image.isfinite().all() and of_laf.isfinite().all()

    def test_flat_images_keep_the_frames(self, device):
        laf, image = self.scene(device)
        adapted = K.feature.LAFAffineShapeEstimator()(laf, torch.full_like(image, 0.5))
        assert_close(adapted, laf, 1e-6, 1e-6)

    def test_no_frames(self, device):
        laf, image = self.scene(device)
        assert K.feature.LAFAffineShapeEstimator()(laf[:, :0], image).shape == (2, 0, 2, 3)

    @pytest.mark.derivatives
    def test_gradcheck(self, device):
        laf, image = self.scene(device, 1, 2)
        image = image[..., ::4, ::4].contiguous()
        laf = laf / 4
        torch.use_deterministic_algorithms(device.type == "cuda", warn_only=True)
        estimator = K.feature.LAFAffineShapeEstimator(7)
        assert torch.autograd.gradcheck(estimator, (laf.requires_grad_(), image.requires_grad_()))
        torch.use_deterministic_algorithms(False)

    def test_errors(self, device):
        laf, image = self.scene(device)
        for bad_laf, bad_image, error in [
            (laf[0], image, ValueError),
            (laf[:1], image, ValueError),
            (laf, image.expand(-1, 3, -1, -1), ValueError),
            (laf.tolist(), image, TypeError),
        ]:
            with pytest.raises(error, match="^LAFAffineShapeEstimator: "):
                K.feature.LAFAffineShapeEstimator()(bad_laf, bad_image)
