"""kvision.tv: torchvision's v2 by its names. Where torchvision is missing, plain tensors and PIL images alone."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from kvision import _ops, tv
from kvision.core.exceptions import TypeCheckError
from kvision.tv import containers
from kvision.tv import functional as F
from kvision.tv.transform import apply_calls

# --- v2's calls that kvision.tv repeats with the same seeds, and how far results may differ ---------------------------

HEIGHT, WIDTH = 61, 54


def photograph(seed: int = 0) -> Tensor:
    """A uint8 image (3, H, W) with smooth parts, edges and noise."""
    torch.manual_seed(seed)
    smooth = torch.nn.functional.interpolate(torch.rand(1, 3, 5, 6), (HEIGHT, WIDTH), mode="bicubic")[0] * 255
    return (smooth + 12 * torch.randn(3, HEIGHT, WIDTH)).clamp(0, 255).to(torch.uint8)


# Names of classes, positional and named arguments; colors of floats are in [0, 1].
MOVES: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = [
    ("RandomHorizontalFlip", (), {"p": 0.7}),
    ("RandomVerticalFlip", (), {"p": 0.7}),
    ("Resize", (40,), {}),
    ("Resize", ((33, 50),), {"interpolation": "bicubic"}),
    ("Resize", ((90, 41),), {"antialias": False}),
    ("Resize", (None,), {"max_size": 90, "interpolation": "nearest-exact"}),
    ("CenterCrop", (32,), {}),
    ("CenterCrop", ((80, 31),), {}),
    ("RandomCrop", (32,), {}),
    ("RandomCrop", ((70, 60),), {"padding": [3, 4, 5, 6], "pad_if_needed": True, "fill": 3}),
    ("RandomResizedCrop", (24,), {}),
    ("Pad", ([1, 2, 3, 4],), {"fill": 7}),
    ("RandomZoomOut", (), {"p": 0.7, "fill": 3}),
    ("RandomRotation", (40,), {"fill": 1}),
    ("RandomRotation", (40,), {"interpolation": "bilinear", "expand": True}),
    (
        "RandomAffine",
        (30,),
        {"translate": (0.1, 0.2), "scale": (0.7, 1.2), "shear": [-10, 10, -5, 5], "interpolation": "bilinear"},
    ),
    ("RandomAffine", (30,), {"shear": 7, "center": [10, 20], "fill": None}),
    ("RandomPerspective", (), {"p": 0.7}),
    ("ElasticTransform", (), {}),
    ("ScaleJitter", ((50, 60),), {}),
    ("RandomShortestSize", ([30, 40],), {"max_size": 50}),
    ("RandomResize", (30, 45), {}),
    ("RandomIoUCrop", (), {}),
    ("ConvertBoundingBoxFormat", ("XYWH",), {}),
    ("ClampBoundingBoxes", (), {}),
    ("ClampKeyPoints", (), {}),
    ("SetClampingMode", (None,), {}),
    ("SanitizeBoundingBoxes", (), {"min_size": 20}),
    ("SanitizeKeyPoints", (), {}),
    ("ToPureTensor", (), {}),
    ("Identity", (), {}),
    ("ToDtype", (torch.float32, True), {}),
    ("Grayscale", (3,), {}),
    ("ColorJitter", (0.3,), {}),
]
COLORS: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = [
    ("Grayscale", (), {}),
    ("RandomGrayscale", (), {"p": 0.7}),
    ("RGB", (), {}),
    ("ColorJitter", (0.4, 0.4, 0.4, 0.2), {}),
    ("RandomPhotometricDistort", (), {}),
    ("RandomChannelPermutation", (), {}),
    ("RandomInvert", (), {"p": 0.7}),
    ("RandomPosterize", (3,), {"p": 0.7}),
    ("RandomSolarize", (0.4,), {"p": 0.7}),
    ("RandomAdjustSharpness", (2.0,), {"p": 0.7}),
    ("RandomAutocontrast", (), {"p": 0.7}),
    ("RandomEqualize", (), {"p": 0.7}),
    ("GaussianBlur", (5,), {}),
    ("GaussianBlur", ((5, 9), (0.5, 1.0)), {}),
    ("GaussianNoise", (), {}),
    ("JPEG", ((20, 70),), {}),
    ("RandomErasing", (), {"p": 0.7}),
    ("RandomErasing", (), {"p": 0.7, "value": "random"}),
    ("RandomErasing", (), {"p": 0.7, "value": [0.1, 0.2, 0.3]}),
    ("ConvertImageDtype", (), {}),
    ("Normalize", ([0.4, 0.5, 0.6], [0.2, 0.2, 0.3]), {}),
    ("AutoAugment", (), {}),
    ("RandAugment", (), {"fill": 3}),
    ("TrivialAugmentWide", (), {}),
    ("AugMix", (), {}),
    ("ToPILImage", (), {}),
    ("ToImage", (), {}),
    ("UniformTemporalSubsample", (3,), {}),
]
# Chains of functions that each truncate bytes: an error of one level may grow.
CHAINS = ("ColorJitter", "RandomPhotometricDistort", "AutoAugment", "RandAugment", "AugMix")


def differences(ours: Any, theirs: Any, levels: float = 1, floats: float = 2e-5, where: str = "") -> list[str]:
    """What differs: types, formats, shapes, or more than .1% of the values by more than `levels` or `floats`."""
    if type(ours) is not type(theirs):
        return [f"{where}: {type(ours).__name__}, not {type(theirs).__name__}"]
    if isinstance(theirs, dict):
        return [d for k in theirs for d in differences(ours[k], theirs[k], levels, floats, f"{where}.{k}")]
    if isinstance(theirs, (tuple, list)):
        pairs = enumerate(zip(ours, theirs, strict=True))
        return [d for i, (x, y) in pairs for d in differences(x, y, levels, floats, f"{where}[{i}]")]
    if hasattr(theirs, "getbands"):
        import numpy as np

        if (ours.mode, ours.size) != (theirs.mode, theirs.size):
            return [f"{where}: {ours}, not {theirs}"]
        ours, theirs = (torch.from_numpy(np.array(x)) for x in (ours, theirs))
    if not isinstance(theirs, Tensor):
        return [] if ours == theirs else [f"{where}: {ours!r}, not {theirs!r}"]
    found = [
        f"{where}: {name} {getattr(ours, name)}, not {getattr(theirs, name)}"
        for name in ("shape", "dtype", "format", "canvas_size", "clamping_mode")
        if getattr(ours, name, None) != getattr(theirs, name, None)
    ]
    if not found:
        distance = (ours.as_subclass(Tensor).double() - theirs.as_subclass(Tensor).double()).abs()
        limit = floats if theirs.is_floating_point() else levels
        share = (distance > limit).double().mean() if distance.numel() else 0.0
        if share > 1e-3:
            found.append(f"{where}: {share:.2%} differ, by {distance.max():.3g} at most")
    return found


def recipes(m: Any) -> dict[str, tuple[str, Any]]:
    """The presets of torchvision's training scripts, of a module, and the kind of sample that they take."""
    from torchvision.tv_tensors import Mask

    to_float = m.ToDtype(torch.float32, scale=True)
    normalize = m.Normalize((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
    end, flip = [to_float, normalize], m.RandomHorizontalFlip()
    train = [m.RandomResizedCrop(32, antialias=True), flip, m.TrivialAugmentWide(), *end, m.RandomErasing(0.1)]
    out = m.RandomZoomOut(fill={"others": (123.0, 117.0, 104.0), Mask: 0})
    jitter = [m.ScaleJitter((50, 50)), m.RandomCrop(50, pad_if_needed=True, fill=0), flip, to_float]
    crop = m.RandomCrop(28, pad_if_needed=True)
    return {
        "classification": ("classification", train),
        "evaluation": ("classification", [m.Resize(40, antialias=True), m.CenterCrop(32), *end]),
        "SSD": ("detection", [m.RandomPhotometricDistort(), out, m.RandomIoUCrop(), flip, to_float]),
        "large scale jitter": ("detection", [*jitter, m.SanitizeBoundingBoxes()]),
        "multiscale": ("detection", [m.RandomShortestSize((30, 40, 50), max_size=70), flip, to_float]),
        "segmentation": ("segmentation", [m.RandomResize(30, 100), flip, crop, *end]),
        "video": ("video", [to_float, m.Resize((40, 50), antialias=False), flip, normalize, m.RandomCrop((32, 32))]),
    }


# --- tests ------------------------------------------------------------------------------------------------------------


def samples() -> dict[str, Any]:
    """What people hand to a pipeline: (image, target), dicts, videos, lists with a plain tensor."""
    tv_tensors = pytest.importorskip("torchvision.tv_tensors", reason="torchvision is not installed")
    image, canvas = photograph(), (HEIGHT, WIDTH)
    boxes = torch.tensor([[3, 6, 20, 25], [10, 9, 45, 51], [30, 2, 54, 60]])
    rotated = torch.tensor([[12.0, 18, 9, 6, 25], [27, 30, 15, 18, -10]])
    target = {
        "boxes": tv_tensors.BoundingBoxes(boxes, format="XYXY", canvas_size=canvas),
        "masks": tv_tensors.Mask(torch.randint(0, 5, (3, *canvas))),
        "points": tv_tensors.KeyPoints(torch.tensor([[3.0, 6], [50, 60], [30, 45]]), canvas_size=canvas),
        "labels": torch.tensor([1, 2, 3]),
        "name": "x",
    }
    return {
        "detection": (tv_tensors.Image(image), target),
        "rotated": {
            "image": image / 255.0,
            "boxes": tv_tensors.BoundingBoxes(rotated, format="CXCYWHR", canvas_size=canvas),
            "labels": torch.tensor([1, 2]),
        },
        "video": tv_tensors.Video(torch.stack([image, image.flip(-1)])),
        "plain": [image / 255.0, 3, torch.ones(2)],
    }


def call(module: Any, name: str, args: Any, options: Any, sample: Any, seed: int) -> Any:
    if module is not tv and "interpolation" in options:  # older versions of torchvision take no names
        options = {**options, "interpolation": module.InterpolationMode(options["interpolation"])}
    torch.manual_seed(seed)
    return getattr(module, name)(*args, **options)(sample)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["detection", "rotated", "video", "plain"])
@pytest.mark.parametrize("rows", [MOVES, COLORS], ids=["moves", "colors"])
def test_a_seed_gives_what_v2_gives(rows: Any, kind: str) -> None:
    """Parameters, types and nesting are equal, values within one level or 2e-5 but for .1% of the pixels."""
    sample = samples()[kind]
    from torchvision.transforms import v2

    exact_masks = "interpolation" in inspect.signature(v2.functional.resize_mask).parameters  # not in torchvision 0.26
    found = []
    for name, args, options in rows:
        if options.get("interpolation") == "nearest-exact" and kind == "detection" and not exact_masks:
            continue
        if name == "RandomSolarize" and kind in ("detection", "video"):
            args = (100.0,)
        for seed in range(3):
            try:
                theirs = call(v2, name, args, options, sample, seed)
            except (TypeError, ValueError, RuntimeError, IndexError):
                with pytest.raises(
                    (TypeError, ValueError, IndexError)
                ):  # the last one by torchvision's key points, once
                    call(tv, name, args, options, sample, seed)
                continue
            if name in ("Grayscale", "RandomGrayscale", "RGB") and kind == "video":
                continue  # v2 passes videos on
            levels = 3 if name in CHAINS else 1
            ours = call(tv, name, args, options, sample, seed)
            found += [f"{name} {options} seed {seed}: {d}" for d in differences(ours, theirs, levels)]
    assert not found, "\n".join(found)


@pytest.mark.filterwarnings("ignore")
def test_recipes_give_what_v2_gives() -> None:
    inputs = samples()
    image, target = inputs["detection"]
    masks = target["masks"]
    inputs["classification"] = (image, 3)
    inputs["segmentation"] = {"image": image, "mask": type(masks)(masks[:1])}
    from torchvision.transforms import v2

    ours, theirs = recipes(tv), recipes(v2)
    found = []
    for name, (kind, steps) in ours.items():
        for seed in range(6):
            results = []
            for module, transforms in ((tv, steps), (v2, theirs[name][1])):
                torch.manual_seed(seed)
                results.append(module.Compose(transforms)(inputs[kind]))
            floats = (
                4.1 / 255 / (1.0 if kind == "detection" else 0.22)
            )  # a level of the first step, after the contrast of others
            found += [f"{name} seed {seed}: {d}" for d in differences(*results, floats=floats)]
    assert not found, "\n".join(found)


def test_mixes_are_those_of_v2() -> None:
    v2 = pytest.importorskip("torchvision.transforms.v2", reason="torchvision is not installed")
    x, labels = torch.stack([photograph(i) / 255.0 for i in range(3)]), torch.tensor([0, 1, 4])
    for name in ("MixUp", "CutMix"):
        for sample in ((x, labels), {"images": x, "Labels": labels.float()[:, None]}):
            for seed in range(3):
                options = {"num_classes": 5} if isinstance(sample, tuple) else {}
                ours, theirs = (call(module, name, (), options, sample, seed) for module in (tv, v2))
                assert not differences(ours, theirs)


def test_to_tensor() -> None:
    """Values of v2's, which warns that it is deprecated."""
    array = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    image = PIL.Image.fromarray(array)
    expected = torch.from_numpy(array).permute(2, 0, 1) / 255
    for source in (array, image):
        assert torch.equal(tv.ToTensor()(source), expected)
    assert torch.equal(tv.ToTensor()(array.astype(np.int32)), torch.from_numpy(array).permute(2, 0, 1).int())
    assert tv.ToTensor()(image.convert("1")).unique().tolist() == [0.0]
    assert torch.equal(tv.ToTensor()(expected), expected)


def test_names_and_arguments_are_those_of_v2() -> None:
    v2 = pytest.importorskip("torchvision.transforms.v2", reason="torchvision is not installed")
    ours = set(tv.__all__) - {"SameOnBatch"}
    theirs = {n for n in dir(v2) if inspect.isclass(getattr(v2, n))}
    assert ours == theirs
    for name in ours - {"InterpolationMode", "AutoAugmentPolicy", "Transform"}:
        mine, other = (inspect.signature(getattr(module, name).__init__).parameters for module in (tv, v2))
        defaults = [(p.name, getattr(p.default, "value", p.default), p.kind) for p in mine.values()]
        if "args" not in other and "args" not in mine:
            assert defaults == [(p.name, getattr(p.default, "value", p.default), p.kind) for p in other.values()], name
    functions = [n for n, f in vars(F).items() if inspect.isfunction(f) and hasattr(f, "kinds")]
    functions += ["clamp_bounding_boxes", "clamp_keypoints", "convert_bounding_box_format", "sanitize_bounding_boxes"]
    functions += ["sanitize_keypoints"]
    assert len(functions) > 40
    for name in functions:
        mine, other = (inspect.signature(getattr(module, name)).parameters for module in (F, v2.functional))
        assert list(mine) == list(other), name


def test_torchvision_is_imported_in_functions_alone() -> None:
    sources = [path.read_text() for path in Path(inspect.getfile(tv)).parent.rglob("*.py")]
    assert len(sources) > 10 and not any(
        re.search("^(import|from) torchvision", text, re.MULTILINE) for text in sources
    )


# Every function that takes arguments of each sample, and some that do not.
OF_BATCHES = [
    lambda: tv.RandomHorizontalFlip(),
    lambda: tv.RandomResizedCrop(24),
    lambda: tv.RandomResizedCrop((24, 30), interpolation="bicubic"),
    lambda: tv.RandomResizedCrop(24, interpolation="nearest"),
    lambda: tv.RandomCrop(32),
    lambda: tv.RandomCrop((HEIGHT, 20)),
    lambda: tv.RandomCrop((HEIGHT, WIDTH), padding=3),
    lambda: tv.RandomRotation(30, "bilinear", fill=[1, 2, 3]),
    lambda: tv.RandomAffine(30, (0.1, 0.2), (0.7, 1.2), [-10, 10, -5, 5], fill=3),
    lambda: tv.RandomPerspective(p=0.7),
    lambda: tv.ElasticTransform(),
    lambda: tv.ColorJitter(0.3, 0.3, 0.3, 0.1),
    lambda: tv.RandomPhotometricDistort(),
    lambda: tv.RandomChannelPermutation(),
    lambda: tv.RandomGrayscale(0.5),
    lambda: tv.RandomAdjustSharpness(3),
    lambda: tv.GaussianBlur((3, 5)),
    lambda: tv.JPEG((20, 90)),
    lambda: tv.RandomErasing(),
    lambda: tv.RandomErasing(value=[1, 2, 3]),
    lambda: tv.RandomErasing(value="random"),
    lambda: tv.AutoAugment(),
    lambda: tv.RandAugment(3),
]


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32], ids=str)
def test_samples_of_a_batch_draw_by_themselves(dtype: torch.dtype, device: torch.device) -> None:
    """Calls for all samples give what calls for each give, by the same numbers; SameOnBatch draws once."""
    x = F.to_dtype(torch.stack([photograph(i) for i in range(6)]), dtype, scale=True).to(device)
    found = []
    for make in OF_BATCHES:
        t = make()
        if type(t) is tv.JPEG and dtype != torch.uint8:
            continue
        results = []
        for t._applies_functions in (True, False):
            torch.manual_seed(3)
            results.append(t(x).cpu())
        levels = 4 if type(t).__name__ in CHAINS else 1
        found += [f"{t}: {d}" for d in differences(*results, levels, floats=2e-5 if device.type == "cpu" else 1e-4)]
        torch.manual_seed(3)
        once = tv.SameOnBatch([t])(x)
        torch.manual_seed(3)
        found += (
            [f"{t} once: {d}" for d in differences(once[0].cpu(), t(x[0]).cpu(), levels)]
            if type(t) is not tv.AugMix
            else []
        )
    assert not found, "\n".join(found)


def test_color_functions_of_bytes_are_one_program(device: torch.device) -> None:
    """Those of each image in its own order: by themselves with their values, and neighbors without a rounding in between."""
    x = torch.stack([photograph(i) for i in range(4)]).to(device)
    calls: list[list[tuple[Any, dict[str, Any]]]] = [
        [(F.invert, {}), (F.adjust_brightness, {"brightness_factor": 0.5})],
        [(F.posterize, {"bits": 3}), (F.invert, {}), (F.invert, {})],
        [(F.solarize, {"threshold": 100.0}), (F.posterize, {"bits": 4})],
        [],
    ]
    results = apply_calls(x, calls)
    assert torch.equal(results[3], x[3])
    for result, image, own in zip(results, x, calls):
        for function, arguments in own:
            image = function(image, **arguments)
        assert not differences(result.cpu(), image.cpu(), 1 if own and own[0][0] is F.invert else 0)
    launched: list[str] = []

    class Names(TorchDispatchMode):
        def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
            launched.append(str(func))
            return func(*args, **(kwargs or {}))

    with Names():
        tv.ColorJitter(0.4, 0.4, 0.4, 0.1)(x)
    if _ops.serves("color_program_around_mean", x) == "native":
        assert [name for name in launched if "kvision" in name] == ["kvision.color_program_around_mean.default"]
        assert len(launched) < 30
    with pytest.raises(TypeError, match=r"solarize: expected a threshold of at most 255\.0, got 300"):
        tv.RandomSolarize(300, p=1.0)(x)


def test_neighbors_in_a_pass_give_what_each_gives(device: torch.device) -> None:
    """The windows and flips that the pass has drawn, by the functions: within a level, as steps of bytes are not rounded."""
    x = torch.stack([photograph(i) for i in range(8)]).to(device)
    mean, std = [0.4, 0.5, 0.6], [0.2, 0.2, 0.3]
    steps = [tv.RandomResizedCrop((24, 30)), tv.RandomHorizontalFlip(), tv.ToDtype(torch.float32, True)]
    augment = tv.Compose([*steps, tv.Normalize(mean, std)])
    result, label = augment((x, 7))
    assert label == 7 and result.dtype == torch.float32
    passed = augment._steps(list(augment.transforms), x)
    assert [name for name, _ in passed] == ["RandomResizedCrop", "RandomHorizontalFlip", "dtype", "Normalize"]
    crop, flip, _ = containers._pass_of(tuple(passed)).augmentations._params
    for i in range(8):
        (left, top), _, (right, bottom), _ = crop.data["src"][i].int().tolist()
        y = F.resized_crop(x[i], top, left, bottom - top + 1, right - left + 1, [24, 30])
        y = F.horizontal_flip(y) if flip.data["batch_prob"][i] else y
        expected = F.normalize(F.to_dtype(y, torch.float32, True), mean, std)
        assert (result[i] - expected).abs().amax() < 1.01 / 255 / 0.2, i
    assert tv.SameOnBatch([augment])(x[:1].expand(2, -1, -1, -1)).unique(dim=0).shape[0] == 1  # draws once
    assert len(augment._steps([tv.Normalize(mean, std)], x)) == 0  # of bytes, which are refused


def test_samples_of_a_batch_choose_by_themselves() -> None:
    x = torch.zeros(64, 1, 2, 3)
    x[..., 0] = 1
    flips = [tv.RandomHorizontalFlip(1.0), tv.RandomInvert(1.0)]
    flipped, inverted, both = x.flip(-1), 1 - x, 1 - x.flip(-1)
    for t, expected in (
        (tv.RandomChoice(flips), (flipped, inverted)),
        (tv.RandomApply(flips), (x, both)),
        (
            tv.RandomOrder([tv.RandomHorizontalFlip(1.0), tv.Pad([1, 0, 0, 0])]),
            (tv.Pad([1, 0, 0, 0])(flipped), tv.Pad([1, 0, 0, 0])(x).flip(-1)),
        ),
    ):
        result, label = t((x, 3))
        assert label == 3
        first, second = ((result == e).flatten(1).all(1) for e in expected)
        assert (first | second).all() and first.any() and second.any(), t


def test_transforms_of_your_own_see_each_sample() -> None:
    class Less(tv.RandomInvert):
        def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
            return {"mean": flat_inputs[0].mean()}

        def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
            return inpt - params["mean"]

    x = torch.rand(3, 1, 4, 5)
    assert torch.allclose(Less(1.0)(x), x - x.mean((1, 2, 3), keepdim=True))


def test_masks_follow_the_images_of_a_batch() -> None:
    tv_tensors = pytest.importorskip("torchvision.tv_tensors", reason="torchvision is not installed")
    x = torch.stack([photograph(i) for i in range(4)])
    sample = {"image": tv_tensors.Image(x), "mask": tv_tensors.Mask(x[:, 0]), "label": torch.arange(4)}
    torch.manual_seed(0)
    result = tv.RandomHorizontalFlip()(sample)
    assert type(result["mask"]) is tv_tensors.Mask and torch.equal(result["image"][:, 0], result["mask"])
    flipped = [torch.equal(result["mask"][i], x[i, 0].flip(-1)) for i in range(4)]
    assert 0 < sum(flipped) < 4 and result["label"] is sample["label"]


def test_pil_images_come_back_with_the_values_of_tensors() -> None:
    x = photograph()
    image = PIL.Image.fromarray(x.permute(1, 2, 0).numpy())
    for name, args, options in (*MOVES[:18], *COLORS[:14]):
        if name in ("RandomSolarize",):
            args = (100.0,)
        if options.get("interpolation") == "bicubic" or "antialias" in options:
            continue  # PIL always averages, as in v2, and clips between its passes
        outputs = []
        for sample in (image, x):
            torch.manual_seed(1)
            outputs.append(getattr(tv, name)(*args, **options)(sample))
        assert isinstance(outputs[0], PIL.Image.Image)
        values = torch.from_numpy(np.array(outputs[0])).reshape(*outputs[0].size[::-1], -1).permute(2, 0, 1)
        assert not differences(values.contiguous(), outputs[1].contiguous()), name


def test_pil_images_of_palettes_bits_16_bits_and_alpha() -> None:
    """Palettes and bits are moved by nearest pixels, as PIL moves them; color functions change what are colors alone."""
    image = PIL.Image.fromarray(photograph().permute(1, 2, 0).numpy())
    size = [24, 24]
    for mode in ("P", "1", "I;16"):
        stored = image.convert("L").convert("I;16") if mode == "I;16" else image.convert(mode)
        moved = F.pad(F.rotate(F.resize(stored, size), 90, "bilinear"), 2, fill=1)
        method = PIL.Image.Resampling.BILINEAR if mode == "I;16" else PIL.Image.Resampling.NEAREST
        expected = np.asarray(stored.resize(size, method).rotate(90))
        assert moved.mode == mode and moved.getpalette() == stored.getpalette()
        assert np.array_equal(np.asarray(moved)[4:-4, 4:-4], expected[2:-2, 2:-2])
        assert all(view.mode == mode for view in F.five_crop(stored, 9))
        with pytest.raises(
            TypeCheckError, match=f"invert: expected a PIL image of 8-bit or float levels, got mode {mode}"
        ):
            F.invert(stored)
    for mode in ("P", "1"):
        assert F.rgb_to_grayscale(image.convert(mode)).mode == "L"
    alpha = image.convert("L").point(lambda level: 255 - level)
    image.putalpha(alpha)
    for function, arguments in (
        (F.adjust_brightness, (0.5,)),
        (F.adjust_hue, (0.1,)),
        (F.invert, ()),
        (F.equalize, ()),
    ):
        output = function(image, *arguments)
        assert np.array_equal(np.asarray(output)[..., 3], np.asarray(alpha))
        assert output.convert("RGB") == function(image.convert("RGB"), *arguments)
    assert F.rgb_to_grayscale(image) == F.rgb_to_grayscale(image.convert("RGB"))


def test_16_bits_become_a_pil_image_of_16_bits() -> None:
    for dtype in (torch.int16, torch.uint16):
        image = F.to_pil_image(torch.tensor([[[3, 30000]]], dtype=dtype))
        assert image.mode == "I;16" and np.asarray(image).tolist() == [[3, 30000]]


def test_crops_and_flips_leave_the_input() -> None:
    x = photograph()
    kept = x.clone()
    assert F.crop(x, 2, 3, 4, 5).data_ptr() == x[:, 2:, 3:].data_ptr()  # a view, as v2's
    for t in (
        tv.RandomHorizontalFlip(1.0),
        tv.RandomErasing(1.0),
        tv.ColorJitter(0.5, 0.5),
        tv.RandomPerspective(p=1.0),
    ):
        t(x)
        assert torch.equal(x, kept)


def test_gradients_reach_the_image() -> None:
    x = (photograph() / 255.0).double().requires_grad_()
    tv.Compose([tv.RandomResizedCrop(24), tv.RandomRotation(20, "bilinear"), tv.Normalize([0.5] * 3, [0.2] * 3)])(
        x
    ).sum().backward()
    assert x.grad is not None and x.grad.abs().sum() > 0


def test_gradients_of_batches_are_those_of_what_is_kept(device: torch.device) -> None:
    x = torch.ones(4, 3, 9, 9, device=device, requires_grad=True)
    for transform in (tv.RandomErasing(1.0), tv.RandomCrop(5)):
        output = transform(x)
        (grad,) = torch.autograd.grad(output.sum(), x)
        assert set(grad.unique().tolist()) == {0.0, 1.0} and grad.sum() == output.sum()


@pytest.mark.parametrize(
    "make",
    [
        lambda: tv.Resize([1, 2, 3]),
        lambda: tv.RandomHorizontalFlip(p=2),
        lambda: tv.ColorJitter(hue=0.7),
        lambda: tv.RandomRotation(-3),
        lambda: tv.GaussianBlur(4),
        lambda: tv.Pad([1, 2, 3]),
        lambda: tv.JPEG(0),
        lambda: tv.ElasticTransform(interpolation=None),
        lambda: tv.RandAugment(interpolation="cubic"),
        lambda: tv.RandomChoice([tv.Identity()], p=[1, 2]),
        lambda: tv.Compose([]),
        lambda: tv.RandomPosterize(9),
        lambda: tv.SanitizeBoundingBoxes(labels_getter="labels"),
        lambda: F.resize(torch.zeros(3, 4, 4), 3, "cubic"),
        lambda: F.affine(torch.zeros(3, 4, 4), 0, [0, 0], 0, 0),
        lambda: F.normalize(torch.zeros(3, 4, 4), [0.0] * 3, [0.0] * 3),
    ],
)
def test_errors(make: Any) -> None:
    with pytest.raises(ValueError):
        make()
