// The functions of glue.h that are not templates. Compiled into both libraries.
#include "glue/glue.h"

#include <cstdio>
#include <cstdlib>
#include <new>
#include <stdexcept>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace kv {
namespace {

bool is_channels_last(Tensor const& x) {
  int64_t const c = x.size(1), w = x.size(3);
  return c > 1 && x.stride(1) == 1 && x.stride(3) == c && x.stride(2) == w * c;
}

#if defined(KV_CUDA)
constexpr int64_t kLargeResult = INT64_MAX;
#else
constexpr int64_t kLargeResult = 1 << 16;  // bytes
#endif
constexpr int64_t kManyPages = 1 << 22;  // bytes

// Memory of a large result on the CPU. Not from torch's allocator, because that requests an address of a certain
// alignment, and glibc before 2.38 may never use such a block again: small blocks that it cuts off at both ends stay in
// use, and the process grows by a result a call; or it gives the block back to the system, and the next result faults
// at each of its pages. An ordinary block is used again by the next result of its size.
void* large_block(int64_t bytes, void*& data) {
  constexpr int64_t alignment = 64;
  char* const block = static_cast<char*>(malloc(size_t(bytes + alignment)));
  if (!block) throw std::bad_alloc();
  data = block + (alignment - reinterpret_cast<uintptr_t>(block) % alignment);
#if defined(__linux__)
  // Large pages, as NumPy asks for them: memory fresh from the system costs a fault for each of its pages when it is
  // first written, and with pages of 4 KB that takes longer than most filters. Only a hint.
  constexpr int64_t page = 4096;
  char* const first = block + (page - reinterpret_cast<uintptr_t>(block) % page) % page;
  if (bytes >= kManyPages) madvise(first, size_t(block + bytes - first), MADV_HUGEPAGE);
#endif
  return block;
}

int64_t bytes_of(ScalarType type) {
  switch (type) {
    case ScalarType::Byte:
    case ScalarType::Bool:
      return 1;
    case ScalarType::Half:
    case ScalarType::BFloat16:
      return 2;
    case ScalarType::Float:
    case ScalarType::Int:
      return 4;
    default:
      return 8;
  }
}

}  // namespace

MessagePart::MessagePart(double number) : text(32, '\0') {
  text.resize(snprintf(text.data(), text.size(), "%g", number));
}

void fail(std::initializer_list<MessagePart> message) {
  std::string words;
  for (MessagePart const& part : message) words += part.text;
  throw std::runtime_error(words);
}

void check_images(char const* op, char const* name, Tensor const& x) {
  KV_CHECK(x.dim() == 4, op, ": expected ", name, " of shape (B, C, H, W), got ", x.dim(), " axes");
  KV_CHECK(x.size(2) > 0 && x.size(3) > 0, op, ": ", name, " has no pixels");
}

void check_volumes(char const* op, char const* name, Tensor const& x) {
  KV_CHECK(x.dim() == 5, op, ": expected ", name, " of 5 axes, got ", x.dim());
  KV_CHECK(x.size(2) > 0 && x.size(3) > 0 && x.size(4) > 0, op, ": ", name, " has no voxels");
}

void check_like(char const* op, char const* name, Tensor const& x, Tensor const& like) {
  bool same = x.dim() == like.dim() && x.scalar_type() == like.scalar_type() && x.device() == like.device();
  for (int64_t i = 0; same && i < x.dim(); ++i) same = x.size(i) == like.size(i);
  KV_CHECK(same, op, ": ", name, " differs in shape, dtype or device from the tensor it belongs to");
}

DType dtype_of(char const* op, Tensor const& x) {
  switch (x.scalar_type()) {
    case ScalarType::Byte:
      return DType::uint8;
    case ScalarType::Half:
      return DType::float16;
    case ScalarType::BFloat16:
      return DType::bfloat16;
    case ScalarType::Float:
      return DType::float32;
    case ScalarType::Double:
      return DType::float64;
    default:
      fail({op, ": no kernel for this dtype"});
  }
}

ScalarType scalar_type_of(DType dtype) {
  constexpr ScalarType kTypes[] = {ScalarType::Byte, ScalarType::Half, ScalarType::BFloat16, ScalarType::Float,
                                   ScalarType::Double};
  return kTypes[int(dtype)];
}

Border to_border(char const* op, int64_t number) {
  KV_CHECK(number >= int64_t(Border::constant) && number <= int64_t(Border::circular), op,
           ": border must be 0 (constant), 1 (reflect), 2 (replicate) or 3 (circular), got ", number);
  return Border(number);
}

void check_border(char const* op, Border border, int64_t pad, int64_t size) {
  int64_t const limit = border == Border::reflect ? size - 1 : border == Border::circular ? size : INT64_MAX;
  KV_CHECK(pad <= limit, op, ": a border of ", pad, " pixels does not fit an axis of ", size);
}

void check_window(char const* op, int64_t ky, int64_t kx) {
  KV_CHECK(ky > 0 && kx > 0 && ky <= kLargestWindow && kx <= kLargestWindow, op, ": expected a window of 1 to ",
           kLargestWindow, " pixels along each axis, got ", ky, " x ", kx);
}

Layout layout_of(Tensor const& x) { return is_channels_last(x) ? Layout::channels_last : Layout::planar; }

Tensor dense(Tensor const& x) { return x.is_contiguous() ? x : torch::stable::contiguous(x); }

Tensor as_layout(Tensor const& x, Layout layout) {
  if (layout == Layout::channels_last)
    return is_channels_last(x) ? x : torch::stable::contiguous(x, torch::headeronly::MemoryFormat::ChannelsLast);
  return x.stride(3) == 1 || x.size(3) == 1 ? x : dense(x);
}

Tensor empty(torch::headeronly::IntHeaderOnlyArrayRef sizes, Tensor const& like, Layout layout,
             std::optional<ScalarType> type) {
  int64_t strides[8], stride = 1;  // not on the heap: a small block held here would stand in the way of reusing images
  auto const add = [&](size_t axis) {
    int64_t const size = sizes[axis];
    strides[axis] = stride;
    stride *= size > 1 ? size : 1;
  };
  size_t rest = sizes.size();
  if (layout == Layout::channels_last) {
    rest -= 3;
    for (size_t axis : {0, 2, 1}) add(rest + axis);
  }
  while (rest-- > 0) add(rest);
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

Tensor empty_like(Tensor const& x, Layout layout) {
  return empty({x.size(0), x.size(1), x.size(2), x.size(3)}, x, layout);
}

ScalarType compute_dtype(Tensor const& x) {
  return x.scalar_type() == ScalarType::Double ? ScalarType::Double : ScalarType::Float;
}

#if defined(KV_CUDA)
CUstream_st* current_stream(Tensor const& x) {
  void* stream;
  TORCH_ERROR_CODE_CHECK(aoti_torch_get_current_cuda_stream(x.get_device_index(), &stream));
  return static_cast<CUstream_st*>(stream);
}
#endif

}  // namespace kv
