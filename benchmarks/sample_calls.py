"""A sample call of every public function that computes on tensors, for sweeps over all names.

Arguments are chosen by the name of the parameter, and for a function alone where `OVERRIDES` says so. The tests read this
table, too: they count the public functions without a sample.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, NamedTuple

import torch
from torch import Tensor

import kvision as K

MODULES = [
    name
    for name in K.__all__
    if isinstance(getattr(K, name), ModuleType) and name not in ("augmentation", "constants", "feature", "info", "io")
]


class Size(NamedTuple):
    """Batch, channels, height and width of the images of a call. Lists of points have as many as an image has columns."""

    b: int
    c: int
    h: int
    w: int


@dataclass(frozen=True)
class Made:
    """An argument made at the time of the call, from the library and the tensors of the call by name."""

    make: Callable[[Any, Mapping[str, Tensor]], Any]


@dataclass(frozen=True)
class SampleCall:
    """A function's tensors for a size, and its other arguments. `call(library, tensors)` calls Kornia's function as well.

    A tensor whose name starts with an underscore is no argument: the sizes of others are taken from it.
    """

    name: str
    makers: Mapping[str, Callable[[Size], Tensor]]
    others: Mapping[str, Any]

    def tensors(self, size: Size, device: torch.device | str = "cpu") -> dict[str, Tensor]:
        torch.manual_seed(0)
        return {name: make(size).to(device) for name, make in self.makers.items()}

    def function(self, library: ModuleType | Any = K) -> Any:
        """The library's function, None where it has none of that name."""
        module, name = self.name.split(".")
        return getattr(getattr(library, module, None), name, None)

    def call(self, library: ModuleType | Any, tensors: Mapping[str, Tensor]) -> Any:
        others = {k: v.make(library, tensors) if isinstance(v, Made) else v for k, v in self.others.items()}
        arguments = {k: v for k, v in tensors.items() if k[0] != "_"}
        return self.function(library)(**arguments, **others)


def public_functions() -> Iterator[str]:
    """`module.name` of every public function, once each."""
    seen = set()
    for module in MODULES:
        for name, value in vars(getattr(K, module)).items():
            if name[0] != "_" and inspect.isfunction(value) and value.__module__.startswith("kvision"):
                if value not in seen:
                    seen.add(value)
                    yield f"{module}.{name}"


def sample_calls() -> Iterator[SampleCall]:
    """Those of all public functions but the ones of WITHOUT_SAMPLE."""
    for name in public_functions():
        call = None if name in WITHOUT_SAMPLE else sample_call(name)
        if call is not None:
            yield call


def sample_call(name: str) -> SampleCall | None:
    """The call of one function, None where this table lacks one of its parameters."""
    module, short = name.split(".")
    overrides = OVERRIDES.get(short, {})
    arguments = dict(overrides)
    for parameter in inspect.signature(getattr(getattr(K, module), short)).parameters.values():
        if parameter.name not in arguments and parameter.default is parameter.empty:
            if parameter.name not in ARGUMENTS:
                return None
            arguments[parameter.name] = ARGUMENTS[parameter.name]
    makers = {k: v for k, v in arguments.items() if inspect.isfunction(v)}
    return SampleCall(name, makers, {k: v for k, v in arguments.items() if k not in makers})


# --- tensors --------------------------------------------------------------------------------------------------------


def image(s: Size) -> Tensor:
    return torch.rand(s)


def gray(s: Size) -> Tensor:
    return torch.rand(s.b, 1, s.h, s.w)


def channels(count: int) -> Callable[[Size], Tensor]:
    return lambda s: torch.rand(s.b, count, s.h, s.w)


def even(s: Size) -> Size:
    return Size(s.b, s.c, s.h // 2 * 2, s.w // 2 * 2)


def volume(s: Size) -> Tensor:
    return torch.rand(s.b, s.c, 9, s.h // 2, s.w // 2)


def labels(s: Size) -> Tensor:
    return torch.randint(0, s.c, (s.b, s.h, s.w))


def binary(s: Size) -> Tensor:
    return torch.randint(0, 2, s)


def distribution(s: Size) -> Tensor:
    return torch.rand(s).flatten(2).softmax(2).view(s)


def depth(s: Size) -> Tensor:
    return 1 + torch.rand(s.b, 1, s.h, s.w)


def camera(s: Size) -> Tensor:
    matrix = [[s.w, 0.0, s.w / 2], [0.0, s.w, s.h / 2], [0.0, 0.0, 1.0]]
    return torch.tensor(matrix).repeat(s.b, 1, 1)


def batch_of(*sizes: int, scale: float = 1.0, shift: float = 0.0) -> Callable[[Size], Tensor]:
    """Uniform numbers in shift + [0, scale), `sizes` for each sample."""
    return lambda s: shift + scale * torch.rand(s.b, *sizes)


def points(dimensions: int, scale: float = 1.0, shift: float = 0.0) -> Callable[[Size], Tensor]:
    """As many points as an image has columns, in shift + [0, scale)."""
    return lambda s: shift + scale * torch.rand(s.b, s.w, dimensions)


def many(*sizes: int) -> Callable[[Size], Tensor]:
    """Rows without a batch axis, one for each pixel."""
    return lambda s: torch.rand(s.h * s.w, *sizes) - 0.5


def rotations(s: Size) -> Tensor:
    return K.geometry.angle_axis_to_rotation_matrix(torch.rand(s.b, 3))


def many_rotations(s: Size) -> Tensor:
    return K.geometry.angle_axis_to_rotation_matrix(torch.rand(s.h * s.w, 3))


def poses(s: Size) -> Tensor:
    return K.geometry.Rt_to_matrix4x4(rotations(s), torch.rand(s.b, 3, 1))


def many_poses(s: Size) -> Tensor:
    return K.geometry.Rt_to_matrix4x4(many_rotations(s), torch.rand(s.h * s.w, 3, 1))


def homographies(s: Size) -> Tensor:
    return torch.eye(3) + 0.02 * torch.rand(s.b, 3, 3)


def homographies3d(s: Size) -> Tensor:
    return torch.eye(4) + 0.02 * torch.rand(s.b, 4, 4)


def affine2d(s: Size) -> Tensor:
    return homographies(s)[:, :2]


def affine3d(s: Size) -> Tensor:
    return homographies3d(s)[:, :3]


def projections(s: Size) -> Tensor:
    return camera(s) @ torch.cat([rotations(s), torch.rand(s.b, 3, 1)], 2)


def essentials(s: Size) -> Tensor:
    return K.geometry.cross_product_matrix(torch.rand(s.b, 3)) @ rotations(s)


def boxes(s: Size) -> Tensor:
    """Corners of a box inside of each image."""
    left, top, right, bottom = 1.0, 1.0, s.w * 0.7 // 1, s.h * 0.6 // 1
    return torch.tensor([[left, top], [right, top], [right, bottom], [left, bottom]]).repeat(s.b, 1, 1)


def boxes3d(s: Size) -> Tensor:
    x, y = (s.w // 4) * 1.0, (s.h // 4) * 1.0
    face = torch.tensor([[0.0, 0, 0], [x, 0, 0], [x, y, 0], [0, y, 0]])
    return torch.cat([face, face + torch.tensor([0.0, 0, 3])]).repeat(s.b, 1, 1)


def boxes_xyxy(s: Size) -> Tensor:
    corner = torch.rand(s.w, 2)
    return torch.cat([corner, corner + 0.1 + torch.rand(s.w, 2)], 1)


def grid(s: Size) -> Tensor:
    return K.geometry.create_meshgrid(s.h, s.w).repeat(s.b, 1, 1, 1)


def grid3d(s: Size) -> Tensor:
    return K.geometry.create_meshgrid3d(4, s.h, s.w).repeat(s.b, 1, 1, 1, 1)


def segments(s: Size) -> Tensor:
    return torch.rand(s.b, s.w, 2, 2)


def corners(s: Size) -> Tensor:
    return torch.tensor([[0.0, 0], [1, 0], [1, 1], [0, 1]]) + 0.1 * torch.rand(s.b, 4, 2)


def corners3d(s: Size) -> Tensor:
    cube = torch.cartesian_prod(*[torch.tensor([0.0, 1])] * 3)
    return cube + 0.1 * torch.rand(s.b, 8, 3)


def affine_weights(s: Size) -> Tensor:
    """Of a thin-plate spline that moves nothing but by its kernels."""
    return torch.cat([torch.zeros(s.b, 1, 2), torch.eye(2).expand(s.b, 2, 2)], 1)


def plane_stack(s: Size) -> Tensor:
    return torch.rand(s.b, s.h, s.w)


def plane(s: Size) -> Tensor:
    return torch.rand(s.h, s.w)


# --- arguments ------------------------------------------------------------------------------------------------------


def smaller(name: str, axes: int = 2) -> Made:
    """Half of the sizes of the tensor of that name."""
    return Made(lambda _, t: tuple(n // 2 for n in t[name].shape[-axes:]))


def sizes_of(name: str, axes: int = 2) -> Made:
    return Made(lambda _, t: tuple(t[name].shape[-axes:]))


def axis_of(name: str, axis: int) -> Made:
    return Made(lambda _, t: t[name].shape[axis])


def kernels(count: int, dimensions: int = 2) -> Callable[[Size], Tensor]:
    return lambda s: torch.rand(1, *[count] * dimensions)


def pinhole(library: Any, tensors: Mapping[str, Tensor], extrinsics: Tensor) -> Any:
    intrinsics, depth = tensors["_intrinsics"], tensors["depth_src"]
    height, width = (intrinsics.new_ones(intrinsics.shape[0]) * n for n in depth.shape[-2:])
    return library.geometry.PinholeCamera(intrinsics, extrinsics.expand_as(intrinsics), height, width)


_COLOR_MAPS: dict[tuple[str, torch.device], Any] = {}


def color_map(library: Any, device: torch.device) -> Any:
    """A table of colors, made once for each library and device: torch.compile does not trace how it is made."""
    key = library.__name__, device
    if key not in _COLOR_MAPS:
        _COLOR_MAPS[key] = library.color.ColorMap("autumn", device=device)
    return _COLOR_MAPS[key]


def each(names: Sequence[str], arguments: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The same arguments for several functions."""
    return {name: dict(arguments) for name in names}


IMAGE_NAMES = (
    "input", "image", "tensor", "img1", "img2", "src", "source", "template", "target", "src1", "src2", "data", "img",
    "patch_src", "input_tensor", "pred", "guidance", "images", "image_src", "patch_dst", "seed", "mask",
)  # fmt: skip
ARGUMENTS: dict[str, Any] = {
    **dict.fromkeys(IMAGE_NAMES, image),
    "kernel_size": 5,
    "kernel": kernels(3),
    "window_size": 5,
    "sigma": (1.5, 1.5),
    "angle": 30.0,
    "direction": 0.5,
    "factor": 0.7,
    "max_val": 1.0,
    "camera_matrix": camera,
    "depth": depth,
    "boxes": boxes,
    "points": points(2),
    "points1": points(2),
    "points2": points(2),
    "pts1": points(2),
    "pts2": points(2),
    "H": homographies,
    "Fm": homographies,
    "F_mat": homographies,
    "E_mat": essentials,
    "K": camera,
    "K1": camera,
    "K2": camera,
    "R": rotations,
    "R1": rotations,
    "R2": rotations,
    "t": batch_of(3, 1),
    "t1": batch_of(3, 1),
    "t2": batch_of(3, 1),
    "dist": batch_of(4, scale=0.05),
    "params": batch_of(1, 4, scale=0.05, shift=0.1),
    "quaternion": many(4),
    "axis_angle": many(3),
    "rotation_matrix": many_rotations,
    "M": homographies,
    "matrix": affine2d,
    "dsize": smaller("src"),
    "src_homo_dst": homographies,
    "points_in_camera": points(3, shift=1.0),
    "projected_points_in_camera_z1_plane": points(2, scale=0.5),
    "distorted_points_in_camera": points(2, scale=0.5),
    "trans_01": many_poses,
    "trans_02": many_poses,
    "trans_12": many_poses,
    "center": batch_of(2, scale=10.0),
    "scale": batch_of(2, shift=0.5),
    "translations": batch_of(2),
    "extrinsics": many_poses,
    "extrinsics_graphics": many_poses,
    "extrinsics_vision": many_poses,
    "qvec": lambda s: torch.nn.functional.normalize(torch.rand(s.b, 4), dim=1),
    "tvec": batch_of(3, 1),
    "P": projections,
    "P1": projections,
    "P2": projections,
    "ls1": segments,
    "ls2": segments,
    "weights": lambda s: torch.rand(s.b, s.w),
    "dst_pix_trans_src_pix": homographies,
    "dsize_src": (20, 24),
    "dsize_dst": (16, 18),
    "src_box": boxes,
    "dst_box": boxes,
    "points_src": corners,
    "points_dst": corners,
    "x": many(),
    "y": many(),
    "z": many(),
    "w": many(),
    "roll": many(),
    "pitch": many(),
    "yaw": many(),
    "colormap": Made(lambda library, tensors: color_map(library, tensors["input_tensor"].device)),
    "alpha_val": 0.5,
    "cfa": Made(lambda library, _: library.color.CFA.BG),
}
THREE_CHANNELS = channels(3)
_VOLUME = {"input": volume}
_EVEN_RGB = {"image": lambda s: THREE_CHANNELS(even(s))}
_MUTUAL = {"input": lambda s: torch.rand(s.b, s.h * s.w), "target": lambda s: torch.rand(s.b, s.h * s.w)}
_DISPARITY = {"input": gray, "target": gray}
_LABELS = {"target": labels}
_TRANSLATIONS3 = {"translations": batch_of(3), "center": batch_of(3), "scale": batch_of(3, shift=0.5)}
_CORNERS = {"center": batch_of(2), "sx": batch_of(scale=0.3), "sy": batch_of(scale=0.3)}
_MORPHOLOGY = {"kernel": lambda s: torch.ones(3, 3)}

OVERRIDES: dict[str, dict[str, Any]] = {
    # of sizes
    "create_meshgrid": {"_like": image, "height": axis_of("_like", 2), "width": axis_of("_like", 3)},
    "create_meshgrid3d": {"_like": image, "depth": 4, "height": axis_of("_like", 2), "width": axis_of("_like", 3)},
    "normal_transform_pixel": {"_like": image, "height": axis_of("_like", 2), "width": axis_of("_like", 3)},
    "normal_transform_pixel3d": {
        "_like": image,
        "depth": 4,
        "height": axis_of("_like", 2),
        "width": axis_of("_like", 3),
    },
    "compute_padding": {"_like": image, "original_size": sizes_of("_like")},
    "get_spatial_gradient_kernel2d": {"mode": "sobel", "order": 1},
    "get_spatial_gradient_kernel3d": {"mode": "diff", "order": 1},
    # color
    **each(("rgb_to_yuv420", "rgb_to_yuv422", "raw_to_rgb_2x2_downscaled", "rgb_to_raw", "raw_to_rgb"), _EVEN_RGB),
    "raw_to_rgb": {"image": lambda s: gray(even(s))},
    "raw_to_rgb_2x2_downscaled": {"image": lambda s: gray(even(s))},
    "yuv420_to_rgb": {
        "imagey": lambda s: gray(even(s)),
        "imageuv": lambda s: torch.rand(s.b, 2, s.h // 2, s.w // 2) - 0.5,
    },
    "yuv422_to_rgb": {
        "imagey": lambda s: gray(even(s)),
        "imageuv": lambda s: torch.rand(s.b, 2, s.h // 2 * 2, s.w // 2) - 0.5,
    },
    "grayscale_to_rgb": {"image": gray},
    "rgba_to_bgr": {"image": channels(4)},
    "rgba_to_rgb": {"image": channels(4)},
    "apply_colormap": {"input_tensor": gray},
    # contrib
    "extract_tensor_patches": {"window_size": (4, 5), "stride": (4, 5)},
    "combine_tensor_patches": {
        "patches": lambda s: torch.rand(s.b, (s.h // 4) * (s.w // 4), s.c, 4, 4),
        "original_size": Made(lambda _, t: (4, 4 * t["patches"].shape[1])),
        "window_size": (4, 4),
        "stride": (4, 4),
    },
    "connected_components": {"image": lambda s: (gray(s) > 0.5).float()},
    "connected_components_union_find": {"image": lambda s: (gray(s) > 0.5).float()},
    "distance_transform": {"image": lambda s: (gray(s) > 0.98).float()},
    "histogram_matching": {},
    "interp": {"x": plane, "xp": lambda s: torch.linspace(0, 1, 9), "fp": lambda s: torch.rand(9)},
    # core, utils
    "eye_like": {"n": 3},
    "vec_like": {"n": 3},
    "safe_inverse_with_mask": {"A": homographies},
    "safe_solve_with_mask": {"A": homographies, "B": batch_of(3, 2)},
    # enhance
    "add_weighted": {"alpha": 0.5, "beta": 0.3, "gamma": 0.1},
    "adjust_gamma": {"gamma": 0.7},
    "equalize3d": _VOLUME,
    "histogram": {
        "x": lambda s: torch.rand(s.b, s.h * s.w),
        "bins": lambda s: torch.linspace(0, 1, 32),
        "bandwidth": lambda s: torch.tensor(0.1),
    },
    "histogram2d": {
        "x1": lambda s: torch.rand(s.b, s.h * s.w),
        "x2": lambda s: torch.rand(s.b, s.h * s.w),
        "bins": lambda s: torch.linspace(0, 1, 32),
        "bandwidth": lambda s: torch.tensor(0.1),
    },
    "image_histogram2d": {"max": 1.0, "n_bins": 32},
    "integral_tensor": {},
    "jpeg_codec_differentiable": {
        "input": lambda s: torch.rand(s.b, 3, s.h // 16 * 16, s.w // 16 * 16),
        "jpeg_quality": batch_of(scale=50, shift=20),
    },
    "normalize": {"mean": lambda s: torch.rand(s.c), "std": lambda s: 0.5 + torch.rand(s.c)},
    "denormalize": {"mean": lambda s: torch.rand(s.c), "std": lambda s: 0.5 + torch.rand(s.c)},
    "posterize": {"bits": 3},
    "shift_rgb": dict.fromkeys(("r_shift", "g_shift", "b_shift"), batch_of(scale=0.3)),
    "threshold": {"thresh": 0.5, "maxval": 1.0},
    "linear_transform": {
        "inp": lambda s: torch.rand(s.w, 8),
        "transform_matrix": lambda s: torch.rand(8, 8),
        "mean_vector": lambda s: torch.rand(1, 8),
    },
    "zca_mean": {"inp": lambda s: torch.rand(s.w, 8)},
    "zca_whiten": {"inp": lambda s: torch.rand(s.w, 8)},
    # filters
    "bilateral_blur": {"sigma_color": 0.1, "sigma_space": (1.5, 1.5), "kernel_size": (5, 5)},
    "joint_bilateral_blur": {"sigma_color": 0.1, "sigma_space": (1.5, 1.5), "kernel_size": (5, 5)},
    "gaussian_blur2d": {"kernel_size": (5, 5)},
    "guided_blur": {"eps": 0.1},
    "unsharp_mask": {"kernel_size": (5, 5)},
    "in_range": {
        "lower": lambda s: torch.full((s.b, s.c, 1, 1), 0.2),
        "upper": lambda s: torch.full((s.b, s.c, 1, 1), 0.8),
    },
    "filter3d": {**_VOLUME, "kernel": kernels(3, 3)},
    "convolve3d": {**_VOLUME, "kernel": kernels(3, 3)},
    "correlate3d": {**_VOLUME, "kernel": kernels(3, 3)},
    "motion_blur3d": {**_VOLUME, "angle": (30.0, 10.0, 5.0)},
    "spatial_gradient3d": _VOLUME,
    "filter2d_separable": {"kernel_x": kernels(5, 1), "kernel_y": kernels(5, 1)},
    "otsu_threshold": {"x": image},
    **each(
        ("gaussian", "get_gaussian_discrete_kernel1d", "get_gaussian_erf_kernel1d", "get_gaussian_kernel1d"),
        {"sigma": batch_of(1, shift=1.0)},
    ),
    "get_gaussian_kernel2d": {"kernel_size": (5, 5), "sigma": batch_of(2, shift=1.0)},
    "get_gaussian_kernel3d": {"kernel_size": (5, 5, 5), "sigma": batch_of(3, shift=1.0)},
    "get_motion_kernel2d": {"angle": batch_of(scale=90), "direction": batch_of()},
    "get_motion_kernel3d": {"angle": batch_of(3, scale=90), "direction": batch_of()},
    # geometry: boxes
    "bbox_generator": dict.fromkeys(("x_start", "y_start", "width", "height"), batch_of(shift=1.0)),
    "bbox_generator3d": dict.fromkeys(
        ("x_start", "y_start", "z_start", "width", "height", "depth"), batch_of(shift=1.0)
    ),
    "bbox_to_mask": {"_like": image, "height": axis_of("_like", 2), "width": axis_of("_like", 3)},
    "bbox_to_mask3d": {"boxes": boxes3d, "size": (6, 20, 24)},
    "infer_bbox_shape3d": {"boxes": boxes3d},
    "validate_bbox3d": {"boxes": boxes3d},
    "nms": {"boxes": boxes_xyxy, "scores": lambda s: torch.rand(s.w), "iou_threshold": 0.5},
    "transform_bbox": {"trans_mat": homographies, "boxes": lambda s: boxes_xyxy(s).repeat(s.b, 1, 1)},
    # geometry: cameras, points, rotations
    "solve_pnp_dlt": {
        "world_points": points(3),
        "img_points": points(2),
        "intrinsics": camera,
    },
    **each(
        ("distort_points_kannala_brandt", "dx_distort_points_kannala_brandt", "undistort_points_kannala_brandt"),
        {"params": batch_of(1, 8, scale=0.05, shift=0.1)},
    ),
    "tilt_projection": {"taux": batch_of(scale=0.1), "tauy": batch_of(scale=0.1)},
    "project_points": {"point_3d": points(3, shift=1.0), "camera_matrix": lambda s: camera(s)[:, None]},
    "unproject_points": {
        "point_2d": points(2),
        "depth": points(1, shift=1.0),
        "camera_matrix": lambda s: camera(s)[:, None],
    },
    "cam2pixel": {"cam_coords_src": lambda s: torch.rand(s.b, s.h, s.w, 3) + 1, "dst_proj_src": poses},
    "pixel2cam": {
        "intrinsics_inv": poses,
        "pixel_coords": lambda s: torch.cat([grid(s), torch.ones(s.b, s.h, s.w, 1)], 3),
    },
    "unproject_points_orthographic": {"points_in_camera": points(2), "extension": points(1, shift=1.0)},
    "unproject_points_z1": {"points_in_cam_canonical": points(2)},
    "project_points_orthographic": {},
    "angle_to_rotation_matrix": {"angle": many()},
    "deg2rad": {},
    "pol2cart": {"rho": many(), "phi": many()},
    "ARKitQTVecs_to_ColmapQTVecs": {},
    "convert_affinematrix_to_homography": {"A": affine2d},
    "convert_affinematrix_to_homography3d": {"A": affine3d},
    "convert_points_from_homogeneous": {"points": points(3, shift=1.0)},
    "denormalize_homography3d": {
        "dst_pix_trans_src_pix": homographies3d,
        "dsize_src": (6, 20, 24),
        "dsize_dst": (5, 16, 18),
    },
    "normalize_homography3d": {
        "dst_pix_trans_src_pix": homographies3d,
        "dsize_src": (6, 20, 24),
        "dsize_dst": (5, 16, 18),
    },
    **each(
        ("denormalize_pixel_coordinates", "normalize_pixel_coordinates"),
        {
            "pixel_coordinates": grid,
            "height": axis_of("pixel_coordinates", 1),
            "width": axis_of("pixel_coordinates", 2),
        },
    ),
    **each(
        ("denormalize_pixel_coordinates3d", "normalize_pixel_coordinates3d"),
        {
            "pixel_coordinates": grid3d,
            "depth": 4,
            "height": axis_of("pixel_coordinates", 2),
            "width": axis_of("pixel_coordinates", 3),
        },
    ),
    "denormalize_points_with_intrinsics": {"point_2d_norm": points(2)},
    "normalize_points_with_intrinsics": {"point_2d": points(2)},
    "quaternion_log_to_exp": {"quaternion": many(3)},
    "vector_to_skew_symmetric_matrix": {"vec": many(3)},
    # geometry: depth
    "photometric_depth_loss": {
        "views": lambda s: torch.rand(1, s.b, *s[1:]),
        "target": lambda s: torch.rand(1, *s[1:]),
        "depth": lambda s: depth(Size(1, *s[1:])),
        "projections": lambda s: projections(s)[None],
    },
    "depth_from_disparity": {"disparity": depth, "baseline": 0.1, "focal": 50.0},
    "depth_from_plane_equation": {
        "plane_normals": lambda s: torch.rand(s.b, 3) + 1,
        "plane_offsets": lambda s: torch.rand(s.b, 1) + 1,
        "points_uv": points(2),
    },
    "unproject_meshgrid": {
        "_like": image,
        "height": axis_of("_like", 2),
        "width": axis_of("_like", 3),
        "device": Made(lambda library, t: t["_like"].device),
    },
    "depth_warp": {
        "_intrinsics": lambda s: torch.eye(4) + torch.nn.functional.pad(camera(s) - torch.eye(3), (0, 1, 0, 1)),
        "_extrinsics": poses,
        "pinhole_dst": Made(lambda library, t: pinhole(library, t, t["_extrinsics"])),
        "pinhole_src": Made(lambda library, t: pinhole(library, t, torch.eye(4, device=t["_extrinsics"].device))),
        "depth_src": depth,
        "height": axis_of("depth_src", -2),
        "width": axis_of("depth_src", -1),
    },
    "warp_frame_depth": {"depth_dst": depth, "src_trans_dst": poses},
    # geometry: several views
    "KRt_from_projection": {},
    "cross_product_matrix": {"x": many(3)},
    "depth_from_point": {"X": points(3, shift=1.0)},
    "find_fundamental": {},
    "get_perpendicular": {"lines": points(3), "points": points(2)},
    "intrinsics_like": {"focal": 50.0},
    "motion_from_essential_choose_solution": {"x1": points(2), "x2": points(2)},
    "random_intrinsics": {"low": 0.5, "high": 1.5},
    "scale_intrinsics": {"scale_factor": 0.5},
    "triangulate_points": {},
    "find_homography_lines_dlt_iterated": {},
    "sample_is_valid_for_homography": {"points1": corners, "points2": corners},
    # geometry: points
    "batched_dot_product": {"x": many(3), "y": many(3)},
    "batched_squared_norm": {"x": many(3)},
    "euclidean_distance": {"x": many(3), "y": many(3)},
    "point_line_distance": {"point": points(2), "line": points(3)},
    "transform_points": {"trans_01": homographies, "points_1": points(2)},
    "fit_line": {},
    "fit_plane": {"points": points(3)},
    "average_quaternions": {"_q": many(4), "Q": Made(lambda library, t: library.geometry.Quaternion(t["_q"]))},
    "determinant_to_polynomial": {"A": batch_of(3, 13)},
    "multiply_deg_one_poly": {"a": batch_of(4), "b": batch_of(4)},
    "multiply_deg_two_one_poly": {"a": batch_of(10), "b": batch_of(4)},
    "null_vector_3x4": {"A": lambda s: torch.rand(s.b, 3, 4)},
    "solve_quadratic": {"coeffs": batch_of(3, shift=-0.5)},
    "solve_cubic": {"coeffs": batch_of(4, shift=-0.5)},
    "solve_quartic": {"coeffs": batch_of(5, shift=-0.5)},
    # geometry: subpixel
    "conv_quad_interp3d": _VOLUME,
    "iterative_quad_interp3d": _VOLUME,
    "conv_soft_argmax3d": _VOLUME,
    "nms2d": {"kernel_size": (3, 3)},
    "nms3d": {**_VOLUME, "kernel_size": (3, 3, 3)},
    "nms3d_minmax": _VOLUME,
    "render_gaussian2d": {"mean": batch_of(2, shift=-0.5), "std": batch_of(2, shift=0.1), "size": (20, 24)},
    # geometry: transforms
    "rotate": {"angle": batch_of(scale=90)},
    "scale": {"scale_factor": batch_of(2, shift=0.5)},
    "shear": {"shear": batch_of(2, scale=0.3)},
    "translate": {"translation": batch_of(2, scale=4)},
    "resize": {"size": smaller("input")},
    "center_crop": {"size": smaller("input_tensor")},
    "crop_and_resize": {"size": smaller("input_tensor")},
    "crop_by_transform_mat": {"transform": homographies, "out_size": smaller("input_tensor")},
    "center_crop3d": {"tensor": volume, "size": smaller("tensor", 3)},
    "crop_and_resize3d": {"tensor": volume, "boxes": boxes3d, "size": smaller("tensor", 3)},
    "crop_by_boxes3d": {"tensor": volume, "src_box": boxes3d, "dst_box": boxes3d},
    "crop_by_transform_mat3d": {"tensor": volume, "transform": homographies3d, "out_size": smaller("tensor", 3)},
    "elastic_transform2d": {
        "noise": lambda s: torch.rand(s.b, 2, s.h, s.w) * 2 - 1,
        "kernel_size": (15, 15),
        "sigma": (4.0, 4.0),
    },
    "get_affine_matrix2d": {"angle": batch_of(scale=90), "sx": batch_of(scale=0.3), "sy": batch_of(scale=0.3)},
    "get_affine_matrix3d": {**_TRANSLATIONS3, "angles": batch_of(3, scale=90)},
    "get_perspective_transform3d": {"src": corners3d, "dst": corners3d},
    "get_projective_transform": {
        "center": batch_of(3),
        "angles": batch_of(3, scale=90),
        "scales": batch_of(3, shift=0.5),
    },
    "get_rotation_matrix2d": {"angle": batch_of(scale=90)},
    "get_shear_matrix2d": _CORNERS,
    "get_shear_matrix3d": {"center": batch_of(3), "sxy": batch_of(scale=0.3)},
    "invert_affine_transform": {},
    "projection_from_Rt": {"rmat": rotations},
    "photometric_homography_loss": {},
    "build_laplacian_pyramid": {"max_level": 2},
    "build_pyramid": {"max_level": 2},
    "resize_to_be_divisible": {"divisible_factor": 4},
    "get_tps_transform": {"points_src": batch_of(9, 2), "points_dst": batch_of(9, 2)},
    "warp_image_tps": {
        "kernel_centers": batch_of(9, 2),
        "kernel_weights": batch_of(9, 2, scale=0.05),
        "affine_weights": affine_weights,
    },
    "warp_points_tps": {
        "points_src": points(2),
        "kernel_centers": batch_of(9, 2),
        "kernel_weights": batch_of(9, 2),
        "affine_weights": batch_of(3, 2),
    },
    "homography_warp": {"dsize": smaller("patch_src")},
    "remap": {
        "map_x": lambda s: torch.rand(s.b, s.h, s.w) * s.w,
        "map_y": lambda s: torch.rand(s.b, s.h, s.w) * s.h,
    },
    "warp_affine": {"M": affine2d},
    "warp_grid": {"grid": grid},
    "affine3d": {"tensor": volume, "matrix": affine3d},
    "homography_warp3d": {"patch_src": volume, "src_homo_dst": homographies3d, "dsize": smaller("patch_src", 3)},
    "rotate3d": {"tensor": volume, **dict.fromkeys(("yaw", "pitch", "roll"), batch_of(scale=30))},
    "warp_affine3d": {"src": volume, "M": affine3d, "dsize": smaller("src", 3)},
    "warp_grid3d": {"grid": grid3d, "src_homo_dst": homographies3d},
    "warp_perspective3d": {"src": volume, "M": homographies3d, "dsize": smaller("src", 3)},
    # image
    "draw_convex_polygon": {
        "polygons": lambda s: boxes(s),
        "colors": lambda s: torch.rand(s.b, s.c),
    },
    "draw_line": {
        "image": lambda s: torch.rand(s[1:]),
        "p1": lambda s: torch.tensor([[1, 2]]),
        "p2": lambda s: torch.tensor([[9, 7]]),
        "color": lambda s: torch.rand(s.c),
    },
    "draw_point2d": {
        "image": lambda s: torch.rand(s[1:]),
        "points": lambda s: torch.tensor([[1, 2], [9, 7]]),
        "color": lambda s: torch.rand(s.c),
    },
    "image_to_string": {"image": lambda s: torch.rand(3, 8, 9)},
    "draw_rectangle": {"rectangle": lambda s: torch.tensor([[[1.0, 2, 9, 7]]]).repeat(s.b, 1, 1)},
    # losses and metrics
    "js_div_loss_2d": {"pred": distribution, "target": distribution},
    "kl_div_loss_2d": {"pred": distribution, "target": distribution},
    "binary_focal_loss_with_logits": {"target": binary},
    "focal_loss": {**_LABELS, "alpha": 0.5},
    "tversky_loss": {**_LABELS, "alpha": 0.5, "beta": 0.5},
    "lovasz_softmax_loss": _LABELS,
    "dice_loss": _LABELS,
    "psnr_loss": {"max_val": 1.0},
    "lovasz_hinge_loss": {"pred": gray, "target": lambda s: torch.randint(0, 2, (s.b, s.h, s.w))},
    "mutual_information_loss": _MUTUAL,
    "normalized_mutual_information_loss": _MUTUAL,
    "mutual_information_loss_2d": {"input": plane_stack, "target": plane_stack},
    "normalized_mutual_information_loss_2d": {"input": plane_stack, "target": plane_stack},
    "mutual_information_loss_3d": {"input": volume, "target": volume},
    "normalized_mutual_information_loss_3d": {"input": volume, "target": volume},
    "inverse_depth_smoothness_loss": {"idepth": gray},
    "ssim3d": {"img1": volume, "img2": volume},
    "ssim3d_loss": {"img1": volume, "img2": volume},
    "one_hot": {"labels": labels, "num_classes": 5, "device": torch.device("cpu"), "dtype": torch.float32},
    "accuracy": {"pred": batch_of(10), "target": lambda s: torch.randint(0, 10, (s.b,))},
    "aepe": {"input": lambda s: torch.rand(s.b, s.h, s.w, 2), "target": lambda s: torch.rand(s.b, s.h, s.w, 2)},
    "angle_error_mat": {},
    "angle_error_vec": {"v1": many(3), "v2": many(3)},
    "auc_from_errors": {"errors": lambda s: 10 * torch.rand(s.w)},
    "confusion_matrix": {"pred": labels, "target": labels, "num_classes": 3},
    "mean_iou": {"pred": labels, "target": labels, "num_classes": 3},
    "mean_iou_bbox": {"boxes_1": boxes_xyxy, "boxes_2": boxes_xyxy},
    **each(
        (
            "kitti_d1_error",
            "mean_absolute_disparity_error",
            "mean_bad_pixel_error",
            "root_mean_squared_disparity_error",
        ),
        _DISPARITY,
    ),
    "pose_errors": {"P": poses, "P_gt": poses},
    "mean_average_precision": {
        **dict.fromkeys(("pred_boxes", "gt_boxes"), Made(lambda _, t: [t["_boxes"]])),
        **dict.fromkeys(("pred_labels", "gt_labels"), Made(lambda _, t: [t["_labels"]])),
        "pred_scores": Made(lambda _, t: [t["_scores"]]),
        "_boxes": boxes_xyxy,
        "_labels": lambda s: torch.randint(0, 3, (s.w,)),
        "_scores": lambda s: torch.rand(s.w),
        "n_classes": 4,
    },
    "translation_ate": {"t": many(3), "t_gt": many(3)},
    # morphology
    **each(("dilation", "erosion", "opening", "closing", "gradient", "top_hat", "bottom_hat"), _MORPHOLOGY),
    "reconstruction": {"num_iters": 8},
}

WITHOUT_SAMPLE = {
    "contrib.diamond_square": "makes random images",
    "geometry.generate_scene": "makes random scenes",
    **dict.fromkeys(
        (
            "geometry.load_pointcloud_ply",
            "geometry.load_pointcloud_ply_binary",
            "geometry.save_pointcloud_ply",
            "geometry.save_pointcloud_ply_binary",
        ),
        "reads and writes files",
    ),
    **dict.fromkeys(("image.image_to_tensor", "image.image_list_to_tensor"), "takes NumPy arrays"),
    **dict.fromkeys(("image.perform_keep_shape_image", "image.perform_keep_shape_video"), "decorates functions"),
    "image.print_image": "prints",
    "image.image_to_string": "gives a string",
    "image.tensor_to_image": "gives a NumPy array",
    "utils.get_sample_images": "reads files",
    "io.get_sample_images": "reads files",
    **dict.fromkeys(
        (
            "utils.batched_forward",
            "utils.map_location_to_cpu",
            "utils.torch_meshgrid",
            "utils.dataclass_to_dict",
            "utils.dict_to_dataclass",
        ),
        "computes nothing of its own",
    ),
}
