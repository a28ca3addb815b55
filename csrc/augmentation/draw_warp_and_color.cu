// Random parameters, and the matrices of the transforms that read them, in one launch on CUDA. A block draws for 32
// samples: each warp makes one draw for all of them at a time. Then one thread per sample multiplies its matrices.
#include "augmentation/draw_warp_and_color.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kSamples = 32, kMaxWarps = 16;

template <class Draws>
__global__ void __launch_bounds__(kSamples* kMaxWarps)
    draw_then_multiply(__grid_constant__ DrawsAndChain<Draws> const p) {
  int64_t const sample = blockIdx.x * int64_t(kSamples) + threadIdx.x, b = p.draws.first() + sample;
  DrawParameters<float> const& common = p.draws.common();
  if (sample < p.draws.samples())
    for (int i = threadIdx.y; i < common.count; i += blockDim.y) draw_sample(p.draws, common.draws[i], sample);
  __syncthreads();
  if (threadIdx.y > 0 || sample >= p.draws.samples()) return;
  TransformMatrix<float> const& chain = p.chain;
  double m[9];
  evaluate_chain(chain, m, [&](int column, double number) {
    return column < 0 ? number : double(chain.parameters[b * chain.stride + column * chain.column_stride]);
  });
  for (int i = 0; i < 9; ++i) chain.result[9 * b + i] = float(m[i]);
}

}  // namespace

static_assert(sizeof(DrawsAndChain<DrawListParameters<float>>) <= 32764, "more than a kernel's parameters");

template <class Draws>
int draw_and_multiply(DrawsAndChain<Draws> const& p, CUstream_st* stream) {
  dim3 const threads(kSamples, unsigned(clamp(p.draws.common().count, 1, kMaxWarps)));
  draw_then_multiply<<<unsigned(ceil_div(p.draws.samples(), int64_t(kSamples))), threads, 0, stream>>>(p);
  return cudaGetLastError();
}

template int draw_and_multiply(DrawsAndChain<DrawParameters<float>> const&, CUstream_st*);
template int draw_and_multiply(DrawsAndChain<DrawListParameters<float>> const&, CUstream_st*);
template int draw_and_multiply(DrawsAndChain<DrawListParameters<float, kFewListedNumbers>> const&, CUstream_st*);

}  // namespace kv::augmentation::cuda
