"""The steps of color programs. Their table is csrc/color/step_list.h.

Numbers are stable, because exported graphs contain them. A new step takes the next number, at the end of the table.
"""

from __future__ import annotations

from typing import NamedTuple

from kvision.color._step_list import STEP_LIST


class Step(NamedTuple):
    """What kernels know of a step, in the columns of step_list.h."""

    number: int
    parameters: int
    domain: str  # rgb: needs three channels; any: the same for all channels
    arguments: str  # numbers: parameters are the same for all samples; tensors: they may be tensors
    channels: str  # of the result: same as before, or one
    affine: str  # always, unless_clipped or never


STEPS = {name: Step(*row) for name, row in STEP_LIST.items()}
NAMES = {step.number: name for name, step in STEPS.items()}
CONTRAST = STEPS["contrast"].number  # the last parameter is the mean of the image before this step
