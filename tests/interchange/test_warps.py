"""Directions of warps.

`warp_affine` and `warp_perspective` take the matrix from the pixels of the image to those of the result and invert it.
`homography_warp` and `remap` say where each pixel of the result reads.
"""

import numpy as np
import torch

import kvision as K
from interchange.rows import chw, noise, row, same

G = K.geometry
X = noise(24, 30)
TO_SOURCE = np.float64([[0.9, 0.15, 1.3], [-0.12, 0.95, 2.1], [1e-3, -2e-3, 1]])
AFFINE = TO_SOURCE[:2]
INSIDE = np.s_[3:-5, 3:-5]


def read(matrix, x=X, **options):
    """The result whose pixels p read the image at matrix p."""
    matrix = torch.from_numpy(np.vstack([matrix, [0, 0, 1]]) if len(matrix) == 2 else matrix).float()[None]
    return G.homography_warp(chw(x), matrix, X.shape, align_corners=True, normalized_homography=False, **options)[0, 0]


@row(
    "OpenCV",
    "`warpAffine`, `warpPerspective`: image to result; `WARP_INVERSE_MAP` result to image",
    "`warp_affine`, `warp_perspective`; `homography_warp(normalized_homography=False)`",
)
def test_opencv(cv2):
    inverse = torch.from_numpy(np.linalg.inv(TO_SOURCE)).float()[None]
    forward = cv2.warpPerspective(X, np.linalg.inv(TO_SOURCE), (30, 24))
    assert same(forward, G.warp_perspective(chw(X), inverse, (24, 30)), 1e-4)
    assert same(
        cv2.warpPerspective(X, TO_SOURCE, (30, 24), flags=cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR),
        read(TO_SOURCE),
        1e-4,
    )


@row(
    "OpenCV", "warps of float64 and of two channels round coordinates to 1/32 pixel; others do not", "exact coordinates"
)
def test_opencv_tables(cv2):
    flags = cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR
    exact = cv2.warpAffine(X, AFFINE, (30, 24), flags=flags)
    assert same(exact, read(AFFINE), 1e-5)
    assert 1e-3 < abs(cv2.warpAffine(X.astype(np.float64), AFFINE, (30, 24), flags=flags) - exact).max() < 0.05
    assert 1e-3 < abs(cv2.warpAffine(np.dstack([X, X]), AFFINE, (30, 24), flags=flags)[..., 0] - exact).max() < 0.05


@row("OpenCV", "`remap`: x and y of the pixels to read", "`remap(x, map_x, map_y, align_corners=True)`")
def test_opencv_remap(cv2):
    y, x = np.mgrid[:20, :25].astype(np.float32) * 0.9 + np.float32([0.3, 1.7]).reshape(2, 1, 1)
    ours = G.remap(chw(X), *(torch.from_numpy(m)[None] for m in (x, y)), align_corners=True)
    assert same(cv2.remap(X, x, y, cv2.INTER_LINEAR), ours)


@row(
    "Pillow",
    "`transform(AFFINE)`: result to image, of coordinates that begin at the edge",
    "`homography_warp`, after a shift of half a pixel on both sides",
)
def test_pillow(PIL):
    from PIL import Image

    to_edges, to_centers = (np.float64([[1, 0, s], [0, 1, s], [0, 0, 1]]) for s in (0.5, -0.5))
    edges = to_edges @ np.vstack([AFFINE, [0, 0, 1]]) @ to_centers
    theirs = np.asarray(Image.fromarray(X).transform((30, 24), Image.AFFINE, edges[:2].flatten(), Image.BILINEAR))
    assert same(theirs[INSIDE], read(AFFINE)[INSIDE], 1e-4)


@row("scikit-image", "`warp(x, matrix)`: result to image, in (x, y)", "`homography_warp(normalized_homography=False)`")
def test_skimage(skimage):
    assert same(skimage.transform.warp(X, TO_SOURCE)[INSIDE], read(TO_SOURCE)[INSIDE], 1e-4)


@row("SciPy", "`affine_transform`: result to image, in (row, column)", "`homography_warp`, rows and columns swapped")
def test_scipy(scipy):
    import scipy.ndimage

    swapped = np.vstack([AFFINE, [0, 0, 1]])[[1, 0, 2]][:, [1, 0, 2]]
    assert same(scipy.ndimage.affine_transform(X, swapped, order=1)[INSIDE], read(AFFINE)[INSIDE], 1e-4)


@row("SciPy", "`map_coordinates(x, (rows, columns), order=1)`", "`remap(x, columns, rows, align_corners=True)`")
def test_scipy_map(scipy):
    import scipy.ndimage

    y, x = np.mgrid[:20, :25].astype(np.float32) * 0.9 + 0.3
    ours = G.remap(chw(X), *(torch.from_numpy(m)[None] for m in (x, y)), align_corners=True)
    assert same(scipy.ndimage.map_coordinates(X, (y, x), order=1), ours)


@row(
    "jax",
    "`scipy.ndimage.map_coordinates(x, (rows, columns), order=1)`",
    "`remap(x, columns, rows, align_corners=True)`",
)
def test_jax(jax):
    import jax.scipy.ndimage

    y, x = np.mgrid[:20, :25].astype(np.float32) * 0.9 + 0.3
    ours = G.remap(chw(X), *(torch.from_numpy(m)[None] for m in (x, y)), align_corners=True)
    assert same(jax.scipy.ndimage.map_coordinates(X, (y, x), order=1), ours)


@row(
    "torch",
    "`affine_grid`, `grid_sample`: result to image, in coordinates from -1 to 1, by edges unless `align_corners=True`",
    "`remap(normalized_coordinates=True)`; `normalize_homography` converts matrices",
)
def test_torch(torch):
    F = torch.nn.functional
    matrix = torch.tensor([[[0.9, 0.1, 0.05], [-0.1, 0.95, 0.02]]])
    for align in (False, True):
        grid = F.affine_grid(matrix, (1, 1, 24, 30), align_corners=align)
        ours = G.remap(chw(X), *grid.unbind(-1), align_corners=align, normalized_coordinates=True)
        assert same(F.grid_sample(chw(X), grid, align_corners=align), ours)


@row(
    "DALI",
    "`warp_affine`: result to image, of coordinates that begin at the edge",
    "`homography_warp`, after a shift of half a pixel on both sides",
)
def test_dali(dali):
    from interchange.pipelines import run

    to_edges, to_centers = (np.float64([[1, 0, s], [0, 1, s], [0, 0, 1]]) for s in (0.5, -0.5))
    edges = (to_edges @ np.vstack([AFFINE, [0, 0, 1]]) @ to_centers)[:2].astype(np.float32)
    theirs = run(lambda fn, x: fn.warp_affine(x, matrix=edges.flatten().tolist(), fill_value=0), X[..., None])[..., 0]
    assert same(theirs[INSIDE], read(AFFINE)[INSIDE], 1e-3)


@row(
    "Kornia",
    "`homography_warp(normalized_homography=False)` inverts the matrix, with True it does not",
    "result to image with both",
)
def test_kornia(kornia):
    options = {"align_corners": True, "normalized_homography": False}
    inverse = torch.from_numpy(np.linalg.inv(TO_SOURCE)).float()[None]
    assert same(
        kornia.geometry.homography_warp(chw(X), inverse, (24, 30), **options)[0, 0][INSIDE],
        read(TO_SOURCE)[INSIDE],
        1e-3,
    )
