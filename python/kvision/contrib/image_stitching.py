"""Panoramas of overlapping images."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import compute_dtype, floats
from kvision.color import rgb_to_grayscale
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.geometry import RANSAC, find_homography_dlt_iterated
from kvision.geometry.transform import warp_perspective

Estimator: TypeAlias = Literal["ransac", "vanilla"]
_ESTIMATORS = get_args(Estimator)
Blending: TypeAlias = Literal["naive"]
_BLENDINGS = get_args(Blending)


class ImageStitcher(nn.Module):
    """Stitch overlapping images, from left to right, by homographies between the key points of a matcher.

    Args:
        matcher: a module that takes {"image0", "image1"}, two gray images (B, 1, H, W), and returns a dict with
            "keypoints0" and "keypoints1" (N, 2) as (x, y) in pixels, in corresponding rows, and "batch_indexes" (N,):
            the samples they are of.
        estimator: 'ransac', or 'vanilla' for a direct linear transformation, iterated, of all matches.
        blending_method: 'naive': the image on the right hides the one on the left.

    Its call takes two or more images (B, C, H, W), C being 1 or 3, and returns (B, C, H, W'): columns on the right that
    no image reaches are cut off, which waits for the device. The gradient goes to the pixels, not through the homographies.

    Raises:
        TypeCheckError: images that are not tensors, a matcher that is not a module.
        ShapeError: images that are not (B, C, H, W), or differ in B, C or H.
        ValueCheckError: another estimator or blending_method, which is a NotImplementedError, too; less than two images.
        RuntimeError: fewer than four matches in a sample.

    Source: M. Brown, D. Lowe, "Automatic panoramic image stitching using invariant features" (2007).

    Example:
        >>> import torch, kvision as K
        >>> class Shifted(torch.nn.Module):
        ...     def forward(self, data):
        ...         points = torch.tensor([[0.0, 0.0], [3.0, 0.0], [0.0, 5.0], [3.0, 5.0], [1.0, 2.0]])
        ...         moved = points + torch.tensor([4.0, 0.0])
        ...         return {"keypoints0": moved, "keypoints1": points, "batch_indexes": torch.zeros(5, dtype=torch.int64)}
        >>> scene = torch.rand(1, 3, 6, 12)
        >>> stitcher = K.contrib.ImageStitcher(Shifted(), estimator="vanilla")
        >>> stitcher(scene[..., :8], scene[..., 4:]).shape
        torch.Size([1, 3, 6, 12])
    """

    def __init__(
        self, matcher: nn.Module, estimator: Estimator = "ransac", blending_method: Blending = "naive"
    ) -> None:
        super().__init__()
        if not isinstance(matcher, nn.Module):
            raise TypeCheckError(
                f"ImageStitcher: expected matcher to be a Module, got {type(matcher).__name__}",
                actual_type=type(matcher),
            )
        _check.choice("ImageStitcher", "estimator", estimator, _ESTIMATORS, _check.UnknownChoiceError)
        _check.choice("ImageStitcher", "blending_method", blending_method, _BLENDINGS, _check.UnknownChoiceError)
        self.matcher = matcher
        self.estimator = estimator
        self.blending_method = blending_method
        self.ransac = RANSAC("homography") if estimator == "ransac" else None

    def preprocess(self, image_1: Tensor, image_2: Tensor) -> dict[str, Tensor]:
        """The input of the matcher for two images."""

        def gray(x: Tensor) -> Tensor:
            return rgb_to_grayscale(x) if x.shape[1] == 3 else x

        return {"image0": gray(image_1), "image1": gray(image_2)}

    def on_matcher(self, data: dict[str, Tensor]) -> dict[str, Tensor]:
        """Run the matcher."""
        return self.matcher(data)

    def estimate_transform(self, batch_size: int | None = None, **matches: Tensor) -> Tensor:
        """The homographies (B, 3, 3) that take keypoints1 to keypoints0, sample by sample."""
        samples = matches["batch_indexes"]
        if batch_size is None:
            batch_size = int(samples.max()) + 1 if len(samples) else 0
        homographies = []
        for b in range(batch_size):
            left, right = (matches[name][samples == b] for name in ("keypoints0", "keypoints1"))
            if len(left) < 4:
                raise RuntimeError(f"ImageStitcher: expected at least 4 matches in sample {b}, got {len(left)}")
            if self.ransac is not None:
                homographies.append(self.ransac(right, left)[0])
            else:
                weights = torch.ones_like(left[None, :, 0])
                homographies.append(find_homography_dlt_iterated(right[None], left[None], weights)[0])
        return torch.stack(homographies)

    def blend_image(self, src_img: Tensor, dst_img: Tensor, mask: Tensor) -> Tensor:
        """src_img where the mask is not 0, dst_img elsewhere."""
        return torch.where(mask != 0, src_img, dst_img)

    def stitch_pair(
        self,
        images_left: Tensor,
        images_right: Tensor,
        mask_left: Tensor | None = None,
        mask_right: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """The image on the right in the frame of the one on the left, with that one, and where there is a pixel."""
        b, _, h, w = images_left.shape
        if images_right.shape[:3] != images_left.shape[:3]:
            raise ShapeError(
                f"ImageStitcher: expected images of one B, C, H, got {tuple(images_left.shape)} and "
                f"{tuple(images_right.shape)}",
                actual_shape=images_right.shape,
            )
        width = w + images_right.shape[3]
        with torch.no_grad():
            matches = self.on_matcher(self.preprocess(images_left, images_right))
            homographies = self.estimate_transform(b, **matches).to(compute_dtype(images_left))
        mask_left = torch.ones_like(images_left[:, :1]) if mask_left is None else mask_left[:, :1]
        mask_right = torch.ones_like(images_right[:, :1]) if mask_right is None else mask_right[:, :1]
        # Beyond its edge an image goes on: zeros would darken the seam.
        warped = warp_perspective(images_right, homographies, (h, width), padding_mode="border")
        inside = warp_perspective(mask_right, homographies, (h, width), mode="nearest")
        extension = images_left.new_zeros(*images_left.shape[:3], width - w)
        left, mask_left = torch.cat([images_left, extension], 3), torch.cat([mask_left, extension[:, :1]], 3)
        return self.blend_image(warped, left, inside), torch.maximum(inside, mask_left)

    def postprocess(self, image: Tensor, mask: Tensor) -> Tensor:
        """The image up to the last column that the mask has a pixel in."""
        used = (mask != 0).flatten(0, 2).any(0).nonzero()
        return image[..., : int(used[-1]) + 1] if len(used) else image

    def forward(self, *imgs: Tensor) -> Tensor:
        if len(imgs) < 2:
            raise ValueCheckError(f"ImageStitcher: expected at least two images, got {len(imgs)}")
        for i, x in enumerate(imgs):
            _check.images("ImageStitcher", f"imgs[{i}]", x)
        panorama = floats(imgs[0])
        mask = torch.ones_like(panorama[:, :1])
        for x in imgs[1:]:
            panorama, mask = self.stitch_pair(panorama, floats(x), mask)
        return self.postprocess(panorama, mask)
