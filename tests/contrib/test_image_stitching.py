"""Panoramas, with a matcher that returns the true correspondences."""

from __future__ import annotations

import pytest
import torch

import kvision as K


class Matches(torch.nn.Module):
    """Points of the image on the right, and where a homography takes them, some of them wrong."""

    def __init__(self, homography, wrong=0):
        super().__init__()
        self.homography, self.wrong = homography, wrong

    def forward(self, data):
        assert data["image0"].shape[1] == data["image1"].shape[1] == 1
        b, device = data["image0"].shape[0], data["image0"].device
        right = torch.rand(b, 60, 2, generator=torch.Generator().manual_seed(0)) * 40
        left = K.geometry.transform_points(self.homography.expand(b, 3, 3), right)
        left[:, : self.wrong] += torch.rand(b, self.wrong, 2) * 30 + 10
        samples = torch.arange(b).repeat_interleave(60)
        matches = {"keypoints0": left.flatten(0, 1), "keypoints1": right.flatten(0, 1), "batch_indexes": samples}
        return {name: value.to(device) for name, value in matches.items()}


def shift(x, y=0.0):
    return torch.tensor([[[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]]])


@pytest.mark.parametrize("estimator, wrong", [("ransac", 20), ("vanilla", 0)])
@pytest.mark.parametrize("channels", [1, 3])
def test_crops_are_stitched_into_the_image(estimator, wrong, channels, device):
    wide = torch.rand(2, channels, 30, 90, device=device)
    stitch = K.contrib.ImageStitcher(Matches(shift(30.0), wrong), estimator)
    result = stitch(wide[..., :50], wide[..., 30:])
    assert result.shape[:3] == wide.shape[:3] and abs(result.shape[3] - 90) <= 1
    torch.testing.assert_close(result[..., 1:88], wide[..., 1:88], atol=2e-2, rtol=0)


def test_three_images_and_gradients(device):
    wide = torch.rand(1, 3, 20, 70, device=device, requires_grad=True)
    stitcher = K.contrib.ImageStitcher(Matches(shift(20.0)), "vanilla")
    panorama, mask = stitcher.stitch_pair(wide[..., :30], wide[..., 20:50])
    assert panorama.shape == (1, 3, 20, 60) and mask.shape == (1, 1, 20, 60)
    stitcher.matcher.homography = shift(40.0)
    panorama, mask = stitcher.stitch_pair(panorama, wide[..., 40:], mask)
    stitched = stitcher.postprocess(panorama, mask)
    torch.testing.assert_close(stitched[..., 1:68], wide[..., 1:68], atol=2e-2, rtol=0)
    stitched.sum().backward()
    assert wide.grad.isfinite().all() and wide.grad.sum() > 0.9 * wide.numel()


@pytest.mark.parametrize("x", [30.3, 30.5, 30.8])
def test_seam_is_not_dark(x, device):
    """The edge of the warped image lies between pixels, and white stays white on both sides of it."""
    white = torch.ones(1, 3, 30, 50, device=device)
    stitched = K.contrib.ImageStitcher(Matches(shift(x)), "vanilla")(white, white)
    assert stitched.shape[3] >= 80 and stitched[..., :80].min() > 0.999  # a column beyond may begin there by rounding


def test_errors():
    matcher, x = Matches(shift(1.0)), torch.rand(1, 3, 8, 8)
    with pytest.raises(NotImplementedError, match="estimator must be"):
        K.contrib.ImageStitcher(matcher, "magic")
    with pytest.raises(TypeError, match="expected matcher"):
        K.contrib.ImageStitcher(None)
    with pytest.raises(ValueError, match="at least two images"):
        K.contrib.ImageStitcher(matcher)(x)
    with pytest.raises(ValueError, match="expected images of one B, C, H"):
        K.contrib.ImageStitcher(matcher)(x, x[:, :, 1:])

    class Few(torch.nn.Module):
        def forward(self, data):
            nothing = torch.zeros(0, 2)
            return {"keypoints0": nothing, "keypoints1": nothing, "batch_indexes": torch.zeros(0, dtype=torch.int64)}

    with pytest.raises(RuntimeError, match="at least 4 matches"):
        K.contrib.ImageStitcher(Few())(x, x)
