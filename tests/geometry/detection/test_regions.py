"""Areas, images and masks of boxes, as torchvision.ops 0.29.1 has them."""

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry
# One box of 4 x 2 in each format, and turned by 30 degrees.
BOX = {"xyxy": [2.0, 1, 6, 3], "xywh": [2.0, 1, 4, 2], "cxcywh": [4.0, 2, 4, 2], "xyxyxyxy": [2.0, 1, 6, 1, 6, 3, 2, 3]}
TURNED = [4.0, 2, 4, 2, 30]


class TestRegions(CompositionTests):
    cases = {
        "box_area": Case(lambda b: G.box_area(b, "xyxyxyxy"), ((2, 3, 8),)),
        "clip_boxes_to_image": Case(lambda b: G.clip_boxes_to_image(5 * b, (2, 3)), ((2, 3, 4),)),
        "masks_to_boxes": Case(lambda m: G.masks_to_boxes(m > 0.8).to(m.dtype), ((2, 4, 5),), differentiable=False),
    }


def test_areas(device):
    for fmt, box in BOX.items():
        assert G.box_area(torch.tensor([[box]], device=device), fmt).tolist() == [[8]]
    for fmt in ("cxcywhr", "xywhr", "xyxyxyxy"):
        turned = G.convert_boxes(torch.tensor(TURNED, device=device), "cxcywhr", fmt)
        assert_close(G.box_area(turned, fmt).cpu(), torch.tensor(8.0), 1e-5, 1e-5)
    assert G.box_area(torch.tensor([[0, 0, 3, 4]], device=device)).dtype == torch.float32


def test_boxes_of_an_image(device):
    boxes = torch.tensor([[-1.0, 2, 5, 9], [3, -4, 12, 2], [20, 20, 30, 30]], device=device)
    clipped = G.clip_boxes_to_image(boxes, (8, 10))
    assert clipped.tolist() == [[0, 2, 5, 8], [3, 0, 10, 2], [10, 8, 10, 8]]
    assert G.remove_small_boxes(clipped, 2).tolist() == [0, 1] and G.remove_small_boxes(boxes, 6.5).tolist() == [2]


def test_masks(device):
    masks = torch.zeros(2, 2, 6, 8, device=device)
    masks[0, 0, 2:4, 3:7] = 0.5
    masks[0, 1, 5, 7] = masks[1, 1, 0, 0] = masks[1, 1, 5, 7] = 1  # masks[1, 0] is empty
    assert G.masks_to_boxes(masks).tolist() == [[[3, 2, 6, 3], [7, 5, 7, 5]], [[0, 0, 0, 0], [0, 0, 7, 5]]]
    assert G.masks_to_boxes(masks.bool(), "xyxy")[0].tolist() == [[3, 2, 7, 4], [7, 5, 8, 6]]
    assert G.masks_to_boxes(masks, "xyxy")[1, 0].tolist() == [0, 0, 0, 0]
    assert G.masks_to_boxes(masks[:0]).shape == (0, 2, 4)


BAD = [
    (lambda: G.box_area(torch.ones(2, 4), "xywhr"), ValueError, r"box_area: expected boxes of shape \(\*, 5\)"),
    (lambda: G.box_area(torch.ones(2, 4), "yxyx"), ValueError, "box_area: fmt must be one of"),
    (lambda: G.clip_boxes_to_image(torch.ones(2, 4), (0, 3)), ValueError, "clip_boxes_to_image: expected size"),
    (lambda: G.remove_small_boxes(torch.ones(2, 3), 1), ValueError, r"expected boxes of shape \(N, 4\)"),
    (lambda: G.masks_to_boxes(torch.ones(2, 0, 4)), ValueError, "masks with H, W of at least 1"),
    (lambda: G.masks_to_boxes(torch.ones(2, 4, 4), "edges"), ValueError, "masks_to_boxes: mode must be one of"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
