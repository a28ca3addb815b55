// The C++ API of kvision: its operators on LibTorch tensors, on CPU and GPU, with gradients. Header-only; link
// kvision::kvision from find_package(kvision), see examples/cpp.
#pragma once

#include "kvision/color.h"
#include "kvision/contrib.h"
#include "kvision/depth.h"
#include "kvision/enhance.h"
#include "kvision/filters.h"
#include "kvision/geometry.h"
#include "kvision/losses.h"
#include "kvision/matrices.h"
#include "kvision/metrics.h"
#include "kvision/morphology.h"
#include "kvision/views.h"
