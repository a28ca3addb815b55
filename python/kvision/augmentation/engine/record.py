"""What one call of a container drew and did.

A call keeps all that it finds out in its record, and a container keeps the record of its last call. So calls of several threads do
not meet, and `_params`, `transform_matrix`, `kept_boxes`, the inverse and labels that come later read one call each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor, nn

from kvision.augmentation.engine.stages import Chain

if TYPE_CHECKING:
    from kvision.augmentation.engine.label_record import LabelRecord
    from kvision.augmentation.inputs import VideoLayout


@dataclass(slots=True)
class Child:
    """A child of a container that is executed, with the parameters that it replays, if any."""

    name: str
    module: nn.Module
    params: Any = None
    record: Any = None  # what it did: the Execution of an augmentation, the Record of a container
    samples: Sequence[int] | None = None  # of a batch, for which it was executed; None for all
    batch: int = 0  # of how many
    # Those of the record that are of these samples, where they shared a run with others.
    rows: Sequence[int] | None = None
    foreign_params: Any = None  # `_params` of a module that has no records, after its call

    def read_params(self) -> Any:
        """The parameters that it was executed with."""
        if self.record is None:
            return self.foreign_params
        record = self.record if self.rows is None else self.record.of_rows(self.rows)
        return self.module._read_params(record)  # type: ignore[operator]


class ParamItem(NamedTuple):
    """The parameters of an executed child: its name in the container, and its `_params`; None for other modules."""

    name: str
    data: Any


class SomeParamItem(NamedTuple):
    """Those of a child that some samples of a batch got, which `samples` (B,) says on the CPU; `data` are those of these alone."""

    name: str
    data: Any
    samples: Tensor


AnyParamItem = ParamItem | SomeParamItem


def item_of(child: Child) -> AnyParamItem:
    """The parameters of an executed child."""
    if child.samples is None:
        return ParamItem(child.name, child.read_params())
    samples = torch.zeros(child.batch, dtype=torch.bool, device="cpu")
    samples[list(child.samples)] = True
    return SomeParamItem(child.name, child.read_params(), samples)


def child_of(item: Any, module: nn.Module) -> Child:
    """A child with the parameters that it replays."""
    samples = getattr(item, "samples", None)
    if samples is None:
        return Child(item.name, module, item.data)
    return Child(item.name, module, item.data, samples=samples.nonzero()[:, 0].tolist(), batch=len(samples))


class Record:
    """One call of a container.

    Args:
        shape: of the images, (B, C, H, W); None before the first call.
        children: those that were executed, in their order.
        stages: what they did to the positions of pixels.
        **values: what is listed below.
    """

    items: list[Any] | None = None  # the parameters by name, where they were given or have been read
    size: tuple[int, ...] = (0, 0)  # of the results
    identity: tuple[torch.device, torch.dtype] | None = None  # `matrix_type` of matrices that are made when read
    is_of_list = False  # of images, which the first child made a batch
    parts: Any = None  # Parts, of a list of images that was executed in parts
    videos: VideoLayout | None = None  # of what frames are
    labels: LabelRecord | None = None
    drawn: Any = None  # of policies
    cells: Sequence[tuple[list[int] | None, Child]] = ()  # of grids: the numbers of cells with their child
    chosen: Tensor | None = None  # (B,) bool, the samples that the container as a whole has augmented; None for all

    def __init__(
        self,
        shape: tuple[int, ...] | None = None,
        children: Sequence[Child] = (),
        stages: Chain | None = None,
        **values: Any,
    ) -> None:
        self._shape, self.children, self.stages = shape, children, stages or Chain()
        for name, value in values.items():  # torch 2.11 does not trace an update of __dict__
            setattr(self, name, value)

    @property
    def shape(self) -> tuple[int, ...] | None:
        if self._shape is None and (self.is_of_list or self.parts is not None):  # which is read where it is asked for
            self._shape = self.children[0].record.shape if self.parts is None else self.parts.shape
        return self._shape

    def identity_matrix(self) -> Tensor:
        """Identity matrices for the samples of images or volumes of the call, on their device."""
        shape = self.shape or ()
        axes = len(shape) - 1
        device, dtype = self.identity or (torch.device("cpu"), torch.float32)
        return torch.eye(axes, device=device, dtype=dtype).expand(shape[0], axes, axes)

    def replaced(self, **values: Any) -> Record:
        """The same call with other values."""
        return Record(**{**self.__dict__, "_shape": self.shape, **values})
