"""Boxes, points and masks of instances of lists of images: as of each image alone, by the launches of a batch."""

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from augmentation.container.test_list_launches import Launches
from augmentation.test_lists import assert_same, pictures, seeds_of
from kvision import augmentation as A

AUGMENTATIONS = {
    "colors": lambda: [A.ColorJitter(0.2, 0.2, p=1.0)],
    "flip": lambda: [A.RandomHorizontalFlip()],
    "affine": lambda: [A.RandomAffine(20.0, (0.1, 0.1), p=0.7)],
    "perspective": lambda: [A.RandomPerspective(p=1.0)],
    "transpose some": lambda: [A.Transpose()],
    "chain": lambda: [A.RandomVerticalFlip(), A.RandomAffine(20.0), A.ColorJitter(0.2, 0.2), A.Transpose(p=1.0)],
    "applied to some": lambda: [A.RandomRotation(30.0, p=1.0, p_batch=0.5), A.RandomHorizontalFlip()],
    "map": lambda: [A.RandomElasticTransform((5, 5), (2.0, 2.0), p=1.0)],
    "maps": lambda: [
        A.RandomAffine(20.0),
        A.RandomThinPlateSpline(0.1, p=0.7),
        A.RandomGaussianNoise(p=0.5),
        A.RandomHorizontalFlip(),
        A.OpticalDistortion(p=1.0),
    ],
    "maps of some": lambda: [
        A.OneOf(A.RandomThinPlateSpline(0.1, p=0.7), A.RandomAffine(20.0), A.RandomRotation(9.0, p_batch=0.5)),
        A.ImageSequential(A.RandomVerticalFlip(), A.OpticalDistortion(p=0.7)),
    ],
    "maps and a crop": lambda: [
        A.RandomThinPlateSpline(0.1),
        A.RandomCrop((26, 24), pad_if_needed=True),
        A.OpticalDistortion(p=0.7),
        A.RandomAffine(20.0),
    ],
    "map and a crop by boxes": lambda: [
        A.RandomThinPlateSpline(0.1, p=0.7),
        A.RandomSizedBBoxSafeCrop(24, 28),
        A.OpticalDistortion(p=0.7),
    ],
    "map and a crop by masks": lambda: [A.OpticalDistortion(p=0.7), A.CropNonEmptyMaskIfExists(16, 20)],
    "maps between filters": lambda: [
        A.RandomApply(
            [A.RandomThinPlateSpline(0.1, p=0.7), A.AugmentationSequential(A.Transpose(), min_box_area=60.0)]
        ),
        A.AugmentationSequential(
            A.OpticalDistortion(p=0.7),
            A.OneOf(A.AugmentationSequential(A.RandomAffine(20.0), min_box_visibility=0.3), A.RandomHorizontalFlip()),
            A.RandomElasticTransform((5, 5), (2.0, 2.0), p=0.7),
            clip_boxes="each",
        ),
        A.RandomThinPlateSpline(0.1, p=1.0),
    ],
    "expanded": lambda: [
        A.RandomVerticalFlip(),
        A.RandomRotation(30.0, p=0.7, expand=True, fill=0.5),
        A.OneOf(A.RandomRotation((90.0, 90.0), p=0.7, expand=True), A.RandomHorizontalFlip()),
    ],
    "scaled": lambda: [A.RandomScale((0.5, 1.5), p=1.0), A.RandomAffine(20.0), A.RandomScale(antialias=False, p=1.0)],
    "erased": lambda: [A.RandomAffine(20.0, p=1.0), A.RandomErasing(p=1.0)],
    "crop": lambda: [A.RandomHorizontalFlip(), A.RandomResizedCrop((12, 14)), A.RandomAffine(20.0)],
    "crop of a window": lambda: [
        A.RandomAffine(20.0),
        A.ColorJitter(0.2, 0.2),
        A.RandomCrop((40, 48), pad_if_needed=True),
    ],
    "crop behind noise": lambda: [A.RandomGaussianNoise(p=0.5), A.RandomHorizontalFlip(), A.CenterCrop((20, 24))],
    "resize": lambda: [A.RandomAffine(20.0), A.Resize((30, 26), antialias=True), A.RandomErasing()],
    "pad": lambda: [A.LongestMaxSize(32), A.RandomVerticalFlip(), A.PadTo((36, 36)), A.RandomErasing()],
    "zoom out": lambda: [A.RandomZoomOut(p=0.7), A.RandomResizedCrop((24, 20)), A.RandomHorizontalFlip()],
    "objects": lambda: [A.RandomAffine(20.0, p=0.7), A.MaskDropout((1, 3), p=0.7), A.RandomHorizontalFlip()],
    "objects of some": lambda: [
        A.OneOf(A.MaskDropout(), A.RandomAffine(20.0)),
        A.ImageSequential(A.RandomVerticalFlip(), A.MaskDropout(p=0.7)),
        A.CenterCrop((30, 30)),
    ],
    "one of": lambda: [A.OneOf(A.RandomHorizontalFlip(), A.RandomAffine(20.0), A.RandomErasing(p=1.0)), A.Transpose()],
    "some of": lambda: [A.SomeOf([A.RandomHorizontalFlip(), A.RandomAffine(20.0), A.RandomVerticalFlip()], 2)],
    "applied": lambda: [A.RandomApply([A.RandomAffine(20.0), A.ColorJitter(0.2, 0.2)]), A.CenterCrop((30, 30))],
    "crop by boxes": lambda: [
        A.RandomHorizontalFlip(),
        A.RandomAffine(20.0),
        A.RandomIoUCrop(),
        A.ColorJitter(0.2),
        A.RandomCropNearBBox((0.1, 0.3), p=0.7),
        A.Transpose(),
        A.RandomSizedBBoxSafeCrop(24, 28),
    ],
    "crop by boxes of all": lambda: [A.RandomHorizontalFlip(), A.RandomAffine(9.0), A.RandomSizedBBoxSafeCrop(24, 28)],
    "crop by masks": lambda: [A.RandomVerticalFlip(), A.RandomAffine(20.0), A.CropNonEmptyMaskIfExists(16, 20)],
    "filtered inside": lambda: [
        A.RandomAffine(20.0, (0.3, 0.3)),
        A.AugmentationSequential(A.RandomAffine(20.0, (0.3, 0.3)), A.Transpose(), clip_boxes="each"),
        A.RandomHorizontalFlip(),
        A.AugmentationSequential(A.ColorJitter(0.2), min_box_area=60.0),
    ],
    "filtered in a choice": lambda: [
        A.RandomAffine(20.0, p=1.0),
        A.OneOf(
            A.AugmentationSequential(A.RandomAffine(20.0, (0.3, 0.3), p=1.0), min_box_visibility=0.5),
            A.Transpose(p=1.0),
        ),
        A.RandomApply([A.LongestMaxSize(48), A.AugmentationSequential(A.RandomRotation(30.0), clip_boxes=True)]),
        A.RandomAffine(20.0, p=1.0),
    ],
    "crop by boxes inside": lambda: [
        A.RandomAffine(20.0),
        A.AugmentationSequential(A.Transpose(), A.RandomIoUCrop(), A.RandomHorizontalFlip(), clip_boxes="each"),
        A.ImageSequential(A.RandomVerticalFlip(), A.RandomApply([A.RandomCropNearBBox((0.1, 0.3))])),
        A.RandomAffine(20.0),
    ],
    "crop by boxes in choices": lambda: [
        A.OneOf(A.RandomIoUCrop(), A.RandomAffine(20.0), A.RandomCropNearBBox((0.1, 0.3))),
        A.SomeOf([A.Transpose(p=1.0), A.RandomIoUCrop(), A.RandomRotation(20.0, p=1.0, p_batch=0.5)], 2),
        A.RandomOrder(A.RandomVerticalFlip(), A.ImageSequential(A.LongestMaxSize(40), A.RandomCropNearBBox())),
        A.RandomSizedBBoxSafeCrop(24, 28),
    ],
    "crop by boxes of expanded": lambda: [
        A.RandomRotation(30.0, p=0.7, expand=True),
        A.RandomIoUCrop(),
        A.RandomScale((0.5, 1.5), p=1.0),
        A.AtLeastOneBBoxRandomCrop(9, 8),
    ],
    "map and crops by boxes in choices": lambda: [
        A.RandomThinPlateSpline(0.1, p=0.7),
        A.OneOf(A.RandomIoUCrop(), A.OpticalDistortion(p=1.0)),
        A.RandomApply([A.RandomElasticTransform((5, 5), (2.0, 2.0)), A.RandomCropNearBBox()]),
        A.OneOf(A.RandomAffine(20.0, p=1.0), A.RandomSizedBBoxSafeCrop(24, 28)),
    ],
    "crop by masks in choices": lambda: [
        A.OneOf(A.RandomRotation(30.0, p=1.0, expand=True), A.CropNonEmptyMaskIfExists(16, 20)),
        A.ImageSequential(A.RandomVerticalFlip(), A.RandomApply([A.CropNonEmptyMaskIfExists(9, 8)]), A.MaskDropout()),
    ],
    "inside": lambda: [
        A.ImageSequential(A.Transpose(), A.RandomApply([A.RandomRotation(9.0)])),
        A.RandomVerticalFlip(),
    ],
}
TOGETHER = [
    name for name in AUGMENTATIONS if "by masks" not in name and name != "crop by boxes in choices"
]  # where a few images take fewer turns
MAPS = [name for name in AUGMENTATIONS if "map" in name]  # of which rounding differs
FILTERS = {
    "all boxes": {},
    "clipped": {"clip_boxes": True, "min_box_visibility": 0.3},
    "clipped each": {"clip_boxes": "each"},
}
KEYS = ["input", "mask", "bbox_xyxy", "class", "bbox", "bbox_xywh", "keypoints"]
COUNTS = (2, 0, 1, 3)


def assert_same_labels(name, mine, other):
    if name in MAPS:
        torch.testing.assert_close(mine, other, rtol=0, atol=1e-3)
    else:
        assert_same(mine, other)


class Names(TorchDispatchMode):
    """The names of all operators that are called."""

    def __init__(self):
        super().__init__()
        self.names = []

    def __torch_dispatch__(self, operator, types, args=(), kwargs=None):
        self.names.append(operator._schema.name)
        return operator(*args, **(kwargs or {}))


def labels_of(images):
    boxes = [torch.rand(n, 4, device=x.device).cumsum(1) * 9 for n, x in zip(COUNTS, images)]
    corners = torch.rand(len(images), 2, 4, 2, device=images[0].device) * 30
    around = torch.stack([corners.amin(2), corners.amax(2)], 2)[
        :, :, [0, 0, 1, 0, 1, 1, 0, 1], [0, 1, 0, 1, 0, 1, 0, 1]
    ]
    points = [torch.rand(n, 2, device=x.device) * 30 for n, x in zip((1, 3, 0, 2), images)]
    masks = [(torch.rand(n, *x.shape[1:], device=x.device) < 0.5).byte() for n, x in zip(COUNTS, images)]
    names = [[f"{i}"] * n for i, n in enumerate(COUNTS)]
    return masks, boxes, names, around.unflatten(2, (4, 2)), [b.int() for b in boxes], points


@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("name", AUGMENTATIONS)
def test_labels_follow_as_alone(name, filters, device):
    augment = A.AugmentationSequential(*AUGMENTATIONS[name](), data_keys=KEYS, **FILTERS[filters])
    images = pictures(device)
    given, seeds = labels_of(images), seeds_of(images)
    results = augment(images, *given, seed=seeds)
    visible, kept = augment.visible_points, augment.kept_boxes
    for b, x in enumerate(images):
        own = augment(x[None], *[value[b : b + 1] for value in given], seed=seeds[b : b + 1])
        for of_list, alone in zip(results[1:], own[1:]):
            assert type(of_list[b]) is type(alone[0])
            if isinstance(alone[0], torch.Tensor):
                assert of_list[b].dtype == alone[0].dtype and of_list[b].shape == alone[0].shape
                assert_same_labels(name, of_list[b].double(), alone[0].double())
            else:
                assert of_list[b] == alone[0]
        assert all(torch.equal(mine[b], alone[0]) for mine, alone in zip(visible, augment.visible_points))
        assert len(kept) == len(augment.kept_boxes)
        assert all(torch.equal(mine[b], alone[0]) for mine, alone in zip(kept, augment.kept_boxes))


def test_images_that_no_filter_met_keep_their_boxes(device):
    """Which boxes stay is said for each of them, also of a list in parts, and of one image."""
    inner = A.AugmentationSequential(A.RandomAffine(0.0, (0.9, 0.9), p=1.0), clip_boxes=True)
    images = pictures(device)
    boxes = [torch.tensor([[1.0, 1, 9, 9]], device=device).repeat(n, 1) for n in COUNTS]
    for other in (A.RandomHorizontalFlip(), A.RandomElasticTransform((3, 3), (1.0, 1.0), p=1.0)):
        augment = A.AugmentationSequential(A.RandomApply([inner, other]), data_keys=["input", "bbox_xyxy"])
        for seed in range(4):
            seeds = seeds_of(images) + 4 * seed
            augment(images, boxes, seed=seeds)
            (kept,) = augment.kept_boxes
            assert [len(own) for own in kept] == [*COUNTS]
            for b, x in enumerate(images):
                augment(x[None], boxes[b : b + 1], seed=seeds[b : b + 1])
                assert torch.equal(augment.kept_boxes[0][0], kept[b])


@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("name", AUGMENTATIONS)
def test_replayed_labels_follow_as_before(name, filters, device):
    augment = A.AugmentationSequential(*AUGMENTATIONS[name](), data_keys=KEYS, **FILTERS[filters])
    images = pictures(device)
    given = labels_of(images)
    _, *results = augment(images, *given)
    visible, kept = augment.visible_points, augment.kept_boxes
    _, *replayed = augment(images, *given, params=augment._params)
    for before, after in zip(results, replayed):
        for mine, other in zip(before, after):
            if isinstance(mine, torch.Tensor):
                assert_same_labels(name, mine.double(), other.double())
            else:
                assert mine == other
    for before, after in zip([*visible, *kept], [*augment.visible_points, *augment.kept_boxes]):
        assert all(map(torch.equal, before, after))


@pytest.mark.parametrize("is_replay", [False, True], ids=["drawn", "replayed"])
@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("name", TOGETHER)
def test_launches_do_not_depend_on_the_number_of_labels(name, filters, is_replay, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    augment, counts = A.AugmentationSequential(*AUGMENTATIONS[name](), data_keys=KEYS, **FILTERS[filters]), []
    for times in (4, 4, 16):  # the first call makes constants
        images = pictures("cpu") * times
        given = [
            value * times if isinstance(value, list) else value.repeat(times, 1, 1, 1)
            for value in labels_of(images[:4])
        ]
        options = {"seed": seeds_of(images)}
        if is_replay:
            augment(images, *given, **options)
            options = {"params": augment._params}
        with Launches() as launches:
            augment(images, *given, **options)
        assert augment._record.labels is not None
        counts.append(launches.count)
    assert (
        counts[2] - counts[1] < 48
    )  # images: which turns these take is drawn, and where all boxes stay nothing is copied


def test_maps_are_made_once_for_images_whose_boxes_are_filtered_at_other_times(backend):
    """Once for images, once for masks, and once for all boxes and points."""
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    augment = A.AugmentationSequential(
        A.RandomApply([A.AugmentationSequential(A.Transpose(), min_box_area=60.0)]),
        A.RandomElasticTransform((5, 5), (2.0, 2.0), p=1.0),
        data_keys=KEYS,
    )
    images = pictures("cpu") * 4
    given = [value * 4 if isinstance(value, list) else value.repeat(4, 1, 1, 1) for value in labels_of(images[:4])]
    with Names() as called:
        augment(images, *given, seed=seeds_of(images))
    assert called.names.count("kvision::elastic_displacements_list") == 3


def test_labels_of_another_number_are_refused():
    augment = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), data_keys=["input", "bbox_xyxy"])
    images = pictures("cpu")
    with pytest.raises(ValueError, match="expected bbox_xyxy of 4 images"):
        augment(images, [torch.rand(1, 4)] * 3)
    with pytest.raises(ValueError, match="expected boxes of shape"):
        augment(images, [torch.rand(1, 5)] * 4)
    with pytest.raises(TypeError, match="of one type"):
        augment(images, [torch.rand(1, 4), *[torch.ones(1, 4, dtype=torch.int64)] * 3])


@pytest.mark.tracing
@pytest.mark.parametrize(
    "name", ["affine", "map and a crop by boxes", "crop of a window", "pad", "crop by boxes of all", "crop by masks"]
)
def test_graphs_have_masks_boxes_and_points(name):
    torch._dynamo.reset()  # there are as many graphs of containers as it keeps
    augment = A.AugmentationSequential(*AUGMENTATIONS[name](), data_keys=["input", "mask", "bbox_xyxy", "keypoints"])
    images = pictures("cpu")
    masks, boxes, *_, points = labels_of(images)
    compiled = torch.compile(augment, fullgraph=True, backend="aot_eager")
    for mine, eager in zip(
        compiled(images, masks, boxes, points, seed=3), augment(images, masks, boxes, points, seed=3)
    ):
        assert all(torch.allclose(a.double(), b.double(), atol=1e-4) for a, b in zip(mine, eager))


@pytest.mark.tracing
def test_graphs_clip_boxes_after_each_move():
    images = pictures("cpu")[:2]
    boxes = torch.tensor([[[2.0, 3.0, 12.0, 14.0], [2.0, 3.0, 18.0, 16.0]]]).repeat(2, 1, 1)
    augment = A.AugmentationSequential(
        A.RandomAffine(20.0, p=1.0), A.RandomHorizontalFlip(), data_keys=["input", "bbox_xyxy"], clip_boxes="each"
    )
    expected = augment(images, boxes, seed=3)[1]
    compiled = torch.compile(augment, fullgraph=True, backend="aot_eager")
    assert torch.allclose(compiled(images, boxes, seed=3)[1], expected, atol=1e-4)
