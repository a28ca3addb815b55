"""Noise of images: the same on all devices, in all layouts, batches and types; its distribution; its gradients."""

import numpy as np
import pytest
import torch
from scipy import stats
from torch import Tensor

import kvision as K
from kvision.augmentation.draws import philox
from kvision.augmentation.noise import (
    BY_CHANNEL,
    CLAMP,
    MULTIPLY,
    RANDOM,
    SHARED,
    UNIT,
    gaussian_noise,
    salt_and_pepper,
    shot_noise,
    uniform_noise,
)
from op_tests import OpTests, assert_close, instruction_set

KEYS = torch.tensor([0x123456789ABCDEF, -3])
PLAN = [1, 2, 3, 0]  # key, position, draw, same_on_batch
LEVEL = 1e-4 / 40


def parameters(x: Tensor) -> Tensor:
    return torch.rand(x.shape[0], 2) * torch.tensor([0.2, 0.5])


def seeds(x: Tensor) -> Tensor:
    return torch.arange(x.shape[0]) * 7919 - 3


def chosen(x: Tensor) -> Tensor:
    return (torch.arange(x.shape[0]) % 2 == 0).float()


class NoiseTests(OpTests):
    bytes = True
    variants = [
        {"parameters": parameters, "seeds": seeds},
        {"parameters": parameters, "seeds": seeds, "chosen": lambda x: chosen(x).to(torch.int64)},
        {"parameters": parameters, "seeds": seeds, "form": MULTIPLY | SHARED},
        {"parameters": parameters, "seeds": seeds, "chosen": lambda x: chosen(x).to(torch.int64), "form": CLAMP},
    ]
    accepted = ("keys of torch.int64", "keys of another batch", "seeds of torch.int64", "chosen of torch.float32")

    @classmethod
    def function(
        cls, x: Tensor, parameters: Tensor, seeds: Tensor, chosen: Tensor | None = None, form: int = 0
    ) -> Tensor:
        if chosen is not None:
            chosen = chosen.float()  # an integer in the variants, since it has no gradient
        x = x if x.is_floating_point() or x.dtype == torch.uint8 else x.float()
        return cls.operator(x, parameters, KEYS[:1], seeds, chosen, [0, *PLAN[1:], form])

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the classes that call the operator check its input")


class TestGaussianNoise(NoiseTests):
    operator = gaussian_noise
    operators = ("gaussian_noise",)


class TestUniformNoise(NoiseTests):
    operator = uniform_noise
    operators = ("uniform_noise",)


class TestSaltAndPepper(NoiseTests):
    operators = ("salt_and_pepper", "salt_and_pepper_backward")
    variants = [*NoiseTests.variants[:2], {"parameters": parameters, "seeds": seeds, "form": BY_CHANNEL | RANDOM}]

    @staticmethod
    def operator(x: Tensor, parameters: Tensor, *args) -> Tensor:
        # Parameters decide and get no gradient: zero times them, so that the suite may ask for one.
        return salt_and_pepper(x, parameters.detach(), *args) + (0 * parameters.sum()).to(x.dtype)


def photons(x: Tensor, parameters: Tensor, keys: Tensor, seeds: Tensor | None, chosen: Tensor | None, plan: list[int]):
    return shot_noise(x, parameters, keys, seeds, chosen, None, plan)


class TestShotNoise(NoiseTests):
    operator = staticmethod(photons)
    operators = ("shot_noise",)
    differentiable = False
    variants = [
        {"parameters": lambda x: torch.tensor([[0.05, 2.2]]).expand(x.shape[0], 2), "seeds": seeds},
        {
            "parameters": lambda x: torch.tensor([[0.3, 1.0]]).expand(x.shape[0], 2),
            "seeds": seeds,
            "chosen": lambda x: chosen(x).to(torch.int64),
        },
    ]


OPERATORS = [gaussian_noise, uniform_noise, salt_and_pepper]
MIDDLE = torch.tensor([[0.1, 0.4]])


def noisy(operator, x: Tensor, keys: Tensor = KEYS, seeds: Tensor | None = None, plan: list[int] = PLAN) -> Tensor:
    columns = MIDDLE.to(x.device, torch.float64 if x.dtype == torch.float64 else torch.float32)
    return operator(x, columns, keys, seeds, None, plan)


@pytest.mark.parametrize("operator", OPERATORS, ids=lambda o: o.name)
def test_noise_is_a_function_of_key_sample_and_pixel(operator, device):
    x = torch.rand(4, 3, 10, 14, device=device)
    whole = noisy(operator, x)
    assert_close(noisy(operator, x[:2]), whole[:2], 0, 0)
    assert_close(noisy(operator, x, KEYS.to(device)), whole, 0, 0)
    # One plane of pixels, whatever its height and width.
    assert_close(noisy(operator, x.reshape(4, 3, 14, 10)).reshape(x.shape), whole, 0, 0)
    same = noisy(operator, x[:1].expand_as(x), plan=[*PLAN[:3], 1])
    assert_close(same, same[:1].expand_as(same), 0, 0)
    assert_close(same[:1], whole[:1], 0, 0)
    for other in ([0, 2, 3, 0], [1, 3, 3, 0], [1, 2, 4, 0]):
        assert not torch.equal(noisy(operator, x, plan=other), whole)
    assert not torch.equal(whole[0] - x[0], whole[1] - x[1])


@pytest.mark.parametrize("operator", OPERATORS, ids=lambda o: o.name)
def test_seeds_belong_to_samples(operator, device):
    x = torch.rand(1, 2, 9, 11, device=device).expand(6, -1, -1, -1)
    seeds, order = torch.randint(-(2**63), 2**63 - 1, (6,), device=device), torch.randperm(6, device=device)
    whole = noisy(operator, x, seeds=seeds)
    assert_close(noisy(operator, x, seeds=seeds[order]), whole[order], 0, 0)
    assert_close(noisy(operator, x[:1], seeds[2:3].cpu(), plan=[0, *PLAN[1:]]), whole[2:3], 0, 0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16, torch.float64, torch.uint8], ids=str)
@pytest.mark.parametrize("operator", OPERATORS, ids=lambda o: o.name)
def test_samples_that_are_not_chosen_keep_their_bits(operator, dtype, device):
    x = (255 * torch.rand(3, 3, 7, 9)).to(dtype).to(device)
    if dtype != torch.uint8:
        x[1, 0, 0, :4] = torch.tensor([float("nan"), float("inf"), -0.0, 1e-7], dtype=dtype)
    columns = MIDDLE.to(device, torch.float64 if dtype == torch.float64 else torch.float32)
    mask = torch.tensor([1.0, 0.0, 1.0], device=device)
    result = operator(x, columns, KEYS, None, mask, PLAN)
    assert torch.equal(result[1].view(torch.uint8), x[1].view(torch.uint8))
    assert torch.equal(result[2], operator(x, columns, KEYS, None, None, PLAN)[2]) and not torch.equal(result[2], x[2])


def test_devices_give_the_same_noise(device):
    zeros = torch.zeros(2, 3, 61, 67)
    expected = gaussian_noise(zeros, torch.tensor([[0.0, 1.0]]), KEYS, None, None, PLAN)
    result = gaussian_noise(zeros.to(device), torch.tensor([[0.0, 1.0]], device=device), KEYS, None, None, PLAN)
    torch.testing.assert_close(result.cpu(), expected, rtol=2e-6, atol=1e-9)
    x = torch.rand(2, 3, 61, 67)
    assert torch.equal(noisy(salt_and_pepper, x.to(device)).cpu(), noisy(salt_and_pepper, x))
    standard = torch.tensor([[0.0, 1.0]])
    expected = uniform_noise(zeros, standard, KEYS, None, None, PLAN)
    assert torch.equal(uniform_noise(zeros.to(device), standard.to(device), KEYS, None, None, PLAN).cpu(), expected)


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_instruction_sets_give_the_same_noise(isa, device, backend):
    if backend == "reference" or device.type != "cpu":
        pytest.skip("this test is about the kernels of the CPU")
    x = torch.rand(2, 3, 61, 67)
    columns = torch.tensor([[0.0, 1.0]], dtype=torch.float64)
    with K.backend("reference"):
        expected = gaussian_noise(torch.zeros_like(x, dtype=torch.float64), columns, KEYS, None, None, PLAN)
        hits, uniform = noisy(salt_and_pepper, x), noisy(uniform_noise, x)
        in_unit = uniform_noise(torch.zeros_like(x).double(), columns, KEYS, None, None, [*PLAN, UNIT]).float()
    with instruction_set(isa):
        result = gaussian_noise(torch.zeros_like(x), columns.float(), KEYS, None, None, PLAN)
        assert torch.equal(noisy(salt_and_pepper, x), hits)
        assert torch.equal(
            uniform_noise(torch.zeros_like(x), columns.float(), KEYS, None, None, [*PLAN, UNIT]), in_unit
        )
        torch.testing.assert_close(noisy(uniform_noise, x), uniform, rtol=0, atol=1.3e-7)  # sums may be rounded once
    torch.testing.assert_close(result.double(), expected, rtol=1e-6, atol=1e-9)


def test_words_are_those_of_philox(device):
    """Of the block of four pixels, which all channels of salt and pepper share."""
    x = torch.full((1, 2, 3, 3), 0.5, device=device)
    result = salt_and_pepper(x, MIDDLE.to(device) + 0.4, KEYS, None, None, PLAN)[0].cpu()
    for pixel in range(9):
        word = philox(int(KEYS[1]), (PLAN[2], pixel // 4, 0, PLAN[1]))[pixel % 4] / 2**32
        expected = 0.5 if word >= 0.5 else 1.0 if word < 0.5 * 0.8 else 0.0
        assert result.flatten(1)[:, pixel].tolist() == [expected] * 2
    zero, unit = torch.zeros(1, 2, 3, 3, dtype=torch.float64, device=device), torch.tensor([[0.0, 1.0]], device=device)
    result = uniform_noise(zero, unit.double(), KEYS, None, None, PLAN)[0].cpu()
    for channel in range(2):
        for pixel in range(9):
            word = philox(int(KEYS[1]), (PLAN[2], 3 * channel + pixel // 4, 0, PLAN[1]))[pixel % 4]
            signed = word if word < 2**31 else word - 2**32
            assert result[channel].flatten()[pixel] == signed / 2**31
    in_unit = uniform_noise(zero, unit.double(), KEYS, None, None, [*PLAN, UNIT])[0].cpu()
    assert torch.equal(in_unit, (result + 1) / 2)
    rounded = uniform_noise(zero.float(), unit, KEYS, None, None, [*PLAN, UNIT])[0].cpu()
    assert torch.equal(rounded, in_unit.float())


# --- statistics ---


def test_noise_is_uniform(device):
    x = torch.full((2, 3, 80, 100), 5.0, device=device)
    columns = torch.tensor([[1.0, 0.5], [-2.0, 3.0]], device=device)
    result = uniform_noise(x, columns, KEYS, None, None, PLAN).cpu()
    for sample, (mean, half) in zip(result, columns.tolist()):
        assert stats.kstest(sample.flatten(), stats.uniform(5 + mean - half, 2 * half).cdf).pvalue > LEVEL
    flat = ((result - 5 - columns[:, 0, None, None, None].cpu()) / columns[:, 1, None, None, None].cpu()).flatten(2)
    for a, b in [(flat[:, 0], flat[:, 1]), (flat[0], flat[1]), (flat[..., 1:], flat[..., :-1])]:
        assert stats.spearmanr(a.flatten(), b.flatten()).pvalue > LEVEL


def test_noise_is_normal(device):
    x = torch.full((2, 3, 80, 100), 5.0, dtype=torch.float64, device=device)
    columns = torch.tensor([[1.0, 0.5], [-2.0, 3.0]], dtype=torch.float64, device=device)
    result = gaussian_noise(x, columns, KEYS, None, None, PLAN).cpu()
    for sample, (mean, deviation) in zip(result, columns.tolist()):
        assert stats.kstest(sample.flatten(), stats.norm(5 + mean, deviation).cdf).pvalue > LEVEL
    # Neighbors of a block share words. Neither they nor channels nor samples depend on each other, nor do their squares.
    flat = ((result - 5 - columns[:, 0, None, None, None].cpu()) / columns[:, 1, None, None, None].cpu()).flatten(2)
    pairs = [(flat[..., i::4], flat[..., k::4]) for i in range(4) for k in range(i)]
    pairs += [(flat[:, 0], flat[:, 1]), (flat[0], flat[1]), (flat[..., 1:], flat[..., :-1])]
    for a, b in pairs:
        assert stats.spearmanr(a.flatten(), b.flatten()).pvalue > LEVEL
        assert stats.spearmanr(a.flatten() ** 2, b.flatten() ** 2).pvalue > LEVEL


@pytest.mark.parametrize("amount, share", [(0.05, 0.5), (0.3, 0.9), (1.0, 0.25)])
def test_shares_of_salt_and_pepper(amount, share, device):
    x = torch.full((1, 3, 200, 200), 0.5, device=device)
    columns = torch.tensor([[amount, share]], device=device)
    result = salt_and_pepper(x, columns, KEYS, None, None, PLAN)
    assert torch.equal(result, result[:, :1].expand_as(result))
    salt, pepper = int((result[:, 0] == 1).sum()), int((result[:, 0] == 0).sum())
    assert amount == 1 or stats.binomtest(salt + pepper, 40000, amount).pvalue > LEVEL
    assert stats.binomtest(salt, salt + pepper, share).pvalue > LEVEL
    bytes_ = salt_and_pepper((255 * x).byte(), columns, KEYS, None, None, PLAN)
    assert torch.equal(bytes_ == 255, result == 1) and torch.equal(bytes_ == 0, result == 0)
    assert torch.equal(salt_and_pepper(x, 0 * columns, KEYS, None, None, PLAN), x)


@pytest.mark.parametrize("rate", [0.05, 3.0, 63.0, 65.0, 4000.0])
def test_photons_follow_the_poisson_distribution(rate, device):
    """Up to 64 they are quantiles of the words, above they are next to them with a probability of 1e-4 at most."""
    step = float(np.float32(1 / (2 * rate + 20)))
    x = torch.full((1, 2, 150, 200), rate * step, device=device)
    columns = torch.tensor([[step, 1.0]], device=device)
    counts = (photons(x, columns, KEYS, None, None, PLAN) / step).round().cpu().double()
    zero, half = torch.zeros_like(x), torch.tensor([[0.5, 0.5]], device=device)
    u = uniform_noise(zero, half, KEYS, None, None, PLAN).cpu().double().numpy()
    expected = torch.from_numpy(stats.poisson.ppf(u, float(x[0, 0, 0, 0]) / step)).clamp(min=0)
    apart = (counts - expected).abs()
    given = torch.from_numpy(u).float().to(device)
    # The reference rounds numbers to float32 where they are given.
    of_given = (shot_noise(x, columns, KEYS, None, None, given, PLAN) / step).round().cpu().double() - counts
    assert of_given.abs().max() <= 1 and (of_given != 0).double().mean() < 1e-3
    assert apart.max() <= 1 and (apart > 0).double().mean() < (1e-4 if rate < 64 else 5e-4)


# --- gradients ---


@pytest.mark.parametrize("operator", [gaussian_noise, uniform_noise], ids=lambda o: o.name)
def test_gradients_of_added_noise(operator, device):
    x = torch.rand(3, 2, 5, 7, dtype=torch.float64, device=device)
    columns = torch.rand(3, 2, dtype=torch.float64, device=device, requires_grad=True)
    mask = torch.tensor([1.0, 0.0, 1.0], device=device)
    result = operator(x, columns, KEYS, None, mask, PLAN)
    noise = operator(
        torch.zeros_like(x), torch.tensor([[0.0, 1.0]], dtype=x.dtype, device=device), KEYS, None, mask, PLAN
    )
    mean, deviation = columns[:, :1, None, None], columns[:, 1:, None, None]
    assert_close(result, x + mask[:, None, None, None] * mean + deviation * noise)
    (grad,) = torch.autograd.grad(result.sum(), columns)
    assert_close(grad, torch.stack([70 * mask.double(), noise.sum((1, 2, 3))], 1))
    shared = torch.rand(1, 2, dtype=torch.float64, device=device, requires_grad=True)
    (of_one,) = torch.autograd.grad(operator(x, shared, KEYS, None, mask, PLAN).sum(), shared)
    assert_close(of_one, grad.sum(0, keepdim=True))


@pytest.mark.parametrize("form", [MULTIPLY | CLAMP, CLAMP | SHARED])
def test_forms_of_added_noise(form, device):
    """Factors, terms of all channels, and results within the range, where the others have no gradient."""
    x = torch.rand(3, 2, 5, 7, dtype=torch.float64, device=device, requires_grad=True)
    columns = torch.tensor([[0.5, 0.9]], dtype=torch.float64, device=device, requires_grad=True)
    mask = torch.tensor([1.0, 0.0, 1.0], device=device)
    standard = torch.tensor([[0.0, 1.0]], dtype=torch.float64, device=device)
    noise = gaussian_noise(torch.zeros_like(x), standard, KEYS, None, None, [*PLAN, form & SHARED]).detach()
    assert torch.equal(noise[:, 0], noise[:, 1]) == bool(form & SHARED)
    term = columns[0, 0] + columns[0, 1] * noise
    noisy_x = (x * term if form & MULTIPLY else x + term).clamp(0, 1)
    expected = torch.where(mask[:, None, None, None] > 0, noisy_x, x)
    result = gaussian_noise(x, columns, KEYS, None, mask, [*PLAN, form])
    assert_close(result, expected)
    weights = torch.rand_like(result)
    grads, of_expected = (torch.autograd.grad((y * weights).sum(), (x, columns)) for y in (result, expected))
    for grad, e in zip(grads, of_expected):
        assert_close(grad, e)


def test_hits_of_channels_and_random_fill(device):
    """Channels are hit apart, by noise that is uniform and independent of where it is."""
    x = torch.full((1, 3, 100, 100), 2.0, device=device)
    columns = torch.tensor([[0.3, 0.0]], device=device)
    result = salt_and_pepper(x, columns, KEYS, None, None, [*PLAN, BY_CHANNEL | RANDOM])
    hit = result != 2
    assert not torch.equal(hit[:, 0], hit[:, 1])
    assert stats.binomtest(int(hit.sum()), x.numel(), 0.3).pvalue > LEVEL
    assert stats.kstest(result[hit].cpu(), stats.uniform(0, 1).cdf).pvalue > LEVEL
    as_bytes = salt_and_pepper(x.byte(), columns, KEYS, None, None, [*PLAN, BY_CHANNEL | RANDOM])
    assert torch.equal(as_bytes[hit], (255 * result[hit]).round().byte()) and (as_bytes[~hit] == 2).all()
    assert torch.equal(salt_and_pepper(x, columns, KEYS, None, None, PLAN)[:, 0] == 0, hit[:, 0])


def test_pixels_that_are_hit_get_no_gradient(device):
    x = torch.full((2, 3, 9, 9), 0.5, device=device, requires_grad=True)
    result = noisy(salt_and_pepper, x)
    (grad,) = torch.autograd.grad(result.sum(), x)
    assert torch.equal(grad, (result == 0.5).float())


@pytest.mark.native
@pytest.mark.parametrize("operator", OPERATORS, ids=lambda o: o.name)
def test_plans_are_checked(operator, device):
    x, columns = torch.zeros(2, 1, 2, 2, device=device), MIDDLE.to(device)
    for plan, message in (
        ([2, 0, 1, 0], "no key 2"),
        ([0, 0, 1], "four to six numbers"),
        ([0, -1, 1, 0], "out of range"),
        ([0, 0, 1, 0, 64], "a form from 0 to 63"),
    ):
        with pytest.raises(RuntimeError, match=f"{operator.name}: .*{message}"):
            operator(x, columns, KEYS, None, None, plan)
