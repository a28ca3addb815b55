"""GPUs whose blocks have less shared memory than those that kernels were tuned for: smaller tiles, or other kernels."""

import os
import subprocess
import sys

import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode

from kvision._shared_memory import fitting


@pytest.mark.parametrize("kilobytes, most", [("", 224), ("163", 160), ("99", 97), ("64", 63), ("300", 224)])
def test_limits_scale_with_shared_memory(kilobytes: str, most: int, device, monkeypatch) -> None:
    if device.type == "cuda":
        pytest.skip("this GPU's own shared memory would limit them further")
    monkeypatch.setenv("KVISION_SHARED_MEMORY", kilobytes and str(int(kilobytes) << 10))
    assert fitting(torch.empty(1), 224) == 224
    with FakeTensorMode():
        assert fitting(torch.empty(1, device="cuda"), 224) == most


# Each call takes more shared memory than some GPUs have where it can.
PROGRAM = """
import sys, torch, kvision as K

def calls(x, y, double):
    yield K.losses.ssim_loss(x, y, 11)
    yield K.metrics.ssim(double, double.flip(-1), 7)
    yield K.losses.MS_SSIMLoss().to(x)(x, y)
    yield K.losses.MS_SSIMLoss().to(double)(double, double.flip(-1))
    yield K.filters.gaussian_blur2d(x, (101, 101), (17.0, 17.0))
    yield K.filters.gaussian_blur2d(double, (201, 201), (30.0, 30.0))
    yield K.filters.box_blur(x, (40, 40))
    yield K.filters.filter2d(x, y[:1, 0, :41, :41])
    yield K.filters.filter2d_separable(x, y[:1, 0, 0, :99], y[:1, 0, 1, :99])
    yield K.filters.bilateral_blur(x, (31, 31), 0.1, (5.0, 5.0))
    yield K.morphology.dilation(x, torch.ones(45, 45, device=x.device))
    yield K.morphology.dilation(x, torch.ones(3, 201, device=x.device))
    yield K.enhance.equalize(x)
    yield K.enhance.equalize_clahe(x, grid_size=(2, 100))
    yield K.enhance.histogram(x.flatten(1), torch.linspace(0, 1, 256, device=x.device), torch.tensor(0.001, device=x.device))
    yield K.geometry.resize(x, (40, 900), antialias=True)
    yield K.augmentation.RandomResizedCrop((120, 700), antialias=True)(x, seed=1)
    yield K.feature.SIFTDescriptor(80).to(x)(x[:, :1, :80, :80])
    yield K.feature.SIFTDescriptor(64).to(double)(double[:, :1, :64, :64])
    yield K.losses.focal_loss(x.reshape(2, 200, -1, 1), y.reshape(2, 200, -1, 1)[:, 0].mul(199).long(), 0.5, reduction="mean")

generator = torch.Generator().manual_seed(0)
x, y = torch.rand(2, 2, 2, 200, 260, generator=generator).cuda()
for backend in ("auto", "reference"):
    with K.backend(backend):
        a, b, double = (t.clone().requires_grad_() for t in (x, y, x.double()))
        numbers = [result.detach().double().abs().mean().item() for result in calls(a, b, double) if not result.sum().backward()]
        print(" ".join(map(repr, numbers + [t.grad.double().abs().mean().item() for t in (a, b, double)])))
"""


@pytest.mark.parametrize("kilobytes", [64, 99, 163])
def test_results_do_not_depend_on_shared_memory(kilobytes: int, device) -> None:
    if device.type == "cpu":
        pytest.skip("shared memory is a GPU's")
    environment = {**os.environ, "KVISION_SHARED_MEMORY": str(kilobytes << 10)}
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    native, reference = (list(map(float, line.split())) for line in done.stdout.splitlines())
    assert native == pytest.approx(reference, rel=1e-4)
