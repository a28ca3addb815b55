"""torchvision.transforms.v2 by kvision's operators: the same classes, arguments, defaults and draws.

    from kvision import tv as v2  # instead of: from torchvision.transforms import v2

Samples of a batch (B, C, H, W) draw by themselves; :class:`SameOnBatch` draws once a call. See :doc:`/torchvision`.
"""

from kvision import _torch_compat
from kvision.tv import color, containers, geometry, mixing, values
from kvision.tv import functional as functional
from kvision.tv.color import *  # noqa: F403
from kvision.tv.containers import *  # noqa: F403
from kvision.tv.functional.geometry import InterpolationMode
from kvision.tv.geometry import *  # noqa: F403
from kvision.tv.mixing import *  # noqa: F403
from kvision.tv.transform import Transform
from kvision.tv.values import *  # noqa: F403

__all__ = ["InterpolationMode", "Transform"]
__all__ += color.__all__
__all__ += containers.__all__
__all__ += geometry.__all__
__all__ += mixing.__all__
__all__ += values.__all__

_torch_compat.refuse_script(globals())
