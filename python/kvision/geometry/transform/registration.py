"""Registration: the geometric transform between two images, by gradient descent on their difference."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeAlias

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from kvision import _check
from kvision._choices import Distance
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.geometry.conversions.angles import cos_sin
from kvision.geometry.conversions.homogeneous import homogeneous
from kvision.geometry.linalg import adjugate
from kvision.geometry.transform import matrices
from kvision.geometry.transform.homography_warper import BaseWarper, HomographyWarper
from kvision.geometry.transform.photometric import photometric_homography_loss
from kvision.geometry.transform.pyramid import build_pyramid
from kvision.geometry.transform.resize import resize

__all__ = ["BaseModel", "Homography", "ImageRegistrator", "Similarity"]

_FUSED: dict[Any, Distance] = {F.l1_loss: "l1", F.mse_loss: "l2"}  # losses with a fused photometric_homography_loss
_LOOK_EVERY = 10  # iterations between two reads of the loss; a read waits for the device


class BaseModel(nn.Module):
    """Base class of the transforms that :class:`ImageRegistrator` learns.

    Subclasses define `forward()`, which returns the transform, `forward_inverse()`, which returns its inverse, and
    `reset_model()`.

    Example:
        >>> import kvision as K
        >>> issubclass(K.geometry.Homography, K.geometry.BaseModel)
        True
    """

    def reset_model(self) -> None:
        """Reset the transform to the identity."""
        raise NotImplementedError(f"{type(self).__name__}: reset_model is for subclasses to define")

    def forward(self) -> Tensor:
        raise NotImplementedError(f"{type(self).__name__}: forward is for subclasses to define")

    def forward_inverse(self) -> Tensor:
        """The inverse transform."""
        raise NotImplementedError(f"{type(self).__name__}: forward_inverse is for subclasses to define")


class Homography(BaseModel):
    """A homography (1, 3, 3) whose nine entries are learned.

    Example:
        >>> import kvision as K
        >>> K.geometry.Homography()()[0, 0]
        tensor([1., 0., 0.], grad_fn=<SelectBackward0>)
    """

    def __init__(self) -> None:
        super().__init__()
        self.model = nn.Parameter(torch.eye(3))

    def reset_model(self) -> None:
        """Reset the transform to the identity."""
        nn.init.eye_(self.model)

    def forward(self) -> Tensor:
        """(1, 3, 3), with a last entry of 1."""
        return (self.model / self.model[2, 2])[None]

    def forward_inverse(self) -> Tensor:
        """(1, 3, 3), with a last entry of 1."""
        inverse = adjugate(self.model)
        return (inverse / inverse[2, 2])[None]


class Similarity(BaseModel):
    """A rotation, a scale and a translation, each of which is learned or constant.

    Args:
        rotation: learn the angle `rot`, in degrees.
        scale: learn `scale`.
        shift: learn `shift`, in coordinates from -1 to 1.

    Example:
        >>> import kvision as K
        >>> [name for name, _ in K.geometry.Similarity(rotation=False).named_parameters()]
        ['scale', 'shift']
    """

    rot: Tensor
    scale: Tensor
    shift: Tensor

    def __init__(self, rotation: bool = True, scale: bool = True, shift: bool = True) -> None:
        super().__init__()
        self._ratio = 1.0
        starts = {"rot": torch.zeros(1), "scale": torch.ones(1), "shift": torch.zeros(1, 2, 1)}
        for (name, start), learned in zip(starts.items(), (rotation, scale, shift)):
            _check.flag("Similarity", name, learned)
            if learned:
                self.register_parameter(name, nn.Parameter(start))
            else:
                self.register_buffer(name, start)

    def reset_model(self) -> None:
        """Reset the transform to the identity."""
        nn.init.zeros_(self.rot)
        nn.init.ones_(self.scale)
        nn.init.zeros_(self.shift)

    def set_image_shape(self, height: int, width: int) -> None:
        """Rotate in pixels, not in the square [-1, 1] x [-1, 1]; :class:`ImageRegistrator` calls this."""
        self._ratio = height / width

    def forward(self) -> Tensor:
        """(1, 3, 3)"""
        c, s = cos_sin(self.rot)
        linear = matrices.matrix_of([[c, s * self._ratio], [-s / self._ratio, c]], self.rot) * self.scale
        return homogeneous(torch.cat([linear, self.shift], -1))

    def forward_inverse(self) -> Tensor:
        """(1, 3, 3)"""
        inverse = adjugate(self())
        return inverse / inverse[:, 2:, 2:]


ModelType: TypeAlias = Literal["homography", "similarity", "translation", "scale", "rotation"]
_MODELS: dict[str, Callable[[], BaseModel]] = {
    "homography": Homography,
    "similarity": Similarity,
    "translation": lambda: Similarity(False, False, True),
    "scale": lambda: Similarity(False, True, False),
    "rotation": lambda: Similarity(True, False, False),
}


class ImageRegistrator(nn.Module):
    """Register two images: gradient descent on their difference, from the coarsest level of a pyramid to the finest.

    Args:
        model_type: 'homography', 'similarity', 'translation', 'scale', 'rotation', or a :class:`BaseModel`.
        optimizer: class of the optimizer, constructed as `optimizer(parameters, lr=lr)`.
        loss_fn: called as `loss_fn(warped, image, reduction="none")`.
        pyramid_levels: number of levels of the pyramid.
        lr: learning rate of the optimizer.
        num_iterations: maximum number of iterations on each level.
        tolerance: a level ends when the loss changes by less from one iteration to the next. It is compared every tenth
            iteration, because that waits for the device; 0 never compares.
        warper: class of the warpers, constructed as `warper(height, width)`; required when `model_type` is a
            :class:`BaseModel`.
        allow_shape_mismatch: resize the first image to the size of the second one.

    Example:
        >>> import torch, kvision as K
        >>> y, x = torch.meshgrid(torch.linspace(-1, 1, 48), torch.linspace(-1, 1, 48), indexing="ij")
        >>> blob = lambda dx: torch.exp(-6 * ((x - dx) ** 2 + y**2))[None, None]
        >>> registrator = K.geometry.ImageRegistrator("translation", pyramid_levels=2, lr=0.02, tolerance=0.0)
        >>> homography = registrator.register(blob(0.1), blob(0.0))
        >>> bool((homography[0, 0, 2] - 0.1).abs() < 0.01)
        True
    """

    def __init__(
        self,
        model_type: ModelType | BaseModel = "homography",
        optimizer: type[torch.optim.Optimizer] = torch.optim.Adam,
        loss_fn: Callable[..., Tensor] = F.l1_loss,
        pyramid_levels: int = 5,
        lr: float = 1e-3,
        num_iterations: int = 100,
        tolerance: float = 1e-4,
        warper: type[BaseWarper] | None = None,
        allow_shape_mismatch: bool = False,
    ) -> None:
        super().__init__()
        if isinstance(model_type, str):
            _check.choice("ImageRegistrator", "model_type", model_type.lower(), tuple(_MODELS))
            model_type = _MODELS[model_type.lower()]()
        elif warper is None:
            raise ValueCheckError("ImageRegistrator: expected a warper for a model class of the caller, got None")
        self.model = model_type
        self.warper: Callable[[int, int], Any] = warper or HomographyWarper
        self._distance = _FUSED.get(loss_fn) if self.warper is HomographyWarper else None
        self.optimizer = optimizer
        self.loss_fn = loss_fn
        self.pyramid_levels = pyramid_levels
        self.lr = lr
        self.num_iterations = num_iterations
        self.tolerance = tolerance
        self.allow_shape_mismatch = allow_shape_mismatch

    def reset_model(self) -> None:
        """Reset the transform to the identity."""
        self.model.reset_model()

    def get_single_level_loss(self, img_src: Tensor, img_dst: Tensor, transform_model: Tensor) -> Tensor:
        """The mean loss of `img_src`, warped, against `img_dst`, over the pixels that the warped image covers."""
        if img_src.shape != img_dst.shape:
            raise ShapeError(
                f"ImageRegistrator: expected images of one shape, got {tuple(img_src.shape)} and {tuple(img_dst.shape)}"
            )
        if self._distance is not None:
            return photometric_homography_loss(img_src, img_dst, transform_model, self._distance).mean()
        warper = self.warper(*img_dst.shape[-2:])
        loss = self.loss_fn(warper(img_src, transform_model), img_dst, reduction="none")
        with torch.no_grad():
            inside = (warper(torch.ones_like(img_src[:, :1]), transform_model) > 0.9).to(loss.dtype).expand_as(loss)
        return (loss * inside).sum() / inside.sum().clamp_min(1)

    def register(
        self, src_img: Tensor, dst_img: Tensor, verbose: bool = False, output_intermediate_models: bool = False
    ) -> Any:
        """The transform from coordinates in `dst_img` to coordinates in `src_img`, from -1 to 1.

        Args:
            src_img: (B, C, H, W).
            dst_img: of the same shape, unless `allow_shape_mismatch`.
            verbose: print the loss every tenth iteration.
            output_intermediate_models: also return the transform after each level.

        Returns:
            The model's transform, (1, 3, 3), and with `output_intermediate_models` a list of these.
        """
        op = "ImageRegistrator"
        _check.images(op, "src_img", src_img)
        _check.images(op, "dst_img", dst_img)
        if src_img.shape != dst_img.shape:
            if not self.allow_shape_mismatch or src_img.shape[:2] != dst_img.shape[:2]:
                raise ShapeError(
                    f"{op}: expected images of one shape, got {tuple(src_img.shape)} and {tuple(dst_img.shape)}; "
                    "allow_shape_mismatch resizes the first"
                )
            src_img = resize(src_img, (dst_img.shape[2], dst_img.shape[3]))
        self.reset_model()
        if isinstance(self.model, Similarity):
            self.model.set_image_shape(*dst_img.shape[-2:])
        optimizer = self.optimizer(self.model.parameters(), lr=self.lr)  # type: ignore[call-arg]
        pyramids = (build_pyramid(image, self.pyramid_levels) for image in (src_img, dst_img))
        after_levels = []
        for source, target in reversed(list(zip(*pyramids))):
            self._descend(source, target, optimizer, verbose)
            after_levels.append(self.model().detach().clone())
        return (self.model(), after_levels) if output_intermediate_models else self.model()

    def _descend(self, source: Tensor, target: Tensor, optimizer: torch.optim.Optimizer, verbose: bool) -> None:
        before = None
        for i in range(self.num_iterations):
            optimizer.zero_grad()
            loss = self.get_single_level_loss(source, target, self.model())
            loss = loss + self.get_single_level_loss(target, source, self.model.forward_inverse())
            if before is not None and self.tolerance > 0 and i % _LOOK_EVERY == 0:
                if bool((loss.detach() - before).abs() < self.tolerance):
                    return
            before = loss.detach()
            if verbose and i % _LOOK_EVERY == 0:
                print(f"loss {float(before):.4f} at iteration {i}")
            loss.backward()
            optimizer.step()

    def warp_src_into_dst(self, src_img: Tensor) -> Tensor:
        """`src_img` warped to the coordinates of the second image."""
        return self.warper(*src_img.shape[-2:])(src_img, self.model())

    def warp_dst_into_src(self, dst_img: Tensor) -> Tensor:
        """`dst_img` warped to the coordinates of the first image."""
        return self.warper(*dst_img.shape[-2:])(dst_img, self.model.forward_inverse())
