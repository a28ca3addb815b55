"""Patches, regions, noise, histograms, clusters: known values, and those of SciPy and Kornia 0.9."""

from __future__ import annotations

import pytest
import scipy.ndimage
import torch

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import LAYOUTS, OpTests, assert_close, with_layout

C = K.contrib


@pytest.fixture(scope="module")
def kornia():
    return pytest.importorskip("kornia.contrib")


def spiral(size: int) -> torch.Tensor:
    """One region of one pixel's width that winds through the whole image."""
    mask = torch.zeros(size, size)
    y = x = 0
    dy, dx, length = 0, 1, size - 1
    for turn in range(size):
        for _ in range(length):
            mask[y, x] = 1
            y, x = y + dy, x + dx
        dy, dx = dx, -dy
        length -= 2 if turn % 2 == 1 and turn > 1 else 0
        if length <= 0:
            break
    return mask


class TestCompositions(CompositionTests):
    cases = {
        "extract": Case(lambda x: C.extract_tensor_patches(x, (3, 2), (2, 1), (1, 0)), ((2, 3, 7, 8),)),
        "combine": Case(lambda p: C.combine_tensor_patches(p, (6, 8), (4, 4), (2, 2)), ((2, 6, 3, 4, 4),)),
        "distance": Case(lambda x: C.distance_transform(0.7 * x), ((2, 1, 6, 5),)),
        "interp": Case(
            lambda x, f: C.interp(x, torch.arange(4.0, device=x.device).double(), f), ((2, 3, 4, 5), (4,)), (1,)
        ),
    }
    compiled = ("extract", "combine")

    def test_transforms(self, case, name, device):
        if name == "interp":
            pytest.skip("its points serve the whole batch")
        super().test_transforms(case, device)


@pytest.mark.parametrize(
    "window, stride, padding, auto",
    [
        (4, 4, 0, False),
        ((3, 2), (2, 1), 0, False),
        (5, 3, (1, 2), False),
        (4, 3, (0, 1, 2, 3), False),
        ((5, 4), (3, 4), 0, True),
    ],
)
@pytest.mark.filterwarnings("ignore:The window")
def test_patches(kornia, window, stride, padding, auto, device):
    x = torch.rand(2, 3, 14, 13)
    patches = C.extract_tensor_patches(x.to(device), window, stride, padding, auto)
    assert_close(patches.cpu(), kornia.extract_tensor_patches(x, window, stride, padding, auto))
    expected = kornia.combine_tensor_patches(patches.cpu(), (14, 13), window, stride, auto, padding)
    assert_close(C.combine_tensor_patches(patches, (14, 13), window, stride, auto, padding).cpu(), expected, 1e-6, 1e-6)


def test_patches_round_trip(device):
    for dtype in (torch.uint8, torch.float16, torch.int64):
        x = torch.randint(0, 200, (2, 3, 10, 12), device=device).to(dtype)
        for stride in (4, 3, 1):
            patches = C.ExtractTensorPatches(4, stride, allow_auto_padding=True)(x)
            back = C.CombineTensorPatches((10, 12), 4, stride, allow_auto_unpadding=True)(patches)
            assert_close(back, x, 0, 0)
    assert C.compute_padding(10, 4, 3) == (0, 0, 0, 0) and C.compute_padding((10, 3), 4) == (1, 1, 0, 1)


def test_components_are_scipys(device):
    masks = (torch.rand(3, 1, 40, 50) < torch.tensor([0.2, 0.4, 0.6])[:, None, None, None]).float()
    masks[0, 0] = 0
    masks[1, 0, :40, :40] = spiral(40)
    labels = C.connected_components(masks.to(device)).cpu()
    assert_close(C.connected_components_union_find(masks.to(device)).cpu(), labels)
    for mask, label in zip(masks[:, 0], labels[:, 0]):
        expected, count = scipy.ndimage.label(mask.numpy(), torch.ones(3, 3))
        pairs = torch.stack([label.flatten(), torch.from_numpy(expected).flatten().long()]).unique(dim=1)
        assert pairs.shape[1] == count + int((mask == 0).any()), "labels correspond one to one"
        assert ((label == 0) == (mask == 0)).all()
    assert C.connected_components(masks[:0]).shape == (0, 1, 40, 50)
    assert_close(C.connected_components(masks[2]), labels[2])
    firsts = labels[2].flatten().unique()[1:]
    assert all((labels[2].flatten() == first).nonzero()[0] == first - 1 for first in firsts)


@pytest.mark.parametrize("size", [(2, 1, 9, 9), (1, 3, 17, 30), (2, 2, 5, 3), (1, 1, 1, 2), (1, 1, 40, 7)])
def test_diamond_square(kornia, size):
    for options in ({}, {"roughness": 0.8, "random_scale": 0.6}, {"normalize_range": (0.0, 1.0)}):
        torch.manual_seed(1)
        expected = kornia.diamond_square(size, **options)
        torch.manual_seed(1)
        assert_close(C.diamond_square(size, **options), expected, 1e-5, 1e-5)
    each = C.diamond_square(size, torch.linspace(0.3, 0.6, size[0]), torch.ones(size[0]), torch.zeros)
    assert torch.equal(C.diamond_square(size, torch.tensor(0.5).double(), random_fn=torch.ones), torch.ones(size))
    assert each.shape == size and (each == 0).all()


def test_histogram_matching(kornia):
    exposure = pytest.importorskip("skimage.exposure")
    x, y = torch.randint(0, 20, (2, 30, 31)).double()
    actual = C.histogram_matching(x, y)
    assert_close(actual, kornia.histogram_matching(x, y), 1e-7, 1e-7)
    assert (actual - torch.from_numpy(exposure.match_histograms(x.numpy(), y.numpy()))).abs().max() <= 1
    template = torch.rand(50, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda t: C.histogram_matching(x[:3], t), template)
    assert C.histogram_matching(x[:0], y).shape == (0, 31)


def test_interp(kornia):
    x, xp, fp = 6 * torch.rand(3, 4, dtype=torch.float64) - 1, torch.arange(5).double() ** 1.1, torch.rand(5).double()
    assert_close(C.interp(x, xp, fp), kornia.interp(x, xp, fp), 1e-12, 1e-12)
    assert_close(C.interp(xp, xp, fp), fp)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16, torch.int64], ids=str)
def test_kmeans(kornia, dtype):
    points = torch.cat([torch.randn(20, 2) + torch.tensor(c) for c in ((0.0, 0.0), (50.0, 0.0), (0.0, 50.0))])
    points = (points if dtype.is_floating_point else 10 * points).to(dtype)
    first = points[[0, 20, 40]]
    kmeans, theirs = C.KMeans(3, first), kornia.KMeans(3, first)
    kmeans.fit(points)
    theirs.fit(points)
    assert_close(kmeans.cluster_centers, theirs.cluster_centers, 1e-3, 1e-3)
    assert_close(kmeans.cluster_assignments, torch.arange(3).repeat_interleave(20))
    assert_close(kmeans.predict(points), kmeans.cluster_assignments)
    kmeans = C.KMeans(3, None, tolerance=None, max_iterations=3, seed=0)
    with pytest.raises(TypeError, match="after fit"):
        _ = kmeans.cluster_centers
    state = torch.get_rng_state()
    kmeans.fit(points)
    assert kmeans.cluster_centers.shape == (3, 2)
    first = kmeans.cluster_centers
    kmeans.fit(points)
    assert torch.equal(kmeans.cluster_centers, first) and torch.equal(torch.get_rng_state(), state)


@pytest.mark.parametrize(
    "call, error, message",
    [
        (lambda: C.extract_tensor_patches([1], 3), TypeError, "extract_tensor_patches: expected input to be a Tensor"),
        (
            lambda: C.extract_tensor_patches(torch.rand(3, 3), 3),
            ValueError,
            "extract_tensor_patches: expected input of shape",
        ),
        (
            lambda: C.extract_tensor_patches(torch.rand(1, 1, 3, 3), 0),
            ValueError,
            "extract_tensor_patches: expected window_size",
        ),
        (lambda: C.extract_tensor_patches(torch.rand(1, 1, 3, 3), 4), ValueError, "no smaller than a window"),
        (
            lambda: C.extract_tensor_patches(torch.rand(1, 1, 3, 3), 2, 1, (1, 2, 3)),
            TypeError,
            "expected padding to be",
        ),
        (
            lambda: C.combine_tensor_patches(torch.rand(1, 4, 1, 2, 2), 4, 2, 3),
            ValueError,
            "expected a stride of at most",
        ),
        (lambda: C.combine_tensor_patches(torch.rand(1, 5, 1, 2, 2), 4, 2, 2), ValueError, "expected 2 x 2 patches"),
        (
            lambda: C.connected_components(torch.rand(3, 4, 4)),
            ValueError,
            "connected_components: expected image of shape",
        ),
        (
            lambda: C.connected_components(torch.rand(1, 4, 4), 1.5),
            TypeError,
            "connected_components: expected num_iterations",
        ),
        (lambda: C.distance_transform(torch.rand(3, 3)), ValueError, "distance_transform: expected image of shape"),
        (
            lambda: C.distance_transform(torch.rand(1, 1, 3, 3), 4),
            ValueError,
            "distance_transform: expected kernel_size to be odd",
        ),
        (lambda: C.distance_transform(torch.rand(1, 1, 3, 3), 3, 0.001), ValueError, "expected h to be larger"),
        (lambda: C.distance_transform(torch.rand(1, 1, 3, 3), 3, 5.0), ValueError, "expected h to be smaller"),
        (lambda: C.diamond_square((1, 1, 4)), ValueError, "diamond_square: expected output_size"),
        (lambda: C.diamond_square((2, 1, 4, 4), torch.rand(3)), ValueError, "diamond_square: expected roughness"),
        (
            lambda: C.histogram_matching(torch.rand(3), torch.rand(0)),
            ValueError,
            "histogram_matching: expected a template",
        ),
        (lambda: C.interp(torch.rand(3), torch.rand(3), torch.rand(2)), ValueError, "interp: expected xp and fp"),
        (lambda: C.KMeans(0, None), ValueError, "KMeans: expected num_clusters"),
        (lambda: C.KMeans(2, torch.rand(3, 2)), ValueError, "KMeans: expected cluster_centers"),
        (lambda: C.KMeans(2, None, tolerance=None), ValueError, "KMeans: expected a tolerance"),
        (lambda: C.KMeans(2, None).fit(torch.rand(1, 2)), ValueError, "KMeans: expected X of at least 2 points"),
        (lambda: C.Lambda(3), TypeError, "Lambda: expected func to be callable"),
    ],
)
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


class TestConnectedComponents(OpTests):
    function = staticmethod(C.connected_components)
    operators = ("connected_components",)
    variants = [{}]
    errors = [
        ({"num_iterations": 0}, ValueError, "expected num_iterations"),
        ({"num_iterations": 1.5}, TypeError, "expected num_iterations"),
    ]
    differentiable = False
    channels = 1
    shape = (2, 1, 13, 18)
    small = (1, 1, 4, 5)

    def input(self, shape, dtype, device):
        return (torch.rand(shape) < 0.5).to(dtype).to(device)

    def expected(self, x, kwargs):
        with K.backend("reference"):
            return self.call(x, kwargs)

    @pytest.mark.parametrize("layout", LAYOUTS)
    def test_layout(self, variant, layout, device):
        """Labels are planar whatever the masks are."""
        x, kwargs = self.setup(variant, device, torch.float32)
        x = x[:1].expand_as(x).contiguous() if layout == "expanded" else x
        assert_close(self.call(with_layout(x, layout), kwargs), self.call(x, kwargs))

    def test_threads_and_runs_give_the_same_bits(self, variant, device):
        masks = self.input((5, 1, 200, 301), torch.float32, device)
        torch.set_num_threads(2)
        try:
            assert_close(self.call(masks, {}), self.expected(masks, {}))
        finally:
            torch.set_num_threads(1)

    def test_vmap(self, variant, device, backend):
        self.needs_native(backend)  # the reference goes on until nothing changes
        super().test_vmap(variant, device)

    @pytest.mark.tracing
    def test_compile(self, device, backend):
        self.needs_native(backend)
        super().test_compile(device, backend)

    test_wrong_kinds = None  # test_errors below; any number of leading axes is right

    def test_nan_stays_in_its_window(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        x[0, 0, 6, 7] = torch.nan
        assert_close(self.call(x, kwargs), self.call(x.nan_to_num(0), kwargs))

    def test_empty(self, variant, device):
        assert self.call(torch.zeros(0, 1, 3, 4, device=device), {}).shape == (0, 1, 3, 4)


def test_histogram_matching_maps_over_batches_and_takes_empty_ones(device):
    source, template = torch.rand(2, 4, 3, 5, 6, device=device)
    result = torch.vmap(C.histogram_matching)(source, template)
    assert_close(result, torch.stack([C.histogram_matching(s, t) for s, t in zip(source, template)]))
    assert C.histogram_matching(source[:0], template[:0]).shape == (0, 3, 5, 6)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_kmeans_refuses_points_that_are_not_finite(value, device):
    points = torch.rand(20, 3, device=device)
    points[7, 1] = value
    with pytest.raises(ValueError, match="KMeans: expected X of finite points"):
        C.KMeans(2, None, seed=0).fit(points)
    C.KMeans(2, None, seed=0).fit(points[:7])
