"""Pixel centers and resizing.

kvision keeps the edges of images in place, where coordinates are those of pixel centers: pixel i of n reads at
(i + 1/2) m / n - 1/2. It does not antialias unless asked to.
"""

import numpy as np

import kvision as K
from interchange.rows import chw, hwc, noise, row, same

resize = K.geometry.resize
X = noise(24, 20)
SMALL, LARGE = (9, 7), (31, 33)


def ours(size, *args, x=X, **options):
    return resize(chw(x), size, *args, **options)


@row("OpenCV", "`INTER_LINEAR`: edges in place, no antialiasing", "`resize(x, size)`")
def test_opencv_linear(cv2):
    assert all(same(cv2.resize(X, s[::-1]), ours(s)) for s in (SMALL, LARGE))


@row("OpenCV", "`INTER_CUBIC`: coefficient -0.75, no antialiasing", '`resize(x, size, "bicubic")`')
def test_opencv_cubic(cv2):
    assert all(same(cv2.resize(X, s[::-1], interpolation=cv2.INTER_CUBIC), ours(s, "bicubic")) for s in (SMALL, LARGE))


@row("OpenCV", "`INTER_NEAREST`: pixel floor(i m / n), not the nearest center", '`resize(x, size, "nearest")`')
def test_opencv_nearest(cv2):
    assert all(
        same(cv2.resize(X, s[::-1], interpolation=cv2.INTER_NEAREST), ours(s, "nearest")) for s in (SMALL, LARGE)
    )


@row(
    "OpenCV",
    "`INTER_NEAREST_EXACT`: nearest center in 16 bits of fraction; 20 of 224 columns of 640 -> 224 are a pixel off",
    '`resize(x, size, "nearest-exact")`, in whole numbers',
)
def test_opencv_nearest_exact(cv2):
    line = np.arange(640, dtype=np.float32)[None]
    theirs = cv2.resize(line, (224, 1), interpolation=cv2.INTER_NEAREST_EXACT)
    exact = (2 * np.arange(224) + 1) * 640 // 448
    assert same(ours((1, 224), "nearest-exact", x=line), exact, 0) and (theirs != exact).sum() == 20


@row("OpenCV", "`INTER_AREA` by a whole factor: the mean of its pixels", '`resize(x, size, "area")`')
def test_opencv_area(cv2):
    assert same(cv2.resize(X, (10, 8), interpolation=cv2.INTER_AREA), ours((8, 10), "area"))


@row(
    "OpenCV",
    "`INTER_AREA` by other factors: pixels count by the part that is covered",
    '"area" takes whole pixels, as torch; `"bilinear", antialias=True` is closer',
)
def test_opencv_area_of_fractions(cv2):
    assert same(cv2.resize(np.float32([[0, 3, 9]]), (2, 1), interpolation=cv2.INTER_AREA), [1, 7])
    assert same(ours((1, 2), "area", x=np.float32([[0, 3, 9]])), [1.5, 6])


@row("OpenCV", "`INTER_LANCZOS4`: 8 taps, no antialiasing", 'none; "lanczos" has Pillow\'s 6 taps')
def test_opencv_lanczos(cv2):
    step = np.repeat(np.float32([[0, 1]]), 20, 1)
    reach = [
        (abs(y - np.rint(y)) > 1e-4).sum()
        for y in (cv2.resize(step, (120, 1), interpolation=cv2.INTER_LANCZOS4), hwc(ours((1, 120), "lanczos", x=step)))
    ]
    assert reach == [24, 18] or reach[0] > reach[1]


@row("Pillow", "`BILINEAR` antialiases where it shrinks, and only there", "`resize(x, size, antialias=True)`")
def test_pillow_bilinear(PIL):
    from PIL import Image

    assert all(
        same(Image.fromarray(X).resize(s[::-1], Image.BILINEAR), ours(s, antialias=True)) for s in (SMALL, LARGE)
    )
    assert same(ours(LARGE, antialias=True), ours(LARGE), 1e-6)


@row("Pillow", "`BICUBIC`: coefficient -0.5, antialiased", '`resize(x, size, "bicubic", antialias=True)`')
def test_pillow_bicubic(PIL):
    from PIL import Image

    assert all(
        same(Image.fromarray(X).resize(s[::-1], Image.BICUBIC), ours(s, "bicubic", antialias=True))
        for s in (SMALL, LARGE)
    )


@row("Pillow", "`LANCZOS`: 3 pixels to either side, antialiased", '`resize(x, size, "lanczos", antialias=True)`')
def test_pillow_lanczos(PIL):
    from PIL import Image

    assert all(
        same(Image.fromarray(X).resize(s[::-1], Image.LANCZOS), ours(s, "lanczos", antialias=True))
        for s in (SMALL, LARGE)
    )


@row("Pillow", "`NEAREST`: the nearest center", '`resize(x, size, "nearest-exact")`')
def test_pillow_nearest(PIL):
    from PIL import Image

    for size in ((16, 16), (32, 32)):  # without centers that are equally far from two pixels
        assert same(Image.fromarray(X).resize(size, Image.NEAREST), ours(size, "nearest-exact"))


@row("Pillow", "`BOX` by a whole factor, and `reduce`: the mean of its pixels", '`resize(x, size, "area")`')
def test_pillow_box(PIL):
    from PIL import Image

    image = Image.fromarray(X)
    assert same(image.resize((10, 8), Image.BOX), ours((8, 10), "area")) and same(image.reduce(4), ours((6, 5), "area"))


@row("Pillow", "bytes are rounded after each axis", "rounded once: bilinear results are at most a level apart")
def test_pillow_bytes(PIL):
    from PIL import Image

    x = noise(24, 20, dtype=np.uint8)
    theirs = np.asarray(Image.fromarray(x).resize((7, 9), Image.BILINEAR)).astype(int)
    assert 0 < abs(theirs - hwc(ours(SMALL, x=x, antialias=True))[..., 0]).max() <= 1


@row("torch", '`interpolate(mode="bilinear")`: `align_corners=False`, no antialiasing', "`resize(x, size)`")
def test_torch_bilinear(torch):
    assert all(same(torch.nn.functional.interpolate(chw(X), s, mode="bilinear"), ours(s)) for s in (SMALL, LARGE))


@row("torch", "`align_corners=True` keeps the centers of the corner pixels", "`resize(x, size, align_corners=True)`")
def test_torch_align_corners(torch):
    theirs = torch.nn.functional.interpolate(chw(X), SMALL, mode="bilinear", align_corners=True)
    assert same(theirs, ours(SMALL, align_corners=True))


@row("torch", '"bicubic": coefficient -0.75, with `antialias=True` -0.5, also where it enlarges', "the same")
def test_torch_bicubic(torch):
    for antialias in (False, True):
        for size in (SMALL, LARGE):
            theirs = torch.nn.functional.interpolate(chw(X), size, mode="bicubic", antialias=antialias)
            assert same(theirs, ours(size, "bicubic", antialias=antialias))
    assert not same(ours(LARGE, "bicubic"), ours(LARGE, "bicubic", antialias=True), 1e-3)


@row(
    "torch",
    '"nearest" is floor(i m / n) in float32, "nearest-exact" the nearest center',
    "the same names, in whole numbers",
)
def test_torch_nearest(torch):
    for mode in ("nearest", "nearest-exact"):
        assert all(same(torch.nn.functional.interpolate(chw(X), s, mode=mode), ours(s, mode)) for s in (SMALL, LARGE))


@row("torchvision", "`resize` antialiases by default", "`resize(x, size, antialias=True)`")
def test_torchvision(torchvision):
    from torchvision.transforms.v2 import functional as F

    assert same(F.resize(chw(X), list(SMALL)), ours(SMALL, antialias=True))


@row(
    "scikit-image",
    "`resize` blurs first where it shrinks, with sigma (factor - 1) / 2",
    '`resize(x, size, antialias="gaussian")`, inside of the border',
)
def test_skimage(skimage):
    theirs, mine = skimage.transform.resize(X, (12, 10)), ours((12, 10), antialias="gaussian")
    assert same(theirs[2:-2, 2:-2], mine[..., 2:-2, 2:-2], 0.02) and not same(theirs, ours((12, 10)), 0.03)


@row("SciPy", "`zoom(order=1)` keeps the centers of the corner pixels", "`resize(x, size, align_corners=True)`")
def test_scipy_zoom(scipy):
    import scipy.ndimage

    theirs = scipy.ndimage.zoom(X, (9 / 24, 7 / 20), order=1)
    assert same(theirs, ours(SMALL, align_corners=True))


@row("SciPy", '`zoom(order=1, grid_mode=True, mode="nearest")` keeps the edges', "`resize(x, size)`")
def test_scipy_zoom_of_grids(scipy):
    import scipy.ndimage

    assert same(scipy.ndimage.zoom(X, (31 / 24, 33 / 20), order=1, grid_mode=True, mode="nearest"), ours(LARGE))


@row(
    "jax",
    '`image.resize` antialiases by default; "linear" leaves out taps outside',
    "`resize(x, size, antialias=True)`",
)
def test_jax_linear(jax):
    assert all(same(jax.image.resize(X, s, "linear"), ours(s, antialias=True)) for s in (SMALL, LARGE))


@row("jax", '"cubic": coefficient -0.5, antialiased or not', '`resize(x, size, "bicubic", antialias=True)`')
def test_jax_cubic(jax):
    assert all(same(jax.image.resize(X, s, "cubic"), ours(s, "bicubic", antialias=True)) for s in (SMALL, LARGE))


@row("jax", '"nearest": the nearest center', '`resize(x, size, "nearest-exact")`')
def test_jax_nearest(jax):
    assert all(same(jax.image.resize(X, s, "nearest"), ours(s, "nearest-exact")) for s in (SMALL, LARGE))


@row(
    "pyvips",
    "`resize` shrinks with Lanczos of 3 pixels, antialiased",
    '`resize(x, size, "lanczos", antialias=True)`, to .01',
)
def test_pyvips(pyvips):
    image = pyvips.Image.new_from_array(X)
    theirs = image.resize(0.5).numpy()
    assert theirs.shape == (12, 10) and same(
        theirs[2:-2, 2:-2], ours((12, 10), "lanczos", antialias=True)[..., 2:-2, 2:-2], 0.01
    )


@row(
    "AlbumentationsX",
    '`Resize`: OpenCV\'s `INTER_LINEAR`; `area_for_downscale="image"` asks for `INTER_AREA`',
    '`resize(x, size)`; "area"',
)
def test_albumentations(A):
    image = np.repeat(X[..., None], 3, 2)
    assert same(A.Resize(9, 7)(image=image)["image"], hwc(ours(SMALL, x=image)))
    assert same(A.Resize(8, 10, area_for_downscale="image")(image=image)["image"], hwc(ours((8, 10), "area", x=image)))


@row(
    "DALI", "`fn.resize` antialiases by default where it shrinks", "`resize(x, size, antialias=True)`, to .05 of noise"
)
def test_dali(dali):
    from interchange.pipelines import run

    theirs = run(lambda fn, x: fn.resize(x, size=SMALL), X[..., None])
    assert same(theirs, ours(SMALL, antialias=True), 0.05) and not same(theirs, ours(SMALL), 0.1)


@row("DALI", "`INTERP_NN`: the nearest center", '`resize(x, size, "nearest-exact")`')
def test_dali_nearest(dali):
    from interchange.pipelines import run

    for size in (SMALL, LARGE):
        theirs = run(lambda fn, x, size=size: fn.resize(x, size=size, interp_type=dali.types.INTERP_NN), X[..., None])
        assert same(theirs, ours(size, "nearest-exact"))


@row("Kornia", "`resize(antialias=True)` blurs with a Gaussian first", '`resize(x, size, antialias="gaussian")`')
def test_kornia(kornia):
    theirs = kornia.geometry.resize(chw(X), SMALL, antialias=True)
    assert same(theirs, ours(SMALL, antialias="gaussian"), 1e-4) and not same(theirs, ours(SMALL, antialias=True), 0.01)
