// RANSAC's scores on CUDA. Blocks read the points in chunks; after each the threads share the models that are left.
// With 70% wrong correspondences, where most are given up, 1.5x (fundamental) and 2.3x (essential) of a warp for each
// model.
#include "core/launch.cuh"
#include "geometry/ransac.h"

namespace kv::geometry::cuda {
namespace {

__device__ __forceinline__ float quotient(float a, float b) { return __fdividef(a, b); }  // within 2 last places
__device__ __forceinline__ double quotient(double a, double b) { return a / b; }

template <class T>
struct Score {
  T sum, count;
  __device__ __forceinline__ void add(Fraction<T> const& error, T t, T per_t) {
    T const e = quotient(error.above, error.below);
    if (e <= t) sum += 1 - e * per_t, count += 1;
  }
};

constexpr int kThreads = 128;
constexpr int kModels = 256;  // of one pair in a block
constexpr int kFew = 16;      // so many models are left to warps, whose threads take correspondences in turns

template <class T>
__global__ void __launch_bounds__(kThreads) score_models(__grid_constant__ Consensus<T> const p) {
  __shared__ T points[8][kChunk];
  __shared__ Score<T> scores[kModels];
  __shared__ int left[2][kModels], num_left[2];
  unsigned const blocks = ceil_div(unsigned(p.num_models), unsigned(kModels));
  int64_t const b = blockIdx.x / blocks, first = b * p.num_models + int64_t(blockIdx.x % blocks) * kModels;
  int64_t const num_models = min((b + 1) * p.num_models - first, int64_t(kModels));
  int const numbers = p.model == Model::lines ? 4 : 2;
  T const t = p.squared_threshold(b), per_t = 1 / t, least = p.least(b);
  auto const read_model = [&](int i, T(&m)[9]) {
#pragma unroll
    for (int k = 0; k < 9; ++k) m[k] = p.models[9 * (first + i) + k];
  };
  auto const store = [&](int i, Score<T> const& score) {
    p.scores[2 * (first + i)] = score.sum, p.scores[2 * (first + i) + 1] = score.count;
  };
  if (threadIdx.x < 2) num_left[threadIdx.x] = 0;
  __syncthreads();
  for (int i = threadIdx.x; i < num_models; i += kThreads) {
    T m[9], is_known = 0;
    read_model(i, m);
#pragma unroll
    for (int k = 0; k < 9; ++k) is_known += m[k];
    scores[i] = {};
    if (is_known == is_known)
      left[0][atomicAdd(&num_left[0], 1)] = i;
    else
      store(i, {});
  }
  __syncthreads();
  int now = 0;
  int64_t start = 0;
  for (; start < p.count && num_left[now] > kFew; start += kChunk, now ^= 1) {
    int const count = num_left[now], seen = int(min(p.count - start, int64_t(kChunk)));
    for (int i = threadIdx.x; i < 2 * numbers * kChunk; i += kThreads) {
      int const row = i / kChunk, k = i % kChunk;
      T const* const from = row < numbers ? p.points1 : p.points2;
      points[row][k] = k < seen ? from[(b * numbers + row % numbers) * p.count + start + k] : T(0);
    }
    if (threadIdx.x == 0) num_left[now ^ 1] = 0;
    __syncthreads();
    for (int at = threadIdx.x; at < count; at += kThreads) {
      int const i = left[now][at];
      T m[9];
      read_model(i, m);
      Score<T> score = scores[i];
#pragma unroll 4
      for (int k = 0; k < seen; ++k) {
        T one[4], two[4];
#pragma unroll
        for (int c = 0; c < 4; ++c)
          if (c < numbers) one[c] = points[c][k], two[c] = points[numbers + c][k];
        score.add(squared_error<T>(p.model, m, one, two), t, per_t);
      }
      if (least > 0 && seen == kChunk && score.sum < p.bound(least, start + kChunk))
        store(i, score);
      else
        left[now ^ 1][atomicAdd(&num_left[now ^ 1], 1)] = i, scores[i] = score;
    }
    __syncthreads();
  }
  for (int at = threadIdx.x / 32; at < num_left[now]; at += kThreads / 32) {
    int const i = left[now][at];
    T m[9];
    read_model(i, m);
    Score<T> const before = scores[i];
    Score<T> score{};
    for (int64_t from = start; from < p.count; from += kChunk) {
#pragma unroll
      for (int k = 0; k < kChunk; k += 32) {
        int64_t const own = from + k + threadIdx.x % 32;
        if (own < p.count) score.add(squared_error<T>(p, m, b, own, [](T const* x) { return *x; }), t, per_t);
      }
      if (least > 0 && from + kChunk <= p.count &&
          before.sum + warp_reduce(score.sum, Sum()) < p.bound(least, from + kChunk))
        break;
    }
    score = {before.sum + warp_reduce(score.sum, Sum()), before.count + warp_reduce(score.count, Sum())};
    if (threadIdx.x % 32 == 0) store(i, score);
  }
}

constexpr int kTopThreads = 1024;
constexpr int kListed = 1024;

// One block for each pair. Few models rank before the last one kept: each of these counts those that are better, 10x.
// Where they are too many, as may be where fewer are kept than asked for, each rank is the best of what the threads
// select.
template <class T>
__global__ void __launch_bounds__(kTopThreads) find_top_k(__grid_constant__ TopKModels<T> const p) {
  __shared__ int64_t warp_best[kTopThreads / 32];
  __shared__ T scores[kListed];
  __shared__ int list[kListed], num_listed;
  int64_t const b = blockIdx.x, last_kept = p.size() - 1;
  bool const is_full = p.kept.count == p.top_k;
  if (threadIdx.x == 0) num_listed = 0;
  __syncthreads();
  for (int64_t i = threadIdx.x; i < p.size(); i += kTopThreads) {
    if (is_full && i != last_kept && !p.is_better(b, i, last_kept)) continue;
    int const at = atomicAdd(&num_listed, 1);
    if (at < kListed) list[at] = int(i), scores[at] = p.score(b, i);
  }
  __syncthreads();
  if (num_listed <= kListed) {
    for (int i = threadIdx.x; i < num_listed; i += kTopThreads) {
      int rank = 0;
      for (int k = 0; k < num_listed; ++k)
        rank += scores[k] > scores[i] || (scores[k] == scores[i] && list[k] < list[i]);
      if (rank < p.top_k) p.copy(b, list[i], rank);
    }
    return;
  }
  int64_t last = -1;
  for (int64_t rank = 0; rank < p.top_k; ++rank) {
    int64_t best = p.next_best(b, last, threadIdx.x, kTopThreads);
    auto const better = [&](int64_t i, int64_t k) { return p.is_better(b, k, i) ? k : i; };
    best = warp_reduce(best, better);
    __syncthreads();  // other threads may still read the last rank's model
    if (threadIdx.x % 32 == 0) warp_best[threadIdx.x / 32] = best;
    __syncthreads();
    last = warp_reduce(warp_best[threadIdx.x % 32], better);
    if (threadIdx.x == 0) p.copy(b, last, rank);
  }
}

template <class T>
__global__ void __launch_bounds__(kMaxThreads) select_of_pairs(__grid_constant__ Selection<T> const p) {
  select_pair(p, blockIdx.x, ThreadBlock{});
}

}  // namespace

template <class T>
int select_inliers(Selection<T> const& p, CUstream_st* stream) {
  select_of_pairs<T><<<unsigned(p.batch), block_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int consensus(Consensus<T> const& p, CUstream_st* stream) {
  score_models<T><<<unsigned(p.batch * ceil_div(p.num_models, kModels)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int top_k_models(TopKModels<T> const& p, CUstream_st* stream) {
  find_top_k<T><<<unsigned(p.batch), kTopThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(consensus, Consensus)
KV_INSTANTIATE_COMPUTED(top_k_models, TopKModels)
KV_INSTANTIATE_ONE(select_inliers, Selection, double)

}  // namespace kv::geometry::cuda
