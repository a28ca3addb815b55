// Suppression of boxes on CUDA, without the host. First all pairs of a strip of boxes are compared at once: a thread
// compares a box with 64 others, whose results are the bits of a word. Then a block per sample goes through the strip,
// 64 boxes a step: those that are kept are found one after the other among themselves, and remove others all at once.
#include "core/launch.cuh"
#include "suppression.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kScanThreads = 1024, kGroups = 8, kWordsOfPass = kScanThreads / kGroups;
constexpr int kSoftThreads = 1024;
constexpr unsigned kMostSamples = 32768;  // of a grid; blocks go on with others

// Boxes from `first` on; gridDim = (words, 64 boxes of the strip, samples).
template <class F>
__global__ void __launch_bounds__(kBoxesOfWord)
    compare_boxes(__grid_constant__ BoxSuppression<F> const p, int64_t first) {
  __shared__ BoxEdges<F> others[kBoxesOfWord];
  __shared__ int64_t labels[kBoxesOfWord];
  int64_t const word = blockIdx.x, row = blockIdx.y * int64_t(kBoxesOfWord) + threadIdx.x, i = first + row;
  if ((word + 1) * kBoxesOfWord <= i - threadIdx.x) return;  // boxes in front of these
  int64_t const k = word * kBoxesOfWord + threadIdx.x;
  int const count = int(min(p.n - word * kBoxesOfWord, int64_t(kBoxesOfWord)));
  for (int64_t sample = blockIdx.z; sample < p.batch; sample += gridDim.z) {
    F const* const edges = p.edges + sample * 4 * p.n;
    __syncthreads();  // the last sample's boxes may be in use
    if (k < p.n) {
      others[threadIdx.x] = box_at(edges, p.n, k);
      if (p.labels) labels[threadIdx.x] = p.labels[sample * p.n + k];
    }
    __syncthreads();
    if (i >= p.n) continue;
    BoxEdges<F> const own = box_at(edges, p.n, i);
    int64_t const label = p.labels ? p.labels[sample * p.n + i] : 0;
    uint64_t bits = 0;
    for (int c = 0; c < count; ++c) {
      BoxEdges<F> const other = others[c];
      bool const crosses = own.x0 < other.x1 && other.x0 < own.x1 && own.y0 < other.y1 && other.y0 < own.y1;
      if (!crosses && p.threshold >= 0) continue;
      if (own.overlap(other) > p.threshold && (!p.labels || labels[c] == label)) bits |= uint64_t(1) << c;
    }
    p.overlaps[(sample * p.strip + row) * p.words() + word] = bits;
  }
}

template <class F>
__global__ void __launch_bounds__(kScanThreads)
    scan_boxes(__grid_constant__ BoxSuppression<F> const p, int64_t first, int64_t last) {
  __shared__ uint64_t among[kBoxesOfWord];
  int64_t const sample = blockIdx.x, words = p.words();
  uint64_t* const removed = p.removed + sample * words;
  int const group = threadIdx.x / kWordsOfPass, lane = threadIdx.x % kWordsOfPass;
  for (int64_t start = first; start < last; start += kBoxesOfWord) {
    int64_t const word = start / kBoxesOfWord;
    int const count = int(min(p.n - start, int64_t(kBoxesOfWord)));
    uint64_t const* const rows = p.overlaps + (sample * p.strip + start - first) * words;
    if (threadIdx.x < count) among[threadIdx.x] = rows[threadIdx.x * words + word];
    __syncthreads();  // the last step's removals, too
    uint64_t gone = __ldcg(reinterpret_cast<unsigned long long const*>(removed + word)), kept = 0;
    for (int i = 0; i < count; ++i) {
      if (gone >> i & 1) continue;
      kept |= uint64_t(1) << i;
      gone |= among[i] & ~(~uint64_t(0) >> (63 - i));  // those behind it
    }
    if (threadIdx.x < count) p.kept[sample * p.n + start + threadIdx.x] = kept >> threadIdx.x & 1;
    for (int64_t w = word + 1 + lane; w < words; w += kWordsOfPass) {
      uint64_t bits = 0;
#pragma unroll
      for (int k = 0; k < kBoxesOfWord / kGroups; ++k) {
        int const i = k * kGroups + group;
        if (kept >> i & 1) bits |= rows[i * words + w];
      }
      if (bits) atomicOr(reinterpret_cast<unsigned long long*>(removed + w), static_cast<unsigned long long>(bits));
    }
    __threadfence_block();
    __syncthreads();  // before the next step's pairs
  }
}

// The larger score wins, then the first box.
template <class F>
struct Candidate {
  F score;
  int64_t at;

  __device__ __forceinline__ bool beats(Candidate const& other) const {
    return score > other.score || (score == other.score && at < other.at);
  }
  __device__ __forceinline__ Candidate best_of_warp() const {
    Candidate best = *this;
#pragma unroll
    for (int step = 16; step > 0; step /= 2) {
      Candidate const other{__shfl_xor_sync(0xffffffffu, best.score, step),
                            __shfl_xor_sync(0xffffffffu, best.at, step)};
      if (other.beats(best)) best = other;
    }
    return best;
  }
};

// A block per sample: every round a thread updates its boxes by the last choice and finds the best of them.
template <class F>
__global__ void __launch_bounds__(kSoftThreads) choose_boxes(__grid_constant__ SoftBoxSuppression<F> const p) {
  __shared__ Candidate<F> of_warps[2][kSoftThreads / 32];
  int64_t const sample = blockIdx.x;
  F const* const edges = p.edges + sample * 4 * p.n;
  F* const left = p.left + sample * p.n;
  F const lowest = -F(__builtin_inf());
  int64_t round = 0, last = -1;
  BoxEdges<F> own{};
  for (; round < p.n; ++round) {
    Candidate<F> best{lowest, p.n};
    for (int64_t k = threadIdx.x; k < p.n; k += kSoftThreads) {
      if (k == last)
        left[k] = lowest;
      else if (last >= 0)
        p.update(sample, own, last, k);
      Candidate<F> const candidate{left[k], k};
      if (candidate.beats(best)) best = candidate;
    }
    best = best.best_of_warp();
    auto& shared = of_warps[round % 2];  // two, so that one barrier a round is enough
    if (threadIdx.x % 32 == 0) shared[threadIdx.x / 32] = best;
    __syncthreads();
    best = shared[threadIdx.x % 32].best_of_warp();
    if (!(best.score >= p.min_score) || best.score == lowest) break;
    last = best.at;
    own = box_at(edges, p.n, last);
    if (threadIdx.x == 0) {
      p.order[sample * p.n + round] = last;
      p.scores[sample * p.n + round] = best.score;
    }
  }
  for (round += threadIdx.x; round < p.n; round += kSoftThreads) {
    p.order[sample * p.n + round] = -1;
    p.scores[sample * p.n + round] = 0;
  }
}

}  // namespace

template <class F>
int suppress_boxes(BoxSuppression<F> const& p, CUstream_st* stream) {
  cudaError_t const error = cudaMemsetAsync(p.removed, 0, size_t(p.batch * p.words()) * sizeof(uint64_t), stream);
  if (error != cudaSuccess) return error;
  for (int64_t first = 0; first < p.n; first += p.strip) {
    int64_t const last = min(first + p.strip, p.n);
    dim3 const blocks(unsigned(p.words()), unsigned(ceil_div(last - first, int64_t(kBoxesOfWord))),
                      unsigned(min(p.batch, int64_t(kMostSamples))));
    compare_boxes<<<blocks, kBoxesOfWord, 0, stream>>>(p, first);
    scan_boxes<<<unsigned(p.batch), kScanThreads, 0, stream>>>(p, first, last);
  }
  return cudaGetLastError();
}

template <class F>
int soft_suppress_boxes(SoftBoxSuppression<F> const& p, CUstream_st* stream) {
  choose_boxes<<<unsigned(p.batch), kSoftThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(suppress_boxes, BoxSuppression)
KV_INSTANTIATE_COMPUTED(soft_suppress_boxes, SoftBoxSuppression)

}  // namespace kv::geometry::cuda
