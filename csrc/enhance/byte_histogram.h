// Images as 8-bit levels: what equalize and equalize_clahe count. The level of a pixel is floor(255 x), the product
// rounded to the type of the image, values outside [0, 1] saturated; a NaN has a level of its own, which does not
// count.
#pragma once

#include "core/half.h"
#include "core/view.h"

namespace kv {

constexpr int kLevels = 256, kNanLevel = 256;

}  // namespace kv
