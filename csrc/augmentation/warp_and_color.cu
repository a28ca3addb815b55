// Warps of a batch with a program of color steps, on CUDA.
#include "augmentation/warp_blocks/warp_rows.cuh"

namespace kv::augmentation::cuda {
namespace {

// With fewer blocks on a multiprocessor at once than two, separate kernels are faster.
constexpr size_t kMaxShared = 112 << 10;

}  // namespace

bool keeps_samples(int64_t height, int64_t width) {
  static size_t const most = [] {
    int device = 0, bytes = 0;
    cudaGetDevice(&device);
    cudaDeviceGetAttribute(&bytes, cudaDevAttrMaxSharedMemoryPerBlockOptin, device);
    return min(kMaxShared, size_t(bytes) - 2048);  // what is not dynamic
  }();
  return supports_clusters(warp_rows<BatchSource<float>, true, true>) &&
         shared_bytes(kept_floats(width, rows_in_cluster(height)), width, rows_in_cluster(height)) <= most;
}

template <class T>
int warp_and_color(WarpAndColor<T> const& p, CUstream_st* stream) {
  return launch_warp_rows<BatchSource<T>>(p, p.warp.y.batch, stream);
}

KV_INSTANTIATE_ONE(warp_and_color, WarpAndColor, float)
KV_INSTANTIATE_ONE(warp_and_color, WarpAndColor, uint8_t)
KV_INSTANTIATE_ONE(warp_and_color, WarpAndColor, ::kv::Half)
KV_INSTANTIATE_ONE(warp_and_color, WarpAndColor, ::kv::BFloat16)

}  // namespace kv::augmentation::cuda
