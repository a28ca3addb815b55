"""The one table of sample calls; model.py says what an entry is.

`sample_calls()` are those of all public functions that compute on tensors, `sample_modules()` further ones of features and of
augmentations. `call.tensors(size, device)` makes the tensors of a call by name, `call.call(library, tensors)` calls it.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from types import ModuleType

import kvision as K
from benchmarks.sample_calls import augmentations, features, filters, functions, geometry
from benchmarks.sample_calls.model import Axes, Derived, SampleCall, Size

MODULES = [
    name
    for name in K.__all__
    if isinstance(getattr(K, name), ModuleType) and name not in ("augmentation", "constants", "feature", "info", "io")
]


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
    yield from functions.CALLS
    yield from filters.CALLS
    yield from geometry.CALLS


def sample_modules() -> Iterator[SampleCall]:
    """Functions and modules of features, then augmentations, each applied to all samples."""
    yield from features.CALLS
    yield from augmentations.CALLS


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
    "geometry.least_squares": "takes a function",
    **dict.fromkeys(("geometry.letterbox", "geometry.pad_to_batch"), "takes a list of images"),
    **dict.fromkeys(
        (
            "geometry.calibrate_camera",
            "geometry.calibrate_rig",
            "geometry.kabsch",
            "geometry.solve_pnp",
            "geometry.umeyama",
        ),
        "solves by least_squares",
    ),
    **dict.fromkeys(
        ("geometry.kabsch_ransac", "geometry.solve_pnp_ransac", "geometry.umeyama_ransac"), "draws samples"
    ),
    "geometry.stereo_rectify": "gives a record of matrices",
    **dict.fromkeys(("image.image_to_tensor", "image.image_list_to_tensor"), "takes NumPy arrays"),
    **dict.fromkeys(("image.to_tensor", "image.to_numpy", "image.to_pil"), "converts images of other libraries"),
    **dict.fromkeys(("image.perform_keep_shape_image", "image.perform_keep_shape_video"), "decorates functions"),
    "image.print_image": "prints",
    "image.show": "draws pictures",
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
