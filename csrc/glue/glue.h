// The only interface between torch and the kernels. Included by *_op.cpp files and by nothing else; uses torch's stable
// ABI only, so one build serves every torch from 2.11 on.
//
// Each *_op.cpp is compiled twice, into libkvision.so and (with KV_CUDA) into libkvision_cuda.so. The entry it defines
// is the same for both: check, lay out, allocate, KV_RUN. Types and ranges were checked in Python; here only what
// memory safety needs is repeated.
#pragma once

#include "core/border.h"
#include "core/ceil_div.h"
#include "core/dtype.h"
#include "core/isa.h"
#include "core/view.h"
#include "glue/torch.h"

namespace kv {

using torch::headeronly::ScalarType;
using torch::stable::Tensor;

// --- checks ----------------------------------------------------------------------------------------------------------

// A word, a number or a name in a message. Strings are made and appended to, but not assigned or inserted into, here
// and wherever else the libraries have them: what GCC 13 compiles of that needs its own libstdc++.
struct MessagePart {
  std::string text;
  MessagePart(char const* text) : text(text) {}
  MessagePart(std::string const& text) : text(text) {}
  template <std::integral T>
  MessagePart(T number) : text(std::to_string(number)) {}
  MessagePart(double number);
};

// Throws an exception that is a RuntimeError in Python.
[[noreturn]] void fail(std::initializer_list<MessagePart> message);

// Not STD_TORCH_CHECK, whose messages begin with the path of this file instead of the operator.
#define KV_CHECK(condition, ...)   \
  do {                             \
    if (!(condition)) [[unlikely]] \
      ::kv::fail({__VA_ARGS__});   \
  } while (0)

// Batches without images or channels are fine, images without pixels are not: every window needs a pixel to read.
void check_images(char const* op, char const* name, Tensor const& x);
void check_volumes(char const* op, char const* name, Tensor const& x);
void check_like(char const* op, char const* name, Tensor const& x, Tensor const& like);

// The border rule of a number; see enum class Border.
Border to_border(char const* op, int64_t number);

// Borders reflect or repeat the image at most once; see core/border.h.
void check_border(char const* op, Border border, int64_t pad, int64_t size);

// The area of a window, and all positions in a row and its border, are then ints.
constexpr int64_t kLargestWindow = (1 << 15) - 1;

void check_window(char const* op, int64_t ky, int64_t kx);

// --- layouts ---------------------------------------------------------------------------------------------------------

// How kernels read an image tensor. planar: the pixels of a row are adjacent, B, C and H have any strides.
// channels_last: the channels of a pixel are adjacent, and so are the pixels of a row.
enum class Layout { planar, channels_last };

Layout layout_of(Tensor const& x);

// `x` itself where it is contiguous, else a copy. torch::stable::contiguous calls the dispatcher in any case.
Tensor dense(Tensor const& x);

// `x` itself where a kernel can read it in `layout`, else a copy that it can.
Tensor as_layout(Tensor const& x, Layout layout);

// Uninitialized memory of the device and, unless told otherwise, the dtype of `like`, dense. `sizes` of images
// (B, C, H, W) or (C, H, W) are laid out as `layout` says.
Tensor empty(torch::headeronly::IntHeaderOnlyArrayRef sizes, Tensor const& like, Layout layout = Layout::planar,
             std::optional<ScalarType> type = {});
Tensor empty_like(Tensor const& x, Layout layout);

// The first element of a tensor. T is the storage type, const for inputs.
template <class T>
T* data_ptr(Tensor const& x) {
  return static_cast<T*>(const_cast<void*>(x.const_data_ptr()));
}

// The rows of an image tensor.
template <class T>
Planes<T> planes(Tensor const& x, Layout layout) {
  T* const data = data_ptr<T>(x);
  int64_t const b = x.size(0), c = x.size(1), h = x.size(2), w = x.size(3);
  if (layout == Layout::channels_last) return {data, b, 1, x.stride(0), 0, x.stride(2), h, w, c};
  if (x.stride(0) == c * x.stride(1) || b == 1) return {data, b * c, 1, x.stride(1), 0, x.stride(2), h, w, 1};
  return {data, b, c, x.stride(0), x.stride(1), x.stride(2), h, w, 1};
}

// The rows of a contiguous tensor of any rank: its last two axes are planes, stacked along the others.
template <class T>
Planes<T> stacked_planes(Tensor const& x) {
  T* const data = data_ptr<T>(x);
  int64_t const h = x.size(x.dim() - 2), w = x.size(x.dim() - 1);
  return {data, x.numel() ? x.numel() / (h * w) : 0, 1, h * w, 0, w, h, w, 1};
}

// --- dtypes ----------------------------------------------------------------------------------------------------------

// The type that kernels compute in for tensors stored as `x`.
ScalarType compute_dtype(Tensor const& x);

// For kernels that learn the storage type at run time.
DType dtype_of(char const* op, Tensor const& x);
ScalarType scalar_type_of(DType dtype);

template <class T>
struct Type {
  using type = T;
};

// Calls f(Type<T>{}) with the storage type of `x`.
template <class F>
void dispatch_floating(char const* op, Tensor const& x, F f) {
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
void dispatch_floating_and_uint8(char const* op, Tensor const& x, F f) {
  if (x.scalar_type() == ScalarType::Byte) return f(Type<uint8_t>{});
  dispatch_floating(op, x, f);
}

// --- running ---------------------------------------------------------------------------------------------------------

#if defined(KV_CUDA)

char const* cuda_error_string(int error);  // module.cu
CUstream_st* current_stream(Tensor const& x);

// Runs kernel `name` over the whole work on the device and current stream of tensor `x`.
#define KV_RUN(name, x, params, rows, row_cost)                                      \
  do {                                                                               \
    if ((rows) > 0) {                                                                \
      torch::stable::accelerator::DeviceGuard guard((x).get_device_index());         \
      int const error = cuda::name(params, ::kv::current_stream(x));                 \
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
