"""Patches, model inputs, regions, distances, noise, histograms and clusters."""

from kvision import _torch_compat
from kvision.contrib.connected_components import connected_components, connected_components_union_find
from kvision.contrib.diamond_square import diamond_square
from kvision.contrib.distance_transform import DistanceTransform, distance_transform
from kvision.contrib.histogram_matching import histogram_matching, interp
from kvision.contrib.image_stitching import ImageStitcher
from kvision.contrib.kmeans import KMeans
from kvision.contrib.lambda_module import Lambda
from kvision.contrib.patches import (
    CombineTensorPatches,
    ExtractTensorPatches,
    combine_tensor_patches,
    compute_padding,
    extract_tensor_patches,
)
from kvision.contrib.vision_patches import VisionPatches, vision_patches

_torch_compat.refuse_script(globals())
