// Quantization of images to 8-bit levels, shared by equalize and equalize_clahe. The level of a pixel is floor(255 x):
// the product is rounded to the type of the image, and values outside [0, 1] saturate. NaN has a separate level, which
// histograms leave out. Bytes are levels.
#pragma once

#include "core/half.h"
#include "core/view.h"

namespace kv::enhance {

constexpr int kLevels = 256, kNanLevel = 256;

}  // namespace kv::enhance
