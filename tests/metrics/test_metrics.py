"""Metrics: the values of Kornia 0.9 and known ones."""

from __future__ import annotations

import math

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests
from kvision import _ops
from op_tests import assert_close, does_not_wait, instruction_set

M = K.metrics


@pytest.fixture(scope="module")
def kornia():
    return pytest.importorskip("kornia.metrics")


def rand(*shape: int) -> torch.Tensor:
    return torch.rand(shape, dtype=torch.float64)


def rotations(n: int, angle: float) -> torch.Tensor:
    """Turned by `angle` radians about random axes."""
    x, y, z = torch.nn.functional.normalize(torch.randn(n, 3, dtype=torch.float64), dim=1).unbind(1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).view(n, 3, 3)
    return torch.linalg.matrix_exp(angle * cross)


@pytest.mark.parametrize("padding", ["same", "valid"])
def test_ssim(kornia, padding):
    x, y = rand(2, 3, 14, 15), rand(2, 3, 14, 15)
    assert_close(M.ssim(x, y, 7, 2.0, padding=padding), kornia.ssim(x, y, 7, 2.0, padding=padding), 1e-8, 1e-9)
    assert_close(M.SSIM(7)(x, y), M.ssim(x, y, 7))
    v, w = rand(1, 2, 7, 8, 9), rand(1, 2, 7, 8, 9)
    assert_close(M.ssim3d(v, w, 5, padding=padding), kornia.ssim3d(v, w, 5, padding=padding), 1e-8, 1e-9)
    assert_close(M.SSIM3D(5)(v, w), M.ssim3d(v, w, 5))
    assert (
        M.ssim(torch.full((1, 1, 9, 9), 200, dtype=torch.uint8), torch.zeros(1, 1, 9, 9).byte(), 3, 255.0).dtype
        == torch.float32
    )


def test_psnr(kornia):
    x, y = rand(2, 3), rand(2, 3)
    assert_close(M.psnr(x, y, 2.0), kornia.psnr(x, y, 2.0))


def test_accuracy(kornia):
    pred, target = rand(20, 6), torch.randint(0, 6, (20,))
    for ours, theirs in zip(M.accuracy(pred, target, (1, 3, 9)), kornia.accuracy(pred, target, (1, 3, 9))):
        assert_close(ours, theirs)


LABELS = (torch.int64, torch.int32, torch.uint8)


@pytest.mark.parametrize("classes", [2, 21, 150])  # many copies of the counts in shared memory, a few, none
@pytest.mark.parametrize("dtype", LABELS, ids=str)
def test_confusion_matrix(kornia, dtype, classes, device):
    pred, target = torch.randint(0, classes, (2, 3, 97, 101)).to(device, dtype)
    target[:, :50] = 1
    for normalized in (False, True):
        assert_close(
            M.confusion_matrix(pred, target, classes, normalized).cpu(),
            kornia.confusion_matrix(pred.cpu().long(), target.cpu().long(), classes, normalized),
        )
    expected = kornia.mean_iou(pred.cpu().long(), target.cpu().long(), classes)
    assert_close(M.mean_iou(pred, target, classes).cpu(), expected)
    assert (M.mean_iou(pred, target, classes + 1)[:, classes] == 1).all()


def test_labels_of_no_class(device):
    pred, target = torch.randint(0, 5, (2, 3, 40, 10)).to(device)
    target[0, 0, 0], pred[1, 0, 0] = 5, 200
    for dtype in LABELS:
        counts = M.confusion_matrix(pred.to(dtype), target.to(dtype), 5)
        assert counts.sum((1, 2)).tolist() == [399, 399, 400]
        assert M.confusion_matrix(pred[:0].to(dtype), target[:0].to(dtype), 5).shape == (0, 5, 5)
        assert (M.confusion_matrix(pred[..., :0].to(dtype), target[..., :0].to(dtype), 5) == 0).all()
    target[0, 0, 0], pred[1, 0, 0] = -1, -(2**60)
    target[2, 0, 0] = 2**32
    assert M.confusion_matrix(pred, target, 5).sum((1, 2)).tolist() == [399, 399, 399]


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_instruction_sets(isa, device, backend):
    if backend == "reference" or device.type != "cpu":
        pytest.skip("instruction sets are the kernels' on the CPU")
    pred, target, boxes = *torch.randint(0, 7, (2, 3, 500)).byte(), rand(9, 4).float().cumsum(1)
    calls = (lambda: M.mean_iou(pred, target, 6), lambda: M.mean_iou_bbox(boxes, boxes[:5], "cxcywh"))
    for call in calls:
        with instruction_set(isa), K.backend("native"):
            result = call()
        with K.backend("reference"):
            assert_close(result, call())


def test_operators_of_labels_and_boxes(device, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    pred, target = torch.randint(0, 4, (2, 2, 9), device=device)
    utils = torch.library._OPCHECK_DEFAULT_UTILS
    for statistic in range(3):
        torch.library.opcheck(
            torch.ops.kvision.confusion_matrix.default, (pred, target, 3, statistic, 1e-6), test_utils=utils
        )
        utils = ("test_schema", "test_faketensor")
    boxes, others = (torch.rand(2, n, 4, device=device).cumsum(2).requires_grad_() for n in (3, 5))
    torch.library.opcheck(torch.ops.kvision.box_iou.default, (boxes, others, 1))
    for wrong in (
        lambda: torch.ops.kvision.confusion_matrix(pred, target[:1], 3, 0, 0.0),
        lambda: torch.ops.kvision.confusion_matrix(pred.int(), target.int(), 3, 0, 0.0),
        lambda: torch.ops.kvision.confusion_matrix(pred, target, 0, 0, 0.0),
        lambda: torch.ops.kvision.confusion_matrix(pred, target, 3, 3, 0.0),
        lambda: torch.ops.kvision.box_iou(boxes[:, :, :3], others, 1),
        lambda: torch.ops.kvision.box_iou(boxes, others.double(), 1),
        lambda: torch.ops.kvision.box_iou(boxes, others, 3),
        lambda: torch.ops.kvision.box_iou_backward(torch.rand(2, 5, 3, device=device), boxes, others, 1),
        lambda: torch.ops.kvision.box_iou_backward(torch.rand(2, 3, 5, device=device), boxes, others, 3),
    ):
        with pytest.raises(RuntimeError, match="confusion_matrix: |box_iou: |box_iou_backward: "):
            wrong()


class TestCompositions(CompositionTests):
    cases = {
        "mean_iou_bbox": Case(lambda a, b: M.mean_iou_bbox(a.cumsum(1), b, "xywh"), ((3, 4), (5, 4)), shared=(1,)),
        "box_iou": Case(lambda a, b: _ops.operators["box_iou"](a.cumsum(2), b.cumsum(2), 0), ((2, 3, 4), (2, 4, 4))),
        "mean_iou": Case(lambda a: M.mean_iou((4 * a).long(), (3 * a).long(), 3), ((2, 3, 5),), differentiable=False),
    }


@pytest.mark.parametrize("box_format", ["xyxy", "xywh", "cxcywh"])
def test_boxes(kornia, box_format):
    a, b = (torch.cat([rand(n, 2), 1 + rand(n, 2)], 1) for n in (5, 7))
    assert_close(M.mean_iou_bbox(a, b, box_format), kornia.mean_iou_bbox(a, b, box_format))
    a[0, 2:] = -5
    assert M.mean_iou_bbox(a, b, box_format)[0].isnan().all()


def test_mean_average_precision(kornia):
    torch.manual_seed(5)
    classes = 4
    gt_boxes = [torch.cat([c := 10 * torch.rand(n, 2), c + 1 + torch.rand(n, 2)], 1) for n in (3, 0, 5, 2, 4, 1)]
    gt_labels = [torch.randint(0, classes - 1, (len(b),)) for b in gt_boxes]
    pred_boxes = [torch.cat([b + 0.3 * torch.randn_like(b).clamp(-1, 1), b[:2] + 0.1, 10 + b[:1]]) for b in gt_boxes]
    pred_labels = [torch.cat([y, y[:2], y[:1]]) for y in gt_labels]
    scores = [torch.rand(len(b)) for b in pred_boxes]
    for threshold in (0.3, 0.5):
        arguments = (pred_boxes, pred_labels, scores, gt_boxes, gt_labels, classes, threshold)
        mean, each = M.mean_average_precision(*arguments)
        expected_mean, expected = kornia.mean_average_precision(*arguments)
        assert_close(mean, expected_mean, 1e-6, 1e-6)
        assert each == pytest.approx(expected, abs=1e-6) and each[classes - 1] == -1
    with pytest.raises(ValueError, match="mean_average_precision: expected labels in"):
        M.mean_average_precision(pred_boxes, pred_labels, scores, gt_boxes, gt_labels, 2)


@pytest.mark.parametrize("reduction", ["mean", "sum", "none"])
@pytest.mark.parametrize(
    "name",
    ["mean_absolute_disparity_error", "root_mean_squared_disparity_error", "mean_bad_pixel_error", "kitti_d1_error"],
)
def test_disparity(kornia, name, reduction):
    x, y = 40 * rand(2, 5, 6), 40 * rand(2, 5, 6)
    for mask in (None, rand(5, 6) > 0.4):
        options = {"valid_mask": mask, "reduction": reduction}
        assert_close(getattr(M, name)(x, y, **options), getattr(kornia, name)(x, y, **options))
    perfect = x.clone().requires_grad_()
    if (loss := getattr(M, name)(perfect, x).sum()).requires_grad:
        loss.backward()
        assert perfect.grad.isfinite().all()


@pytest.mark.parametrize("reduction", ["mean", "sum", "none"])
def test_endpoint_error(kornia, reduction):
    x, y = rand(3, 4, 2), rand(3, 4, 2)
    assert_close(M.aepe(x, y, reduction), kornia.aepe(x, y, reduction))
    assert_close(M.AEPE(reduction)(x, y), M.average_endpoint_error(x, y, reduction))
    perfect = x.clone().requires_grad_()
    M.aepe(perfect, x, reduction).sum().backward()
    assert (perfect.grad == 0).all()


def test_pose(kornia):
    for angle in (0.0, 1e-7, 1.0, math.pi - 1e-7):
        R = rotations(6, 0.7)
        turned = R @ rotations(6, angle)
        assert_close(
            M.angle_error_mat(R, turned), torch.full((6,), math.degrees(angle), dtype=torch.float64), 1e-7, 1e-6
        )
    P, P_gt = torch.cat([rotations(4, 1.0), 1 - 2 * rand(4, 3, 1)], 2), torch.cat([rotations(4, 2.0), rand(4, 3, 1)], 2)
    for fold in (True, False):
        ours, theirs = M.pose_errors(P, P_gt, fold), kornia.pose_errors(P, P_gt, fold)
        assert ours.keys() == theirs.keys()
        for key in ours:
            assert_close(ours[key], theirs[key], 1e-7, 1e-7)
    assert_close(M.translation_ate(P[..., 3], P_gt[..., 3]), kornia.translation_ate(P[..., 3], P_gt[..., 3]))
    same = P[:1, :, 3].clone().requires_grad_()
    M.angle_error_vec(same, P[:1, :, 3]).sum().backward()
    assert same.grad.isfinite().all()


def test_auc(kornia):
    errors = 12 * rand(50)
    assert M.auc_from_errors(errors) == pytest.approx(kornia.auc_from_errors(errors))
    assert M.auc_from_errors(errors, 20.0) == pytest.approx(kornia.auc_from_errors(errors, 20.0))
    errors[3] = torch.nan
    assert all(math.isnan(v) for v in M.auc_from_errors(errors).values())


@pytest.mark.parametrize(
    "call, error, message",
    [
        (lambda: M.accuracy(rand(3), rand(3)), ValueError, "accuracy: expected pred of shape"),
        (
            lambda: M.confusion_matrix(rand(2, 3), rand(2, 3), 3),
            TypeError,
            "confusion_matrix: expected pred to hold integer",
        ),
        (
            lambda: M.mean_iou(torch.ones(2).long(), torch.ones(2).long(), 1),
            ValueError,
            "mean_iou: expected num_classes",
        ),
        (lambda: M.mean_iou_bbox(rand(2, 4), rand(2, 4), "yxyx"), ValueError, "mean_iou_bbox: box_format"),
        (
            lambda: M.mean_average_precision([], [], [], [], [], 2),
            ValueError,
            "mean_average_precision: expected an entry",
        ),
        (lambda: M.aepe(rand(2, 3), rand(2, 3)), ValueError, "aepe: expected input of shape"),
        (lambda: M.aepe(rand(2), rand(2), "max"), NotImplementedError, "aepe: reduction"),
        (
            lambda: M.kitti_d1_error(torch.ones(2).long(), rand(2)),
            TypeError,
            "kitti_d1_error: expected input to be floating",
        ),
        (
            lambda: M.mean_bad_pixel_error(rand(2), rand(2), valid_mask=rand(3)),
            ValueError,
            "mean_bad_pixel_error: expected a val",
        ),
        (lambda: M.angle_error_mat(rand(3), rand(3)), ValueError, "angle_error_mat: expected R1 of shape"),
        (lambda: M.pose_errors(rand(3, 3), rand(3, 3)), ValueError, "pose_errors: expected P of shape"),
        (lambda: M.translation_ate([1.0], rand(3)), TypeError, "translation_ate: expected t to be a Tensor"),
        (lambda: M.auc_from_errors(-rand(3)), ValueError, "auc_from_errors: expected errors of at least 0"),
        (lambda: M.auc_from_errors(rand(3), ()), ValueError, "auc_from_errors: expected thresholds"),
        (lambda: M.psnr(rand(3), None, 1.0), TypeError, "psnr: expected target to be a Tensor"),
        (
            lambda: M.ssim(rand(1, 1, 3, 3), rand(1, 1, 3, 3), 5, padding="valid"),
            ValueError,
            "ssim: expected images no smaller",
        ),
    ],
)
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


def test_does_not_synchronize_with_the_device(device):
    x, y, v = rand(2, 3, 16, 16).to(device), rand(2, 3, 16, 16).to(device), rand(1, 2, 9, 8, 8).to(device)
    labels, R, t = (4 * y[:, 0]).long(), rotations(3, 0.2).to(device), rand(3, 3).to(device)
    P = torch.cat([R, t[:, :, None]], 2)
    calls = (
        lambda: M.accuracy(x[:, :, 0, 0], labels[:, 0, 0].clamp_max(2), (1, 2)),
        lambda: M.aepe(x[..., :2], y[..., :2]),
        lambda: M.angle_error_mat(R, R.mT),
        lambda: M.angle_error_vec(t, t.flip(0)),
        lambda: M.confusion_matrix(labels, labels.flip(0), 4, normalized=True),
        lambda: M.kitti_d1_error(x, y),
        lambda: M.mean_absolute_disparity_error(x, y, valid_mask=x > 0.5),
        lambda: M.mean_bad_pixel_error(x, y),
        lambda: M.mean_iou(labels, labels.flip(0), 4),
        lambda: M.mean_iou_bbox(x[0, 0, :, :4], y[0, 0, :, :4]),
        lambda: M.pose_errors(P, P.flip(0)),
        lambda: M.psnr(x, y, 1.0),
        lambda: M.root_mean_squared_disparity_error(x, y),
        lambda: M.ssim(x, y, 5),
        lambda: M.ssim3d(v, v.flip(2), 5),
        lambda: M.translation_ate(t, t.flip(0)),
    )
    does_not_wait(device, calls)
