// Rows of tensors as one tensor: schema and entry, for CPU and CUDA.
#include <algorithm>

#include "augmentation/lists/copy_rows.h"
#include "glue/image_list.h"

namespace kv::augmentation {
namespace {

// `x` itself where its rows are dense, else a copy.
Tensor with_dense_rows(Tensor const& x, Layout layout) {
  if (layout == Layout::planar) return dense(x);
  int64_t const row = x.size(3) * x.size(1);
  bool const is_dense = layout_of(x) == layout && x.stride(2) == row && x.stride(0) == row * x.size(2);
  return is_dense ? x : as_layout(dense(x), layout);
}

// Rows of images (B, C, H, W) of one size and type, numbered as if these were one batch. The result has the layout of
// the first ones.
Tensor copy_rows(Tensors const& parts, std::vector<int64_t> const& rows) {
  constexpr char const* op = "copy_rows";
  KV_CHECK(!parts.empty(), op, ": expected parts with at least one batch");
  Tensor const& first = parts[0];
  check_images(op, "parts", first);
  Layout const layout = layout_of(first);
  Tensors own;
  std::vector<uint8_t const*> all;
  int64_t const row = first.size(1) * first.size(2) * first.size(3), size = row * int64_t(first.element_size());
  for (Tensor const& part : parts) {
    check_images(op, "parts", part);
    KV_CHECK(part.size(1) == first.size(1) && part.size(2) == first.size(2) && part.size(3) == first.size(3) &&
                 part.scalar_type() == first.scalar_type() && part.device() == first.device(),
             op, ": expected parts of one size, type and device");
    own.push_back(with_dense_rows(part, layout));
    auto const* const data = static_cast<uint8_t const*>(own.back().const_data_ptr());
    for (int64_t i = 0; i < part.size(0); ++i) all.push_back(data + i * size);
  }
  for (int64_t const i : rows)
    KV_CHECK(i >= 0 && i < int64_t(all.size()), op, ": expected rows within 0 and ", all.size(), ", got ", i);
  int64_t const count = int64_t(rows.size()), sizes[] = {count, first.size(1), first.size(2), first.size(3)};
  Tensor const y = empty(sizes, first, layout);
  if (size == 0) return y;
  CopyRows<uint8_t> params{};
  params.size = size;
  for (int64_t begin = 0; begin < count; begin += kCopiedRows) {
    params.count = int(std::min(count - begin, int64_t(kCopiedRows)));
    params.to = static_cast<uint8_t*>(y.mutable_data_ptr()) + begin * size;
    for (int i = 0; i < params.count; ++i) params.from[i] = all[size_t(rows[size_t(begin + i)])];
    KV_RUN(copy_rows, first, params, params.count, row);
  }
  return y;
}

}  // namespace

KV_OPERATOR(copy_rows, "(Tensor[] parts, int[] rows) -> Tensor")

}  // namespace kv::augmentation
