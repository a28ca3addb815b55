"""Boxes and key points in the formats of data sets."""

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry
# One box of columns 2 to 5 and rows 1 to 2, of an image of 8 x 16.
BOX = {
    "xyxy": [2, 1, 6, 3],
    "xywh": [2, 1, 4, 2],
    "cxcywh": [4, 2, 4, 2],
    "xyxy_plus": [2, 1, 5, 2],
    "normalized_xyxy": [2 / 16, 1 / 8, 6 / 16, 3 / 8],
    "normalized_xywh": [2 / 16, 1 / 8, 4 / 16, 2 / 8],
    "normalized_cxcywh": [4 / 16, 2 / 8, 4 / 16, 2 / 8],
}
# The same box of columns 2 to 5 and rows 1 to 2 turned by 30 degrees, as torchvision 0.29.1 converts it.
COS, SIN = 3**0.5 / 2, 0.5
TURNED = {
    "cxcywhr": [4, 2, 4, 2, 30],
    "xywhr": [4 - 2 * COS - SIN, 2 - COS + 2 * SIN, 4, 2, 30],
    "xyxyxyxy": [
        *(4 - 2 * COS - SIN, 2 - COS + 2 * SIN, 4 + 2 * COS - SIN, 2 - COS - 2 * SIN),
        *(4 + 2 * COS + SIN, 2 + COS - 2 * SIN, 4 - 2 * COS + SIN, 2 + COS + 2 * SIN),
    ],
}
POINT = {"centers": [3, 2], "edges": [3.5, 2.5], "normalized_edges": [3.5 / 16, 2.5 / 8]}


class TestLabels(CompositionTests):
    cases = {
        "convert_boxes": Case(lambda x: G.convert_boxes(x, "normalized_cxcywh", "xyxy_plus", (8, 16)), ((2, 5, 4),)),
        "convert_boxes rotated": Case(lambda x: G.convert_boxes(x, "xyxyxyxy", "xywhr"), ((2, 5, 8),)),
        "convert_keypoints": Case(lambda x: G.convert_keypoints(x, "centers", "normalized_edges", (8, 16)), ((2, 2),)),
    }
    compiled = ()


@pytest.mark.parametrize(
    "convert, values",
    [(G.convert_boxes, BOX), (G.convert_boxes, TURNED), (G.convert_keypoints, POINT)],
    ids=["boxes", "rotated boxes", "points"],
)
def test_every_mode_to_every_other(convert, values, device):
    for source, value in values.items():
        for target, expected in values.items():
            x = torch.tensor([[value]] * 2, device=device, dtype=torch.float64)
            result = convert(x, source, target, (8, 16))
            assert_close(result.cpu(), torch.tensor([[expected]] * 2, dtype=torch.float64), 0, 1e-12)
            assert result.data_ptr() != x.data_ptr(), (source, target)


def test_upright_boxes_become_rotated_ones():
    for mode, box in BOX.items():
        assert_close(
            G.convert_boxes(torch.tensor(box).float(), mode, "cxcywhr", (8, 16)), torch.tensor([4.0, 2, 4, 2, 0])
        )


def test_boxes_are_those_of_the_object():
    boxes = torch.tensor([[[2.0, 1, 4, 2]]])
    for mode in ("xyxy", "xyxy_plus", "xywh"):
        assert_close(G.convert_boxes(boxes, "xywh", mode), G.Boxes.from_tensor(boxes, mode="xywh").to_tensor(mode))


BAD = [
    (lambda: G.convert_boxes(torch.ones(3), "xyxy", "xywh"), ValueError, r"expected boxes of shape \(\*, 4\)"),
    (lambda: G.convert_boxes(torch.ones(4), "xyxy", "yolo"), ValueError, "out_mode must be one of"),
    (lambda: G.convert_boxes(torch.ones(4), "xywhr", "xywhr"), ValueError, r"expected boxes of shape \(\*, 5\)"),
    (lambda: G.convert_boxes(torch.ones(5), "xywhr", "xywh"), ValueError, "expected out_mode to be one of"),
    (lambda: G.convert_boxes(torch.ones(4), "xyxy", "normalized_xywh"), ValueError, "expected image_size"),
    (lambda: G.convert_keypoints(torch.ones(2), "edges", "normalized_edges"), ValueError, "expected image_size"),
    (lambda: G.convert_keypoints(torch.ones(2), "edges", "centers", 2.0), TypeError, "expected image_size"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
