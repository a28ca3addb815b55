"""Key points of images."""

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests

G = K.geometry


class TestKeypoints(CompositionTests):
    cases = {
        "keypoints": Case(lambda k, M: G.Keypoints(k).transform_keypoints(M).data, ((2, 5, 2), (2, 3, 3))),
        "keypoints3d": Case(lambda k, p: G.Keypoints3D(k).pad(p).data, ((2, 5, 3), (2, 6))),
    }
    compiled = ()


BAD = [
    (lambda: G.Keypoints(torch.ones(3)), ValueError, r"Keypoints: expected keypoints of shape \(\*, 2\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_videos(device):
    points = torch.rand(2, 3, 4, 2, device=device)
    mirror = torch.tensor([[-1.0, 0, 10], [0, 1, 0], [0, 0, 1]], device=device)
    kornia = pytest.importorskip("kornia").geometry.keypoints.VideoKeypoints.from_tensor(points)
    video = G.VideoKeypoints.from_tensor(points)
    assert isinstance(video, G.Keypoints) and video.temporal_channel_size == 3
    assert torch.equal(video.data, kornia.data) and torch.equal(video.to_tensor(), points)
    moved = video.transform_keypoints(mirror)
    assert isinstance(moved, G.VideoKeypoints) and torch.equal(video.to_tensor(), points)
    torch.testing.assert_close(moved.to_tensor(), kornia.transform_keypoints(mirror[None].expand(6, 3, 3)).to_tensor())
    copy = video.clone()
    assert video.transform_keypoints(mirror, inplace=True) is video and torch.equal(copy.to_tensor(), points)
    assert torch.equal(video.to_tensor(), moved.to_tensor())
    for empty in (points[:0], points[:, :, :0]):
        assert G.VideoKeypoints.from_tensor(empty).to_tensor().shape == empty.shape
    for bad in (points[0], points[..., :1], points[:, :0], [points]):
        with pytest.raises((TypeError, ValueError), match="VideoKeypoints: expected boxes"):
            G.VideoKeypoints.from_tensor(bad)
