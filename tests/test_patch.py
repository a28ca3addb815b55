"""kvision.patch_kornia: what it replaces in Kornia, that values stay the same, and that it is undone."""

from __future__ import annotations

import contextlib
import doctest
import importlib
import pkgutil
import re
import sys
import time
import urllib.request
import warnings
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision as K
from benchmarks.sample_calls import Size, sample_calls

pytestmark = pytest.mark.interface

kornia = pytest.importorskip("kornia")

SIZE = Size(2, 3, 20, 24)


def namespaces() -> dict[str, dict[str, Any]]:
    return {
        name: dict(vars(module))
        for name, module in sys.modules.items()
        if module and name.partition(".")[0] == "kornia"
    }


def test_patch_replaces_kornia_and_is_undone() -> None:
    before = namespaces()
    with K.patch_kornia() as patch:
        assert kornia.filters.sobel is K.filters.sobel
        assert kornia.filters.spatial_gradient is K.filters.spatial_gradient
        assert sys.modules["kornia.filters.canny"].spatial_gradient is K.filters.spatial_gradient
        assert kornia.losses.SSIMLoss is K.losses.SSIMLoss
        assert kornia.geometry.transform.warp_affine is kornia.geometry.warp_affine is K.geometry.warp_affine
        jiggle = sys.modules["kornia.augmentation._2d.intensity.color_jiggle"]
        assert K.enhance.adjust_contrast in jiggle._STEPS
        assert len(patch.replaced) + len(patch.partly) > 450 and patch.places > 1000
    after = namespaces()
    assert before.keys() == after.keys()
    for name, values in before.items():
        assert values.keys() == after[name].keys()
        changed = [key for key, value in values.items() if after[name][key] is not value]
        assert not changed, name


def test_report_names_remaining_uses_with_reasons() -> None:
    with K.patch_kornia() as patch:
        assert "propagates labels" in patch.left["contrib.connected_components"]
        assert "of its own library" in patch.left["geometry.depth_warp"]
        assert "derive from it" in patch.left["losses.MILossFromRef"]
        assert patch.left["core.ImageModule"] == "has no forward"
        assert patch.partly["geometry.resize"] == "antialias=True"
        assert patch.partly["filters.box_blur"] == "uint8 images"
        names = [*patch.replaced, *patch.partly, *patch.left]
        assert len(names) == len(set(names))
        assert all(name in repr(patch) for name in names)


def test_calls_with_other_results_go_to_kornia() -> None:
    image = torch.rand(1, 3, 16, 16)
    data = (255 * image).to(torch.uint8)
    expected = kornia.geometry.resize(image, 8, antialias=True), kornia.filters.box_blur(data, 3)
    with K.patch_kornia():
        torch.testing.assert_close(kornia.geometry.resize(image, 8, antialias=True), expected[0])
        assert torch.equal(kornia.geometry.resize(image, 8), K.geometry.resize(image, 8))
        assert kornia.filters.box_blur(data, 3).dtype == expected[1].dtype == torch.float32
    with K.patch_kornia(include_different=True) as patch:
        assert not patch.partly
        assert kornia.geometry.resize is K.geometry.resize
        assert kornia.contrib.connected_components is K.contrib.connected_components
        assert kornia.filters.box_blur(data, 3).dtype == torch.uint8


def test_patches_nest_and_end_in_any_order() -> None:
    sobel = kornia.filters.sobel
    first = K.patch_kornia()
    second = K.patch_kornia()
    assert "filters.sobel" in first.replaced and second.places == 0
    second.undo()
    assert kornia.filters.sobel is K.filters.sobel
    first.undo()
    first.undo()
    assert kornia.filters.sobel is sobel


def test_names_imported_meanwhile_are_put_back() -> None:
    name = "kornia.augmentation._2d.intensity.gaussian_blur"
    module = importlib.import_module(name)
    original = module.gaussian_blur2d
    with K.patch_kornia():
        importlib.reload(module)
        assert module.gaussian_blur2d is kornia.filters.gaussian_blur2d is not original
    assert module.gaussian_blur2d is original


def test_a_wrong_argument_is_an_error() -> None:
    with pytest.raises(TypeError, match="^patch_kornia: expected include_different to be a bool, got 'all'"):
        K.patch_kornia("all")


def tensors_of(value: Any) -> list[Tensor]:
    if isinstance(value, Tensor):
        return [value]
    return [tensor for part in value for tensor in tensors_of(part)] if isinstance(value, (list, tuple)) else []


def test_all_functions_give_the_same_values(device) -> None:
    """Every replaced function, called by Kornia's name with the arguments of the sweeps."""
    plain = {}
    calls = [call for call in sample_calls() if call.function(kornia) is not None]
    for call in calls:
        plain[call.name] = tensors_of(call.call(kornia, call.tensors(SIZE, device)))
    differing = []
    with K.patch_kornia():
        for call in calls:
            patched = tensors_of(call.call(kornia, call.tensors(SIZE, device)))
            try:
                assert len(patched) == len(plain[call.name])
                for actual, expected in zip(patched, plain[call.name]):
                    torch.testing.assert_close(actual, expected, rtol=1e-3, atol=1e-4, equal_nan=True)
            except AssertionError as error:
                differing.append(f"{call.name}: {error}")
    assert len(plain) > 380
    assert not differing, "\n".join(differing)


Examples = list[tuple[Any, doctest.DocTest]]

# Networks of Kornia's own that take most of the time of all examples. kvision has none of them.
LARGE_NETWORKS = re.compile(
    r"VisualPrompter|sold2_detector\.SOLD2|DeFMO|SigLip2Model|DeDoDe|DescriptorMatcherWithSteerer|DexiNed|EdgeDetector"
    r"|VisionTransformer|loftr\.LoFTR|Sam\.from_config"
)


def docstring_examples() -> Examples:
    """The examples of Kornia's modules with the module whose names they see, but for the large networks."""
    examples = []
    for result in pkgutil.walk_packages(kornia.__path__, "kornia."):
        with contextlib.suppress(ImportError):  # of packages that Kornia does not require
            module = importlib.import_module(result.name)
            tests = doctest.DocTestFinder().find(module, result.name)
            examples += [(module, test) for test in tests if test.examples and not LARGE_NETWORKS.search(test.name)]
    return examples


class SameNumbers(doctest.OutputChecker):
    """Compares printed numbers as numbers, to three digits, and the text around them without its spaces."""

    number = re.compile(r"[-+]?(?:\d+\.?\d*(?:e[-+]?\d+)?)")

    def check_output(self, want: str, got: str, optionflags: int) -> bool:
        texts = ["".join(self.number.sub("#", text.replace("<BLANKLINE>", "")).split()) for text in (want, got)]
        numbers = [[float(n) for n in self.number.findall(text)] for text in (want, got)]
        return super().check_output(want, got, optionflags) or (
            texts[0] == texts[1] and numbers[1] == pytest.approx(numbers[0], rel=1e-3, abs=1e-3)
        )


class SameValues(SameNumbers):
    """Compares printed tensors without the names of their gradients."""

    def check_output(self, want: str, got: str, optionflags: int) -> bool:
        want, got = (re.sub(r",\s*(grad_fn=<\w+>|requires_grad=True)", "", text) for text in (want, got))
        return super().check_output(want, got, optionflags)


def failures(examples: Examples, checker: type[doctest.OutputChecker] = SameNumbers) -> dict[str, str]:
    """What the examples that fail print, by name."""
    failed = {}
    for module, test in examples:
        torch.manual_seed(0)
        printed: list[str] = []
        runner = doctest.DocTestRunner(checker(), optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
        globs = dict(vars(module)) if isinstance(module, ModuleType) else module
        case = doctest.DocTest(test.examples, globs, test.name, test.filename, test.lineno, test.docstring)
        if runner.run(case, out=printed.append).failed:
            failed[test.name] = "".join(printed)
    return failed


@pytest.fixture(scope="module")
def examples(tmp_path_factory) -> Iterator[tuple[Examples, dict[str, str]]]:
    """Kornia's examples, and which of them fail with Kornia.

    Weights are not downloaded, nor waited for, and files are written into a folder of their own.
    """

    def refuse(*_: Any, **__: Any) -> None:
        raise OSError("these tests download nothing")

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("examples"))
        for name in ("load_state_dict_from_url", "download_url_to_file"):
            patch.setattr(torch.hub, name, refuse)
        patch.setattr(urllib.request, "urlopen", refuse)
        patch.setattr(time, "sleep", lambda _: None)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = docstring_examples()
            yield result, failures(result)


@pytest.mark.slow
def test_examples_of_kornia_pass_patched(examples) -> None:
    """The examples in Kornia's docstrings that pass without the patch; some fail on machines without a network."""
    every, before = examples
    with K.patch_kornia():
        after = failures(every)
    assert sum(len(test.examples) for _, test in every) > 2500 and len(before) < 50
    new = {name: printed for name, printed in after.items() if name not in before}
    assert not new, "\n".join(new.values())


# Examples that print other values where kvision takes Kornia's place, and why. docs/differences.md says more of each.
RANDOM = "random numbers are functions of one key a call"
BORDER = "pixels around an undone crop are 0"
PRINTS = "groups, poses and vectors print their parts in other words"
CONVERGES = "lenses are inverted until they are"
DIFFERENT_EXAMPLES = {
    "kornia.geometry.calibration.undistort.undistort_points": CONVERGES,
    **{
        f"kornia.augmentation.{name}": RANDOM
        for name in (
            "_2d.geometric.affine.RandomAffine",
            "_2d.geometric.perspective.RandomPerspective",
            "_2d.geometric.rotation.RandomRotation",
            "_2d.geometric.shear.RandomShear",
            "_2d.geometric.translate.RandomTranslate",
            "_2d.intensity.brightness.RandomBrightness",
            "_2d.intensity.channel_dropout.RandomChannelDropout",
            "_2d.intensity.channel_shuffle.RandomChannelShuffle",
            "_2d.intensity.color_jiggle.ColorJiggle",
            "_2d.intensity.contrast.RandomContrast",
            "_2d.intensity.erasing.RandomErasing",
            "_2d.intensity.gamma.RandomGamma",
            "_2d.intensity.gaussian_blur.RandomGaussianBlur",
            "_2d.intensity.gaussian_illumination.RandomGaussianIllumination",
            "_2d.intensity.gaussian_noise.RandomGaussianNoise",
            "_2d.intensity.hue.RandomHue",
            "_2d.intensity.motion_blur.RandomMotionBlur",
            "_2d.intensity.planckian_jitter.RandomPlanckianJitter",
            "_2d.intensity.plasma.RandomPlasmaBrightness",
            "_2d.intensity.plasma.RandomPlasmaContrast",
            "_2d.intensity.posterize.RandomPosterize",
            "_2d.intensity.random_rain.RandomRain",
            "_2d.intensity.random_rgb_shift.RandomRGBShift",
            "_2d.intensity.salt_pepper_noise.RandomSaltAndPepperNoise",
            "_2d.intensity.saturation.RandomSaturation",
            "_2d.intensity.sharpness.RandomSharpness",
            "_2d.intensity.solarize.RandomSolarize",
            "_2d.mix.cutmix.RandomCutMixV2",
            "_2d.mix.mixup.RandomMixUpV2",
            "_2d.mix.transplantation.RandomTransplantation",
            "_3d.geometric.affine.RandomAffine3D",
            "_3d.geometric.crop.RandomCrop3D",
            "_3d.geometric.perspective.RandomPerspective3D",
            "_3d.geometric.rotation.RandomRotation3D",
            "_3d.intensity.motion_blur.RandomMotionBlur3D",
            "random_generator._2d.plain_uniform.PlainUniformGenerator",
        )
    },
    **{
        f"kornia.augmentation._2d.geometric.{name}": BORDER
        for name in ("center_crop.CenterCrop", "crop.RandomCrop", "resized_crop.RandomResizedCrop")
    },
    "kornia.contrib.connected_components.connected_components_union_find": "a label is the index of a pixel",
    "kornia.geometry.liegroup.so3.So3": PRINTS,
    **{
        f"kornia.geometry.liegroup.{name}": "rotations are nn.Parameters"
        for name in (
            *("se3.Se3", *(f"se3.Se3.{n}" for n in ("__init__", "exp", "from_matrix", "from_qxyz", "identity"))),
            *(f"so3.So3.{n}" for n in ("__init__", "exp", "from_matrix", "from_wxyz", "identity")),
        )
    },
    **{
        f"kornia.geometry.pose.NamedPose{name}": PRINTS
        for name in ("", ".__mul__", ".from_matrix", ".from_rt", ".inverse")
    },
    **{
        f"kornia.sensors.camera.{name}": PRINTS
        for name in (
            *("camera_model.CameraModelBase.project", "camera_model.CameraModelBase.unproject"),
            *("distortion_model.AffineTransform.distort", "distortion_model.AffineTransform.undistort"),
            *("projection_model.Z1Projection.project", "projection_model.Z1Projection.unproject"),
        )
    },
}


def in_place_of_kornia(module: ModuleType, test: doctest.DocTest) -> tuple[dict[str, Any], doctest.DocTest]:
    """An example after "one changed import": its own imports, and the names it sees in its module, are kvision's."""
    names: dict[str, Any] = {}
    for name, value in vars(module).items():
        home = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None) or ""
        if home.partition(".")[0] != "kornia":
            names[name] = value
        elif isinstance(value, ModuleType):
            with contextlib.suppress(ImportError):
                names[name] = importlib.import_module(home.replace("kornia", "kvision", 1))
        elif (ours := found_in_kvision(name, module.__name__, home)) is not None:
            names[name] = ours
    renamed = []
    for e in test.examples:
        source = re.sub(r"\b(from|import) kornia\b(?!$)", r"\1 kvision", e.source.rstrip("\n"), flags=re.M)
        source = re.sub(r"\bimport kornia$", "import kvision as kornia", source, flags=re.M)
        renamed.append(doctest.Example(source, e.want, e.exc_msg, e.lineno, e.indent, e.options))
    return names, doctest.DocTest(renamed, {}, test.name, test.filename, test.lineno, test.docstring)


def found_in_kvision(name: str, *homes: str) -> Any:
    """The object of that name in the innermost of kvision's packages that correspond to modules of Kornia."""
    for home in homes:
        path = home.split(".")[1:]
        for depth in range(len(path), -1, -1):
            with contextlib.suppress(ImportError):
                package = importlib.import_module(".".join(["kvision", *path[:depth]]))
                if hasattr(package, name):
                    return getattr(package, name)
    return None


LACKING = re.compile(r"NameError: name|has no attribute|No module named 'kvision|cannot import name")


@pytest.mark.slow
def test_examples_of_kornia_pass_with_the_patch(examples) -> None:
    """All that pass with Kornia and use nothing that kvision lacks, but for those of random and of decided differences."""
    every, before = examples
    shared = [(m, test) for m, test in every if hasattr(K, m.__name__.split(".")[1])]  # no models of Kornia's own
    after = failures([in_place_of_kornia(*example) for example in shared], SameValues)
    different = {name: printed for name, printed in after.items() if name not in before and not LACKING.search(printed)}
    assert len(shared) - len(after) > 400
    new = {name: printed for name, printed in different.items() if name not in DIFFERENT_EXAMPLES}
    assert not new, "\n".join(new.values())
    assert set(DIFFERENT_EXAMPLES) <= set(different)


AUGMENTATIONS = {
    "RandomResizedCrop": {"size": (16, 20)},
    "RandomHorizontalFlip": {"p": 1.0},
    "RandomVerticalFlip": {"p": 1.0},
    "ColorJitter": {"brightness": 0.2, "contrast": 0.2, "saturation": 0.2, "hue": 0.1, "p": 1.0},
    "ColorJiggle": {"brightness": 0.2, "contrast": 0.2, "saturation": 0.2, "hue": 0.1, "p": 1.0},
    "RandomAffine": {"degrees": 20.0, "translate": (0.1, 0.1), "scale": (0.9, 1.1), "p": 1.0},
    "RandomPerspective": {"p": 1.0},
    "RandomRotation": {"degrees": 20.0, "p": 1.0},
    "RandomElasticTransform": {"p": 1.0},
    "RandomThinPlateSpline": {"p": 1.0},
    "RandomGaussianBlur": {"kernel_size": (5, 5), "sigma": (0.5, 1.5), "p": 1.0},
    "RandomMotionBlur": {"kernel_size": 5, "angle": 20.0, "direction": 0.5, "p": 1.0},
    "RandomSharpness": {"p": 1.0},
    "RandomGrayscale": {"p": 1.0},
    "RandomGamma": {"p": 1.0},
    "RandomSolarize": {"p": 1.0},
    "RandomPosterize": {"p": 1.0},
    "RandomEqualize": {"p": 1.0},
    "RandomClahe": {"slow_and_differentiable": True, "p": 1.0},
    "RandomErasing": {"p": 1.0},
    "RandomInvert": {"p": 1.0},
    "Normalize": {"mean": torch.tensor([0.4, 0.5, 0.6]), "std": torch.tensor([0.2, 0.3, 0.2])},
    "RandomMosaic": {"output_size": (20, 24), "p": 1.0, "data_keys": ["input"]},
}


@pytest.mark.parametrize("name", AUGMENTATIONS)
def test_a_training_step_of_an_augmentation(name: str, device) -> None:
    """The same loss and the same gradient at the weights before it, patched and not."""
    warnings.simplefilter("ignore")
    images = torch.rand(4, 3, 20, 24, device=device)

    def step() -> tuple[Tensor, Tensor]:
        torch.manual_seed(1)
        augment = getattr(kornia.augmentation, name)(**AUGMENTATIONS[name]).to(device)
        weight = torch.rand(3, 3, 1, 1, device=device).div(3).requires_grad_()
        output = augment(torch.nn.functional.conv2d(images, weight))
        loss = kornia.losses.ssim_loss(output, torch.zeros_like(output), 5) + output.square().mean()
        loss.backward()
        return loss.detach(), weight.grad

    expected = step()
    with K.patch_kornia():
        actual = step()
    for a, e in zip(actual, expected, strict=True):
        if a is None or e is None:
            assert a is e
        else:
            torch.testing.assert_close(a, e, rtol=1e-3, atol=1e-4)


def test_a_pipeline_of_augmentations(device) -> None:
    augment = kornia.augmentation.AugmentationSequential(
        kornia.augmentation.RandomResizedCrop((16, 20)),
        kornia.augmentation.RandomHorizontalFlip(),
        kornia.augmentation.ColorJitter(0.2, 0.2, 0.2, 0.1),
        kornia.augmentation.Normalize(torch.tensor(0.4), torch.tensor(0.2)),
        data_keys=["input", "mask"],
    )
    images, masks = torch.rand(4, 3, 20, 24, device=device), torch.ones(4, 1, 20, 24, device=device)
    results = []
    for context in (contextlib.nullcontext, K.patch_kornia):
        with context():
            torch.manual_seed(0)
            results.append(augment(images, masks))
    for actual, expected in zip(*results):
        torch.testing.assert_close(actual, expected, rtol=1e-3, atol=1e-4)
