"""Objects of masks that are dropped."""

import pytest
import torch
from scipy import ndimage

from kvision.augmentation.draws import mixed_words
from kvision.augmentation.occlusion.objects import drop_objects
from kvision.contrib.connected_components import connected_components
from point_op_tests import Call, PointOpTests


def masks() -> torch.Tensor:
    return torch.randint(0, 3, (1, 8, 9))


class TestDropObjectsOperators(PointOpTests):
    calls = {
        "drop_objects": [
            Call(
                (
                    masks,
                    lambda: connected_components((masks() != 0).byte()),
                    lambda: torch.tensor(5.0),
                    lambda: torch.tensor(2.0),
                ),
                (3,),
                broadcasts=False,
                differentiable=False,
                dtypes=(torch.float32,),
                accepted=("of torch.int64", "most"),
            )
        ],
    }


@pytest.mark.parametrize("number", [1, 3])
def test_the_highest_ranks_are_dropped(number, device):
    """In random masks of small objects, and of many that are one."""
    x = torch.randint(0, 4, (5, number, 31, 45)) * (torch.rand(5, number, 31, 45) < 0.4)
    x[4] = 0
    words, counts = torch.tensor([3.0, 7.0, 2**24 - 1.0, 0.0, 1.0]), torch.tensor([1.0, 4.0, 0.0, 50.0, 2.0])
    regions = connected_components((x != 0).byte()) if number == 1 else None
    arguments = x, regions, words, counts
    y = drop_objects(*(None if a is None else a.to(device) for a in arguments), 50).cpu()
    assert torch.equal(y, drop_objects.reference(*arguments, 50))
    assert torch.equal(
        drop_objects(*(None if a is None else a.to(device) for a in arguments), 2).cpu()[3:],
        drop_objects.reference(*arguments, 2)[3:],
    )
    for b, count in enumerate(counts.int().tolist()):
        covered = [plane != 0 for plane in x[b] if plane.any()]
        if number == 1:
            labels = torch.from_numpy(ndimage.label(x[b, 0].numpy(), structure=[[1] * 3] * 3)[0])
            pairs = set(zip(labels.flatten().tolist(), x[b, 0].flatten().tolist()))
            covered = [(labels == i) & (x[b, 0] == value) for i, value in pairs if value]
        whole = sum(bool(y[b, 0][c].all()) for c in covered)
        parts = sum(bool(y[b, 0][c].any()) and not bool(y[b, 0][c].all()) for c in covered)
        assert whole >= min(count, len(covered)) and (number > 1 or (whole == min(count, len(covered)) and not parts))
        inside = torch.stack(covered).any(0) if covered else torch.zeros(31, 45, dtype=torch.bool)
        assert not y[b, 0][~inside].any()


def test_hash_is_that_of_draws(device):
    """Ranks of two objects in the order of their words."""
    x = torch.tensor([[1, 0], [0, 1]])[None, :, None].to(device)
    for word in range(8):
        ranks = mixed_words(torch.arange(2) ^ mixed_words(torch.tensor(word)))
        dropped = drop_objects(x, None, torch.tensor([float(word)], device=device), torch.ones(1, device=device), 1)
        assert dropped.flatten().tolist() == [int(ranks[0] > ranks[1]), int(ranks[1] > ranks[0])]
