// Sums of lists, whose tensors have memory of their own, for the entries of operators.
#pragma once

#include "geometry/transform/lists/list_numbers.h"
#include "glue/image_list.h"

namespace kv::geometry {

#if defined(KV_CUDA)
// Dense tensors `to` rounded from those of `from`, which are of the type that is computed in; or zeros without these.
inline void write_numbers(Tensors const& from, Tensors const& to) {
  dispatch_floating("write_numbers", to[0], [&]<class T>(Type<T>) {
    for (size_t begin = 0; begin < to.size(); begin += kMaxListed) {
      ListedNumbers<T> p;
      p.count = int(std::min(to.size() - begin, size_t(kMaxListed)));
      for (int i = 0; i < p.count; ++i) {
        size_t const b = begin + size_t(i);
        p.from[i] = from.empty() ? nullptr : data_ptr<Compute<T> const>(from[b]);
        p.to[i] = data_ptr<T>(to[b]);
        p.numbers[i] = to[b].numel();
      }
      KV_RUN(write_numbers, to[0], p, p.count, 1);
    }
  });
}
#endif

// Memory for the sums of a list of images is zeros on CUDA, where kernels add to it; kernels of the CPU write it.
inline void clear_sums([[maybe_unused]] Tensors const& sums) {
#if defined(KV_CUDA)
  write_numbers({}, sums);
#endif
}

// The sums themselves, or rounded to the type of the images.
inline Tensors sums_of_type(Tensors const& sums, ScalarType type) {
  if (sums[0].scalar_type() == type) return sums;
  Tensors results;
  results.reserve(sums.size());
  for (Tensor const& sum : sums) results.push_back(empty(sum.sizes(), sum, Layout::planar, type));
#if defined(KV_CUDA)
  write_numbers(sums, results);
#else
  for (size_t b = 0; b < sums.size(); ++b) torch::stable::copy_(results[b], sums[b]);
#endif
  return results;
}

}  // namespace kv::geometry
