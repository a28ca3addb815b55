"""Images made of pieces of the images of a batch, and the pieces of mixing augmentations."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import kvision.augmentation as A
from kvision.augmentation.mixing.pieces import MIX_KIND, make_piece, mix_pieces, paste_pieces
from op_tests import OpTests, assert_close
from point_op_tests import Call, PointOpTests, vector


def pieces(x: Tensor, weight: float = 1.0) -> Tensor:
    """Windows over the border, one within the other, of a partner at a distance, and of the sample itself."""
    batch, height, width = x.shape[0], x.shape[2], x.shape[3]
    partner = torch.arange(batch).roll(1)
    rows = [
        ([1, 0, width - 1, height], partner, [-1, 1], weight),
        ([-2, -3, 2, 2], None, [2, 1], 1.0),
        ([width // 2, 1, width + 4, height - 1], partner.roll(1), [0, 0], 0.25),
    ]
    made = [
        make_piece(torch.tensor([w]).expand(batch, 4), p, torch.tensor([s]).expand(batch, 2), v) for w, p, s, v in rows
    ]
    return torch.stack(made, 1)


class TestPastePieces(OpTests):
    operators = ("paste_pieces", "paste_pieces_backward")
    bytes = True
    variants = [
        {"pieces": lambda x: (4 * pieces(x, 0.5)).long(), "size": None},
        {"pieces": lambda x: (4 * pieces(x)).long(), "size": (5, 9)},
    ]
    accepted = ("pieces of torch.float32",)
    mixed = ("images", "grad", "pieces")

    @staticmethod
    def function(x: Tensor, pieces: Tensor, size: tuple[int, int] | None) -> Tensor:
        # Pieces get no gradient, so that the variants have integers: four times the numbers.
        x = x if x.is_floating_point() or x.dtype == torch.uint8 else x.float()
        return paste_pieces(x, pieces.float() / 4, list(size or x.shape[-2:]))

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the classes that call the operator check its input")


COMMON = {"broadcasts": False, "per_sample": False, "differentiable": False, "dtypes": (torch.float32,) * 2}


class TestMixPieces(PointOpTests):
    plans = (
        (0, 1, -1, 1, 1, 1, 12, 18, 12, 18),
        (1, 1, 0, 2, 1, 1, 12, 18, 12, 18),
        (2, 0, -1, 1, 5, 3, 12, 18, 12, 18),
        (3, 1, 0, 6, 2, 3, 12, 18, 12, 18),
        (4, 1, 0, 5, 2, 2, 12, 18, 9, 14),
    )
    calls = {"mix_pieces": [Call((vector(10),), (list(plan), [0.2, 0.7]), **COMMON) for plan in plans]}


def test_a_piece_is_read_at_a_distance_and_zero_is_outside(device):
    x = torch.arange(12.0, device=device).reshape(2, 1, 2, 3)
    piece = make_piece(torch.tensor([[1.0, 0, 3, 2]] * 2), torch.tensor([1, 0]), torch.tensor([[-1, 1]] * 2)).to(device)
    y = paste_pieces(x, piece[:, None], [2, 3])
    assert y.flatten(1).tolist() == [[0, 9, 10, 3, 0, 0], [6, 3, 4, 9, 0, 0]]
    half = torch.cat([piece[:, :8], torch.full((2, 1), 0.5, device=device)], 1)
    assert paste_pieces(x, half[:, None], [2, 3])[0].flatten().tolist() == [0, 5, 6, 3, 2, 2.5]


def test_integers_are_copied(device):
    x = torch.arange(2**24, 2**24 + 8, device=device).reshape(2, 1, 2, 2)
    piece = make_piece(torch.tensor([[0.0, 0, 2, 1]] * 2), torch.tensor([1, 0])).to(device)
    y = paste_pieces(x, piece[:, None], [2, 2])
    assert torch.equal(y[:, :, 0], x[:, :, 0].flip(0)) and torch.equal(y[:, :, 1], x[:, :, 1])


def test_gradients_are_gathered(device):
    x = torch.rand(5, 2, 6, 8, dtype=torch.float64, device=device, requires_grad=True)
    of = pieces(x, 0.5).to(device)
    grad = torch.rand(5, 2, 6, 8, dtype=torch.float64, device=device)
    (to_x,) = torch.autograd.grad(paste_pieces(x, of, [6, 8]), x, grad)
    y = torch.rand_like(grad)
    assert_close((grad * paste_pieces(y, of, [6, 8])).sum(), (to_x * y).sum())


def test_many_pieces_of_many_rows(device):
    """More cells than a warp has threads, in rows of more vectors than a block, and pieces that overlap those that read."""
    x = torch.randint(0, 200, (3, 2, 40, 1200), device=device).double().requires_grad_()
    made = []
    for n in range(60):
        window = torch.randint(-20, 60, (3, 4)) * torch.tensor([20, 1, 20, 1])
        window[:, 2:] = window[:, :2] + torch.tensor([300, 9])
        partner = torch.arange(3) if n % 3 else torch.arange(3).roll(n)
        made.append(make_piece(window, partner, torch.randint(-9, 9, (3, 2)), (1.0, 0.5, 0.25)[n % 3]))
    of = torch.stack(made, 1).to(device)
    y = paste_pieces(x, of, [40, 1200])
    assert_close(y, paste_pieces.reference(x, of, [40, 1200]))
    grad = torch.randint(0, 200, y.shape, device=device).double()
    (to_x,) = torch.autograd.grad(y, x, grad)
    assert_close(to_x, torch.autograd.grad(paste_pieces.reference(x, of, [40, 1200]), x, grad)[0])


CLASSES = {
    "mixup": A.RandomMixUpV2((0.1, 0.9)),
    "cutmix": A.RandomCutMixV2(num_mix=2, cut_size=(0.2, 0.7), p=0.6),
    "patch_mix": A.PatchMix(patch_size=(5, 3), p=0.6),
    "jigsaw": A.RandomJigsaw((2, 3), p=0.6),
    "mosaic": A.RandomMosaic((9, 14), (2, 3), p=0.6),
}


@pytest.mark.parametrize("kind", MIX_KIND)
def test_pieces_of_the_kernel_are_those_of_the_parameters(kind, device):
    """As the reference of `mix_pieces` has them, in every entry."""
    mix, x = CLASSES[kind], torch.rand(7, 1, 12, 18, device=device)
    for seed in range(20):
        execution = mix._draw(x, seed, None)
        made = mix._drawn_pieces(execution)
        assert torch.equal(made, mix_pieces.reference(*_arguments(mix, execution)))


def _arguments(mix, execution):
    kind, count, grid, numbers = mix._mix_plan(execution.shape)
    span, shape = execution.columns.span, execution.shape
    sizes = [*grid, *shape[-2:], *mix._output_size(shape)]
    chosen = span.first if span.has_chosen else -1
    return execution.columns.drawn, [MIX_KIND[kind], span.first_value, chosen, count, *sizes], numbers


@pytest.mark.native
@pytest.mark.parametrize("kind", MIX_KIND)
def test_a_mix_is_a_few_launches(kind):
    """Draws, pieces and images are three operators, however many samples, windows and cells there are."""
    mix, x = CLASSES[kind], torch.rand(7, 3, 9, 14) if kind == "mosaic" else torch.rand(7, 3, 12, 18)
    if kind == "patch_mix":
        assert mix(x).shape == x.shape
    mix(x)
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU]) as profile:
        mix(x)
    own = [event.name for event in profile.events() if event.name.startswith("kvision::")]
    assert own == ["kvision::draw_parameters", "kvision::mix_pieces", "kvision::paste_pieces"]
