"""Fractal noise that is drawn where it is made."""

import pytest
import torch

from kvision.augmentation.keys import Keys
from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.random_generator.fractal_noise import _fractal_noise, fractal_noise
from op_tests import assert_close
from point_op_tests import NUMBER, SINGLE_AND_DOUBLE, Call, PointOpTests

KEYS = torch.tensor([0x123456789ABCDEF, -3])
PLAN = (1, 2, 700, 0)


def seed() -> torch.Tensor:
    return torch.randint(-(2**62), 2**62, ())


class TestFractalNoiseOperators(PointOpTests):
    calls = {
        "fractal_noise": [
            Call(
                (NUMBER, KEYS, seeds),
                (PLAN, size),
                broadcasts=False,
                per_sample=seeds is not None,
                differentiable=False,
                dtypes=SINGLE_AND_DOUBLE,
                accepted=("keys", "seeds", "size"),
            )
            for seeds, size in ((seed, [2, 11, 7]), (None, [1, 3, 20]))
        ]
    }


@pytest.mark.parametrize("size", [(1, 1), (3, 3), (2, 70), (129, 4), (66, 130), (200, 257)], ids=str)
def test_maps_are_those_of_the_reference(size, device):
    """Of sizes that are upright, wide and square, of one tile and of several; rounded to float32 from float64."""
    roughness = torch.tensor([0.1, 0.5, 0.7])
    for same in (0, 1):
        y = _fractal_noise(roughness.to(device), KEYS, None, (*PLAN[:3], same), [2, *size]).cpu()
        expected = _fractal_noise.reference(roughness, KEYS, None, (*PLAN[:3], same), [2, *size])
        assert_close(y, expected, 1e-7, 1e-8)
        assert torch.equal(y[0, 0], y[0, 1]) is False


def test_source(device):
    """Numbers of another augmentation are others, and seeds stand for samples."""
    roughness = torch.full((2,), 0.4, device=device)

    def drawn(number: int, seeds: torch.Tensor | None = None) -> torch.Tensor:
        keys = Keys(KEYS, None if seeds is None else seeds.to(device), seeds is not None)
        return fractal_noise(roughness, PixelNoise(keys, number, False, roughness.device), (1, 20, 30))

    first, second = drawn(0), drawn(1)
    assert not torch.equal(first, second) and not torch.equal(first[0], first[1])
    of_seeds = drawn(0, torch.tensor([7, 7]))
    assert torch.equal(of_seeds[0], of_seeds[1])
