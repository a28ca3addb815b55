"""Calls of DALI's operators on one array."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np


def run(call: Callable[[Any, Any], Any], *arrays: np.ndarray) -> np.ndarray:
    from nvidia.dali import fn, pipeline_def

    @pipeline_def(batch_size=1, num_threads=1, device_id=None)
    def pipeline() -> Any:
        inputs = fn.external_source(lambda: [a[None] for a in arrays], num_outputs=len(arrays))
        return call(fn, *inputs)

    made = pipeline()
    made.build()
    (result,) = made.run()
    return np.asarray(result.at(0))
