"""Images of one camera as another one sees them: independent rays, OpenCV's maps, round trips and panoramas."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.sensors import camera as C
from op_tests import assert_close

G = K.geometry
SIZE = K.image.ImageSize(40, 48)
LENSES: dict[str, tuple[Any, list[float]]] = {
    "pinhole": (C.PinholeModel, [30.0, 31, 23, 20]),
    "brown_conrady": (C.BrownConradyModel, [30.0, 31, 23, 20, -0.1, 0.02, 1e-3, -2e-3, 1e-3, 0.01, 0, 0]),
    "thin_prism": (C.BrownConradyModel, [30.0, 31, 23, 20, -0.1, 0.02, 1e-3, -2e-3, 0, 0, 0, 0, 0.01, 0, 0.02, 0]),
    "kannala_brandt": (C.KannalaBrandtK3, [17.0, 18, 23, 20, 0.05, -0.01, 1e-3, 0]),
    "equirectangular": (C.EquirectangularModel, [15.0, 16, 23, 20]),
    "double_sphere": (C.DoubleSphereModel, [18.0, 19, 23, 20, -0.2, 0.6]),
    "unified": (C.EnhancedUnifiedModel, [18.0, 19, 23, 20, 0.62, 1.1]),
}


def camera(kind: str, **options: Any) -> Any:
    make, params = LENSES[kind]
    return make(SIZE, torch.tensor(params, **{"dtype": torch.float64, **options}))


def rotation(*axis: float) -> Tensor:
    return G.axis_angle_to_rotation_matrix(torch.tensor([axis], dtype=torch.float64))[0]


def pixels_of(h: int, w: int) -> Tensor:
    """The centers (h * w, 2) of pixels."""
    return G.create_meshgrid(h, w, normalized_coordinates=False, dtype=torch.float64).reshape(-1, 2)


def smooth(h: int, w: int) -> Tensor:
    """A smooth picture (1, 2, h, w)."""
    x, y = pixels_of(h, w).mT.unflatten(-1, (h, w))
    return torch.stack([(x / 9).sin() + y / 30, (y / 8).cos() - x / 40])[None]


def seen(kind: str, p: list[float], ray: Any) -> tuple[float, float] | None:
    """The pixel of one ray by the formulas of the papers, in numbers of Python."""
    x, y, z = (float(v) for v in ray)
    fx, fy, cx, cy, *k = p
    length, r = math.hypot(x, y, z), math.hypot(x, y)
    if kind in ("pinhole", "brown_conrady", "thin_prism"):
        if z <= 0:
            return None
        u, v = x / z, y / z
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = (k + [0.0] * 12)[:12]
        q = u * u + v * v
        radial = (1 + k1 * q + k2 * q**2 + k3 * q**3) / (1 + k4 * q + k5 * q**2 + k6 * q**3)
        u, v = (
            u * radial + 2 * p1 * u * v + p2 * (q + 2 * u * u) + s1 * q + s2 * q * q,
            v * radial + p1 * (q + 2 * v * v) + 2 * p2 * u * v + s3 * q + s4 * q * q,
        )
    elif kind == "kannala_brandt":
        t = math.atan2(r, z)
        d = t * (1 + k[0] * t**2 + k[1] * t**4 + k[2] * t**6 + k[3] * t**8)
        u, v = (d * x / r, d * y / r) if r else (0.0, 0.0)
    elif kind == "equirectangular":
        u, v = math.atan2(x, z), math.asin(y / length)
    elif kind == "double_sphere":
        xi, a = k
        d2 = math.hypot(x, y, xi * length + z)
        w1 = a / (1 - a) if a <= 0.5 else (1 - a) / a
        if z <= -(w1 + xi) / math.sqrt(2 * w1 * xi + xi * xi + 1) * length:
            return None
        depth = a * d2 + (1 - a) * (xi * length + z)
        u, v = x / depth, y / depth
    else:
        a, b = k
        d = math.sqrt(b * r * r + z * z)
        if z <= -(a / (1 - a) if a <= 0.5 else (1 - a) / a) * d:
            return None
        u, v = x / (a * d + (1 - a) * z), y / (a * d + (1 - a) * z)
    return fx * u + cx, fy * v + cy


@pytest.mark.parametrize("kind", LENSES)
def test_pixels_of_rays_and_back(kind: str, device: torch.device) -> None:
    model, params = camera(kind, device=device), LENSES[kind][1]
    random = torch.Generator().manual_seed(0)
    rays = torch.nn.functional.normalize(torch.randn(300, 3, generator=random, dtype=torch.float64), dim=-1)
    pixels = model.project_rays(3 * rays.to(device)).cpu()
    for ray, pixel in zip(rays, pixels):
        expected = seen(kind, params, ray)
        if expected is None:
            assert pixel.isnan().all()
        elif not (kind in ("brown_conrady", "thin_prism") and pixel.isnan().all()):  # beyond the domain of the lens
            # A panorama of part of a turn takes the column nearest to its middle.
            turn = math.tau * params[0] if kind == "equirectangular" else 0.0
            nearest = min((expected[0] + i * turn for i in (0, -1, 1)), key=lambda x: abs(x - 23.5))
            assert pixel.tolist() == pytest.approx((nearest, expected[1]), 1e-9, 1e-9)
    grid = pixels_of(40, 48).to(device)
    back = model.unproject_rays(grid)
    has_ray = back.isfinite().all(-1)
    assert has_ray.double().mean() > 0.9
    assert_close(back[has_ray].norm(dim=-1), torch.ones_like(back[has_ray][:, 0]), 1e-12, 1e-12)
    tolerance = 1e-4 if kind in ("brown_conrady", "thin_prism") else 1e-9
    assert_close(model.project_rays(back[has_ray]), grid[has_ray], tolerance, tolerance)


@pytest.mark.parametrize("kind", LENSES)
def test_equals_independent_rays(kind: str, device: torch.device) -> None:
    """From every lens, of an image whose values are its coordinates: exactly where the ray goes, or nothing."""
    R, image = rotation(0.1, -0.2, 0.3), pixels_of(40, 48).mT.unflatten(-1, (40, 48))[None]
    for other in ("kannala_brandt", "equirectangular"):
        cameras = (camera(name, device=device) for name in (kind, other))
        result, valid = (x.cpu() for x in G.reproject_image(image.to(device), *cameras, R, return_valid=True))
        rays, count = camera(other).unproject_rays(pixels_of(40, 48)) @ R, 0
        for i in range(0, 1920, 3):
            is_valid, value = bool(valid.flatten()[i]), result.flatten(2)[0, :, i].tolist()
            place = None if rays[i].isnan().any() else seen(kind, LENSES[kind][1], rays[i])
            if place is None or not (-0.5 <= place[0] <= 47.5 and -0.5 <= place[1] <= 39.5):
                assert not is_valid or kind == "equirectangular"
                assert place is not None or value == [0, 0]
            elif not is_valid:
                assert kind in ("brown_conrady", "thin_prism")  # beyond the radius to which the distortion grows
                assert value == [0, 0]
            elif 0 <= place[0] <= 47 and 0 <= place[1] <= 39:
                count += 1
                assert value == pytest.approx(place, 1e-9, 1e-9)
        assert count > 100


def test_equals_opencv() -> None:
    """Undistorted and rectified images by cv2.remap with the maps of cv2.initUndistortRectifyMap and cv2.fisheye."""
    cv2 = pytest.importorskip("cv2")
    image = smooth(40, 48).float()
    R, view = rotation(0.05, 0.1, -0.02), C.PinholeModel(K.image.ImageSize(30, 36), torch.tensor([25.0, 25, 18, 14]))
    matrix = view.matrix().double().numpy()
    for kind in ("brown_conrady", "kannala_brandt"):
        model = camera(kind, dtype=torch.float32)
        lens = model.matrix().double().numpy(), model.params[4:].double().numpy()
        maps = cv2.fisheye.initUndistortRectifyMap if kind == "kannala_brandt" else cv2.initUndistortRectifyMap
        x, y = maps(*lens, R.numpy(), matrix, (36, 30), cv2.CV_32FC1)
        planes = [cv2.remap(plane.numpy(), x, y, cv2.INTER_LINEAR) for plane in image[0]]
        ours, valid = G.reproject_image(image, model, view, R, return_valid=True)
        # OpenCV rounds coordinates to 1/32 of a pixel.
        assert_close(ours[0, :, valid[0]], torch.from_numpy(np.stack(planes))[:, valid[0]], 1e-2, 1e-2)
        assert valid.double().mean() > 0.8


def test_round_trip_and_antialias(device: torch.device) -> None:
    """A picture through a fisheye lens and back; a shrunk image is the mean of what it covers."""
    h, w = 120, 160
    image = smooth(h, w).to(device)
    view = C.PinholeModel(K.image.ImageSize(h, w), torch.tensor([110.0, 110, 79.5, 59.5], device=device))
    fisheye = C.KannalaBrandtK3(
        K.image.ImageSize(h, w), torch.tensor([110.0, 110, 79.5, 59.5, 0, 0, 0, 0], device=device)
    )
    R = rotation(0.1, 0.0, 0.2).to(device)
    there = G.reproject_image(image, view, fisheye, R, "bicubic")
    back, valid = G.reproject_image(there, fisheye, view, R.mT, "bicubic", return_valid=True)
    inside = torch.zeros_like(valid)
    inside[:, 45:75, 60:100] = True
    assert (valid & inside).sum() == inside.sum()
    assert (back - image)[:, :, inside[0]].abs().max() < 4e-3

    small = C.PinholeModel(
        K.image.ImageSize(h // 8, w // 8), torch.tensor([110 / 8, 110 / 8, 9.4375, 6.9375], device=device)
    )
    noise = torch.rand(1, 1, h, w, device=device)
    coarse, smoothed = (G.reproject_image(noise, view, small, antialias=a)[0, 0, 2:-2, 2:-2] for a in (False, True))
    assert smoothed.std() < 0.3 * coarse.std()
    assert abs(smoothed.mean() - 0.5) < 0.02


def test_panoramas_have_no_seam(device: torch.device) -> None:
    """Cube maps of a whole sphere, and the sphere of each of them; across the seam and the poles, antialiased too."""
    h, w = 64, 128
    panorama = C.EquirectangularModel(K.image.ImageSize(h, w))

    def scene(rays: Tensor) -> Tensor:
        return rays[..., 0] + 0.5 * rays[..., 1] - 0.7 * rays[..., 2]

    def rays_of(model: Any, h: int, w: int) -> Tensor:
        return model.unproject_rays(
            G.create_meshgrid(h, w, normalized_coordinates=False, dtype=torch.float64, device=device)[0]
        )

    image = scene(rays_of(panorama, h, w))[None, None]
    face = C.PinholeModel(K.image.ImageSize(17, 17), torch.tensor([8.5, 8.5, 8, 8], device=device))
    turns = [
        (0, 0, 0),
        (0, math.pi / 2, 0),
        (0, math.pi, 0),
        (0, -math.pi / 2, 0),
        (math.pi / 2, 0, 0),
        (-math.pi / 2, 0, 0),
    ]
    R = torch.stack([rotation(*turn) for turn in turns]).to(device)
    expected = scene(rays_of(face, 17, 17) @ R[:, None])
    for antialias, tolerance in ((False, 5e-3), (True, 5e-2)):
        faces, valid = G.reproject_image(image, panorama, face, R, antialias=antialias, return_valid=True)
        assert valid.all()
        assert (faces[:, 0] - expected).abs().max() < tolerance
    back = G.reproject_image(faces, face, panorama, R.mT)
    assert_close((back != 0).sum(0).clamp(max=1), torch.ones_like(image[0], dtype=torch.int64))
    shifted = C.EquirectangularModel(SIZE, torch.tensor([20.0, 20, 83, 20], dtype=torch.float64))  # looks backwards
    assert shifted.project_rays(torch.tensor([-0.01, 0, -1.0])).allclose(
        torch.tensor([83 - math.pi * 20 + 0.2, 20.0]), atol=1e-3
    )


@pytest.mark.derivatives
@pytest.mark.parametrize("kind", LENSES)
def test_gradients(kind: str) -> None:
    """To the image, the parameters of both cameras and the rotation; pixels without a ray give none."""
    make, params = LENSES[kind]
    random = torch.Generator().manual_seed(1)
    image = torch.rand(1, 1, 40, 48, generator=random, dtype=torch.float64).requires_grad_()
    to = torch.tensor([5.0, 5, 2.2, 1.8, 0.02, 0, 0, 0], dtype=torch.float64, requires_grad=True)
    of, R = torch.tensor(params, dtype=torch.float64, requires_grad=True), rotation(0.1, 0.2, 0.1).requires_grad_()

    def reprojected(of: Tensor, to: Tensor, R: Tensor) -> Tensor:
        target = C.KannalaBrandtK3(K.image.ImageSize(4, 5), to)
        return G.reproject_image(smooth(40, 48), make(SIZE, of), target, R, "bicubic")

    tolerance = dict(eps=1e-6, atol=2e-3, rtol=1e-3, fast_mode=True)
    assert torch.autograd.gradcheck(reprojected, (of, to, R), **tolerance)
    wide = C.KannalaBrandtK3(K.image.ImageSize(9, 9), torch.tensor([1.0, 1, 4, 4, 0.02, 0, 0, 0], requires_grad=True))
    result = G.reproject_image(image, make(SIZE, of), wide, R, antialias=True)
    for grad in torch.autograd.grad(result.sum(), (image, of, wide.params, R)):
        assert grad.isfinite().all() and grad.abs().sum() > 0


def test_types_batches_and_errors() -> None:
    image, fisheye, view = smooth(40, 48).float(), camera("kannala_brandt"), camera("pinhole")
    params = torch.stack([view.params, 1.2 * view.params])
    both = G.reproject_image(image, fisheye, C.PinholeModel(SIZE, params))
    assert_close(both[1:], G.reproject_image(image, fisheye, C.PinholeModel(SIZE, params[1])), 1e-5, 1e-5)
    sources = C.KannalaBrandtK3(SIZE, torch.stack([fisheye.params, 1.1 * fisheye.params]))
    pair = G.reproject_image(image.expand(2, -1, -1, -1), sources, view)
    assert_close(pair[:1], G.reproject_image(image, fisheye, view), 1e-5, 1e-5)
    assert not pair[0].allclose(pair[1])
    byte = G.reproject_image((255 * image.clamp(0, 1)).byte(), fisheye, view)
    assert byte.dtype == torch.uint8
    assert G.reproject_image(image.half(), fisheye, view).dtype == torch.float16
    assert G.reproject_image(image[:0], fisheye, view).shape == (0, 2, 40, 48)
    # Rays behind a pinhole are 0 whatever the padding, and no mirror image.
    turned = G.reproject_image(
        image + 5, view, camera("equirectangular"), rotation(0, math.pi, 0), padding_mode="border"
    )
    assert (turned[..., 20, 20:26] == 0).all()
    with pytest.raises(ValueError, match=r"reproject_image: expected image of the size of camera_from, \(40, 48\)"):
        G.reproject_image(image[..., 1:], fisheye, view)
    with pytest.raises(ValueError, match="expected a camera whose rays meet in its center, got parallel ones"):
        G.reproject_image(image, C.Orthographic(SIZE, view.params), view)
    with pytest.raises(TypeError, match="reproject_image: expected camera_to to be a camera of kvision.sensors.camera"):
        G.reproject_image(image, view, torch.eye(3))
