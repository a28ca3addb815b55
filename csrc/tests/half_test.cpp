// The 16-bit floats against rounding written down from their definition: every pattern to float and back, and floats
// around every rounding boundary.
#include "core/half.h"

#include <cmath>

#include "check.h"

namespace {

struct Format {
  int mantissa_bits, min_exponent;
  double overflow;  // the first value that rounds to infinity
};
constexpr Format kHalf{10, -14, 65520}, kBFloat16{7, -126, 0x1.ffp127};

// The nearest representable number, the even one of two.
float rounded(float f, Format format) {
  if (!std::isfinite(f) || f == 0) return f;
  if (std::fabs(double(f)) >= format.overflow) return std::copysign(INFINITY, f);
  int const exponent = std::max(std::ilogb(f), format.min_exponent);
  double const unit = std::ldexp(1.0, exponent - format.mantissa_bits);
  return float(std::copysign(std::nearbyint(std::fabs(f) / unit) * unit, f));
}

bool same(float a, float b) { return (std::isnan(a) && std::isnan(b)) || kv::float_to_bits(a) == kv::float_to_bits(b); }

template <class T, class Store>
void check(Format format, Store store) {
  for (uint32_t pattern = 0; pattern < 0x10000; ++pattern) {
    T const x{uint16_t(pattern)};
    float const f = kv::to_float(x);
    CHECK(same(f, rounded(f, format)), pattern, f);  // representable
    T const back = store(f);
    CHECK(std::isnan(f) ? std::isnan(kv::to_float(back)) : back.bits == pattern, pattern, f, back.bits);
  }
  // All upper halves of a float with lower halves on, next to and between the boundaries of both formats.
  for (uint32_t high = 0; high < 0x10000; ++high)
    for (uint32_t low = 0; low < 0x10000; low += 0x1000)
      for (uint32_t near : {0u, 1u, 0xfffu}) {
        float const f = kv::bits_to_float(high << 16 | low | near);
        CHECK(same(kv::to_float(store(f)), rounded(f, format)), f, kv::to_float(store(f)), rounded(f, format));
      }
}

void known_values() {
  CHECK(kv::to_float(kv::Half{0x3c00}) == 1 && kv::to_float(kv::Half{0x7bff}) == 65504);
  CHECK(kv::to_float(kv::Half{0x0001}) == 0x1p-24f && kv::to_float(kv::Half{0xfc00}) == -INFINITY);
  CHECK(kv::to_float(kv::BFloat16{0x3f80}) == 1 && kv::to_float(kv::BFloat16{0xff80}) == -INFINITY);
}

}  // namespace

int main() {
  known_values();
  check<kv::Half>(kHalf, [](float f) { return kv::to_half(f); });
  check<kv::BFloat16>(kBFloat16, [](float f) { return kv::to_bfloat16(f); });
  return failures();
}
