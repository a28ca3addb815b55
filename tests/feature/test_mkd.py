from pathlib import Path

import kornia
import pytest
import torch

import kvision as K
from op_tests import assert_close

WEIGHTS = Path(__file__).parents[3] / "shared" / "data" / "weights"
SIZES = {"cart": 63, "polar": 175, "concat": 238}


def published(kernel_type):
    path = WEIGHTS / f"mkd-{kernel_type}-64.pth"
    if not path.exists():
        pytest.skip(f"{path.name} is not here")
    return path


def whitening(size):
    """Statistics of descriptors that are as large as published ones."""
    generator = torch.Generator().manual_seed(0)
    vectors = torch.linalg.qr(torch.randn(size, size, generator=generator)).Q
    values = torch.rand(size, generator=generator).sort(descending=True).values + 0.01
    model = {"mean": 0.1 * torch.rand(size, generator=generator), "eigvecs": vectors, "eigvals": values}
    return {"liberty": {"pca": model, "lw": model}}


@pytest.fixture
def patches(device):
    return torch.rand(5, 1, 32, 32, device=device)


def kornias(monkeypatch, weights, *args):
    monkeypatch.setattr("kornia.feature.mkd.load_state_dict_from_url", lambda *_, **__: weights)
    return kornia.feature.MKDDescriptor(*args)


@pytest.mark.parametrize("kernel_type", SIZES)
@pytest.mark.parametrize("kind", [None, "pca", "pcawt", "pcaws", "lw"])
def test_against_kornia(kernel_type, kind, patches, monkeypatch):
    weights = whitening(SIZES[kernel_type])
    args = (32, kernel_type, kind, "liberty", 50)
    ours = K.feature.MKDDescriptor(*args, pretrained=weights).to(patches.device)
    theirs = kornias(monkeypatch, weights, *args).to(patches.device)
    leaves = [patches.clone().requires_grad_() for _ in range(2)]
    descriptors, expected = ours(leaves[0]), theirs(leaves[1])
    assert descriptors.shape == (5, SIZES[kernel_type] if kind is None else 50)
    assert_close(descriptors, expected, 1e-3, 1e-4)
    direction = torch.rand_like(descriptors)
    of_ours, of_theirs = (
        torch.autograd.grad((y * direction).sum(), x)[0] for y, x in zip((descriptors, expected), leaves)
    )
    assert_close(of_ours, of_theirs, 1e-2, 1e-2 * float(of_theirs.abs().max()))


@pytest.mark.parametrize("kernel_type", ["cart", "concat"])
def test_published_whitening(kernel_type, patches, monkeypatch):
    path = published(kernel_type)
    weights = torch.load(path, weights_only=True)
    for kind, training_set in (("pcawt", "liberty"), ("lw", "notredame"), ("pcaws", "yosemite")):
        ours = K.feature.MKDDescriptor(32, kernel_type, kind, training_set, pretrained=path)
        theirs = kornias(monkeypatch, weights, 32, kernel_type, kind, training_set)
        assert_close(ours(patches.cpu()), theirs(patches.cpu()), 1e-3, 1e-4)


def test_lengths_types_and_no_patches(device, patches):
    mkd = K.feature.MKDDescriptor(whitening=None).to(device)
    for dtype in (torch.float16, torch.float32, torch.float64):
        descriptors = mkd(patches.to(dtype))
        assert descriptors.dtype == dtype
        assert_close(descriptors.float().norm(dim=1), torch.ones(5, device=device), 1e-2, 1e-2)
    assert mkd(patches[:0]).shape == (0, 238)
    assert mkd((255 * patches).byte()).dtype == torch.float32


def test_flat_patches_are_finite(device):
    flat = torch.ones(2, 1, 32, 32, device=device, requires_grad=True)
    descriptors = K.feature.MKDDescriptor(pretrained=whitening(238)).to(device)(flat)
    (grad,) = torch.autograd.grad(descriptors.sum(), flat)
    assert descriptors.isfinite().all() and torch.equal(grad, torch.zeros_like(grad))


def test_gradcheck(device):
    mkd = K.feature.MKDDescriptor(6, "concat", None).to(device, torch.float64)
    x = torch.rand(1, 1, 6, 6, device=device, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(mkd, x)


def test_without_network(monkeypatch, tmp_path):
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    monkeypatch.setattr(
        torch.hub, "download_url_to_file", lambda *_, **__: (_ for _ in ()).throw(OSError("no network"))
    )
    with pytest.raises(RuntimeError, match="^MKDDescriptor: .*no network.*mkd-concat-64.pth"):
        K.feature.MKDDescriptor()


@pytest.mark.parametrize(
    "call, error",
    [
        (lambda: K.feature.MKDDescriptor(0, whitening=None), ValueError),
        (lambda: K.feature.MKDDescriptor(kernel_type="round", whitening=None), ValueError),
        (lambda: K.feature.MKDDescriptor(whitening="white", pretrained=whitening(238)), ValueError),
        (lambda: K.feature.MKDDescriptor(training_set="paris", pretrained=whitening(238)), ValueError),
        (lambda: K.feature.MKDDescriptor(training_set="yosemite", pretrained=whitening(238)), ValueError),
        (lambda: K.feature.MKDDescriptor(pretrained=whitening(63)), ValueError),
        (lambda: K.feature.MKDDescriptor(pretrained=3), TypeError),
        (lambda: K.feature.MKDDescriptor(whitening=None)([1.0]), TypeError),
        (lambda: K.feature.MKDDescriptor(whitening=None)(torch.rand(1, 1, 31, 31)), ValueError),
        (lambda: K.feature.MKDDescriptor(whitening=None)(torch.rand(1, 3, 32, 32)), ValueError),
    ],
)
def test_errors(call, error):
    with pytest.raises(error, match="^MKDDescriptor: "):
        call()
