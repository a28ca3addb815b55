// Sums of products by group on CUDA: one block for each group of each problem. Threads have an entry of the result and
// a part of the sum each, which are added in order. Sums are in double.
#include "core/launch.cuh"
#include "geometry/optim/group_products.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kMaxThreads = 256;

template <class T>
__global__ void __launch_bounds__(kMaxThreads) sum_products(__grid_constant__ GroupProducts<T> const p) {
  __shared__ double parts[kMaxThreads];
  int64_t const b = blockIdx.x / p.groups, g = blockIdx.x % p.groups, first = p.first(g);
  int64_t const terms = (p.first(g + 1) - first) * p.inner, entries = p.rows * p.columns;
  for (int64_t begin = 0; begin < entries; begin += blockDim.x) {
    unsigned const width = entries - begin < blockDim.x ? unsigned(entries - begin) : blockDim.x;
    unsigned const lanes = blockDim.x / width, lane = threadIdx.x / width;
    int64_t const entry = begin + threadIdx.x % width, i = entry / p.columns, j = entry % p.columns;
    double sum = 0;
    if (lane < lanes)
      for (int64_t term = lane; term < terms; term += lanes) {
        int64_t const pair = first + term / p.inner, u = term % p.inner, row = p.left_row(pair);
        T const* const right = p.right_of(b, pair) + j * p.right_strides[3];
        double value = 0;
        if (p.middle) {
          T const* const middle = p.middle_of(b, row) + u * p.inner;
          for (int64_t v = 0; v < p.inner; ++v) value += double(middle[v]) * double(right[v * p.right_strides[2]]);
        } else {
          value = right[u * p.right_strides[2]];
        }
        sum += double(p.left_of(b, row)[u * p.left_strides[2] + i * p.left_strides[3]]) * value;
      }
    parts[threadIdx.x] = sum;
    __syncthreads();
    if (lane == 0) {
      for (unsigned k = 1; k < lanes; ++k) sum += parts[k * width + threadIdx.x];
      p.result[blockIdx.x * entries + entry] = T(sum);
    }
    __syncthreads();
  }
}

}  // namespace

template <class T>
int group_products(GroupProducts<T> const& p, CUstream_st* stream) {
  int64_t const work = p.pairs * p.inner * p.rows * p.columns / p.groups;  // of a block
  unsigned const blocks = unsigned(p.batch * p.groups), threads = work > 4096 ? kMaxThreads : work > 512 ? 64 : 32;
  sum_products<T><<<blocks, threads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(group_products, GroupProducts, float)
KV_INSTANTIATE_ONE(group_products, GroupProducts, double)

}  // namespace kv::geometry::cuda
