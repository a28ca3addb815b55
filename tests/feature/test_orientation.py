import math

import cv2
import kornia
import numpy as np
import pytest
import torch

import kvision as K
from kvision.feature.orientation import dominant_orientations, orientation_slots
from op_tests import assert_close
from patch_tests import SquarePatchTests, of_patches
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, vector


def ramps(n, count, device="cpu"):
    """Patches that grow in `count` directions, and these, counter-clockwise as seen in the image."""
    angles = torch.linspace(-math.pi, math.pi, count, dtype=torch.float64, device=device)
    x = torch.arange(n, dtype=torch.float64, device=device) - (n - 1) / 2
    c, s = angles.cos()[:, None, None, None], -angles.sin()[:, None, None, None]
    return c * x + s * x[:, None], angles


def difference(a, b):
    return torch.remainder(a - b + math.pi, 2 * math.pi) - math.pi


class TestPatchDominantGradientOrientation(SquarePatchTests):
    kind = K.feature.PatchDominantGradientOrientation
    function = staticmethod(of_patches(K.feature.PatchDominantGradientOrientation))
    operators = ("orientation", "orientation_backward")
    variants = [{}, {"num_angular_bins": 8}, {"num_angular_bins": 5}]
    errors = [
        ({"num_angular_bins": 2}, ValueError, "expected num_angular_bins"),
        ({"num_angular_bins": 36.0}, TypeError, "expected num_angular_bins"),
        ({"eps": "small"}, TypeError, "expected eps"),
    ]
    tolerances = {torch.float32: (1e-4, 2e-5), torch.float16: (1e-2, 1e-2)}

    def input(self, shape, dtype, device):
        """Patches with one dominant direction: where two bins are equally large, rounding decides between them."""
        if dtype == torch.uint8 or shape[-1] != shape[-2]:
            return super().input(shape, dtype, device)
        n = shape[-1]
        patches, _ = ramps(n, max(1, math.prod(shape[:-2])) + 2)
        patches = patches[1:-1][: math.prod(shape[:-2])] / max(n, 1)
        noise = torch.rand(patches.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(n))
        return (patches + 0.2 * noise / max(n, 1)).reshape(shape).to(dtype).to(device)

    def test_within_a_degree(self, device):
        for n in (19, 32, 41):
            patches, angles = ramps(n, 721, device)
            error = difference(K.feature.PatchDominantGradientOrientation(n)(patches), angles)
            assert error.abs().max() < math.radians(1)

    def test_the_sense_is_the_opposite_of_opencvs(self, device):
        """Key points of cv2.SIFT have their angles clockwise."""
        noise = np.random.default_rng(0).random((300, 300)).astype(np.float32)
        image = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 4), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
        keypoints = cv2.SIFT_create().detect(image, None)
        positions = [k.pt for k in keypoints]
        keypoints = [k for k in keypoints if positions.count(k.pt) == 1 and min(*k.pt) > 40 and max(*k.pt) < 260]
        center = torch.tensor([[k.pt for k in keypoints]], dtype=torch.float32, device=device)
        theirs = torch.tensor([k.angle for k in keypoints], device=device).deg2rad()
        # OpenCV's window has a sigma of 1.5 times that of the key point, ours of a third of the frame.
        scale = torch.tensor([4.5 * k.size / 2 for k in keypoints], device=device).reshape(1, -1, 1, 1)
        laf = K.feature.laf_from_center_scale_ori(center, scale)
        x = torch.from_numpy(image)[None, None].float().to(device)
        ours = K.feature.PatchDominantGradientOrientation(32)(K.feature.extract_patches_simple(x, laf, 32)[0])
        assert len(keypoints) > 50
        assert (difference(ours, -theirs).abs() < math.radians(20)).float().mean() > 0.8
        assert (difference(ours, theirs).abs() < math.radians(20)).float().mean() < 0.3

    def test_against_kornia(self, device):
        for n in (19, 32):
            x = self.input((8, 1, n, n), torch.float64, device)
            leaves = [x.clone().requires_grad_() for _ in range(2)]
            ours, theirs = (
                module(n).to(device, torch.float64)(leaf)
                for module, leaf in zip(
                    (K.feature.PatchDominantGradientOrientation, kornia.feature.PatchDominantGradientOrientation),
                    leaves,
                )
            )
            assert_close(difference(ours, theirs), torch.zeros_like(ours), 0, 1e-4)
            of_ours, of_theirs = (torch.autograd.grad(y.sum(), leaf)[0] for y, leaf in zip((ours, theirs), leaves))
            assert_close(of_ours, of_theirs, 1e-2, 1e-3 * float(of_theirs.abs().max()))

    def test_is_invariant_to_contrast_and_brightness(self, variant, device):
        super().test_is_invariant_to_contrast_and_brightness({**variant, "eps": 0.0}, device)


class TestLAFOrienter:
    def frames(self, image, count=6):
        b, side = image.shape[0], image.shape[-1]
        center = torch.rand(b, count, 2, dtype=image.dtype, device=image.device) * side / 2 + side / 4
        scale = torch.full((b, count, 1, 1), side / 8, dtype=image.dtype, device=image.device)
        angle = 360 * torch.rand(b, count, 1, dtype=image.dtype, device=image.device) - 180
        return K.feature.laf_from_center_scale_ori(center, scale, angle)

    def test_x_axis_is_rotated_onto_the_gradient(self, device):
        for patch, angle in zip(*ramps(96, 9, device)):
            image = patch[None] / 96
            turned = K.feature.LAFOrienter()(self.frames(image), image)
            result = torch.deg2rad(K.feature.get_laf_orientation(turned))
            assert difference(result, angle).abs().max() < math.radians(1)

    def test_against_kornia(self, device):
        image = torch.nn.functional.interpolate(
            torch.rand(2, 1, 16, 16, device=device, dtype=torch.float64), size=(96, 96), mode="bicubic"
        )
        laf = self.frames(image)
        ours = K.feature.LAFOrienter(19)(laf, image)
        theirs = kornia.feature.LAFOrienter(19).to(device, torch.float64)(laf, image)
        close = (ours - theirs).abs().amax((2, 3)) < 1e-3
        assert close.double().mean() > 0.9  # two peaks may be nearly as large

    def test_custom_detector(self, device):
        class Quarter(torch.nn.Module):
            def forward(self, patches):
                return torch.full((len(patches),), math.pi / 2, device=patches.device)

        image = torch.rand(1, 1, 40, 40, device=device)
        laf = self.frames(image)
        turned = K.feature.LAFOrienter(32, angle_detector=Quarter())(laf, image)
        assert_close(turned, K.feature.rotate_laf(laf, torch.full((1, 6, 1), 90.0, device=device)))

    def test_empty_slots_and_no_frames(self, device):
        image = torch.rand(2, 1, 40, 40, device=device, requires_grad=True)
        laf = self.frames(image.detach())
        laf[0, 1] = 0
        turned = K.feature.LAFOrienter()(laf.requires_grad_(), image)
        assert torch.equal(turned[0, 1], torch.zeros_like(turned[0, 1]))
        assert all(g.isfinite().all() for g in torch.autograd.grad(turned.sum(), (laf, image)))
        assert K.feature.LAFOrienter()(laf[:, :0], image).shape == (2, 0, 2, 3)

    @pytest.mark.derivatives
    def test_gradcheck(self, device):
        image = torch.nn.functional.interpolate(
            torch.rand(1, 1, 5, 5, device=device, dtype=torch.float64), size=(20, 20), mode="bicubic"
        )
        laf = self.frames(image, 2)
        torch.use_deterministic_algorithms(device.type == "cuda", warn_only=True)
        orienter = K.feature.LAFOrienter(9)
        assert torch.autograd.gradcheck(orienter, (laf.requires_grad_(), image.requires_grad_()))
        torch.use_deterministic_algorithms(False)

    def test_errors(self, device):
        image = torch.rand(2, 1, 40, 40, device=device)
        laf = self.frames(image)
        for bad_laf, bad_image, error in [
            (laf[0], image, ValueError),
            (laf[:1], image, ValueError),
            (laf, image[0], ValueError),
            (laf, image.expand(-1, 3, -1, -1), ValueError),
            (laf.long(), image, TypeError),
            (None, image, TypeError),
        ]:
            with pytest.raises(error, match="^LAFOrienter: "):
                K.feature.LAFOrienter()(bad_laf, bad_image)


class TestSeveralOrientations(SquarePatchTests):
    """The peaks of a patch, the largest first."""

    function = staticmethod(dominant_orientations)
    operators = ("orientation", "orientation_backward")
    variants = [{"count": 2}, {"count": 3, "threshold": 0.2}]
    tolerances = {torch.float32: (1e-4, 5e-5), torch.float16: (1e-2, 1e-2)}

    test_gradient_at_ties_and_bounds = None  # which of equal peaks counts

    def input(self, shape, dtype, device):
        """Patches that grow to the right, and, half as wide, almost as much downwards."""
        if dtype == torch.uint8 or shape[-1] != shape[-2]:
            return super().input(shape, dtype, device)
        n = shape[-1]
        x = torch.linspace(-1, 1, n, dtype=torch.float64).abs()
        noise = torch.rand(math.prod(shape), dtype=torch.float64, generator=torch.Generator().manual_seed(n))
        corner = torch.maximum(x, 0.97 * x[:, None] + 0.02) + 0.02 * x
        level = 0.02 if n > 2 else 1  # two pixels are as far right as left: without noise, their peaks would be equal
        return (corner + level * noise.reshape(shape)).to(dtype).to(device)

    test_patches_of_another_size = None  # they say which size they have

    def test_two_directions(self, device):
        """The second peak counts where it is at least `threshold` times the first one; the first angle is that of the module."""
        n = 32
        x = torch.arange(n, dtype=torch.float64, device=device) - (n - 1) / 2
        right, down = x.expand(n, n), x[:, None].expand(n, n)
        patches = torch.stack(
            [torch.where(right > down, a * right, b * down) for a, b in ((1, 0.9), (1, 0.5), (0.9, 1))]
        )
        angles = dominant_orientations(patches[:, None], 3)
        assert difference(angles[:, 0], torch.tensor([0, 0, -math.pi / 2], device=device)).abs().max() < 0.06
        assert difference(angles[:, 1], torch.tensor([-math.pi / 2, 0, 0], device=device)).abs().max() < 0.06
        assert (angles[1] == angles[1, 0]).all() and (angles[:, 2] == angles[:, 0]).all()
        assert_close(angles[:, 0], K.feature.PatchDominantGradientOrientation(n)(patches[:, None]))


def some_frames():
    """Eight slots of frames, of which the last two are empty."""
    return 5 * torch.rand(8, 2, 3, dtype=torch.float64) * (torch.arange(8) < 6)[:, None, None]


def some_angles():
    """Three different angles of each frame: results are not differentiable where angles are equal."""
    return 6 * torch.rand(8, 3, dtype=torch.float64) - 3


class TestOrientationSlots(PointOpTests):
    calls = {
        "orientation_slots": [Call((some_frames, vector(8), some_angles), dtypes=SINGLE_AND_DOUBLE, broadcasts=False)]
    }

    def test_slots_are_in_order(self, device):
        laf = torch.eye(2, 3, device=device).expand(1, 4, 2, 3).clone()
        laf[0, :, 0, 2] = torch.tensor([5.0, 6, 7, 0])
        laf[0, 3] = 0
        angles = torch.tensor([[[0.0, 1, 0], [1, 1, 1], [2, 3, 4], [0, 1, 2]]], device=device)
        responses = torch.tensor([[9.0, 8, 7, 0]], device=device)
        frames, scores = orientation_slots(laf, responses, angles)
        assert scores.tolist() == [[9, 9, 8, 7]] and frames[0, :, 0, 2].tolist() == [5, 5, 6, 7]
        degrees = K.feature.get_laf_orientation(frames)[0, :, 0]
        assert_close(degrees, torch.rad2deg(torch.tensor([0.0, 1, 1, 2], device=device)), 1e-5, 1e-5)
        frames, scores = orientation_slots(laf[:, 2:], responses[:, 2:], angles[:, 2:, :1])
        assert scores.tolist() == [[7, 0]] and (frames[0, 1] == 0).all()
