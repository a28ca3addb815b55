// Rows of tensors as one tensor, on the CPU: rows [begin, end) of the result. Compiled once per instruction set.
#include <cstddef>

#include "augmentation/lists/copy_rows.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void copy_rows(CopyRows<T> const& p, int64_t begin, int64_t end) {
  for (int64_t i = begin; i < end; ++i) __builtin_memcpy(p.to + i * p.size, p.from[i], size_t(p.size));
}

KV_INSTANTIATE_ONE(copy_rows, CopyRows, uint8_t)

}  // namespace kv::augmentation::KV_ISA
