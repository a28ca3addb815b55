// The brightness of a color by ITU-R BT.601.
#pragma once

namespace kv {

constexpr double kLumaRed = 0.299, kLumaGreen = 0.587, kLumaBlue = 0.114;

}  // namespace kv
