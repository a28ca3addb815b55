"""Disks with blurred edges."""

import cv2
import numpy as np
import pytest
import torch

from kvision.augmentation.corruption.disk import disk_kernels
from op_tests import assert_close
from point_op_tests import NUMBER, SINGLE_AND_DOUBLE, Call, PointOpTests


def radius() -> torch.Tensor:
    return torch.randint(1, 11, ())


class TestDiskKernelsOperators(PointOpTests):
    calls = {
        "disk_kernels": [
            Call(
                (NUMBER, radius),
                (largest,),
                broadcasts=False,
                dtypes=SINGLE_AND_DOUBLE,
                accepted=("of torch.int64", "largest"),
            )
            for largest in (10, 12)
        ]
    }


@pytest.mark.parametrize("radius", [1, 3, 7, 8, 9, 12])
def test_disks_are_those_of_opencv(radius, device):
    """As Albumentations and ImageNet-C make them."""
    reach, window = max(8, radius), 3 if radius <= 8 else 5
    at = np.arange(-reach, reach + 1)
    disk = (at**2 + at[:, None] ** 2 <= radius**2).astype(np.float32)
    expected = cv2.GaussianBlur(disk / disk.sum(), (window, window), 0.5)
    for largest in (radius, 12):
        y = disk_kernels(torch.tensor([0.5]).to(device), torch.tensor([radius]).to(device), largest)[0].cpu()
        own = (y.shape[0] - 1) // 2
        small = min(own, reach)
        parts = (slice(n - small, n + small + 1) for n in (own, reach))
        ours, theirs = (k[part, part] for k, part in zip((y, torch.from_numpy(expected)), parts))
        assert_close(ours, theirs, 1e-5, 1e-7)
        assert abs(float(y.sum() - expected.sum())) < 1e-5
