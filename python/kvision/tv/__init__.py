"""torchvision.transforms.v2 by kvision's operators: the same classes, arguments, defaults and draws.

    from kvision import tv as v2  # instead of: from torchvision.transforms import v2

Samples of a batch (B, C, H, W) draw by themselves; :class:`SameOnBatch` draws once a call. See :doc:`/torchvision`.
"""

from kvision import _torch_compat
from kvision.tv import functional as functional
from kvision.tv.color import *  # noqa: F403
from kvision.tv.containers import *  # noqa: F403
from kvision.tv.functional.geometry import InterpolationMode as InterpolationMode
from kvision.tv.geometry import *  # noqa: F403
from kvision.tv.mixing import *  # noqa: F403
from kvision.tv.transform import Transform as Transform
from kvision.tv.values import *  # noqa: F403

_BASES = {"Chance", "RandomTransform"}
_CLASSES = {name for name, value in globals().items() if getattr(value, "__module__", "").startswith("kvision.tv.")}
__all__ = sorted(name for name in _CLASSES - _BASES if name[0] not in "_" and isinstance(globals()[name], type))

_torch_compat.refuse_script(globals())
