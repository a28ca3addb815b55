// The C++ API of kvision: computer vision on LibTorch tensors, on CPU and GPU, with gradients, under the names of the
// Python functions. Header-only; link kvision::kvision from find_package(kvision), see examples/cpp and docs/cpp.md.
// kvision::ops has the operators of torch.ops.kvision below it.
#pragma once

#include "kvision/augmentation.h"
#include "kvision/color.h"
#include "kvision/contrib.h"
#include "kvision/enhance.h"
#include "kvision/feature.h"
#include "kvision/filters.h"
#include "kvision/geometry/calibration.h"
#include "kvision/geometry/conversions.h"
#include "kvision/geometry/depth.h"
#include "kvision/geometry/epipolar.h"
#include "kvision/geometry/homography.h"
#include "kvision/geometry/liegroup.h"
#include "kvision/geometry/subpix.h"
#include "kvision/geometry/transform.h"
#include "kvision/losses.h"
#include "kvision/metrics.h"
#include "kvision/morphology.h"
