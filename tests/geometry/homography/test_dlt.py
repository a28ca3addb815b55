"""Homographies by direct linear transformation."""

import cv2
import pytest
import torch

import kvision as K
from composition_tests import Case, on
from op_tests import assert_close
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, vector
from view_tests import ViewTests, finite_gradients, on_planes, points

G = K.geometry
# Values of the tests are random in [0.1, 1); these are what they are added to.
X, Y, H = on_planes(1, 12)
X7, Y7, LINES_X, LINES_Y = X[:, :7], Y[:, :7], X.view(6, 2, 2), Y.view(6, 2, 2)
POINTS = (2, 12, 2)


class TestDlt(ViewTests):
    cases = {
        "homography": Case(lambda x, y: G.find_homography_dlt(points(x, X), points(y, Y)), (POINTS, POINTS)),
        "weighted": Case(lambda x, w: G.find_homography_dlt(x, points(x, Y), w), (POINTS, (2, 12))),
        "iterated": Case(
            lambda x, w: G.find_homography_dlt_iterated(points(x, X), on(x.device, Y).to(x.dtype).expand_as(x), w, 9.0, 3),
            (POINTS, (2, 12)),
        ),
        "lines": Case(
            lambda x, w: G.find_homography_lines_dlt(points(x, LINES_X), points(x, LINES_Y), w),
            ((2, 6, 2, 2), (2, 6)),
        ),
    }  # fmt: skip
    compiled = ("weighted", "lines")


def test_homographies_of_degenerate_points(device):
    square = torch.tensor([[[0.0, 0], [9, 0], [9, 9], [0, 9]]]).to(device)
    assert_close(
        finite_gradients(G.find_homography_dlt, square, 3 * square + 1)[0, 2, 2], torch.tensor(1.0, device=device)
    )
    line = torch.arange(10.0, device=device)[None, :, None].expand(1, 10, 2)
    one = torch.ones(1, 5, 2, device=device)
    for same in (line, one, torch.zeros_like(one)):
        finite_gradients(G.find_homography_dlt, same, same + 1)
    weights = torch.tensor([[1.0, 1, 1, 1, 0]], device=device)
    outlier = torch.cat([square, square[:, :1] + 50], 1), torch.cat([2 * square, square[:, :1]], 1)
    result = finite_gradients(lambda x, y: G.find_homography_dlt(x, y, weights), *outlier)
    assert_close(result, torch.diag(torch.tensor([2.0, 2, 1], device=device))[None], 0, 1e-4)


def test_not_finite_points_stay_in_their_sample(device):
    x, y, H = (v.to(device) for v in on_planes(2, 8))
    x[1, 3, 0] = float("nan")
    result = G.find_homography_dlt(x, y)
    assert_close(result[0], (H / H[:, 2:, 2:])[0], 1e-6, 1e-6)
    assert result[1].isnan().all()


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16], ids=str)
def test_half_types_are_rounded_once(dtype, device):
    x, y = (v.to(device, dtype) for v in on_planes(1, 9)[:2])
    for call in (
        G.find_homography_dlt,
        lambda x, y: G.sampson_epipolar_distance(x, y, torch.ones(1, 3, 3, dtype=dtype, device=device)),
        lambda x, y: G.normalize_points(x)[0],
    ):
        result = call(x, y)
        assert result.dtype == dtype
        assert_close(result, call(x.float(), y.float()).to(dtype), 1e-2, 1e-2)


def test_float32_is_as_good_as_it_can_be(device):
    x, y, H = (v.to(device) for v in on_planes(8, 9))
    expected = H / H[:, 2:, 2:]
    result = G.find_homography_dlt(x.float(), y.float())
    assert_close(result.double(), G.find_homography_dlt(x.float().double(), y.float().double()), 1e-5, 1e-6)
    assert_close(result.double(), expected, 1e-3, 1e-4)


def test_opencv_homography():
    x, y, _ = on_planes(3, 30, noise=0.5)
    for a, b, result in zip(x, y, G.find_homography_dlt(x, y)):
        expected = torch.from_numpy(cv2.findHomography(a.numpy(), b.numpy(), 0)[0])
        error, opencv_error = (G.oneway_transfer_error(a[None], b[None], h[None]).mean() for h in (result, expected))
        assert error < 1.05 * opencv_error  # OpenCV refines the same estimate by Levenberg-Marquardt


P, Q, M = torch.rand(2, 8, 2), torch.rand(2, 8, 2), torch.rand(2, 3, 3)
BAD = [
    (lambda: G.find_homography_dlt([1.0], Q), TypeError, "find_homography_dlt: expected points1 to be a Tensor, got list"),
    (lambda: G.find_homography_dlt(P.int(), Q), TypeError, "find_homography_dlt: expected points1 to be floating point"),
    (lambda: G.find_homography_dlt(P[:, :3], Q[:, :3]), ValueError, "find_homography_dlt: expected points1 of shape .* at least 4"),
    (lambda: G.find_homography_dlt(P, Q[:1]), ValueError, "find_homography_dlt: expected tensors of one shape"),
    (lambda: G.find_homography_dlt(P, Q, torch.ones(2, 7)), ValueError, r"find_homography_dlt: expected weights of shape \(2, 8\)"),
    (lambda: G.find_homography_dlt(P, Q, solver="qr"), NotImplementedError, "find_homography_dlt: solver must be one of lu, svd"),
    (lambda: G.find_homography_dlt_iterated(P, Q, P[..., 0], 0.0), ValueError, "find_homography_dlt_iterated: expected"),
    (lambda: G.find_homography_dlt_iterated(P, Q, P[..., 0], n_iter=0), ValueError, "find_homography_dlt_iterated: expected"),
    (lambda: G.find_homography_lines_dlt(P, Q), ValueError, r"find_homography_lines_dlt: expected ls1 of shape \(B, N, 2, 2\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


# Points of both images of a plane, a little off, so that what fits them is unique.
PLANE = [lambda x=x: x[0] + 0.5 * torch.rand_like(x[0]) for x in on_planes(1, 12)[:2]]
LINES = [lambda x=x: x().view(6, 2, 2) for x in PLANE]


class TestDltOperators(PointOpTests):
    calls = {
        "homography_dlt": [
            Call(
                (*PLANE, vector(12)),
                broadcasts=False,
                accepted=("another dtype",),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=500,
            ),
            Call(
                (*PLANE, None), broadcasts=False, accepted=("another dtype",), dtypes=SINGLE_AND_DOUBLE, tolerance=500
            ),
        ],
        "homography_lines_dlt": [
            Call(
                (*LINES, vector(6)),
                broadcasts=False,
                accepted=("another dtype",),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=500,
            )
        ],
    }
