// The only door between torch and the kernels. Included by *_op.cpp files and by nothing else; speaks torch's stable
// ABI only, so one build serves every torch from 2.11 on.
//
// Each *_op.cpp is compiled twice, into libkvision.so and (with KV_CUDA) into libkvision_cuda.so. The entry it defines
// is the same for both: check, lay out, allocate, KV_RUN. Types and ranges were checked in Python; here only what
// memory safety needs is repeated.
#pragma once

#include <torch/csrc/inductor/aoti_torch/c/shim.h>
#include <torch/csrc/stable/accelerator.h>
#include <torch/csrc/stable/library.h>
#include <torch/csrc/stable/ops.h>
#include <torch/csrc/stable/tensor.h>

#include <cstdlib>
#include <new>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif

#include "core/border.h"
#include "core/isa.h"
#include "core/view.h"

namespace kv {

using torch::headeronly::ScalarType;
using torch::stable::Tensor;

// --- checks
// ------------------------------------------------------------------------------------------------------------

template <class... Parts>
[[noreturn]] void fail(Parts const&... parts) {
  std::ostringstream message;
  (message << ... << parts);
  throw std::runtime_error(message.str());
}

// Not STD_TORCH_CHECK, whose messages begin with the path of this file instead of the operator.
#define KV_CHECK(condition, ...)   \
  do {                             \
    if (!(condition)) [[unlikely]] \
      ::kv::fail(__VA_ARGS__);     \
  } while (0)

// Batches without images or channels are fine, images without pixels are not: every window needs a pixel to read.
inline void check_images(char const* op, char const* name, Tensor const& x) {
  KV_CHECK(x.dim() == 4, op, ": expected ", name, " of shape (B, C, H, W), got ", x.dim(), " axes");
  KV_CHECK(x.size(2) > 0 && x.size(3) > 0, op, ": ", name, " has no pixels");
}

inline void check_volumes(char const* op, char const* name, Tensor const& x) {
  KV_CHECK(x.dim() == 5, op, ": expected ", name, " of 5 axes, got ", x.dim());
  KV_CHECK(x.size(2) > 0 && x.size(3) > 0 && x.size(4) > 0, op, ": ", name, " has no voxels");
}

inline void check_like(char const* op, char const* name, Tensor const& x, Tensor const& like) {
  bool same = x.dim() == like.dim() && x.scalar_type() == like.scalar_type() && x.device() == like.device();
  for (int64_t i = 0; same && i < x.dim(); ++i) same = x.size(i) == like.size(i);
  KV_CHECK(same, op, ": ", name, " differs in shape, dtype or device from the tensor it belongs to");
}

inline Border border_of(char const* op, std::string const& name) {
  if (name == "reflect") return Border::reflect;
  if (name == "replicate") return Border::replicate;
  if (name == "constant") return Border::constant;
  KV_CHECK(name == "circular", op, ": border must be one of constant, reflect, replicate, circular; got '", name, "'");
  return Border::circular;
}

// A border reaches at most one reflection or period into the image; see core/border.h.
inline void check_border(char const* op, Border border, int64_t pad, int64_t size) {
  int64_t const limit = border == Border::reflect ? size - 1 : border == Border::circular ? size : INT64_MAX;
  KV_CHECK(pad <= limit, op, ": a border of ", pad, " pixels does not fit an axis of ", size);
}

// The area of a window, and all positions in and around a row, then fit an int.
constexpr int64_t kLargestWindow = (1 << 15) - 1;

inline void check_window(char const* op, int64_t ky, int64_t kx) {
  KV_CHECK(ky > 0 && kx > 0 && ky <= kLargestWindow && kx <= kLargestWindow, op, ": expected a window of 1 to ",
           kLargestWindow, " pixels along each axis, got ", ky, " x ", kx);
}

// --- layouts
// -----------------------------------------------------------------------------------------------------------

// How the kernels read an image tensor. planar: rows of neighbouring pixels, whatever the strides of B, C and H.
// channels_last: rows of neighbouring pixels with their channels inside.
enum class Layout { planar, channels_last };

inline bool is_channels_last(Tensor const& x) {
  int64_t const c = x.size(1), w = x.size(3);
  return c > 1 && x.stride(1) == 1 && x.stride(3) == c && x.stride(2) == w * c;
}

inline Layout layout_of(Tensor const& x) { return is_channels_last(x) ? Layout::channels_last : Layout::planar; }

// `x` itself where a kernel can read it in `layout`, else a copy that it can.
inline Tensor conform(Tensor const& x, Layout layout) {
  if (layout == Layout::channels_last)
    return is_channels_last(x) ? x : torch::stable::contiguous(x, torch::headeronly::MemoryFormat::ChannelsLast);
  return x.stride(3) == 1 || x.size(3) == 1 ? x : torch::stable::contiguous(x);
}

#if defined(KV_CUDA)
constexpr int64_t kLargeResult = INT64_MAX;
#else
constexpr int64_t kLargeResult = 1 << 22;  // bytes
#endif

// Memory of a large result on the CPU. Not from torch's allocator, because that asks glibc for an address of a certain
// alignment, and glibc before 2.38 may never use such a block again: small blocks that it cuts off at both ends stay in
// use, and the process grows by a result a call. An ordinary block is used again by the next result of its size.
inline void* large_block(int64_t bytes, void*& data) {
  constexpr int64_t alignment = 64;
  char* const block = static_cast<char*>(malloc(size_t(bytes + alignment)));
  if (!block) throw std::bad_alloc();
  data = block + (alignment - reinterpret_cast<uintptr_t>(block) % alignment);
#if defined(__linux__)
  // Large pages, as NumPy asks for them: memory fresh from the system costs a fault for each of its pages when it is
  // first written, and with pages of 4 KB that takes longer than most filters. Only a hint.
  constexpr int64_t page = 4096;
  char* const first = block + (page - reinterpret_cast<uintptr_t>(block) % page) % page;
  madvise(first, size_t(block + bytes - first), MADV_HUGEPAGE);
#endif
  return block;
}

inline int64_t bytes_of(ScalarType image_type) {
  switch (image_type) {
    case ScalarType::Byte:
      return 1;
    case ScalarType::Half:
    case ScalarType::BFloat16:
      return 2;
    default:
      return image_type == ScalarType::Float ? 4 : 8;
  }
}

// Uninitialised memory of the device and, unless told otherwise, the dtype of `like`, dense. `sizes` of four axes are
// laid out as `layout` says.
inline Tensor empty(torch::headeronly::IntHeaderOnlyArrayRef sizes, Tensor const& like, Layout layout = Layout::planar,
                    std::optional<ScalarType> type = {}) {
  int64_t strides[8], stride = 1;  // not on the heap: a small block held here would stand in the way of reusing images
  auto const add = [&](size_t axis) {
    int64_t const size = sizes[axis];
    strides[axis] = stride;
    stride *= size > 1 ? size : 1;
  };
  if (layout == Layout::channels_last)
    for (size_t axis : {1, 3, 2, 0}) add(axis);
  else
    for (size_t axis = sizes.size(); axis-- > 0;) add(axis);
  int32_t dtype, device_type;
  TORCH_ERROR_CODE_CHECK(aoti_torch_get_dtype(like.get(), &dtype));
  TORCH_ERROR_CODE_CHECK(aoti_torch_get_device_type(like.get(), &device_type));
  if (type) dtype = torch::stable::detail::to<int32_t>(torch::stable::detail::from(*type));
  AtenTensorHandle handle;
  int64_t const axes = int64_t(sizes.size());
  int64_t bytes = type ? bytes_of(*type) : like.element_size();
  for (int64_t size : sizes) bytes *= size;
  if (kLargeResult == INT64_MAX || bytes < kLargeResult) {
    TORCH_ERROR_CODE_CHECK(
        aoti_torch_empty_strided(axes, sizes.data(), strides, dtype, device_type, like.get_device_index(), &handle));
  } else {
    void* data;
    void* const block = large_block(bytes, data);
    auto const release = [](void*, void* block) { free(block); };
    TORCH_ERROR_CODE_CHECK(torch_from_blob(data, axes, sizes.data(), strides, 0, dtype, device_type, -1, &handle,
                                           aoti_torch_layout_strided(), nullptr, 0, release, block));
  }
  return Tensor(handle);
}

inline Tensor empty_like(Tensor const& x, Layout layout) {
  return empty({x.size(0), x.size(1), x.size(2), x.size(3)}, x, layout);
}

// The rows of an image tensor. T is the storage type, const for inputs.
template <class T>
Planes<T> planes(Tensor const& x, Layout layout) {
  auto* data = static_cast<T*>(const_cast<void*>(static_cast<void const*>(x.const_data_ptr())));
  int64_t const b = x.size(0), c = x.size(1), h = x.size(2), w = x.size(3);
  if (layout == Layout::channels_last) return {data, b, 1, x.stride(0), 0, x.stride(2), h, w, c};
  if (x.stride(0) == c * x.stride(1) || b == 1) return {data, b * c, 1, x.stride(1), 0, x.stride(2), h, w, 1};
  return {data, b, c, x.stride(0), x.stride(1), x.stride(2), h, w, 1};
}

// The rows of a contiguous tensor of any rank: its last two axes are planes, stacked along the others.
template <class T>
Planes<T> stacked_planes(Tensor const& x) {
  auto* data = static_cast<T*>(const_cast<void*>(static_cast<void const*>(x.const_data_ptr())));
  int64_t const h = x.size(x.dim() - 2), w = x.size(x.dim() - 1);
  return {data, x.numel() ? x.numel() / (h * w) : 0, 1, h * w, 0, w, h, w, 1};
}

// --- dtypes
// ------------------------------------------------------------------------------------------------------------

template <class T>
struct Type {
  using type = T;
};

// Calls f(Type<T>{}) with the storage type of `x`.
template <class F>
void for_floats(char const* op, Tensor const& x, F f) {
  switch (x.scalar_type()) {
    case ScalarType::Float:
      return f(Type<float>{});
    case ScalarType::Double:
      return f(Type<double>{});
    case ScalarType::Half:
      return f(Type<Half>{});
    case ScalarType::BFloat16:
      return f(Type<BFloat16>{});
    default:
      KV_CHECK(false, op, ": no kernel for this dtype");
  }
}
template <class F>
void for_floats_and_bytes(char const* op, Tensor const& x, F f) {
  if (x.scalar_type() == ScalarType::Byte) return f(Type<uint8_t>{});
  for_floats(op, x, f);
}

// --- running
// -----------------------------------------------------------------------------------------------------------

#if defined(KV_CUDA)

char const* cuda_error_string(int error);  // module.cu

inline CUstream_st* current_stream(Tensor const& x) {
  void* stream;
  TORCH_ERROR_CODE_CHECK(aoti_torch_get_current_cuda_stream(x.get_device_index(), &stream));
  return static_cast<CUstream_st*>(stream);
}

// Runs kernel `name` over the whole work on the device and current stream of tensor `x`.
#define KV_RUN(name, x, params, rows, row_cost)                                      \
  do {                                                                               \
    if ((rows) > 0) {                                                                \
      torch::stable::accelerator::DeviceGuard guard((x).get_device_index());         \
      int const error = ::kv::cuda::name(params, ::kv::current_stream(x));           \
      KV_CHECK(error == 0, #name, ": CUDA error: ", ::kv::cuda_error_string(error)); \
    }                                                                                \
  } while (0)

#define KV_OPERATOR(entry, schema) \
  STABLE_TORCH_LIBRARY_IMPL(kvision, CUDA, m) { m.impl(#entry, TORCH_BOX(&entry)); }

#else

// Runs kernel `name` over [0, rows) with torch's threads. `row_cost` is about how many elements a row of work touches:
// less than a few ten thousand are not worth a second thread.
#define KV_RUN(name, x, params, rows, row_cost)                                                               \
  do {                                                                                                        \
    int64_t const kv_grain = 1 + 32768 / (1 + int64_t(row_cost));                                             \
    if ((rows) <= kv_grain) {                                                                                 \
      KV_FOR_ISA(name, params, 0, rows);                                                                      \
    } else {                                                                                                  \
      torch::stable::parallel_for(0, rows, kv_grain,                                                          \
                                  [&](int64_t begin, int64_t end) { KV_FOR_ISA(name, params, begin, end); }); \
    }                                                                                                         \
  } while (0)

#define KV_OPERATOR(entry, schema)                                    \
  STABLE_TORCH_LIBRARY_FRAGMENT(kvision, m) { m.def(#entry schema); } \
  STABLE_TORCH_LIBRARY_IMPL(kvision, CPU, m) { m.impl(#entry, TORCH_BOX(&entry)); }

#endif

}  // namespace kv
