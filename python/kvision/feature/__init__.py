"""Local features: detectors, local affine frames (LAFs), patches, descriptors and their matches.

Frames are (B, N, 2, 3), one of N slots for each feature; a frame of zeros is an empty slot. Responses keep (B, C, H, W).
Everything but the choice of features is differentiable.
"""

from kvision import _torch_compat
from kvision.feature.adalam import GeometryAwareDescriptorMatcher, match_adalam
from kvision.feature.affine_shape import LAFAffineShapeEstimator, PatchAffineShapeEstimator
from kvision.feature.affnet import LAFAffNetShapeEstimator
from kvision.feature.hardnet import HardNet, HardNet8
from kvision.feature.hynet import TLU, FilterResponseNorm2d, HyNet
from kvision.feature.keynet import KeyNet, KeyNetDetector
from kvision.feature.laf import (
    denormalize_laf,
    ellipse_to_laf,
    get_laf_center,
    get_laf_orientation,
    get_laf_scale,
    laf_from_center_scale_ori,
    laf_from_three_points,
    laf_is_filled,
    laf_is_inside_image,
    laf_is_valid,
    laf_to_boundary_points,
    laf_to_three_points,
    make_upright,
    normalize_laf,
    perspective_transform_lafs,
    rotate_laf,
    scale_laf,
    set_laf_orientation,
)
from kvision.feature.local_feature import (
    DoGAffNetHardNet,
    DoGHardNet,
    GFTTAffNetHardNet,
    HesAffNetHardNet,
    KeyNetAffNetHardNet,
    KeyNetHardNet,
    LAFDescriptor,
    LocalFeature,
    LocalFeatureMatcher,
    SIFTFeature,
    SIFTFeatureScaleSpace,
    get_laf_descriptors,
)
from kvision.feature.matching import (
    DescriptorMatcher,
    match_fginn,
    match_mnn,
    match_nn,
    match_smnn,
    match_smnn_batched,
    match_snn,
)
from kvision.feature.mkd import MKDDescriptor
from kvision.feature.multi_resolution_detector import MultiResolutionDetector, get_default_detector_config
from kvision.feature.orientation import LAFOrienter, PatchDominantGradientOrientation
from kvision.feature.orinet import OriNet
from kvision.feature.patches import extract_patches_from_pyramid, extract_patches_simple
from kvision.feature.responses import (
    BlobDoG,
    BlobDoGSingle,
    BlobHessian,
    CornerGFTT,
    CornerHarris,
    dog_response,
    dog_response_single,
    gftt_response,
    harris_response,
    hessian_response,
)
from kvision.feature.scale_space_detector import PassLAF, ScaleSpaceDetector
from kvision.feature.sift import (
    DenseSIFTDescriptor,
    SIFTDescriptor,
    SIFTDescriptorFromPyramid,
    convert_sift_descriptor_layout,
)
from kvision.feature.sosnet import SOSNet
from kvision.feature.tfeat import TFeat

_torch_compat.refuse_script(globals())
