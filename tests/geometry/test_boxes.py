"""Boxes: Kornia's values in every form, gradients, tracing."""

import itertools
import pickle
import warnings
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry
MODES = ("xyxy", "xyxy_plus", "xywh", "vertices", "vertices_plus")
MODES3D = ("xyzxyz", "xyzxyz_plus", "xyzwhd", "vertices", "vertices_plus")


def rand(*shape: int, seed: int = 3) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def xyxy(*shape: int, axes: int = 2, seed: int = 3) -> Tensor:
    near = 20 * rand(*shape, axes, seed=seed)
    return torch.cat([near, near + 2 + 10 * rand(*shape, axes, seed=seed + 1)], -1)


def rigid(batch: int, axes: int = 2) -> Tensor:
    M = torch.eye(axes + 1, dtype=torch.float64).repeat(batch, 1, 1)
    M[:, :axes] += 0.1 * rand(batch, axes, axes + 1, seed=9)
    M[:, axes, 0] = 1e-3
    return M


class TestBoxes(CompositionTests):
    cases = {
        "corners": Case(lambda b: G.Boxes.from_tensor(b, validate_boxes=False).data, ((2, 5, 4),)),
        "transform": Case(lambda b, M: G.Boxes(b).transform_boxes(M).to_tensor("xywh"), ((2, 5, 4, 2), (2, 3, 3))),
        "area": Case(lambda b: G.Boxes(b).compute_area(), ((2, 5, 4, 2),)),
        "filtered": Case(
            lambda b: G.Boxes(b).filter_boxes_by_area(0.1).translate(b[:, 0, 0]).to_tensor(), ((2, 5, 4, 2),)
        ),
        "clamp": Case(lambda b, a: G.Boxes(b).clamp(a / 2, (0.7, 0.8)).data, ((2, 5, 4, 2), (2, 2))),
        "merge": Case(lambda b, c: G.Boxes(b).merge(G.Boxes(c)).data, ((2, 5, 4, 2), (2, 3, 4, 2))),
        "mask": Case(lambda b: G.Boxes(4 * b).to_mask(4, 5), ((2, 3, 4, 2),), differentiable=False),
        "space": Case(lambda b, M: G.Boxes3D(b).transform_boxes(M).to_tensor("xyzwhd"), ((2, 5, 8, 3), (2, 4, 4))),
        "video": Case(lambda b: G.VideoBoxes.from_tensor(b, False).to_tensor("xyxy"), ((2, 3, 5, 4, 2),)),
    }
    compiled = ("filtered", "mask")


def every_form(boxes: Tensor, pads: Tensor, M: Tensor) -> list[Tensor]:
    """Of Boxes and VideoBoxes."""
    results = []
    for mode in MODES:
        results.append(G.Boxes.from_tensor(G.Boxes(boxes).to_tensor(mode), mode, validate_boxes=False).to_tensor(mode))
        results.append(G.VideoBoxes.from_tensor(boxes[:, None], False).to_tensor(mode))
    moved = G.Boxes(boxes).transform_boxes(M).pad(pads).unpad(pads).translate(pads[:, :2])
    kept = moved.clamp(pads[:, :2], (9, 9)).merge(moved).filter_boxes_by_area(1.0, 9.0).trim(True)
    moved[:1] = moved[1:]
    for some in (moved, kept, kept.clone()[0], moved.to(dtype=torch.float32)):
        results += [some.data, some.compute_area(), *some.get_boxes_shape()]
    return [*results, moved.to_mask(7, 8)]


def every_form3d(boxes: Tensor, points: Tensor, M: Tensor) -> list[Tensor]:
    """Of Boxes3D and Keypoints."""
    results = []
    for mode in MODES3D:
        moved = G.Boxes3D.from_tensor(G.Boxes3D(boxes).to_tensor(mode), mode, validate_boxes=False).transform_boxes(M)
        results += [moved.to_tensor(mode), *moved.get_boxes_shape()]
    for kind, pads, matrix in ((G.Keypoints, M[:, 0], M[:, 1:, 1:]), (G.Keypoints3D, M.flatten(1)[:, :6], None)):
        moved = kind.from_tensor(points[..., : pads.shape[1] // 2]).pad(pads).unpad(pads)
        results += [moved[0].data, (moved if matrix is None else moved.transform_keypoints(matrix)).to_tensor()]
    return [*results, G.Boxes3D(boxes).to_mask(3, 4, 5)]


@pytest.mark.tracing
def test_all_of_it_compiles_without_a_break(device):
    corners = G.Boxes.from_tensor(xyxy(2, 5)).data.to(device)
    corners3d = G.Boxes3D.from_tensor(xyxy(2, 5, axes=3)).data.to(device)
    calls = (every_form, corners, rand(2, 4), rigid(2)), (every_form3d, corners3d, rand(2, 5, 3), rigid(2, 3))
    for call, *args in calls:
        values = [v.to(device) for v in args]
        for result, expected in zip(torch.compile(call, fullgraph=True, backend="eager")(*values), call(*values)):
            assert_close(result, expected)


@pytest.mark.tracing
def test_containers_go_into_and_come_out_of_compiled_functions(device):
    M = rigid(2).to(device)
    boxes, points = G.Boxes.from_tensor(xyxy(2, 5).to(device)), G.Keypoints(rand(2, 5, 2).to(device))
    moved = torch.compile(
        lambda b, k: (b.transform_boxes(M), k.transform_keypoints(M)), fullgraph=True, backend="eager"
    )
    for result, expected in zip(moved(boxes, points), (boxes.transform_boxes(M), points.transform_keypoints(M))):
        assert type(result) is type(expected)
        assert_close(result.data, expected.data)


@pytest.fixture(scope="module")
def theirs():
    """Kornia's functions and classes of boxes."""
    pytest.importorskip("kornia")
    from kornia.geometry import bbox, boxes

    return SimpleNamespace(**vars(bbox) | vars(boxes))


NORMALIZED = [[0.1, 0.1, 0.6, 0.9], [0.0, 0.25, 1.0, 0.5]]


def in_every_mode(near: Tensor, far: Tensor, modes: tuple[str, ...]) -> dict[str, Tensor]:
    """Boxes of edges in all modes: there is no last pixel."""
    vertices = G.bbox.corners(near, far)
    return dict(zip(modes, (*[torch.cat([near, far], -1)] * 2, torch.cat([near, far - near], -1), *[vertices] * 2)))


@pytest.mark.parametrize("kind, modes", [(G.Boxes, MODES), (G.Boxes3D, MODES3D)])
@pytest.mark.parametrize("batch", [(), (2,)], ids=["one", "batch"])
def test_normalized_boxes_are_edges(kind, modes, batch, device):
    axes = kind.item[-1]
    near = rand(*batch, 5, axes).to(device) / 2
    far = near + rand(*batch, 5, axes, seed=8).to(device) / 2
    forms = in_every_mode(near, far, modes)
    half = torch.diag(torch.tensor([0.5] * axes + [1.0], dtype=torch.float64, device=device))
    for mode, form in forms.items():
        boxes = kind.from_tensor(form, mode, normalized=True)
        assert_close(boxes.data, forms["vertices"])
        moved, one = boxes.clone().transform_boxes(half), boxes[1:]
        assert_close(moved.to_tensor(mode), form / 2)
        assert_close(one.to_tensor(mode), form[1:])
        assert boxes.normalized and moved.normalized and one.normalized
    assert_close(torch.stack(boxes.get_boxes_shape()[::-1], -1), far - near)
    with pytest.raises(ValueError, match=f"{kind.__name__}: expected boxes that are all normalized, or none"):
        boxes.index_put((torch.tensor([0], device=device),), kind(boxes.data)[:1])


def test_area_masks_and_overlap_of_normalized_boxes(device):
    boxes = G.Boxes.from_tensor(torch.tensor(NORMALIZED, device=device), normalized=True)
    assert_close(boxes.compute_area(), torch.tensor([0.4, 0.25], device=device))
    mask = boxes.to_mask(10, 20)
    expected = torch.zeros(2, 10, 20, device=device)
    expected[0, 1:9, 2:12] = 1
    expected[1, 2:5] = 1  # 2.5 is rounded to even
    assert_close(mask, expected)
    iou = K.metrics.mean_iou_bbox(boxes.to_tensor(), boxes.to_tensor())
    assert_close(iou[0, 1], torch.tensor(0.125 / 0.525, device=device))
    lists = G.Boxes.from_tensor([torch.tensor(NORMALIZED[:1], device=device), boxes.to_tensor()], normalized=True)
    assert_close(lists.to_tensor()[1], boxes.to_tensor())
    both = boxes.merge(boxes)
    assert both.normalized and both.shape[0] == 4
    with pytest.raises(ValueError, match="Boxes: expected boxes that are all normalized, or none, got both"):
        boxes.merge(G.Boxes(boxes.data))
    corners = boxes.to_tensor("vertices").reshape(2, 1, 1, 4, 2)
    video = G.VideoBoxes.from_tensor(corners, normalized=True)
    assert video.normalized and video[0].normalized
    assert_close(video.to_tensor("xyxy").reshape(2, 4), boxes.to_tensor())
    cubes = G.Boxes3D.from_tensor(torch.tensor([[0.1, 0.1, 0, 0.6, 0.9, 1]], device=device), normalized=True)
    assert_close(cubes.to_mask(4, 10, 20)[0], expected[0].expand(4, -1, -1))
    with pytest.raises(ValueError, match="expected boxes in pixels, got normalized ones"):
        augment = K.augmentation.AugmentationSequential(
            K.augmentation.RandomHorizontalFlip(p=1.0), data_keys=["input", "bbox"]
        )
        augment(torch.zeros(1, 1, 4, 4, device=device), boxes)


@pytest.mark.parametrize("kind, modes", [(G.Boxes, MODES), (G.Boxes3D, MODES3D)])
def test_sides_below_1_are_warned_of(kind, modes):
    near = torch.full((1, kind.item[-1]), 0.1)
    forms = in_every_mode(near, near + 0.5, modes)
    for mode in (modes[0], modes[2], modes[3]):
        with pytest.warns(
            UserWarning, match=f"{kind.__name__}.from_tensor: .* side below 1.*normalized=True"
        ) as caught:
            kind.from_tensor(forms[mode], mode)
        assert [w.filename for w in caught] == [__file__]
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            kind.from_tensor(forms[mode], mode, validate_boxes=False)
            kind.from_tensor(forms[mode], mode, normalized=True)
            kind.from_tensor(2 * forms[mode], mode)  # a side of 1 pixel


@pytest.mark.parametrize("batch", [(), (2,)], ids=["one", "batch"])
@pytest.mark.parametrize("source, target", [*itertools.product(MODES, MODES)])
def test_forms_are_those_of_kornia(source, target, batch, theirs, device):
    tensor = theirs.Boxes.from_tensor(xyxy(*batch, 5)).to_tensor(source)
    ours = G.Boxes.from_tensor(tensor.to(device), source)
    his = theirs.Boxes.from_tensor(tensor, source)
    assert_close(ours.data.cpu(), his.data)
    assert_close(ours.to_tensor(target).cpu(), his.to_tensor(target))
    assert ours.mode == source
    assert_close(ours.to_tensor(), ours.to_tensor(source))


@pytest.mark.parametrize("source, target", [*itertools.product(MODES3D[:3], MODES3D)])
def test_forms_in_space_are_those_of_kornia(source, target, theirs, device):
    tensor = theirs.Boxes3D.from_tensor(xyxy(2, 5, axes=3)).to_tensor(source)
    ours, his = G.Boxes3D.from_tensor(tensor.to(device), source), theirs.Boxes3D.from_tensor(tensor, source)
    assert_close(ours.data.cpu(), his.data)
    assert_close(ours.to_tensor(target).cpu(), his.to_tensor(target))
    assert_close([x.cpu() for x in ours.get_boxes_shape()], list(his.get_boxes_shape()))
    assert_close(ours.to_mask(9, 20, 22).cpu(), his.to_mask(9, 20, 22))
    again = G.Boxes3D.from_tensor(ours.to_tensor("vertices"), "vertices")
    assert_close(again.data, ours.data)
    M = rigid(2, 3)
    assert_close(ours.transform_boxes(M.to(device)).data.cpu(), his.transform_boxes(M).data, 1e-9, 1e-9)


@pytest.mark.parametrize("batch", [(), (2,)], ids=["one", "batch"])
def test_methods_are_those_of_kornia(batch, theirs, device):
    tensor, more = xyxy(*batch, 5), xyxy(*batch, 3, seed=7)
    ours, his = G.Boxes.from_tensor(tensor.to(device)), theirs.Boxes.from_tensor(tensor)
    n = batch[0] if batch else 1
    M, move, padding = rigid(n), rand(n, 2), 5 * rand(n, 4)
    low, high = torch.full((n, 2), 8.0, dtype=torch.float64), torch.full((n, 2), 19.0, dtype=torch.float64)
    index = (torch.tensor([0]),)

    def both(call):
        result, expected = call(ours.clone(), lambda x: x.to(device)), call(his.clone(), lambda x: x)
        for a, b in zip(*((y,) if not isinstance(y, tuple) else y for y in (result, expected)), strict=True):
            a, b = (y if isinstance(y, Tensor) else y.data for y in (a, b))
            assert_close(a.cpu(), b, 1e-9, 1e-9)

    both(lambda x, on: x.get_boxes_shape())
    both(lambda x, on: x.compute_area())
    both(lambda x, on: x.to_mask(20, 25))
    both(lambda x, on: x.transform_boxes(on(M)))
    both(lambda x, on: x.transform_boxes(on(M)).to_tensor("xyxy"))
    both(lambda x, on: x.transform_boxes_(on(M)))
    both(lambda x, on: x.translate(on(move)))
    both(lambda x, on: x.pad(on(padding)))
    both(lambda x, on: x.unpad(on(padding)))
    both(lambda x, on: x.clamp(on(low), on(high)))
    both(lambda x, on: x.merge(type(x).from_tensor(on(more))))
    both(lambda x, on: x.filter_boxes_by_area(30, 90).to_tensor("xyxy"))
    both(lambda x, on: x.filter_boxes_by_area(30, 90).translate(on(move)).to_tensor("xywh"))
    both(lambda x, on: x.index_put(tuple(map(on, index)), x.data[1:2]))
    both(lambda x, on: x.index_put(tuple(map(on, index)), x[1:2]))
    both(lambda x, on: x[1:2])


def test_lists(theirs, device):
    parts = [xyxy(3), xyxy(0), xyxy(5, seed=5)]
    ours = G.Boxes.from_tensor([p.to(device) for p in parts])
    his = theirs.Boxes.from_tensor(parts)
    assert_close(ours.data.cpu(), his.data)
    for mode in MODES:
        assert_close([x.cpu() for x in ours.to_tensor(mode)], his.to_tensor(mode))
    assert ours.to_tensor("xyxy", as_padded_sequence=True)[0, 3:].abs().max() == 0
    assert_close(ours.to_mask(20, 20).cpu(), his.to_mask(20, 20))
    assert [len(x) for x in ours[1:].to_tensor()] == [0, 5]
    assert [len(x) for x in ours[torch.tensor([2, 0], device=device)].to_tensor()] == [5, 3]
    assert_close(ours[2].to_tensor("xyxy").cpu(), parts[2])
    both = ours.merge(ours)
    assert_close([x.cpu() for x in both.to_tensor()], [torch.cat([p, p]) for p in parts])
    assert [len(x) for x in ours.merge(G.Boxes(ours.data[:, :2])).to_tensor()] == [5, 2, 7]
    assert G.Boxes.from_tensor([[1.0, 2, 3, 4]]).shape == (1, 4, 2)
    assert G.Boxes.from_tensor([]).to_tensor() == []
    points = G.Keypoints([p[:, :2].to(device) for p in parts]).transform_keypoints(torch.eye(3, device=device).double())
    assert_close([x.cpu() for x in points.to_tensor()], [p[:, :2] for p in parts])
    assert points.to_tensor(as_padded_sequence=True).shape == (3, 5, 2)


def test_trim(device):
    sizes = torch.tensor([[9.0, 1, 9, 1], [1, 1, 9, 1]], device=device)
    zero = torch.zeros_like(sizes)
    boxes = G.Boxes.from_tensor(torch.stack([zero, zero, sizes + 1, sizes + 1], -1)).filter_boxes_by_area(4)
    assert_close(boxes.trim(True).to_tensor("xywh")[..., 2], torch.tensor([[10.0, 10], [0, 10]], device=device))
    assert boxes.trim().shape == (2, 2, 4, 2)
    assert_close(boxes.trim().to_tensor("xywh")[..., 2], torch.tensor([[10.0, 10], [10, 0]], device=device))
    assert boxes[1].trim(inplace=True).shape == (1, 4, 2)


def test_videos(theirs, device):
    vertices = theirs.Boxes.from_tensor(xyxy(6, 5)).data.reshape(2, 3, 5, 4, 2)
    ours, his = G.VideoBoxes.from_tensor(vertices.to(device)), theirs.VideoBoxes.from_tensor(vertices)
    for mode in MODES:
        assert_close(ours.to_tensor(mode).cpu(), his.to_tensor(mode))
    M = rigid(6)
    moved = ours.transform_boxes(M.to(device))
    assert isinstance(moved, G.VideoBoxes)
    assert_close(moved.to_tensor("xyxy").cpu(), his.transform_boxes(M).to_tensor("xyxy"), 1e-9, 1e-9)
    assert_close([x.cpu() for x in ours.get_boxes_shape()], list(his.get_boxes_shape()))
    for key in (0, -1, slice(1, 2), torch.tensor([1, 0])):
        assert_close(ours[key].to_tensor().cpu(), his[key].to_tensor())
    ours[0] = ours[1]
    assert_close(ours.to_tensor()[0], ours.to_tensor()[1])
    small = ours.filter_boxes_by_area(max_area=50)
    assert_close(small[1].to_tensor(), small.to_tensor()[1:])


def test_objects_keep_to_themselves(device):
    """What is made of a tensor does not write to it, and only what says so changes an object."""
    tensor = xyxy(2, 5).to(device)
    vertices = G.Boxes.from_tensor(tensor).data
    before, boxes = vertices.clone(), G.Boxes(vertices)
    other = boxes.clone()
    boxes.pad(torch.ones(2, 4, device=device))
    boxes[0] = boxes[1]
    boxes.index_put((torch.tensor([0], device=device),), boxes[1:], inplace=True)
    boxes.clamp((0, 0), (5, 5), inplace=True)
    boxes.translate(torch.ones(1, 2, device=device), "fast", inplace=True)
    boxes.filter_boxes_by_area(3, inplace=True)
    boxes.merge(other, inplace=True)
    assert boxes.shape == (2, 10, 4, 2)
    assert_close(vertices, before)
    assert_close(other.data, before)
    assert boxes.type(torch.float16).dtype == boxes.to("cpu").dtype == torch.float16
    assert_close(pickle.loads(pickle.dumps(boxes)).to_tensor("xyxy"), boxes.to_tensor("xyxy"))
    assert "Boxes(" in repr(boxes)
    points = G.Keypoints3D.from_tensor(tensor[..., :3])
    moved = (
        points.clone().unpad(torch.ones(1, 6, device=device)).transform_keypoints_(torch.eye(4, device=device).double())
    )
    assert_close(moved.data + 1, points.data)


BOX = xyxy(2, 5)
BAD = [
    (lambda: G.Boxes(BOX), ValueError, r"Boxes: expected boxes of shape \(\*, 4, 2\), got \(2, 5, 4\)"),
    (lambda: G.Boxes(torch.ones(4, 2)), ValueError, r"Boxes: expected boxes of shape \(N, 4, 2\) or \(B, N, 4, 2\)"),
    (lambda: G.Boxes(torch.ones(1, 4, 2).int()), TypeError, "Boxes: expected boxes to be floating point"),
    (lambda: G.Boxes.from_tensor(BOX, "yxyx"), ValueError, "Boxes: mode must be one of xyxy, xyxy_plus, xywh"),
    (lambda: G.Boxes.from_tensor(BOX, 3), TypeError, "Boxes: expected mode to be a str"),
    (lambda: G.Boxes.from_tensor(3.0), TypeError, "Boxes: expected boxes to be a Tensor or a list, got float"),
    (lambda: G.Boxes.from_tensor(BOX[0, 0]), ValueError, r"expected boxes of shape \(N, 4\) or \(B, N, 4\) in mode 'xyxy'"),
    (lambda: G.Boxes.from_tensor(-BOX), ValueError, "Boxes: expected boxes of positive size"),
    (lambda: G.Boxes.from_tensor(BOX / 0), ValueError, "Boxes: expected boxes that are finite"),
    (lambda: G.Boxes.from_tensor(BOX).to_tensor("xy"), ValueError, "mode must be one of"),
    (lambda: G.Boxes.from_tensor(BOX).to_mask(0, 3), ValueError, "Boxes.to_mask: expected height"),
    (lambda: G.Boxes.from_tensor(BOX).transform_boxes(torch.eye(4)), ValueError, r"expected M of shape \(\*, 3, 3\)"),
    (lambda: G.Boxes.from_tensor(BOX).transform_boxes(torch.eye(3).expand(3, 3, 3)), ValueError, r"\(3, 3\) or \(2, 3, 3\)"),
    (lambda: G.Boxes.from_tensor(BOX).translate(torch.ones(3, 2)), ValueError, "expected size with a batch size of 1 or 2"),
    (lambda: G.Boxes.from_tensor(BOX).translate(torch.ones(2, 2), "slow"), ValueError, "translate: method must be one of"),
    (lambda: G.Boxes.from_tensor(BOX).pad(torch.ones(2, 2)), ValueError, r"Boxes.pad: expected padding_size of shape \(B, 4\)"),
    (lambda: G.Boxes.from_tensor(BOX).merge(BOX), TypeError, "Boxes.merge: expected boxes to be Boxes, got Tensor"),
    (lambda: G.Boxes.from_tensor(BOX).merge(G.Boxes.from_tensor(BOX[:1])), ValueError, "merge: expected boxes of as many images"),
    (lambda: G.Boxes.from_tensor(BOX).to(dtype=torch.int32), TypeError, "Boxes.to: expected dtype to be floating point"),
    (lambda: G.VideoBoxes.from_tensor(torch.ones(2, 3, 4, 2)), ValueError, r"VideoBoxes: .* \(B, T, N, 4, 2\)"),
    (lambda: G.Boxes3D.from_tensor(BOX), ValueError, r"Boxes3D: expected boxes of shape \(\*, 6\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
