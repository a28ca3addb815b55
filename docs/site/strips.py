"""Picture strips of the reference: an image, what a call makes of it, and the call. TABLE is the one list of them.

Below the name of a module are calls of it. Their first argument is the input of the strip; augmentations get the photograph with
its labels, and show four draws. Names are those of the module, of `torch` and of the images in `sources`.
"""

from __future__ import annotations

import ast
import functools
import inspect
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor, nn

import kvision as K
import kvision.augmentation as A
from kvision.augmentation.container.sheet import draw_samples
from kvision.image import drawing

SIZE, DRAWS, MOST = 160, 4, 5  # the longer side of a cell; cells of a strip
QUALITY = 82

TABLE = """
augmentation
    AtLeastOneBBoxRandomCrop(160, 160)
    CenterCrop((160, 160))
    ChromaticAberration((-0.1, 0.1), (-0.2, 0.2), p=1.0)
    CoarseDropout((6, 12), fill="random", p=1.0)
    ColorJiggle(0.3, 0.3, 0.3, 0.2, p=1.0)
    ColorJitter(0.4, 0.4, 0.4, 0.2, p=1.0)
    CommonCorruption("snow", 2)
    CropNonEmptyMaskIfExists(160, 160)
    D4()
    Defocus(p=1.0)
    Denormalize(mean=0.2, std=0.5)
    Downscale((0.1, 0.3), antialias=True, p=1.0)
    FiveCrop(160)
    FrequencyMasking(60, p=1.0)
    GlassBlur(p=1.0)
    GridDistortion(p=1.0)
    GridDropout(0.6, p=1.0)
    GridMask(rotation_range=(-0.5, 0.5), p=1.0)
    ISONoise((0.05, 0.1), (0.5, 1.5), p=1.0)
    LongestMaxSize(96)
    MaskDropout(p=1.0)
    MultiCrop(160, 64)
    MultiplicativeNoise((0.5, 1.5), True, True, p=1.0)
    Normalize(mean=(0.5, 0.4, 0.4), std=(0.3, 0.3, 0.3))
    OneOf(RandomInvert(), RandomAffine(30.0), RandomGaussianBlur((15, 15), (3.0, 5.0)))
    OpticalDistortion((-0.6, 0.6), p=1.0)
    Pad((40, 10), padding_mode="reflect")
    PadIfNeeded(320, 400)
    PadTo((340, 400))
    PatchMix(patch_size=48)
    PiecewiseAffine((0.1, 0.2), p=1.0)
    PixelDropout(0.2, p=1.0)
    RandomAffine(30.0, (0.1, 0.1), (0.8, 1.2), 10.0, p=1.0)
    RandomApply(RandomVerticalFlip(p=1.0), RandomGrayscale(p=1.0), p=0.5)
    RandomAutoContrast(p=1.0)
    RandomBoxBlur((9, 9), p=1.0)
    RandomBrightness((0.5, 1.6), p=1.0)
    RandomChannelDropout(p=1.0)
    RandomChannelShuffle(p=1.0)
    RandomClahe((2.0, 8.0), p=1.0)
    RandomContrast((0.3, 1.8), p=1.0)
    RandomCopyPaste(1.0, p=1.0)
    RandomCrop((160, 160), p=1.0)
    RandomCropNearBBox()
    RandomCutMixV2(num_mix=2)
    RandomElasticTransform((63, 63), (16.0, 16.0), (4.0, 4.0), p=1.0)
    RandomEqualize(p=1.0)
    RandomErasing((0.05, 0.2), value="random", p=1.0)
    RandomFisheye((-0.3, 0.3), (-0.3, 0.3), (0.7, 1.4), p=1.0)
    RandomFog((1.0, 2.0), p=1.0)
    RandomFrost(torch.rand(3, 24, 32)[None].repeat_interleave(20, 2).repeat_interleave(20, 3), (0.7, 0.8), (0.3, 0.4), p=1.0)
    RandomGamma((0.4, 2.0), p=1.0)
    RandomGaussianBlur((15, 15), (1.0, 5.0), p=1.0)
    RandomGaussianIllumination(gain=(0.3, 0.5), p=1.0)
    RandomGaussianNoise(0.0, 0.15, p=1.0)
    RandomGrayscale(p=1.0)
    RandomHorizontalFlip(p=0.5)
    RandomHue((-0.5, 0.5), p=1.0)
    RandomInvert(p=1.0)
    RandomIoUCrop()
    RandomJPEG((3.0, 15.0), p=1.0)
    RandomJigsaw((4, 4), p=1.0)
    RandomLinearCornerIllumination(gain=(0.4, 0.6), p=1.0)
    RandomLinearIllumination(gain=(0.4, 0.6), p=1.0)
    RandomMedianBlur((9, 9), p=1.0)
    RandomMixUpV2(lambda_val=(0.3, 0.6))
    RandomMosaic(p=1.0)
    RandomMotionBlur((15, 31), 90.0, 0.5, border_type="replicate", p=1.0)
    RandomOrder(RandomRotation(45.0, p=1.0), RandomVerticalFlip(), RandomInvert(p=0.5))
    RandomPerspective(0.5, p=1.0)
    RandomPlanckianJitter(p=1.0)
    RandomPlasmaBrightness((0.3, 0.7), (0.3, 0.6), p=1.0)
    RandomPlasmaContrast(p=1.0)
    RandomPlasmaShadow((0.3, 0.7), (-0.7, -0.4), (0.3, 0.6), p=1.0)
    RandomPosterize((1, 3), p=1.0)
    RandomRGBShift(0.3, 0.3, 0.3, p=1.0)
    RandomRain((300, 500), (15, 30), (-6, 6), p=1.0)
    RandomResizedCrop((192, 192), (0.2, 0.6), p=1.0)
    RandomRotation(45.0, p=1.0)
    RandomRotation90((-1, 2), p=1.0)
    RandomSaltAndPepperNoise((0.05, 0.2), p=1.0)
    RandomSaturation((0.0, 2.5), p=1.0)
    RandomSharpness((1.0, 8.0), p=1.0)
    RandomScale((0.4, 0.9), p=1.0)
    RandomShear((-20.0, 20.0, -20.0, 20.0), p=1.0)
    RandomSizedBBoxSafeCrop(160, 160)
    RandomSnow((0.3, 0.6), (1.5, 2.5))
    RandomSolarize(0.2, 0.1, p=1.0)
    RandomThinPlateSpline(0.25, p=1.0)
    RandomTranslate((-0.3, 0.3), (-0.3, 0.3), p=1.0)
    RandomTransplantation(p=1.0)
    RandomVerticalFlip(p=0.5)
    RandomZoomOut(p=1.0)
    Resize((96, 192))
    RingingOvershoot(p=1.0)
    ShotNoise(p=1.0)
    SmallestMaxSize(96)
    SomeOf(RandomInvert(p=1.0), RandomHorizontalFlip(p=1.0), RandomMotionBlur((31, 31), 90.0, 0.5, p=1.0), n=2)
    Spatter((0.6, 0.7), mode="mud", p=1.0)
    SpeckleNoise(p=1.0)
    Swirl((-4.0, 4.0), p=1.0)
    TenCrop(160)
    TimeMasking(80, p=1.0)
    Transpose(p=1.0)
    XYMasking((1, 3), (1, 3), (0.05, 0.1), (0.05, 0.1), p=1.0)
    ZoomBlur((1.1, 1.3), p=1.0)
augmentation.auto
    AugMix(5)
    AutoAugment("imagenet")
    RandAugment(2, 15)
    TrivialAugment()
color
    apply_colormap(gray, ColorMap("viridis"))
    bgr_to_grayscale(image)
    bgr_to_rgb(image)
    bgr_to_rgba(image, 0.5)
    grayscale_to_rgb(gray)
    hls_to_rgb(rgb_to_hls(image))
    hsv_to_rgb(rgb_to_hsv(image))
    lab_to_rgb(rgb_to_lab(image))
    linear_rgb_to_rgb(image)
    luv_to_rgb(rgb_to_luv(image))
    raw_to_rgb(raw, CFA.BG)
    raw_to_rgb_2x2_downscaled(raw, CFA.BG)
    rgb_to_bgr(image)
    rgb_to_grayscale(image)
    rgb_to_hls(image)
    rgb_to_hsv(image)
    rgb_to_lab(image)
    rgb_to_linear_rgb(image)
    rgb_to_luv(image)
    rgb_to_raw(image, CFA.BG)
    rgb_to_rgba(image, 0.5)
    rgb_to_xyz(image)
    rgb_to_y(image)
    rgb_to_ycbcr(image)
    rgb_to_yuv(image)
    rgb_to_yuv420(image)
    rgb_to_yuv422(image)
    rgba_to_bgr(rgb_to_rgba(image, 0.5))
    rgba_to_rgb(rgb_to_rgba(image, 0.5))
    sepia(image)
    xyz_to_rgb(rgb_to_xyz(image))
    ycbcr_to_rgb(rgb_to_ycbcr(image))
    yuv420_to_rgb(*rgb_to_yuv420(image))
    yuv422_to_rgb(*rgb_to_yuv422(image))
    yuv_to_rgb(rgb_to_yuv(image))
contrib
    connected_components(shapes)
    connected_components_union_find(shapes)
    distance_transform(1 - shapes, exact=True)
    histogram_matching(image, other)
enhance
    add_weighted(image, 0.6, other, 0.4, 0.0)
    adjust_brightness(image, 0.3)
    adjust_brightness_accumulative(image, 0.5)
    adjust_contrast(image, 0.4)
    adjust_contrast_with_mean_subtraction(image, 2.0)
    adjust_gamma(image, 2.2)
    adjust_hue(image, 1.6)
    adjust_log(image)
    adjust_saturation(image, 2.5)
    adjust_saturation_with_gray_subtraction(image, 0.3)
    adjust_sigmoid(image, 0.5, 10.0)
    denormalize(image, 0.2, 0.5)
    equalize(image)
    equalize_clahe(image, 4.0)
    integral_image(image)
    invert(image)
    jpeg_codec_differentiable(image, 5.0)
    normalize(image, mean, std)
    normalize_min_max(0.5 * image, 0.0, 1.0)
    posterize(image, 2)
    sharpness(image, 8.0)
    shift_rgb(image, 0.3, 0.0, -0.3)
    solarize(image, 0.5)
    threshold(gray, 0.4, 1.0)
feature
    dog_response_single(gray, 1.0, 3.0)
    gftt_response(gray)
    harris_response(gray)
    hessian_response(gray)
filters
    bilateral_blur(image, 25, 0.5, (8.0, 8.0))
    blur_pool2d(image, 5)
    box_blur(image, 15)
    canny(image, 0.2, 0.5)
    correlate2d(image, emboss)
    convolve2d(image, emboss)
    edge_aware_blur_pool2d(image, 7)
    fft_conv(image, emboss)
    filter2d(image, emboss)
    filter2d_separable(image, bar, bar)
    gaussian_blur2d(image, 21, (4.0, 4.0))
    guided_blur(image, image, 21, 0.05)
    in_range(image, (0.5, 0.0, 0.0), (1.0, 0.6, 0.4))
    joint_bilateral_blur(image, gray, 25, 0.15, (8.0, 8.0))
    laplacian(image, 3)
    max_blur_pool2d(image, 5)
    median_blur(image, 9)
    motion_blur(image, 31, 30.0, 0.0)
    otsu_threshold(gray)
    sobel(image)
    spatial_gradient(gray)
    unsharp_mask(image, 9, (3.0, 3.0))
geometry
    affine(image, turn)
    build_laplacian_pyramid(image[..., :256, :256], 3)
    build_pyramid(image, 3)
    center_crop(image, (160, 160))
    crop_and_resize(image, corners, (160, 160))
    crop_by_boxes(image, corners, square)
    crop_by_indices(image, corners)
    crop_by_transform_mat(image, perspective, (160, 160))
    elastic_transform2d(image, noise, (63, 63), (8.0, 8.0))
    hflip(image)
    homography_warp(image, tilt, (288, 288))
    nms2d(response, (9, 9))
    pyrdown(image)
    pyrup(image)
    remap(image, wave_x, wave_y, align_corners=True)
    reproject_image(image, pinhole, fisheye, tipped)
    rescale(image, 0.5)
    resize(image, (96, 192))
    resize_to_be_divisible(image, 100)
    rot180(image)
    rotate(image, 30.0)
    scale(image, 0.7)
    shear(image, torch.tensor([[0.3, 0.0]]))
    translate(image, torch.tensor([[60.0, 30.0]]))
    undistort_image(image, camera, lens)
    vflip(image)
    warp_image_tps(image, centers, *get_tps_transform(centers, moved))
    warp_affine(image, turn, (288, 288))
    warp_perspective(image, perspective, (288, 288))
image
    draw_convex_polygon(image.clone(), corners, color)
    draw_line(small.clone(), torch.tensor([3, 44]), torch.tensor([44, 6]), color)
    draw_point2d(small.clone(), points, color)
    draw_rectangle(image.clone(), box, color, line_width=4)
    make_grid(torch.cat([image, other]))
morphology
    bottom_hat(gray, window)
    closing(gray, window)
    dilation(gray, window)
    erosion(gray, window)
    gradient(gray, window)
    opening(gray, window)
    reconstruction(gray - 0.3, gray)
    top_hat(gray, window)
"""


def entries() -> dict[str, str]:
    """The calls by the names of what they call, `filters.sobel`."""
    calls, module = {}, ""
    for line in TABLE.split("\n"):
        if line.startswith(" "):
            calls[f"{module}.{line.strip().split('(')[0]}"] = line.strip()
        elif line:
            module = line
    return calls


@functools.cache
def sources() -> dict[str, Any]:
    """What calls mention, for a photograph of 288 x 288 pixels."""
    folder = Path(__file__).parents[1] / "pictures/gallery"
    image, other = (K.io.load_image(folder / f"{name}_photo.jpg")[None] for name in ("astronaut", "coffee"))
    gray = K.color.rgb_to_grayscale(image)
    shapes = torch.zeros(1, 1, 96, 96)
    shapes[..., 10:40, 12:30] = shapes[..., 55:85, 40:80] = shapes[..., 15:30, 55:85] = 1.0
    y, x = torch.meshgrid(torch.arange(288.0), torch.arange(288.0), indexing="ij")
    left, top, right, bottom = 96.0, 4.0, 176.0, 130.0
    size = K.image.ImageSize(288, 288)
    return {
        "torch": torch,
        "image": image,
        "other": other,
        "gray": gray,
        "raw": K.color.rgb_to_raw(image, K.color.CFA.BG),
        "shapes": shapes,
        "mean": torch.tensor([0.5, 0.4, 0.4]),
        "std": torch.tensor([0.3, 0.3, 0.3]),
        "emboss": torch.tensor([[[-2.0, -1.0, 0.0], [-1.0, 1.0, 1.0], [0.0, 1.0, 2.0]]]),
        "bar": torch.ones(1, 15) / 15,
        "turn": torch.tensor([[[0.87, -0.5, 90.0], [0.5, 0.87, -50.0]]]),
        "tilt": torch.tensor([[[1.0, 0.2, 0.0], [0.1, 1.1, 0.0], [0.2, 0.1, 1.2]]]),
        "perspective": torch.tensor([[[1.0, 0.2, 10.0], [0.1, 0.9, 10.0], [0.0008, 0.0004, 1.0]]]),
        "corners": torch.tensor([[[left, top], [right, top], [right, bottom], [left, bottom]]]),
        "square": torch.tensor([[[0.0, 0.0], [159.0, 0.0], [159.0, 159.0], [0.0, 159.0]]]),
        "box": torch.tensor([[[left, top, right, bottom]]]),
        "color": torch.tensor([1.0, 0.5, 0.0]),
        "noise": torch.rand(1, 2, 288, 288, generator=torch.Generator().manual_seed(1)) * 2 - 1,
        "response": K.feature.gftt_response(gray),
        "wave_x": (x + 8 * torch.sin(y / 12))[None],
        "wave_y": (y + 8 * torch.sin(x / 12))[None],
        "camera": torch.tensor([[[250.0, 0.0, 144.0], [0.0, 250.0, 144.0], [0.0, 0.0, 1.0]]]),
        "lens": torch.tensor([[-0.4, 0.1, 0.0, 0.0]]),
        "pinhole": K.sensors.camera.PinholeModel(size, torch.tensor([150.0, 150.0, 143.5, 143.5])),
        "fisheye": K.sensors.camera.KannalaBrandtK3(size, torch.tensor([130.0, 130, 143.5, 143.5, -0.05, 0, 0, 0])),
        "tipped": K.geometry.axis_angle_to_rotation_matrix(torch.tensor([[-0.3, 0.3, 0.2]]))[0],
        "window": torch.ones(9, 9),
        "centers": torch.tensor([[[-0.8, -0.8], [0.8, -0.8], [0.8, 0.8], [-0.8, 0.8], [0.0, 0.0]]]),
        "moved": torch.tensor([[[-0.8, -0.8], [0.8, -0.8], [0.8, 0.8], [-0.8, 0.8], [0.3, 0.2]]]),
        "small": image[0, :, 3::6, 3::6],
        "points": 47 * torch.rand(40, 2, generator=torch.Generator().manual_seed(1)),
    }


def labels() -> tuple[Tensor, Tensor, Tensor]:
    """A mask, a box and two key points of the photograph."""
    y, x = torch.meshgrid(torch.arange(288.0), torch.arange(288.0), indexing="ij")
    mask = (((x - 134) / 42) ** 2 + ((y - 66) / 62) ** 2 < 1).long()[None, None]
    return mask, torch.tensor([[[92.0, 4.0, 176.0, 130.0]]]), torch.tensor([[[118.0, 58.0], [148.0, 60.0]]])


def strip(name: str, call: str) -> bytes:
    """The strip of a call, a JPEG."""
    module: ModuleType = functools.reduce(getattr, name.split(".")[:-1], K)
    namespace = {**vars(module), **sources()}
    with torch.random.fork_rng():
        torch.manual_seed(3)
        value = eval(call, namespace)
        if isinstance(value, nn.Module):
            cells = _draws(value)
        else:
            expression = ast.parse(call, mode="eval").body
            assert isinstance(expression, ast.Call)
            first = expression.args[0]
            inputs = eval(ast.unparse(first.value if isinstance(first, ast.Starred) else first), namespace)
            splits = name.startswith("color.")
            cells = [drawing.framed(cell, 3) for cell in _cells(inputs, splits)[:1]]
            cells += _cells(value, splits and not name.endswith("to_rgb"), inputs)
    sheet = drawing.sheet_of(cells[:MOST], MOST, 4)
    pixels = (255 * sheet.clamp(0, 1)).round().byte().permute(1, 2, 0).numpy()
    done, data = cv2.imencode(".jpg", np.ascontiguousarray(pixels[..., ::-1]), (cv2.IMWRITE_JPEG_QUALITY, QUALITY))
    assert done
    return bytes(data)


def _draws(augment: nn.Module) -> list[Tensor]:
    """The photograph and draws, with the labels that the augmentation moves; those that mix samples get two photographs."""
    image, other = (sources()[name] for name in ("image", "other"))
    if getattr(augment, "mixes_samples", False) or isinstance(augment, A.PatchMix):
        images = torch.cat([image, other])
        mask = torch.cat([labels()[0], torch.zeros_like(labels()[0])])
        if isinstance(augment, (A.RandomCopyPaste, A.RandomTransplantation)):
            mask = mask if isinstance(augment, A.RandomCopyPaste) else mask[:, 0]
            return _cells([images[:1], images[1:], augment(images, mask, seed=3)[0][1:]])
        return draw_samples(augment, (images,), ["image"], DRAWS, SIZE, seed=3)
    if isinstance(augment, A.MaskDropout):
        return [drawing.framed(_cells(image)[0], 3), *_cells(augment(image, masks=labels()[0]))]
    if isinstance(augment, (A.FiveCrop, A.MultiCrop)):
        return [drawing.framed(_cells(image)[0], 3), *_cells([x[0] for x in augment(image)], like=image)]
    if isinstance(augment, (A.Normalize, A.Denormalize, A.LongestMaxSize, A.SmallestMaxSize)):
        return [drawing.framed(_cells(image)[0], 3), *_cells(augment(image), like=image)]
    if isinstance(augment, A.RandomAutoContrast):
        image = 0.3 + 0.4 * image  # the photograph has all contrast
    if isinstance(augment, A.IntensityAugmentationBase2D):
        before, *draws = draw_samples(augment, (image,), ["image"], DRAWS, SIZE, seed=3)
    else:
        keys = ["image", "mask", "bbox_xyxy", "keypoints"]
        before, *draws = draw_samples(augment, (image, *labels()), keys, DRAWS, SIZE, seed=3)
    return [before, *draws[: 1 if all(torch.equal(draw, draws[0]) for draw in draws) else DRAWS]]


def _cells(value: Any, splits: bool = False, like: Any = None) -> list[Tensor]:
    """The pictures of tensors, as large as their share of the size of `like`; with `splits` colors outside [0, 1] one by one."""
    tensors = [x for x in value if x.dim() > 2] if isinstance(value, (tuple, list)) else [value]
    cells = []
    for tensor in tensors:
        longest = max(tensor.shape[-2:]) if like is None else max(max(x.shape[-2:]) for x in _listed(like))
        size = min(SIZE, round(SIZE * max(tensor.shape[-2:]) / longest))
        is_color = tensor.shape[-3] in (3, 4) and not (splits and (tensor.min() < 0 or tensor.max() > 1))
        pictures = (
            (tensor.flatten(0, -4) if tensor.dim() > 3 else tensor[None])
            if is_color
            else tensor.flatten(0, -3)[:, None]
        )
        cells += [drawing.with_labels(drawing.on_white(_stretched(picture)), size) for picture in pictures[: MOST - 1]]
    return cells


def _listed(value: Any) -> list[Tensor]:
    return list(value) if isinstance(value, (tuple, list)) else [value]


def _stretched(picture: Tensor) -> Tensor:
    """Values that leave [0, 1] or fill little of it, between the quantiles .002 and .998 of some pixels."""
    x = picture.float()
    low, high = x.flatten()[::11].quantile(torch.tensor([0.002, 0.998])).tolist()
    if x.min() >= 0 and x.max() <= 1 and high > 0.3:
        return x
    return (x - low) / max(high - low, 1e-12)


@functools.cache
def strips() -> dict[str, bytes]:
    """All strips by name, rendered once in a process; on one thread, because images are small."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return {name: strip(name, call) for name, call in entries().items()}
    finally:
        torch.set_num_threads(threads)


FORM = re.compile(r"(?:Module|Class) form of :func:`([\w.]+)`")


def name_of(module: str, value: Any) -> str | None:
    """The strip of a function or class of a module, "filters.sobel"; of a class also that of the function that it calls."""
    form = FORM.search(inspect.getdoc(value) or "") if inspect.isclass(value) else None
    for name in (value.__name__, *([form[1].split(".")[-1]] if form else [])):
        if f"{module}.{name}" in entries():
            return f"{module}.{name}"
    return None


def uri(name: str) -> str:
    """The file of a strip on the site."""
    return f"pictures/strips/{name}.jpg"


def overview(link: Callable[[str], str]) -> str:
    """The page of all strips, by module, each a link to its reference."""
    lines = [
        "# Pictures",
        "",
        "What each function and augmentation does to a photograph: the input in a frame, the result or four draws, and the call.",
        "",
    ]
    module = ""
    for name, call in entries().items():
        if name.rpartition(".")[0] != module:
            module = name.rpartition(".")[0]
            lines += [f"## {module}", ""]
        lines += [f"[![{name}](../{uri(name)}){{ loading=lazy }}]({link(name)})", "", f"`{call}`", "{ .call }", ""]
    return "\n".join(lines)
