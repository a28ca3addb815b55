"""Losses: of segmentations, boxes, images, probability maps and signals.

Segmentations are logits (B, C, H, W) with int64 labels (B, H, W). Every loss is differentiable and does not synchronize
with the device. Half types are computed in float32.
"""

from kvision import _torch_compat
from kvision.losses.box_overlap import complete_box_iou_loss, distance_box_iou_loss, generalized_box_iou_loss
from kvision.losses.divergence import js_div_loss_2d, kl_div_loss_2d
from kvision.losses.focal import BinaryFocalLossWithLogits, FocalLoss, binary_focal_loss_with_logits, focal_loss
from kvision.losses.hausdorff import HausdorffERLoss, HausdorffERLoss3D
from kvision.losses.lovasz import LovaszHingeLoss, LovaszSoftmaxLoss, lovasz_hinge_loss, lovasz_softmax_loss
from kvision.losses.ms_ssim import MS_SSIMLoss
from kvision.losses.mutual_information import (
    MIKernel,
    MILossFromRef,
    MILossFromRef2D,
    MILossFromRef3D,
    NMILossFromRef,
    NMILossFromRef2D,
    NMILossFromRef3D,
    mutual_information_loss,
    mutual_information_loss_2d,
    mutual_information_loss_3d,
    normalized_mutual_information_loss,
    normalized_mutual_information_loss_2d,
    normalized_mutual_information_loss_3d,
)
from kvision.losses.one_hot import one_hot
from kvision.losses.overlap import DiceLoss, TverskyLoss, dice_loss, tversky_loss
from kvision.losses.psnr import PSNRLoss, psnr_loss
from kvision.losses.robust import (
    CauchyLoss,
    CharbonnierLoss,
    GemanMcclureLoss,
    WelschLoss,
    cauchy_loss,
    charbonnier_loss,
    geman_mcclure_loss,
    welsch_loss,
)
from kvision.losses.smoothness import (
    InverseDepthSmoothnessLoss,
    TotalVariation,
    inverse_depth_smoothness_loss,
    total_variation,
)
from kvision.losses.ssim import L1SSIMLoss, SSIM3DLoss, SSIMLoss, l1_ssim_loss, ssim3d_loss, ssim_loss

_torch_compat.refuse_script(globals())
