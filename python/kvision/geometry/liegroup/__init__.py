"""Lie groups: rotations, rigid motions and similarities, with exponential maps, logarithms and Jacobians."""

from kvision.geometry.liegroup.se2 import Se2
from kvision.geometry.liegroup.se3 import Se3
from kvision.geometry.liegroup.sim3 import Sim3
from kvision.geometry.liegroup.so2 import So2
from kvision.geometry.liegroup.so3 import So3

__all__ = ["Se2", "Se3", "Sim3", "So2", "So3"]
