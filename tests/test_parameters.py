"""Whatever replaces the parameters of a module, its next call uses those that it has by then."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn

import kvision as K

pytestmark = [pytest.mark.interface]

A, E, G = K.augmentation, K.enhance, K.geometry


def parameter(*values: Any) -> nn.Parameter:
    return nn.Parameter(torch.tensor(values))


def image() -> Tensor:
    return torch.rand(2, 3, 8, 8, generator=torch.Generator().manual_seed(1))


def patches() -> Tensor:
    return torch.rand(2, 1, 32, 32, generator=torch.Generator().manual_seed(1))


def volume() -> Tensor:
    return torch.rand(2, 1, 4, 6, 8, generator=torch.Generator().manual_seed(1))


Call = Callable[[Any], Any]
AUGMENTATIONS: list[tuple[Callable[[], nn.Module], Callable[[], Tensor]]] = [
    (lambda: A.RandomAffine(parameter(5.0, 9.0), parameter(0.1, 0.2), parameter(0.8, 0.9), parameter(3.0)), image),
    (lambda: A.RandomRotation(parameter(9.0)), image),
    (lambda: A.RandomShear(parameter(2.0, 3.0)), image),
    (lambda: A.RandomTranslate(parameter(0.1, 0.2), parameter(0.1, 0.3)), image),
    (lambda: A.ColorJitter(parameter(0.5, 0.8), parameter(0.5, 0.8), parameter(0.5, 0.8), parameter(0.1, 0.2)), image),
    (lambda: A.ColorJiggle(parameter(1.1, 1.2), hue=parameter(0.1, 0.2)), image),
    (lambda: A.RandomBrightness(parameter(0.5, 0.6)), image),
    (lambda: A.RandomContrast(parameter(0.5, 0.6)), image),
    (lambda: A.RandomSaturation(parameter(0.5, 0.6)), image),
    (lambda: A.RandomHue(parameter(0.1, 0.2)), image),
    (lambda: A.RandomGamma(parameter(0.5, 0.6), parameter(0.8, 0.9)), image),
    (lambda: A.RandomGaussianBlur(3, parameter(0.5, 0.6)), image),
    (lambda: A.RandomSharpness(parameter(0.5, 0.6)), image),
    (lambda: A.RandomMotionBlur(3, parameter(5.0, 9.0), parameter(0.2, 0.3)), image),
    (lambda: A.RandomGaussianIllumination(parameter(0.2, 0.3)), image),
    (lambda: A.RandomLinearIllumination(parameter(0.2, 0.3)), image),
    (lambda: A.RandomSaltAndPepperNoise(parameter(0.3, 0.4)), image),
    (lambda: A.RandomFisheye(parameter(-0.1, 0.1), parameter(-0.1, 0.1), parameter(0.9, 1.1)), image),
    (lambda: A.RandomMixUpV2(parameter(0.2, 0.3)), image),
    (lambda: A.RandomAffine3D(parameter(5.0, 9.0), scale=parameter(0.8, 0.9)), volume),
    (lambda: A.RandomRotation3D(parameter(5.0, 9.0)), volume),
    (lambda: A.RandomMotionBlur3D(3, parameter(5.0, 9.0), parameter(0.2, 0.3)), volume),
    (lambda: A.ImageSequential(A.RandomRotation(parameter(9.0)), A.RandomGamma(parameter(0.5, 0.6))), image),
    (lambda: A.auto.operations.Rotate(), image),
    (lambda: A.auto.operations.Brightness(), image),
]
GROUP_SIZES: dict[str, tuple[int, ...]] = {"So2": (2,), "So3": (2, 3), "Se2": (2, 3), "Se3": (2, 6)}


def group(name: str) -> nn.Module:
    made: nn.Module = getattr(G.liegroup, name).exp(torch.full(GROUP_SIZES[name], 0.3))
    return made


def of_augmentation(
    make: Callable[[], nn.Module], inputs: Callable[[], Tensor]
) -> tuple[Callable[[], nn.Module], Call]:
    def always() -> nn.Module:
        module = make()
        for child in module.modules():
            if isinstance(child, A.AugmentationBase2D):
                child.p = 1.0
        return module

    return always, lambda module: module(inputs(), seed=3)


# What makes a module of each class with parameters, and a call of it.
MODULES: dict[str, tuple[Callable[[], nn.Module], Call]] = {
    **{f"augmentation {i}": of_augmentation(*made) for i, made in enumerate(AUGMENTATIONS)},
    "AdjustGamma": (lambda: E.AdjustGamma(parameter(0.5)), lambda m: m(image())),
    "AdjustBrightness": (lambda: E.AdjustBrightness(parameter(0.5)), lambda m: m(image())),
    "AdjustContrast": (lambda: E.AdjustContrast(parameter(0.5)), lambda m: m(image())),
    "AdjustHue": (lambda: E.AdjustHue(parameter(0.5)), lambda m: m(image())),
    "AdjustSaturation": (lambda: E.AdjustSaturation(parameter(0.5)), lambda m: m(image())),
    "GaussianBlur2d": (lambda: K.filters.GaussianBlur2d(3, parameter([0.5, 0.6])), lambda m: m(image())),
    "Rotate": (lambda: G.Rotate(parameter(9.0)), lambda m: m(image()[:1])),
    "Translate": (lambda: G.Translate(parameter([1.0, 2.0])), lambda m: m(image()[:1])),
    "Scale": (lambda: G.Scale(parameter([0.8, 0.9])), lambda m: m(image()[:1])),
    "Shear": (lambda: G.Shear(parameter([0.1, 0.2])), lambda m: m(image()[:1])),
    "Affine": (lambda: G.Affine(parameter(9.0)), lambda m: m(image()[:1])),
    "Homography": (G.transform.Homography, lambda m: m()),
    "Similarity": (G.transform.Similarity, lambda m: m()),
    "ImageRegistrator": (lambda: G.ImageRegistrator("similarity"), lambda m: m.model()),
    **{name: (lambda name=name: group(name), lambda m: m.matrix()) for name in GROUP_SIZES},
    "Quaternion": (lambda: G.Quaternion(parameter([0.3, 0.4, 0.5, 0.6])), lambda m: m.matrix()),
    "ParametrizedLine": (lambda: G.ParametrizedLine(torch.ones(3), torch.ones(3)), lambda m: m.point_at(0.5)),
    "Hyperplane": (
        lambda: G.Hyperplane(G.Vector3(torch.ones(3)), G.Scalar(torch.ones(()))),
        lambda m: m.signed_distance(G.Vector3(torch.ones(3))).data,
    ),
    **{
        name: (lambda name=name: getattr(K.feature, name)(pretrained=False).eval(), lambda m: m(patches()))
        for name in ("TFeat", "KeyNet")
    },
}


class Use(nn.Module):
    """A call as `forward`, of a member, as models have it."""

    def __init__(self, member: nn.Module, call: Call) -> None:
        super().__init__()
        self.member, self.call = member, call

    def forward(self) -> Any:
        return self.call(self.member)


def owner_of(module: nn.Module, name: str) -> tuple[nn.Module, str]:
    path, _, last = name.rpartition(".")
    return module.get_submodule(path), last


def moved(x: Tensor) -> Tensor:
    """Other values, which get gradients too, since kernels of those may round in another way."""
    return (1.25 * x.detach() + torch.linspace(0, 0.01, x.numel()).reshape(x.shape)).requires_grad_()


EACH_TIME = ("augmentation 0", "augmentation 4", "augmentation 10", "Similarity", "Se3")


@pytest.mark.parametrize(
    "name", [name if name in EACH_TIME else pytest.param(name, marks=pytest.mark.slow) for name in MODULES]
)
def test_replaced_parameters_are_used(name: str) -> None:
    made, call = MODULES[name]
    torch.manual_seed(0)
    module = Use(made(), call)
    before = module()
    state = {key: moved(x) for key, x in module.named_parameters()}
    assert state
    expected = copy.deepcopy(module)
    expected.load_state_dict(state, strict=False)
    after = expected()
    assert not torch.equal(before, after)

    called = torch.func.functional_call(module, state, ())
    assert torch.equal(called, after)
    assert torch.equal(module(), before)

    assigned = copy.deepcopy(module)
    assigned.load_state_dict(state, strict=False, assign=True)
    assert torch.equal(assigned(), after)

    set_ = copy.deepcopy(module)
    for key, x in state.items():
        owner, last = owner_of(set_, key)
        setattr(owner, last, nn.Parameter(x))
    assert torch.equal(set_(), after)

    overwritten = copy.deepcopy(module)
    keeps = torch.__future__.get_overwrite_module_params_on_conversion()
    torch.__future__.set_overwrite_module_params_on_conversion(True)
    try:
        overwritten.double().float()
    finally:
        torch.__future__.set_overwrite_module_params_on_conversion(keeps)
    with torch.no_grad():
        for key, parameter_of in overwritten.named_parameters():
            parameter_of.copy_(state[key])
    assert torch.equal(overwritten(), after)
