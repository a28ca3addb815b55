"""Networks, compared with Kornia's: the same weights give the same results; what `pretrained` takes."""

from __future__ import annotations

import hashlib
import shutil

import kornia.feature as KF
import pytest
import skimage.data
import torch
from torch import nn

import kvision as K
from kvision.feature import _weights

DESCRIPTORS = ("HardNet", "HardNet8", "SOSNet", "TFeat", "HyNet")
OF_PATCHES = (*DESCRIPTORS, "OriNet")
FILES = {"TFeat": "tfeat-liberty.params", "OriNet": "OriNet.pth", "KeyNet": "keynet_pytorch.pth"}


def twins(name: str, device: torch.device, **options: object) -> tuple[nn.Module, nn.Module]:
    """kvision's and Kornia's network with the same random weights."""
    theirs = getattr(KF, name)(pretrained=False, **options)
    state = {
        key: torch.rand_like(x) + 0.5
        if "running_var" in key
        else 0.2 * torch.randn_like(x)
        if x.is_floating_point()
        else x
        for key, x in theirs.state_dict().items()
    }
    theirs.load_state_dict(state)
    ours = getattr(K.feature, name)(pretrained=state, **options)
    assert {k: x.shape for k, x in ours.state_dict().items()} == {k: x.shape for k, x in state.items()}
    return ours.to(device), theirs.eval().to(device)


def compare(ours: nn.Module, theirs: nn.Module, x: torch.Tensor) -> None:
    """Results, and gradients to the input and to all parameters."""
    x.requires_grad_()
    grads = []
    with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):  # TF32 rounds to 10 bits
        results = [net(x) for net in (ours, theirs)]
        torch.testing.assert_close(*results, atol=2e-5, rtol=2e-5)
        for net, y in zip((ours, theirs), results):
            weights = torch.linspace(-1, 1, y.numel(), device=y.device).reshape(y.shape)
            parameters = [p for p in net.parameters() if p.requires_grad]
            grads.append(torch.autograd.grad((weights * y).sum(), (x, *parameters)))
    for a, b in zip(*grads, strict=True):
        scale = max(float(b.abs().max()), 1e-30)  # a unit that is never active has no gradient
        torch.testing.assert_close(a / scale, b / scale, atol=2e-4, rtol=0)


@pytest.mark.parametrize("name", OF_PATCHES)
def test_patches_equal_kornia(name, device):
    compare(*twins(name, device), torch.rand(5, 1, 32, 32, device=device))


@pytest.mark.parametrize("name", ["HardNet", "HardNet8", "OriNet"])
def test_patches_of_little_contrast_equal_kornia(name, device):
    """They are divided by their deviation plus a small number."""
    ours, theirs = twins(name, device)
    x = 0.5 + 1e-5 * torch.rand(5, 1, 32, 32, device=device, dtype=torch.float64)
    with torch.no_grad():
        torch.testing.assert_close(ours.double()(x), theirs.double()(x), atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize("options", [{"is_bias": False}, {"dim_desc": 64, "drop_rate": 0.1}], ids=str)
def test_options_of_hynet(options, device):
    compare(*twins("HyNet", device, **options), torch.rand(3, 1, 32, 32, device=device))


@pytest.mark.parametrize("name", OF_PATCHES)
def test_published_patch_networks(name, data, device):
    if name not in FILES:
        pytest.skip("its weights are not in the sample data")
    path = data / "weights" / FILES[name]
    theirs = getattr(KF, name)(pretrained=False).eval().to(device)
    state = torch.load(path, map_location=device, weights_only=True)
    theirs.load_state_dict(state.get("state_dict", state))
    compare(getattr(K.feature, name)(path).to(device), theirs, torch.rand(5, 1, 32, 32, device=device))


def test_published_keynet(data, device):
    path = data / "weights" / FILES["KeyNet"]
    theirs = KF.KeyNet(pretrained=False).eval().to(device)
    theirs.load_state_dict(torch.load(path, map_location=device, weights_only=True)["state_dict"])
    ours, x = K.feature.KeyNet(str(path)).to(device), torch.rand(2, 1, 45, 61, device=device)
    expected = theirs(x)
    scale = float(expected.abs().max())
    torch.testing.assert_close(ours(x) / scale, expected / scale, atol=1e-5, rtol=0)
    compare(ours, theirs, 0.01 * x)


def test_published_keynet_detector(data, device):
    path = data / "weights" / FILES["KeyNet"]
    theirs = KF.KeyNetDetector(False, 150).eval().to(device)
    theirs.model.load_state_dict(torch.load(path, map_location=device, weights_only=True)["state_dict"])
    image = torch.tensor(skimage.data.camera()[100:300, 100:340] / 255.0, dtype=torch.float32, device=device)[
        None, None
    ]
    ours = K.feature.KeyNetDetector(path, 150).to(device)
    (lafs, responses), (expected, expected_responses) = (detector(image) for detector in (ours, theirs))
    assert lafs.shape == expected.shape and responses.shape == expected_responses.shape
    distances = torch.cdist(K.feature.get_laf_center(lafs)[0], K.feature.get_laf_center(expected)[0])
    assert (distances.amin(1) < 2).float().mean() > 0.9  # Kornia does not refine positions between pixels


def frames(device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """Frames inside of a photograph 160 x 160, and two empty slots."""
    image = torch.tensor(skimage.data.camera()[:160, :160] / 255.0, dtype=torch.float32, device=device)
    centers, scales, angles = (
        100 * torch.rand(1, 20, 2) + 30,
        10 * torch.rand(1, 20, 1, 1) + 5,
        360 * torch.rand(1, 20, 1),
    )
    lafs = K.feature.laf_from_center_scale_ori(centers, scales, angles)
    return torch.cat([lafs, torch.zeros(1, 2, 2, 3)], 1).to(device), image[None, None]


@pytest.mark.parametrize("preserve_orientation", [False, True])
def test_published_affnet(preserve_orientation, data, device):
    path = data / "weights" / "AffNet.pth"
    theirs = KF.LAFAffNetShapeEstimator(False, preserve_orientation).eval().to(device)
    theirs.load_state_dict(torch.load(path, map_location=device, weights_only=True)["state_dict"])
    lafs, image = frames(device)
    result = K.feature.LAFAffNetShapeEstimator(path, preserve_orientation).to(device)(lafs, image)
    torch.testing.assert_close(result[:, :20], theirs(lafs[:, :20], image), atol=1e-2, rtol=1e-3)
    assert torch.equal(result[:, 20:], lafs[:, 20:])  # Kornia makes NaN of empty slots


def test_affnet_adapts_frames(device):
    lafs, image = frames(device)
    network = K.feature.LAFAffNetShapeEstimator(pretrained=False).eval().to(device)
    image.requires_grad_()
    lafs.requires_grad_()
    result = network(lafs, image)
    for value in (K.feature.get_laf_center, K.feature.get_laf_scale):
        torch.testing.assert_close(value(result), value(lafs), atol=1e-3, rtol=1e-3)
    turned = K.feature.get_laf_orientation(result[:, :20]) - K.feature.get_laf_orientation(lafs[:, :20])
    assert ((turned + 180) % 360 - 180).abs().max() < 0.01
    result.square().sum().backward()
    assert image.grad.isfinite().all() and image.grad.abs().sum() > 0 and lafs.grad.isfinite().all()
    assert network(lafs[:, :0], image).shape == (1, 0, 2, 3)
    with pytest.raises(ValueError, match="LAFAffNetShapeEstimator: expected "):
        network(lafs, image.expand(1, 3, 160, 160))


def test_files_in_the_sample_data_have_the_checksums(data):
    names = {"LAFAffNetShapeEstimator": "AffNet.pth", **FILES}
    for name, file in names.items():
        content = (data / "weights" / file).read_bytes()
        assert hashlib.sha256(content).hexdigest() == _weights.PUBLISHED[name].sha256


def test_weights_without_a_checksum_are_said_to_be_unverified(monkeypatch, tmp_path):
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    file = _weights.PUBLISHED["HardNet"].file
    file.parent.mkdir()
    torch.save(K.feature.HardNet(pretrained=False).state_dict(), file)
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    with pytest.warns(UserWarning, match=f"HardNet: the published weights are unverified, .* the SHA-256 {digest}"):
        K.feature.HardNet()


@pytest.mark.parametrize("name", OF_PATCHES)
def test_extreme_patches_are_finite(name, device):
    network = getattr(K.feature, name)(pretrained=False).eval().to(device)
    for x in (torch.full((2, 1, 32, 32), 0.5), torch.zeros(2, 1, 32, 32), torch.zeros(0, 1, 32, 32)):
        x = x.to(device).requires_grad_()
        y = network(x)
        y.sum().backward()
        assert y.isfinite().all() and x.grad.isfinite().all() and len(y) == len(x)


def test_descriptors_have_unit_length(device):
    for name in DESCRIPTORS:
        y = getattr(K.feature, name)(pretrained=False).eval().to(device)(torch.rand(3, 1, 32, 32, device=device))
        assert y.shape == (3, 128)
        if name != "TFeat":
            torch.testing.assert_close(y.norm(dim=1), torch.ones(3, device=device), atol=1e-5, rtol=0)


def test_filter_response_normalization_equals_kornia(device):
    x = torch.randn(2, 3, 4, 5, device=device)
    for options in ({}, {"is_bias": False}, {"is_scale": False}, {"is_eps_leanable": True, "eps": 0.1}):
        ours, theirs = (k.FilterResponseNorm2d(3, **options).to(device) for k in (K.feature, KF.hynet))
        assert set(ours.state_dict()) == set(theirs.state_dict())
        torch.testing.assert_close(ours(x), theirs(x))
    torch.testing.assert_close(K.feature.TLU(3).to(device)(x), KF.hynet.TLU(3).to(device)(x))


def test_hynet_without_bias_of_its_normalization():
    """Kornia's argument is_bias_FRN does nothing."""
    network = K.feature.HyNet(pretrained=False, is_bias_FRN=False)
    assert not any(".0.bias" in name for name, _ in network.layer1.named_parameters())
    assert set(network.state_dict()) == set(KF.HyNet(pretrained=False).state_dict())


# --- pretrained -----------------------------------------------------------------------------------------------------


@pytest.fixture
def hub(tmp_path, monkeypatch):
    """An empty folder of torch.hub, and no network."""
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))

    def download(url: str, *_: object, **__: object) -> None:
        raise OSError("no network")

    monkeypatch.setattr(torch.hub, "download_url_to_file", download)
    return tmp_path / "hub" / "checkpoints"


@pytest.mark.parametrize("name", [*OF_PATCHES, "KeyNet"])
def test_without_network_an_error_says_what_to_do(name, hub):
    checkpoint = _weights.PUBLISHED[name]
    with pytest.raises(RuntimeError, match=f"{name}: the published weights could not be downloaded") as caught:
        getattr(K.feature, name)()
    assert f"Put {checkpoint.url} to {hub / checkpoint.url.rpartition('/')[2]}" in str(caught.value)


def test_files_of_torch_hub_are_taken_and_checked(hub, data):
    hub.mkdir(parents=True)
    shutil.copy(data / "weights" / FILES["TFeat"], hub)
    state = K.feature.TFeat().state_dict()
    assert torch.equal(state["descr.0.bias"], K.feature.TFeat(hub / FILES["TFeat"]).state_dict()["descr.0.bias"])
    with open(hub / FILES["TFeat"], "ab") as file:
        file.write(b"changed")
    with pytest.raises(RuntimeError, match="TFeat: .*tfeat-liberty.params is not https://.*: its SHA-256 is not"):
        K.feature.TFeat()


def test_state_dicts_and_paths(tmp_path):
    state = K.feature.HardNet(pretrained=False).state_dict()
    torch.save({"epoch": 3, "state_dict": state}, tmp_path / "weights.pth")
    for pretrained in (state, {"state_dict": state}, tmp_path / "weights.pth", str(tmp_path / "weights.pth")):
        network = K.feature.HardNet(pretrained)
        assert not network.training
        assert all(torch.equal(x, state[key]) for key, x in network.state_dict().items())
    assert K.feature.HardNet(pretrained=False).training
    with pytest.raises(FileNotFoundError, match="HardNet: expected pretrained to be the path of a file"):
        K.feature.HardNet(tmp_path / "nothing.pth")
    with pytest.raises(RuntimeError, match="SOSNet: pretrained has other weights than the network"):
        K.feature.SOSNet(state)
    with pytest.raises(TypeError, match="HardNet: expected pretrained to be a bool, a path or a state dict, got int"):
        K.feature.HardNet(3)


def test_errors():
    for name in OF_PATCHES:
        network = getattr(K.feature, name)(pretrained=False)
        with pytest.raises(
            ValueError, match=rf"{name}: expected input of shape \(B, 1, 32, 32\), got \(1, 1, 31, 32\)"
        ):
            network(torch.rand(1, 1, 31, 32))
        with pytest.raises(TypeError, match=f"{name}: expected input to be a Tensor, got NoneType"):
            network(None)
        with pytest.raises(TypeError, match=f"{name}: expected input to be floating point"):
            network(torch.zeros(1, 1, 32, 32, dtype=torch.uint8))
    with pytest.raises(ValueError, match=r"KeyNet: expected x of shape \(B, 1, H, W\), got \(1, 3, 32, 32\)"):
        K.feature.KeyNet(pretrained=False)(torch.rand(1, 3, 32, 32))
