"""How boxes and points follow the stages of a call.

Through matrices they move stage by stage. A map says where a result reads the image, and not where the image is in the result:
it may fold, so that a pixel of the image is in several positions. So if there are maps among the stages, the pixels of the last
result are traced back through all of them: `preimages` finds the positions that read a point, or the inside of a box.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._constants import on_device
from kvision.augmentation.engine.lists import OnList, SizeOfEach
from kvision.augmentation.engine.stages import Chain, Stage
from kvision.augmentation.labels import (
    around_outlines,
    clip_polygons,
    is_within,
    line_corners,
    outward_normals,
    polygon_area,
    rectangle_around,
)
from kvision.augmentation.maps import vector
from kvision.augmentation.preimages.result_map import EXACT, ResultMap, at_nodes, result_map
from kvision.augmentation.preimages.result_map_list import NodeReading, ResultMapList, result_map_list
from kvision.augmentation.samples import where_chosen

_SIDE = 16  # points on each side of a box that moves through what bends its sides
_REACH = 4  # sizes of images around a result in which boxes and points outside are found


class LabelMoves:
    """Moves of boxes and points (B, ...) through the stages of a call.

    Args:
        stages: the stages.
        size: height and width of the results, of a list (B, 1) of each; depth, height and width of volumes.
        clips: boxes end at the edges of the image after each stage.

    Samples that have not been through a stage yet are as they were given: nothing of theirs has left the image.
    """

    def __init__(self, stages: Chain, size: Sequence[Any], clips: bool = False) -> None:
        self.chain, self.size, self.clips = Chain(stages.flat()), size, clips
        self.stages = self.chain.stages
        self._map: ResultMap | ResultMapList | None = None
        self._has_maps = bool(self.chain.maps())

    # --- points ---

    def move_points(self, points: Tensor) -> tuple[Tensor, Tensor | None]:
        """Points (B, N, 2 or 3) of results, and which are visible, bool (B, N); None for those that `are_visible` tells."""
        if not self._has_maps:
            return self.chain.move_points(points), None
        known = self._result_map(points)
        positions, kinds = known.positions(points.detach().to(known.coordinates))
        moved = self._refined(points, positions.to(points), kinds == EXACT)
        by_matrices = self.chain.move_points(points)
        is_mapped = self._is_mapped()
        visible = where_chosen(is_mapped, kinds > 0, self.are_visible(by_matrices) if is_mapped is not None else False)
        return where_chosen(is_mapped, moved, by_matrices), visible

    def are_visible(self, moved: Tensor) -> Tensor:
        """Which moved points (B, N, 2 or 3) are in the results, and were in those before: bool (B, N).

        Those of samples that no stage has moved are.
        """
        visible = where_chosen(_members(moved, self.stages), is_within(moved, self.size), True)
        for i, stage in reversed(list(enumerate(self.stages))):
            moved = stage.move_points_back(moved)
            if i > 0 and (size := stage.source_size()) is not None:
                members = _members(moved, self.stages[:i], stage)
                visible = visible & where_chosen(members, is_within(moved, size), True)
        return visible

    @property
    def concerns_all(self) -> bool:
        """Whether all samples have been through a stage."""
        return any(stage.members() is None for stage in self.stages)

    def _refined(self, points: Tensor, positions: Tensor, is_exact: Tensor) -> Tensor:
        """Positions after a step of Newton's method, by which they have gradients and follow what is between nodes."""
        step_x, step_y = vector(positions, 0.5, 0.0), vector(positions, 0.0, 0.5)
        around = [positions, positions + step_x, positions - step_x, positions + step_y, positions - step_y]
        at, right, left, below, above = self.chain.move_points_back(torch.cat(around, 1)).chunk(5, 1)
        along, down = (right - left).detach(), (below - above).detach()
        miss = points - at
        determinant = along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0]
        step = torch.stack(
            [
                miss[..., 0] * down[..., 1] - miss[..., 1] * down[..., 0],
                miss[..., 1] * along[..., 0] - miss[..., 0] * along[..., 1],
            ],
            -1,
        )
        is_small = is_exact & (step.detach().abs().amax(-1) < 0.25 * determinant.abs())
        step = step / torch.where(is_small, determinant, 1.0)[..., None]
        return positions + torch.where(is_small[..., None], step, 0.0)

    # --- boxes ---

    def move_boxes(self, corners: Tensor, is_upright: bool) -> tuple[Tensor, Tensor | None]:
        """The corners (B, N, 4, 2) of moved boxes, and the visible fractions of their areas (B, N), None where not computed.

        Upright boxes are the smallest ones around what they contained. The sides of others are parallel to the lines between
        their moved corners, and outside of what they contained.
        """
        if not self._has_maps:
            return self._clipped(corners) if self.clips else (self._moved_outlines(corners, is_upright), None)
        known = self._result_map(corners)
        quads = corners.detach().to(known.coordinates)
        normals = vector(quads, 0, -1, 1, 0, 0, 1, -1, 0).reshape(4, 2)  # of top, right, bottom and left
        if not is_upright:
            outward, is_convex = outward_normals(self.move_points(quads.flatten(1, 2))[0].reshape(quads.shape))
            normals = torch.where(is_convex[..., None, None], outward, normals)
        shown, whole = known.extents(quads, normals).unbind(2)
        is_shown, is_known = shown[..., 0].isfinite(), whole[..., 0].isfinite()
        by_matrices = self._moved_outlines(corners, is_upright)
        by_matrices = rectangle_around(by_matrices) if is_upright else by_matrices
        by_matrices, of_matrices = self._clipped_without_map(corners, by_matrices)
        whole = line_corners(normals, whole, by_matrices.to(quads))
        moved = torch.where(is_shown[..., None, None], line_corners(normals, shown, whole), whole)
        fraction = torch.where(is_shown, polygon_area(moved) / polygon_area(whole).clamp(min=1e-9), 0.0).clamp(max=1)
        moved = torch.where(is_known[..., None, None], moved.to(corners), by_matrices)
        is_mapped = self._is_mapped()
        return where_chosen(is_mapped, moved, by_matrices), where_chosen(is_mapped, fraction, of_matrices)

    def _moved_outlines(self, corners: Tensor, is_upright: bool) -> Tensor:
        """Points of boxes, as `_around_outlines` gives them, moved by all but maps."""
        count = 1 if self._has_maps or self.chain.keeps_lines else _SIDE
        return around_outlines(corners, is_upright, count, self.chain.move_points)

    def _clipped(self, corners: Tensor) -> tuple[Tensor, Tensor]:
        """Rectangles around boxes whose parts outside of the image are cut off after each stage."""
        polygons, fraction = corners, torch.ones_like(corners[..., 0, 0])
        for i, stage in enumerate(self.stages):
            polygons = stage.move_points(polygons.flatten(1, 2)).reshape(polygons.shape)
            is_last = i == len(self.stages) - 1
            size = stage.result_size() or (self.size if is_last else self.stages[i + 1].source_size())
            if size is not None:
                whole, members = polygon_area(polygons), _members(polygons, [stage])
                clipped, is_inside = clip_polygons(polygons, size)
                part = torch.where(is_inside, (polygon_area(clipped) / whole).nan_to_num(1.0), 0.0)
                fraction = fraction * where_chosen(members, part, 1.0)
                if members is not None:  # as many vertices in all images
                    first = polygons[..., :1, :].expand(*polygons.shape[:-2], clipped.shape[-2] - polygons.shape[-2], 2)
                    clipped = where_chosen(members, clipped, torch.cat([polygons, first], -2))
                polygons = clipped
        moved = where_chosen(_members(polygons, self.stages), rectangle_around(polygons), corners)
        return moved, fraction.clamp(max=1)

    def _clipped_without_map(self, corners: Tensor, moved: Tensor) -> tuple[Tensor, Any]:
        """Boxes that no map moves, and their visible fractions: of images of a list that went through none they are cut off."""
        through = [stage for stage in self.stages if isinstance(stage, OnList) and stage.maps()] if self.clips else []
        has_map = _members(moved, through) if through else None
        if has_map is None:
            return moved, 1.0
        clipped, fraction = self._clipped(corners)
        return where_chosen(has_map, moved, clipped), where_chosen(has_map, torch.ones_like(fraction), fraction)

    # --- maps ---

    def forget_map(self) -> None:
        """Free what is as large as the images. It can be computed again."""
        self._map = None

    def _result_map(self, like: Tensor) -> ResultMap | ResultMapList:
        """Where the results read the images, in float32."""
        if self._map is None or self._map.coordinates.device != like.device:
            float_like = like.new_empty(0, dtype=torch.float32)
            if isinstance(self.size, SizeOfEach):
                self._map = self._result_map_list(self.size.sides, float_like)
                return self._map
            before = self.stages[0].source_size() or self.size
            with torch.no_grad():
                reach = _REACH * max(*self.size, *before)
                self._map = result_map(self.size, reach, float_like, functools.partial(self._read, like.shape[0]))
        return self._map

    def _result_map_list(self, sides: Sequence[int], like: Tensor) -> ResultMapList:
        """The same of a list, for height and width of each result."""
        readings: list[NodeReading] = []
        everything = range(len(sides) // 2)
        for i, stage in reversed(list(enumerate(self.stages))):
            assert isinstance(stage, OnList)
            through = _numbers(self.stages[:i], stage) if i > 0 else set()
            readings += stage.readings(like, [through is None or sample in through for sample in everything])
        before = self.chain.source_size()
        assert isinstance(before, SizeOfEach)
        sizes = zip(sides[::2], sides[1::2], before.sides[::2], before.sides[1::2])
        with torch.no_grad():
            return result_map_list(sides, [_REACH * max(own) for own in sizes], readings)

    def _read(self, batch: int, nodes: Tensor, margin: int) -> tuple[Tensor, Tensor]:
        """Where nodes (H, W, 2) of results read the images, (B, H, W, 2), and whether they are within the images in between."""
        shape = (batch, *nodes.shape[:2])
        reads = torch.ones(shape, dtype=torch.bool, device=nodes.device)
        stages, positions = self.stages, nodes.reshape(1, -1, 2).expand(batch, -1, -1)
        for i, stage in reversed(list(enumerate(stages))):
            displacements = stage.displacements(nodes) if i == len(stages) - 1 else None
            if displacements is not None:  # which are known at the nodes
                positions = at_nodes(nodes, displacements, margin).flatten(1, 2)
            else:
                positions = stage.move_points_back(positions)
            if i > 0 and (size := stage.source_size()) is not None:
                inside = is_within(positions, size, margin=1.0).reshape(shape)  # some of a pixel, interpolated
                reads = reads & where_chosen(_members(positions, stages[:i], stage), inside, True)
        return positions.unflatten(1, shape[1:]), reads

    def _is_mapped(self) -> Tensor | None:
        """(B,) bool, the samples that a map has moved; None for all."""
        any_chosen = None
        for chosen in self.chain.maps():
            if chosen is None:
                return None
            any_chosen = chosen if any_chosen is None else any_chosen | chosen.to(any_chosen.device)
        return any_chosen


def _members(like: Tensor, stages: Sequence[Stage], then: Stage | None = None) -> Tensor | None:
    """Which samples (B,) of points or boxes like these `_numbers` has; None for all."""
    members = _numbers(stages, then)
    if members is None:
        return None
    return on_device(torch.tensor([i in members for i in range(len(like))], device="cpu"), like.device)


def _numbers(stages: Sequence[Stage], then: Stage | None = None) -> set[int] | None:
    """The samples that have been through any of some stages, and `then` one; None for all."""
    each = [stage.members() for stage in stages]
    members: set[int] | None = None
    if not any(samples is None for samples in each):
        members = {sample for samples in each for sample in samples or ()}
    own = None if then is None else then.members()
    if own is not None:
        members = {*own} if members is None else members.intersection(own)
    return members


def move_boxes_back(stages: Chain, corners: Tensor, is_upright: bool) -> tuple[Tensor, None]:
    """The corners (B, N, 4, 2) of boxes of results around what their outlines are before all stages."""
    count = 1 if stages.keeps_lines else _SIDE
    return around_outlines(corners, is_upright, count, stages.move_points_back), None
