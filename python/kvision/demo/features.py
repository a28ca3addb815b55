"""The sheet of the feature module: key points, and matches of a photo with another view of it."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import feature, geometry
from kvision.demo.sheet import Image, Sheet, Step

KEY_POINTS, SHOWN_KEY_POINTS = 500, 60  # found in a photo, and drawn
SHOWN_MATCHES = 60
CLOSE = 3.0  # pixels within which a match is right
FRAME, RIGHT, WRONG = (255, 214, 10), (64, 200, 90), (230, 60, 60)
LARGER = 3  # photos are drawn this much larger and reduced again, for smooth lines


class KeyPoints(NamedTuple):
    """Photos (B, 3, H, W) with frames (B, N, 2, 3), strongest first, and descriptors (B, N, 128)."""

    photos: Tensor
    lafs: Tensor
    descriptors: Tensor


class Matches(NamedTuple):
    """Key points of photos and of other views of them, pairs (M, 3) of image and both indices, and which are right."""

    photos: KeyPoints
    views: KeyPoints
    pairs: Tensor
    is_right: Tensor


def key_points(photos: Tensor) -> KeyPoints:
    sift = feature.SIFTFeature(KEY_POINTS, device=photos.device)
    lafs, _, descriptors = sift(photos)
    return KeyPoints(photos, lafs, descriptors)


def key_points_opencv(image: Image) -> object:
    gray = cv2.cvtColor((255 * image).round().astype(np.uint8), cv2.COLOR_RGB2GRAY)
    return cv2.SIFT.create(KEY_POINTS).detectAndCompute(gray, None)


def another_view(photos: Tensor) -> tuple[Tensor, Tensor]:
    """The photos turned by 25 degrees, at 0.8 of their size, in perspective and darker; and the homography."""
    height, width = photos.shape[2:]
    center = photos.new_tensor([[(width - 1) / 2, (height - 1) / 2]])
    rotation = geometry.get_rotation_matrix2d(center, photos.new_tensor([25.0]), photos.new_tensor([[0.8, 0.8]]))
    homography = F.pad(rotation, (0, 0, 0, 1))
    homography[:, 2] = photos.new_tensor([2e-4, -3e-4, 1])
    matrices = homography.expand(len(photos), -1, -1)
    return 0.75 * geometry.warp_perspective(photos, matrices, (height, width)), homography


def matches(photos: Tensor) -> Matches:
    views, homography = another_view(photos)
    both = key_points(torch.cat([photos, views]))
    first, second = (KeyPoints(*parts) for parts in zip(*(x.chunk(2) for x in both)))
    masks = [feature.laf_is_filled(x.lafs) for x in (first, second)]
    _, pairs = feature.match_smnn_batched(first.descriptors, second.descriptors, 0.9, mask1=masks[0], mask2=masks[1])
    x, y = (feature.get_laf_center(k.lafs)[pairs[:, 0], pairs[:, i]] for i, k in ((1, first), (2, second)))
    moved = geometry.transform_points(homography, x[None])[0]
    return Matches(first, second, pairs, (moved - y).norm(dim=1) <= CLOSE)


# --- images -------------------------------------------------------------------------------------------------------


def enlarged(photo: Tensor) -> Image:
    """(3, H, W) in [0, 1] as bytes (LARGER H, LARGER W, 3)."""
    image = (255 * photo.permute(1, 2, 0).clamp(0, 1)).round().byte().cpu().numpy()
    return cv2.resize(image, None, fx=LARGER, fy=LARGER, interpolation=cv2.INTER_CUBIC)


def reduced(image: Image) -> Tensor:
    height, width = (side // LARGER for side in image.shape[:2])
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return torch.from_numpy(small).permute(2, 0, 1) / 255


def at(points: Tensor) -> Image:
    """Pixels of an enlarged image."""
    return (((points.cpu() + 0.5) * LARGER - 0.5).round()).to(torch.int32).numpy()


def draw_key_points(detected: KeyPoints) -> Tensor:
    """The frames of the strongest key points as circles, with a line from the center along their orientation."""
    pictures = []
    for photo, lafs in zip(detected.photos, detected.lafs):
        image = enlarged(photo)
        lafs = lafs[None, :SHOWN_KEY_POINTS]
        lafs = lafs[:, feature.laf_is_filled(lafs)[0]]
        circles = at(feature.laf_to_boundary_points(feature.scale_laf(lafs, 0.5))[0])
        cv2.polylines(image, list(circles), True, (0, 0, 0), 2 * LARGER, cv2.LINE_AA)
        cv2.polylines(image, list(circles), True, FRAME, LARGER, cv2.LINE_AA)
        pictures.append(reduced(image))
    return torch.stack(pictures)


def draw_matches(matched: Matches) -> Tensor:
    """Photos and views side by side with lines between matches, of which those off by more than CLOSE are red."""
    pictures = []
    for i, (photo, view) in enumerate(zip(matched.photos.photos, matched.views.photos)):
        image = np.concatenate([enlarged(photo), enlarged(view)], 1)
        of_photo = (matched.pairs[:, 0] == i).nonzero()[:, 0]
        of_photo = of_photo[:: max(1, -(-len(of_photo) // SHOWN_MATCHES))]
        pairs, is_right = matched.pairs[of_photo], matched.is_right[of_photo].tolist()
        x = at(feature.get_laf_center(matched.photos.lafs)[i, pairs[:, 1]])
        y = at(feature.get_laf_center(matched.views.lafs)[i, pairs[:, 2]])
        y[:, 0] += LARGER * photo.shape[2]
        for start, end, right in sorted(zip(x.tolist(), y.tolist(), is_right), key=lambda line: not line[2]):
            color = RIGHT if right else WRONG
            cv2.line(image, start, end, color, LARGER, cv2.LINE_AA)
            for point in (start, end):
                cv2.circle(image, point, 2 * LARGER, color, -1, cv2.LINE_AA)
        pictures.append(reduced(image))
    return torch.stack(pictures)


SHEET = Sheet(
    "Features",
    [
        Step(
            "key points",
            "SIFTFeature(500)(x): the 60 strongest, with size and orientation",
            key_points,
            key_points_opencv,
            draw_key_points,
        ),
        Step(
            "matches", "match_smnn_batched(descriptors, others, 0.9): right ones are green", matches, show=draw_matches
        ),
    ],
)
