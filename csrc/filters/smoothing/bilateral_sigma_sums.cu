// The gradients of the bilateral blur to its sigmas on CUDA, as sums over rows; see bilateral.h.
#include "bilateral.cuh"

namespace kv::filters::cuda {
namespace {

// One block for each row.
template <class T, bool Joint>
__global__ void __launch_bounds__(kThreads) bilateral_sigma_sums(BilateralSigmas<T> p) {
  using F = Compute<T>;
  auto const& guide = guide_of<Joint>(p);
  int const ry = p.ky / 2, rx = p.kx / 2;
  int64_t const b = blockIdx.x / p.x.height;
  int const y = int(blockIdx.x % p.x.height);
  Falloff<F> const falloff = p.sigma.at(b);
  F sums[3] = {};
  for (int x = threadIdx.x; x < p.x.width; x += kThreads) {
    auto const* const center = pixel(guide, b, p.border, y, x);
    T const* const grad = p.grad.row(b, 0, y) + x * p.grad.step;
    for (int c = 0; c < p.x.channels; c += kChunk) {
      F mean[kChunk], a[kChunk];
      F const inverse = 1 / sum_window<Joint>(p, falloff, b, c, y, x, mean);
      for (int k = 0; k < kChunk; ++k) {
        mean[k] *= inverse;
        a[k] = c + k < p.x.channels ? value(p.grad, grad, c + k) * inverse : F(0);
      }
      for (int dy = -ry; dy <= ry; ++dy)
        for (int dx = -rx; dx <= rx; ++dx) {
          auto const* const from = pixel(p.x, b, p.border, y + dy, x + dx);
          F const d = distance(guide, p.l1, pixel(guide, b, p.border, y + dy, x + dx), center);
          F const square = p.l1 ? d * d : d, square_y = F(dy * dy), square_x = F(dx * dx);
          F weight_grad = 0;
          for (int k = 0; k < kChunk; ++k)
            if (c + k < p.x.channels) weight_grad += a[k] * (value(p.x, from, c + k) - mean[k]);
          weight_grad *= fast_exp2(falloff.space_y * square_y + falloff.space_x * square_x - square * falloff.color);
          sums[0] += weight_grad * square;
          sums[1] += weight_grad * square_y;
          sums[2] += weight_grad * square_x;
        }
    }
  }
  __shared__ F partials[3][kThreads / 32];
  for (int i = 0; i < 3; ++i) {
    sums[i] = warp_reduce(sums[i], Sum());
    if (threadIdx.x % 32 == 0) partials[i][threadIdx.x / 32] = sums[i];
  }
  __syncthreads();
  if (threadIdx.x < 3) {
    F sum = 0;
    for (F const partial : partials[threadIdx.x]) sum += partial;
    p.sums[(b * 3 + threadIdx.x) * p.x.height + y] = round_to<T>(sum);
  }
}

}  // namespace

template <class T>
int bilateral_blur_sigma_sums(BilateralSigmas<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.x.batch * p.x.height);
  if (p.joint)
    bilateral_sigma_sums<T, true><<<blocks, kThreads, 0, stream>>>(p);
  else
    bilateral_sigma_sums<T, false><<<blocks, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(bilateral_blur_sigma_sums, BilateralSigmas)

}  // namespace kv::filters::cuda
