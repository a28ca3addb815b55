// Color programs from planes of bytes to planes of bytes or of float32, on CUDA.
#include "program_bytes.cuh"
#include "program_step.h"

namespace kv::color::cuda {
namespace {

constexpr int P = kPixelsPerThread<float>;

// T: of the results, or void.
template <int C, class T>
__global__ void __launch_bounds__(kThreads) run_bytes(__grid_constant__ Program<float> const p) {
  __shared__ Sample<float> sample;
  for (int64_t n = blockIdx.y; n < p.samples; n += gridDim.y) {
    int64_t const b = sample_of(p, n), size = size_of(p.y.type);
    auto const* const from = static_cast<uint8_t const*>(p.x.data) + p.x.offset(b);
    auto* const to = static_cast<char*>(p.y.data) + size * p.y.offset(b);
    run_block_of_bytes<C, T, false>(p, sample,
                                    {p.x, p.y, from, to, b, p.pixels, int(blockIdx.x), int(gridDim.x),
                                     p.parts + b * gridDim.x + blockIdx.x, parts_of(p, b)});
  }
}

// Whether the planes of three channels of float32 are vectors of a thread's pixels.
bool has_vectors(Pixels const& y) {
  return y.type == DType::float32 && y.channels == 3 && (y.outer_stride | y.inner_stride | y.channel_stride) % P == 0 &&
         reinterpret_cast<uintptr_t>(y.data) % sizeof(Vector<float, P>) == 0;
}

}  // namespace

// Special case, H200: 1.02 (invert) to 1.8 (gray at 335x513) times as fast as the kernel of any type; to float32 1.33
// (rgb_to_ycbcr) to 1.39 (rgb_to_lab).
bool takes_bytes(Program<float> const& p) {
  if (p.x.type != DType::uint8 || p.x.step != 1) return false;
  return p.measures_mean || (p.y.step == 1 && (p.y.type == DType::uint8 || has_vectors(p.y)));
}

int program_of_bytes(Program<float> const& p, CUstream_st* stream) {
  dim3 const grid = grid_of(p.samples, p.measures_mean ? p.parts_count : blocks_per_sample<float>(p.samples, p.pixels));
  bool const values = p.x.channels == 1;
  auto* const kernel = p.measures_mean              ? (values ? run_bytes<1, void> : run_bytes<3, void>)
                       : p.y.type == DType::float32 ? run_bytes<3, float>
                       : values                     ? run_bytes<1, uint8_t>
                                                    : run_bytes<3, uint8_t>;
  kernel<<<grid, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace kv::color::cuda
