// Storage types that are known at run time: stable numbers, and the type that dispatch_dtype calls with.
#include "core/dtype.h"

#include <type_traits>

#include "check.h"

using kv::DType;

namespace {

// Exported color programs contain these numbers.
void numbers_are_stable() {
  CHECK(int(DType::uint8) == 0 && int(DType::float16) == 1 && int(DType::bfloat16) == 2);
  CHECK(int(DType::float32) == 3 && int(DType::float64) == 4);
}

template <class T>
void dispatches(DType dtype) {
  int calls = 0;
  bool same = false;
  kv::dispatch_dtype(dtype, [&](auto x) {
    ++calls;
    same = std::is_same_v<decltype(x), T>;
  });
  CHECK(calls == 1 && same, int(dtype), calls, same);
}

}  // namespace

int main() {
  numbers_are_stable();
  dispatches<uint8_t>(DType::uint8);
  dispatches<kv::Half>(DType::float16);
  dispatches<kv::BFloat16>(DType::bfloat16);
  dispatches<float>(DType::float32);
  dispatches<double>(DType::float64);
  return failures();
}
