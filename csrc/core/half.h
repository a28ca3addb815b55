// Storage types of 16-bit floats. They have the layout of torch's Half and BFloat16, so that tensor data is read in
// place. Conversions of SIMD vectors are in lanes.h, those of CUDA in launch.cuh.
#pragma once

#include "hd.h"

namespace kv {

struct Half {
  uint16_t bits;
};
struct BFloat16 {
  uint16_t bits;
};

KV_HD float bits_to_float(uint32_t bits) {
  float f;
  __builtin_memcpy(&f, &bits, 4);
  return f;
}
KV_HD uint32_t float_to_bits(float f) {
  uint32_t bits;
  __builtin_memcpy(&bits, &f, 4);
  return bits;
}

KV_HD float to_float(BFloat16 x) { return bits_to_float(uint32_t(x.bits) << 16); }

KV_HD BFloat16 to_bfloat16(float f) {
  uint32_t const bits = float_to_bits(f);
  if (f != f) return {0x7fc0};
  return {uint16_t((bits + 0x7fff + ((bits >> 16) & 1)) >> 16)};  // round half to even
}

// IEEE 754 binary16 <-> binary32 in integer arithmetic; used where the CPU has no F16C.
KV_HD float to_float(Half x) {
  uint32_t const sign = uint32_t(x.bits & 0x8000) << 16;
  uint32_t const magnitude = x.bits & 0x7fff;
  if (magnitude >= 0x7c00) return bits_to_float(sign | 0x7f800000 | (magnitude & 0x3ff) << 13);     // inf, NaN
  if (magnitude < 0x0400) return bits_to_float(sign | float_to_bits(float(magnitude) * 0x1p-24f));  // subnormal
  return bits_to_float(sign | ((magnitude << 13) + (112u << 23)));
}

KV_HD Half to_half(float f) {
  uint32_t const bits = float_to_bits(f);
  uint16_t const sign = uint16_t((bits >> 16) & 0x8000);
  uint32_t const magnitude = bits & 0x7fffffff;
  if (magnitude > 0x7f800000) return {uint16_t(sign | 0x7e00)};   // NaN
  if (magnitude >= 0x477ff000) return {uint16_t(sign | 0x7c00)};  // rounds to more than 65504
  if (magnitude < 0x38800000) {                                   // subnormal: the unit in the last place is 2^-24
    uint32_t const shifted = float_to_bits(bits_to_float(magnitude) + 0.5f) - float_to_bits(0.5f);
    return {uint16_t(sign | shifted)};
  }
  return {uint16_t(sign | ((magnitude - (112u << 23) + 0xfff + ((magnitude >> 13) & 1)) >> 13))};
}

}  // namespace kv
