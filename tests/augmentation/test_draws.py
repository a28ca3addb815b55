"""Random parameters: their distributions, what they depend on, and the same bits everywhere."""

import itertools
import math

import pytest
import torch
from scipy import stats
from torch import Tensor

import kvision as K
from kvision.augmentation.draws import (
    KINDS,
    MAX_DRAWS,
    MAX_NUMBERS,
    Draw,
    Request,
    are_chosen_batches,
    draw_list_parameters,
    draw_parameters,
    integer,
    is_chosen_batch,
    make_plan,
    philox,
    uniform,
)
from kvision.augmentation.keys import draw_keys, seeds_of_samples
from op_tests import instruction_set
from point_op_tests import Call, PointOpTests, vector

KEYS = torch.tensor([0x123456789ABCDEF, -3, 2**62, 11, 5, 0x5DEECE66D])
N = 20000

CROP = Draw("resized_crop", (0.08, 1.0, math.log(3 / 4), math.log(4 / 3), 97, 131))
TALL = Draw("resized_crop", (0.9, 1.0, -1.9, -1.8, 97, 31))  # none fits: the largest one
RECTANGLE = Draw("rectangle", (0.02, 0.33, 0.3, 3.3, 97, 131))
WIDE = Draw("rectangle", (0.5, 2.0, 0.1, 0.4, 20, 30))
HOLES = Draw("rectangles", (12, 1, 2, 9, 1, 0.1, 0.4, 0, 30, 40))
# Those with the same bits everywhere, and those of the C library's or CUDA's logarithm and cosine.
EXACT = [
    Request([Draw("chosen"), uniform(-1, 2.5, 0.5), integer(3, 17, 3, step=2)], 0.7, 0.8),
    Request([Draw("exponential_of_uniform", (-0.3, 0.4, 1.0)), Draw("permutation", (6, 0, 1)), uniform(0, 1)], 0.9),
    Request([CROP, TALL, RECTANGLE, WIDE, Draw("permutation", (1, 0, 0))], 0.9),
    Request([uniform(0, 1), Draw("permutation", (9, 8, -1))], 1.0, 1.0, True),
    Request([Draw("uniform_and_affine", (-0.3, 0.3, 0.7, 0.1, 0.25))], 0.9),
    Request([uniform(0, 1), Draw("uniform_of_sample", (0, 2, -1)), HOLES], 0.9, 1.0, True),
]
ROUNDED = [
    Request([Draw("beta", (0.4, 0.4, 0.1)), Draw("beta", (3.0, 2.0, 0.1)), Draw("normal", (1.0, 2.0, 0.0))], 0.9)
]


def images(batch: int, device: torch.device | str = "cpu") -> Tensor:
    return torch.zeros(batch, 1, 1, 1, device=device)


def drawn(requests: list[Request], batch: int, device: torch.device, keys: Tensor = KEYS, seeds: Tensor | None = None):
    plan = make_plan(requests, has_seed=seeds is not None)
    return draw_parameters(images(batch, device), keys, seeds, plan.plan, plan.numbers)


def _of_each(plan: list[int], numbers: list[float], first: Request):
    own = [n for draw in first.draws for n in draw.numbers]
    return lambda batch: (plan, numbers, own * batch, list(range(len(first.draws))))


class TestDrawParameters(PointOpTests):
    exact, rounded, seeded = make_plan(EXACT), make_plan(ROUNDED), make_plan(EXACT, True, 3)
    accepted = ("images of", "keys of torch.int64", "keys of another batch", "seeds of torch.int64")
    common = {"broadcasts": False, "differentiable": False, "accepted": accepted}
    calls = {
        "draw_parameters": [
            Call((vector(2, 3), KEYS, None), exact[:2], per_sample=False, **common),
            Call((vector(2, 3), KEYS, None), rounded[:2], per_sample=False, **common),
            Call((vector(2, 3), KEYS[:1], lambda: torch.randint(-(2**63), 2**63 - 1, ())), seeded[:2], **common),
        ],
        "draw_list_parameters": [
            Call((vector(2, 3), KEYS, None), _of_each(*exact[:2], EXACT[0]), per_sample=False, **common)
        ],
    }


@pytest.mark.parametrize("seeds", [None, "seeds"])
def test_numbers_of_each_sample(device, backend, seeds):
    """Each row is that of a batch whose images are all of this size. 600 samples take several launches of the kernel."""
    batch = 12 if backend == "reference" else 600
    sizes = [(40 + b % 3, 300 - b % 4) for b in range(batch)]
    seeds = None if seeds is None else torch.arange(batch, device=device) * 7919 - 5
    plans, listed = {}, [1, 2, 3]
    for size in set(sizes):
        crops = [Draw(draw.kind, (*draw.numbers[:4], *size)) for draw in (CROP, RECTANGLE)]
        requests = [Request([uniform(0, 1), *crops, integer(0, size[0])], 0.9)]
        requests.append(Request([CROP, Draw("number", (7.0 * size[0],))]))
        plans[size] = make_plan(requests, seeds is not None)
        plans[size] = (plans[size], [n for i in listed for n in requests[0].draws[i].numbers] + [7.0 * size[0]])
    x, (plan, numbers, _) = images(batch, device), plans[sizes[0]][0]
    of_each = [n for size in sizes for n in plans[size][1]]
    result = draw_list_parameters(x, KEYS[:2], seeds, plan, numbers, of_each, [*listed, 5])
    for size, (of_size, _) in plans.items():
        of_this = torch.tensor([s == size for s in sizes], device=device)
        expected = draw_parameters(x, KEYS[:2], seeds, of_size.plan, of_size.numbers)
        assert torch.equal(result[of_this], expected[of_this]) and (result[of_this, -1] == 7 * size[0]).all()
    assert draw_list_parameters(x[:0], KEYS[:2], None, plan, numbers, [], [1]).shape == (0, plan[0])


def test_bad_numbers_of_samples(device, backend):
    if backend == "reference":
        pytest.skip("plans are made by the library; the kernel reads them")
    plan = make_plan([Request([Draw("permutation", (3, 0, 1))])])
    with pytest.raises(RuntimeError, match="expected 3 numbers for each of 2 images, got 5"):
        draw_list_parameters(images(2, device), KEYS[:1], None, *plan[:2], [3, 0, 1, 3, 0], [0])
    with pytest.raises(RuntimeError, match="expected draws of 3 columns, got 4"):
        draw_list_parameters(images(2, device), KEYS[:1], None, *plan[:2], [3, 0, 1, 4, 0, 1], [0])
    with pytest.raises(RuntimeError, match="there is no draw 1 to list"):
        draw_list_parameters(images(2, device), KEYS[:1], None, *plan[:2], [3, 0, 1, 3, 0, 1], [1])


# --- what the parameters depend on ---


def test_known_answers_of_philox():
    """The vectors of Random123, the library of the generator's authors."""
    ones, pi = [0xFFFFFFFF] * 4, [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344]
    assert philox(0, (0, 0, 0, 0)) == (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)
    assert philox(-1, ones) == (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)
    assert philox(0x299F31D0A4093822, pi) == (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1)
    tensors = [torch.tensor([0, a]) for a in pi]
    assert [int(word[1]) for word in philox(torch.tensor([0, 0x299F31D0A4093822]), tensors)] == [
        *(0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1)
    ]


def test_words_of_the_operator_are_those_of_philox(device):
    key, position = int(KEYS[1]), 5
    plan = make_plan([Request([uniform(0, 1), uniform(0, 2.0**20)])], True, position)
    result = draw_parameters(images(3, device), KEYS[1:2], None, plan.plan, plan.numbers).cpu()
    for sample, index in itertools.product(range(3), (1, 2)):
        unit = philox(key, (index, 0, sample, position))[0] / 2**32
        assert result[sample, index - 1] == torch.tensor(unit * (1, 2.0**20)[index - 1], dtype=torch.float32)


def test_kernel_equals_reference(device, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    native = drawn(EXACT + ROUNDED, N, device, torch.cat([KEYS, KEYS[:1]]))
    with K.backend("reference"):
        reference = drawn(EXACT + ROUNDED, N, device, torch.cat([KEYS, KEYS[:1]]))
    whole = (reference == reference.round()).all(0)
    assert whole.sum() == 46 and torch.equal(native[:, whole], reference[:, whole])
    torch.testing.assert_close(native, reference, rtol=2.0**-22, atol=1e-12)


def test_devices_give_the_same_bits(device):
    assert torch.equal(drawn(EXACT, N, device).cpu(), drawn(EXACT, N, torch.device("cpu")))
    torch.testing.assert_close(
        drawn(ROUNDED, N, device).cpu(), drawn(ROUNDED, N, torch.device("cpu")), rtol=2.0**-22, atol=1e-12
    )


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_instruction_sets_give_the_same_bits(isa, device, backend):
    if backend == "reference" or device.type != "cpu":
        pytest.skip("this test is about the kernels of the CPU")
    expected = drawn(EXACT, 2000, torch.device("cpu"))
    with instruction_set(isa):
        assert torch.equal(drawn(EXACT, 2000, torch.device("cpu")), expected)


def test_keys_may_be_on_the_device(device):
    assert torch.equal(drawn(EXACT, 9, device, KEYS.to(device)), drawn(EXACT, 9, device))


def test_a_sample_does_not_depend_on_its_batch(device):
    whole = drawn(EXACT, 100, device)
    for batch in (0, 1, 33):
        assert torch.equal(drawn(EXACT, batch, device), whole[:batch])


def test_requests_do_not_depend_on_each_other(device):
    whole, plan = drawn(EXACT, 50, device), make_plan(EXACT)
    ends = [*plan.first_columns[1:], plan.plan[0]]
    for i, (first, end) in enumerate(zip(plan.first_columns, ends)):
        assert torch.equal(drawn(EXACT[i : i + 1], 50, device, KEYS[i : i + 1]), whole[:, first:end])


def test_seeds_belong_to_samples(device):
    seeds = torch.randint(-(2**63), 2**63 - 1, (40,), device=device)
    whole, order = drawn(EXACT, 40, device, KEYS[:1], seeds), torch.randperm(40, device=device)
    assert torch.equal(drawn(EXACT, 40, device, KEYS[:1], seeds[order]), whole[order])
    plan = make_plan(EXACT, has_seed=True)
    for i in (0, 7):
        alone = draw_parameters(images(1, device), seeds[i : i + 1].cpu(), None, plan.plan, plan.numbers)
        assert torch.equal(alone, whole[i : i + 1])


def test_positions_tell_equal_requests_apart(device):
    requests = [Request([uniform(0, 1)])] * 3
    plan = make_plan(requests, True)
    result = draw_parameters(images(5, device), KEYS[:1], None, plan.plan, plan.numbers)
    assert result.flatten().unique().numel() == 15
    later = make_plan(requests[1:], True, 1)
    assert torch.equal(draw_parameters(images(5, device), KEYS[:1], None, later.plan, later.numbers), result[:, 1:])


def test_same_on_batch(device):
    result = drawn([Request([uniform(0, 1), CROP], 0.5, 1.0, True)], 20, device, KEYS[1:2])
    assert torch.equal(result, result[:1].expand(20, -1))
    assert torch.equal(result[:1], drawn([Request([uniform(0, 1), CROP], 0.5)], 1, device, KEYS[1:2]))


@pytest.mark.parametrize("kind", KINDS)
def test_samples_that_are_not_chosen_get_the_identity(kind, device):
    draw = {
        "chosen": Draw("chosen"),
        "permutation": Draw("permutation", (3, 5, 0.5)),
        "resized_crop": CROP,
        "rectangle": RECTANGLE,
        "rectangles": HOLES,
        "integer": integer(1, 4, 9),
        "uniform_and_affine": Draw("uniform_and_affine", (0.0, 1.0, 2.0, 0.5, 9.0)),
        "number": Draw("number", (9.0,)),
    }.get(kind, Draw(kind, (0.5, 0.75, 9.0)))
    identity = {"chosen": [0], "permutation": [5, 5.5, 6], "resized_crop": [0, 0, 131, 97], "rectangle": [0] * 4}
    identity["rectangles"] = [0] * 12
    identity["uniform_and_affine"] = [9, 18.5]
    expected = torch.tensor([identity.get(kind, [9.0])], dtype=torch.float32, device=device)
    for p, p_batch in ((0.0, 1.0), (1.0, 0.0)):
        assert torch.equal(drawn([Request([draw], p, p_batch)], 4, device), expected.expand(4, -1))


def test_p_batch_decides_for_all(device):
    requests = [Request([Draw("chosen")], 1.0, 0.3)]
    keys = torch.randint(-(2**63), 2**63 - 1, (200,))
    chosen = torch.stack([drawn(requests, 3, device, key[None])[:, 0].cpu() for key in keys])
    assert torch.equal(chosen, chosen[:, :1].expand(-1, 3))
    assert chosen[:, 0].bool().tolist() == [is_chosen_batch(int(key), 0, 0.3) for key in keys]
    assert 40 < chosen[:, 0].sum() < 80
    assert [is_chosen_batch(1, 0, p) for p in (0.0, 1.0)] == [False, True]
    for p in (0.0, 0.3, 1.0):
        assert are_chosen_batches(keys, 2, p) == [is_chosen_batch(int(key), 2, p) for key in keys]


def test_seeds_of_samples_are_those_of_splitmix64():
    known = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431, 16408922859458223821]
    seeds = seeds_of_samples(torch.tensor([1234567]), torch.arange(5))
    assert [seed % 2**64 for seed in seeds.tolist()] == known


# --- statistics: at a level of 1e-4 for all tests together ---

TESTS = 60
LEVEL = 1e-4 / TESTS


def columns(device: torch.device, *draws: Draw, p: float = 1.0, key: int = 0) -> list[Tensor]:
    plan = make_plan([Request(draws, p)])
    result = draw_parameters(images(N, device), torch.tensor([key]), None, plan.plan, plan.numbers)
    return list(result.double().cpu().unbind(1))


def follows(values: Tensor, distribution) -> bool:
    return stats.kstest(values.numpy(), distribution.cdf).pvalue > LEVEL


def evenly(counts: Tensor) -> bool:
    return stats.chisquare(counts.numpy()).pvalue > LEVEL


@pytest.mark.parametrize("key", [0, 1, -(2**63)])
def test_uniform(key, device):
    (values,) = columns(device, uniform(-3, 5), key=key)
    assert follows(values, stats.uniform(-3, 8))
    assert values.min() >= -3 and values.max() <= 5


def test_exponential_of_uniform(device):
    (values,) = columns(device, Draw("exponential_of_uniform", (-0.5, 2.0, 1.0)))
    assert follows(values.log(), stats.uniform(-0.5, 2.5))


def test_integer(device):
    (values,) = columns(device, integer(-3, 12, step=3))
    result, counts = values.unique(return_counts=True)
    assert result.tolist() == [-3, 0, 3, 6, 9, 12] and evenly(counts)


def test_uniform_and_affine(device):
    values, others = columns(device, Draw("uniform_and_affine", (-0.3, 0.3, 0.7, 0.1, 0.25)))
    assert follows(values, stats.uniform(-0.3, 0.6))
    # The kernel rounds once; a product and a sum rounded on their own may be on the other side of a tie.
    torch.testing.assert_close(others, 0.7 * values + 0.1, rtol=0, atol=2.0**-25)


@pytest.mark.parametrize("p", [0.1, 0.5, 0.9])
def test_chosen(p, device):
    (values,) = columns(device, Draw("chosen"), p=p)
    assert stats.binomtest(int(values.sum()), N, p).pvalue > LEVEL


def test_permutation(device):
    orders = torch.stack(columns(device, Draw("permutation", (4, 0, 1))), 1)
    assert torch.equal(orders.sort(1).values, torch.arange(4.0, dtype=torch.float64).expand(N, 4))
    result, counts = orders.unique(dim=0, return_counts=True)
    assert len(result) == 24 and evenly(counts)


def test_resized_crop(device):
    size = 4096
    x, y, w, h = columns(device, Draw("resized_crop", (0.25, 0.5, math.log(3 / 4), math.log(4 / 3), size, size)))
    assert follows(w * h / size**2, stats.uniform(0.25, 0.25))
    assert follows((w / h).log(), stats.uniform(math.log(3 / 4), 2 * math.log(4 / 3)))
    assert follows((x + 0.5) / (size - w + 1), stats.uniform()) and follows((y + 0.5) / (size - h + 1), stats.uniform())
    assert abs(stats.spearmanr(x, y).statistic) < 0.05


def test_crops_lie_in_the_image(device):
    for draw in (CROP, TALL, RECTANGLE, WIDE):
        height, width = draw.numbers[-2:]
        x, y, w, h = columns(device, draw)
        assert x.min() >= 0 and y.min() >= 0 and w.min() >= 1 and h.min() >= 1
        assert (x + w).max() <= width and (y + h).max() <= height
        assert all(torch.equal(v, v.round()) for v in (x, y, w, h))
    x, y, w, h = columns(device, TALL)
    tallest = round(97 * math.exp(-1.8))
    assert all(set(v.tolist()) == {e} for v, e in zip((x, y, w, h), ((31 - tallest) // 2, 0, tallest, 97)))


def test_rectangle(device):
    size = 8192
    x, y, w, h = columns(device, Draw("rectangle", (0.02, 0.1, 0.25, 4.0, size, size)))
    aspect = h / w
    assert follows(w * h / size**2, stats.uniform(0.02, 0.08))
    # As often wide as high, and uniform in each half.
    assert follows(torch.where(aspect < 1, (aspect - 0.25) / 1.5, 0.5 + (aspect - 1) / 6), stats.uniform())
    assert follows((x + 0.5) / (size - w + 1), stats.uniform()) and follows((y + 0.5) / (size - h + 1), stats.uniform())
    _, _, w, h = columns(device, Draw("rectangle", (0.02, 0.1, 0.5, 0.9, size, size)))
    assert follows(h / w, stats.uniform(0.5, 0.4))


@pytest.mark.parametrize("alpha, beta", [(0.4, 0.4), (1.0, 1.0), (0.2, 3.0), (3.0, 2.0), (50.0, 70.0)])
def test_beta(alpha, beta, device):
    (values,) = columns(device, Draw("beta", (alpha, beta, 0.0)))
    assert follows(values, stats.beta(alpha, beta))


def test_normal(device):
    (values,) = columns(device, Draw("normal", (1.5, 0.25, 0.0)))
    assert follows(values, stats.norm(1.5, 0.25))


def test_parameters_are_independent(device):
    """Of each other, of whether the sample is chosen, and of those of the next sample."""
    draws = [uniform(0, 1), uniform(0, 1), Draw("normal", (0.0, 1.0, 0.0)), Draw("beta", (2.0, 2.0, 0.0))]
    values = columns(device, *draws)
    pairs = [*itertools.combinations(values, 2), *((v[1:], v[:-1]) for v in values)]
    assert all(stats.spearmanr(a, b).pvalue > LEVEL for a, b in pairs)
    chosen, value = columns(device, Draw("chosen"), uniform(0, 1, -1), p=0.5)
    assert torch.equal(chosen == 1, value >= 0) and follows(value[value >= 0], stats.uniform())
    other = columns(device, *draws, key=1)
    assert all(stats.spearmanr(a, b).pvalue > LEVEL for a, b in zip(values, other))


# --- as an operator ---


class Drawing(torch.nn.Module):
    def forward(self, x: Tensor, keys: Tensor) -> Tensor:
        plan = make_plan(EXACT)
        return draw_parameters(x, keys, None, plan.plan, plan.numbers)


@pytest.mark.tracing
def test_compiles_and_exports(device):
    x = torch.rand(3, 3, 8, 8, device=device)
    expected = Drawing()(x, KEYS)
    torch._dynamo.reset()
    assert torch.equal(torch.compile(Drawing(), fullgraph=True, backend="aot_eager")(x, KEYS), expected)
    batch = torch.export.Dim("batch", min=2, max=64)
    program = torch.export.export(Drawing(), (x, KEYS), dynamic_shapes={"x": {0: batch}, "keys": None})
    assert torch.equal(program.module()(torch.cat([x, x]), KEYS)[:3], expected)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float16, torch.int32], ids=str)
def test_images_of_any_type(dtype, device):
    plan = make_plan(EXACT)
    x = torch.zeros(5, 3, 2, 2, dtype=dtype, device=device)
    assert torch.equal(draw_parameters(x, KEYS, None, plan.plan, plan.numbers), drawn(EXACT, 5, device))


def test_images_get_no_gradient(device):
    x = images(2, device).requires_grad_()
    plan = make_plan(EXACT)
    assert not draw_parameters(x, KEYS, None, plan.plan, plan.numbers).requires_grad


@pytest.mark.native
def test_plans_are_checked(device):
    plan, numbers, _ = make_plan(EXACT)
    x = images(2, device)
    too_many = make_plan([Request([uniform(0, 1)] * (MAX_DRAWS + 1))])
    too_long = make_plan([Request([CROP] * (MAX_NUMBERS // 6 + 1))])
    bad = [
        (KEYS[:4], plan, numbers, "a key from 0 to 3, got 4"),
        (KEYS, plan[:-1], numbers, "the plan ends within a request"),
        (KEYS, [plan[0] - 1, *plan[1:]], numbers, "more columns than"),
        (KEYS, [plan[0] + 1, *plan[1:]], numbers, "the draws take"),
        (KEYS, [*plan[:-1], 13], numbers, "a kind of draw from 0 to 12, got 13"),
        (KEYS, plan, numbers[:-4], "expected more numbers"),
        (KEYS, *too_many[:2], "the number of draws from 0 to 64, got 65"),
        (KEYS, *too_long[:2], "at most 256 numbers"),
        (
            KEYS,
            *make_plan([Request([Draw("permutation", (3, 0, 1))])])[:1],
            [1.0, 1.0, 1e9, 0, 1],
            "columns of a draw",
        ),
    ]
    for keys, ints, floats, message in bad:
        with pytest.raises(RuntimeError, match=f"draw_parameters: .*{message}"):
            draw_parameters(x, keys, None, ints, floats)


def test_a_generator_of_the_cpu_is_not_captured(monkeypatch: pytest.MonkeyPatch) -> None:
    """All replays would get the numbers of the capture."""
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: True)
    with pytest.raises(RuntimeError, match="op: a generator of the CPU cannot draw for a CUDA graph"):
        draw_keys("op", 1, torch.device("cuda"), None, torch.Generator())
    assert draw_keys("op", 1, torch.device("cuda"), 5, None).has_seed
    assert len(draw_keys("op", 2, torch.device("cpu"), None, torch.Generator()).keys) == 2


@pytest.mark.native
def test_replays_of_a_graph_read_new_keys(device):
    if device.type != "cuda":
        pytest.skip("CUDA graphs are CUDA's")
    keys, plan = KEYS.to(device), make_plan(EXACT)
    x = images(9, device)
    draw_parameters(x, keys, None, plan.plan, plan.numbers)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        result = draw_parameters(x, keys, None, plan.plan, plan.numbers)
    for new in (KEYS, KEYS + 1):
        keys.copy_(new)
        graph.replay()
        assert torch.equal(result, drawn(EXACT, 9, device, new))


@pytest.mark.native
def test_graphs_read_seeds_of_the_host(device):
    if device.type != "cuda":
        pytest.skip("CUDA graphs are CUDA's")
    x, seeds, turn = torch.rand(3, 1, 8, 9, device=device), torch.arange(3), K.augmentation.RandomRotation(30.0, p=1.0)
    expected, graph = turn(x, seed=seeds), torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        result = turn(x, seed=seeds)
    graph.replay()
    assert torch.equal(result, expected)
