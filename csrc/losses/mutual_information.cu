// Mutual information on CUDA. Forward: the ranges of the signals' chunks, joint histograms, then the loss and its
// gradients. Backward: the gradients of the samples' positions, then the contributions of the minimum and maximum of
// each range. Histograms are fixed-point sums, so that the order of atomic additions does not change the result. They
// are in shared memory where they fit, with two words per bin.
#include "core/row_sums.cuh"
#include "mutual_information.h"

namespace kv::losses::cuda {
namespace {

constexpr int kThreads = kSumThreads, kFinalizeThreads = 1024;
constexpr int kShared = 5632;  // bins of a joint histogram that fit a block's shared memory

__device__ __forceinline__ unsigned fixed_point(float x) { return __float2uint_rn(x); }  // at most 30 bits
__device__ __forceinline__ unsigned long long fixed_point(double x) { return __double2ull_rn(x); }

// The row of a block, and its samples.
struct Chunk {
  int64_t row, first, last;

  __device__ __forceinline__ Chunk(int64_t chunks, int64_t samples) : row(blockIdx.x / chunks) {
    int64_t const each = ceil_div(samples, chunks), chunk = blockIdx.x - row * chunks;
    first = min(chunk * each, samples), last = min(first + each, samples);
  }
};

// Ranges are kept as -low and high.
template <class F>
__global__ void __launch_bounds__(kThreads) find_ranges(__grid_constant__ MutualInformation<F> const p) {
  Chunk const at(p.chunks, p.samples);
  F ends[] = {-F(INFINITY), -F(INFINITY), -F(INFINITY), -F(INFINITY)};
#pragma unroll 4
  for (int64_t i = at.first + threadIdx.x; i < at.last; i += kThreads) {
    F const x = p.x.at(at.row, i), y = p.y.at(at.row, i);
    if (p.x.counts(at.row, i)) ends[0] = NanMax()(ends[0], -x), ends[1] = NanMax()(ends[1], x);
    if (p.y.counts(at.row, i)) ends[2] = NanMax()(ends[2], -y), ends[3] = NanMax()(ends[3], y);
  }
  block_reduce<kSumThreads>(ends, NanMax());
  if (threadIdx.x < 4) p.partial[4 * int64_t(blockIdx.x) + threadIdx.x] = ends[threadIdx.x];
}

template <class F>
__global__ void __launch_bounds__(kThreads) count_pairs(__grid_constant__ MutualInformation<F> const p) {
  __shared__ unsigned low_words[kShared], high_words[kShared];
  Chunk const at(p.chunks, p.samples);
  int const bins = p.binning.bins, cells = bins * bins;
  bool const shared = cells <= kShared;
  for (int i = threadIdx.x; shared && i < cells; i += kThreads) low_words[i] = high_words[i] = 0;
  F ends[] = {-F(INFINITY), -F(INFINITY), -F(INFINITY), -F(INFINITY)};
  for (int64_t i = threadIdx.x; i < p.chunks; i += kThreads)
#pragma unroll
    for (int k = 0; k < 4; ++k) ends[k] = NanMax()(ends[k], p.partial[4 * (at.row * p.chunks + i) + k]);
  block_reduce<kSumThreads>(ends, NanMax());
  SignalRange<F> const of_x{-ends[0], ends[1]}, of_y{-ends[2], ends[3]};
  if (at.first == 0 && threadIdx.x < 4)
    p.ranges[4 * at.row + threadIdx.x] = threadIdx.x % 2 == 0 ? -ends[threadIdx.x] : ends[threadIdx.x];
  if (!of_x.is_finite() || !of_y.is_finite()) return;
  unsigned long long* const counts = p.counts + at.row * cells;
  F const scale = F(1ll << p.bits);
  for (int64_t i = at.first + threadIdx.x; i < at.last; i += kThreads) {
    if (!p.x.counts(at.row, i) || !p.y.counts(at.row, i)) continue;
    F const fraction_x = of_x.fraction(p.x.at(at.row, i), p.binning.epsilon);
    F const fraction_y = of_y.fraction(p.y.at(at.row, i), p.binning.epsilon);
    p.binning.for_each_bin(fraction_x, [&](int k, F t) {
      F const weight = p.binning.weight(t < 0 ? -t : t) * scale;
      p.binning.for_each_bin(fraction_y, [&](int m, F u) {
        auto const fixed = fixed_point(weight * p.binning.weight(u < 0 ? -u : u));
        int const cell = k * bins + m;
        if (!shared) {
          atomicAdd(counts + cell, static_cast<unsigned long long>(fixed));
          return;
        }
        unsigned const low = unsigned(fixed), before = atomicAdd(low_words + cell, low);
        unsigned const high = unsigned(uint64_t(fixed) >> 32) + (before + low < before);
        if (high) atomicAdd(high_words + cell, high);
      });
    });
  }
  __syncthreads();
  for (int i = threadIdx.x; shared && i < cells; i += kThreads) {
    unsigned long long const result = static_cast<unsigned long long>(high_words[i]) << 32 | low_words[i];
    if (result) atomicAdd(counts + i, result);
  }
}

// One block per row.
template <class F>
__global__ void __launch_bounds__(kFinalizeThreads) find_information(__grid_constant__ MutualInformation<F> const p) {
  int64_t const row = blockIdx.x;
  int const bins = p.binning.bins, cells = bins * bins, lane = threadIdx.x % 32;
  unsigned long long const* const counts = p.counts + row * cells;
  F *const gradients = p.gradients + row * cells, *const of_x = p.sums + row * 2 * bins, *const of_y = of_x + bins;
  F const* const ranges = p.ranges + 4 * row;
  bool const finite =
      SignalRange<F>{ranges[0], ranges[1]}.is_finite() && SignalRange<F>{ranges[2], ranges[3]}.is_finite();
  F const scale = p.binning.top * p.binning.top / F(1ll << p.bits);
  auto const count_of = [&](int i) {
    F const result = F(counts[i]) * scale;
    return result < p.min_count ? p.min_count : result;
  };
  double of_all[1] = {};
  for (int k = threadIdx.x / 32; k < bins; k += kFinalizeThreads / 32) {
    double sum = 0;
    for (int m = lane; m < bins; m += 32) sum += count_of(k * bins + m);
    sum = warp_reduce(sum, Sum());
    if (lane == 0) of_x[k] = F(sum), of_all[0] += sum;
  }
  // If there are more threads than columns, several threads split a column.
  __shared__ double parts[kFinalizeThreads];
  int const fraction = max(kFinalizeThreads / bins, 1), columns = kFinalizeThreads / fraction;
  int const part = int(threadIdx.x) / columns, of_part = int(threadIdx.x) % columns;
  for (int first = 0; first < bins; first += columns) {
    int const m = first + of_part;
    double sum = 0;
    if (part < fraction && m < bins)
      for (int k = part; k < bins; k += fraction) sum += count_of(k * bins + m);
    __syncthreads();
    parts[threadIdx.x] = sum;
    __syncthreads();
    for (int i = 1; part == 0 && i < fraction; ++i) sum += parts[i * columns + of_part];
    if (part == 0 && m < bins) of_y[m] = F(sum);
  }
  block_reduce<kFinalizeThreads>(of_all, Sum());  // its barrier also publishes the sums of other threads
  F const all = F(of_all[0]), inverse = 1 / all;
  double entropies[3] = {};
  for (int i = threadIdx.x; i < 2 * bins; i += kFinalizeThreads) {
    F const fraction = of_x[i] * inverse, log_of = ::log(fraction);
    entropies[i < bins ? 1 : 2] -= fraction * log_of;
  }
  for (int i = threadIdx.x; i < cells; i += kFinalizeThreads) {
    F const fraction = count_of(i) * inverse;
    entropies[0] -= fraction * ::log(fraction);
  }
  block_reduce<kFinalizeThreads>(entropies, Sum());
  Entropies<F> const h{entropies[0], entropies[1], entropies[2]};
  F const loss = finite ? F(h.loss(p.normalized)) : F(NAN);
  if (threadIdx.x == 0) p.loss[row] = loss;
  for (int i = threadIdx.x; i < cells; i += kFinalizeThreads) {
    int const k = i / bins, m = i - k * bins;
    F const log_x = ::log(of_x[k] * inverse), log_y = ::log(of_y[m] * inverse), log_p = ::log(count_of(i) * inverse);
    bool const too_few = finite && F(counts[i]) * scale < p.min_count;
    gradients[i] = too_few ? F(0) : h.derivative(p.normalized, loss, log_x, log_y, log_p) * inverse;
  }
}

// The gradients through the samples' positions, and the chunk's sums for the ends of the range.
template <class F>
__global__ void __launch_bounds__(kThreads) sample_gradients(__grid_constant__ MutualInformationBackward<F> const p) {
  Chunk const at(p.chunks, p.samples);
  Signal<F> const& own = p.by_y ? p.y : p.x;
  SignalRange<F> const range = p.range(at.row, p.by_y);
  bool const flat = range.is_flat(p.binning.epsilon);
  F const inverse = 1 / (range.high - range.low);
  EndSums<F> ends{};
  for (int64_t i = at.first + threadIdx.x; i < at.last; i += kThreads) {
    F const grad_fraction = flat ? F(0) : p.grad_fraction_at(at.row, i);
    if (own.counts(at.row, i)) {
      F const x = own.at(at.row, i);
      ends.add(grad_fraction, range.fraction(x, p.binning.epsilon));
      ends.count(x == range.low, x == range.high);
    }
    p.out[at.row * p.samples + i] = flat ? F(0) : grad_fraction * inverse;
  }
  double result[] = {ends.low, ends.high, ends.lowest, ends.highest};
  block_reduce<kSumThreads>(result, Sum());
  if (threadIdx.x < 4) p.partial[4 * int64_t(blockIdx.x) + threadIdx.x] = F(result[threadIdx.x]);
}

template <class F>
__global__ void __launch_bounds__(kThreads) add_to_ends(__grid_constant__ MutualInformationBackward<F> const p) {
  Chunk const at(p.chunks, p.samples);
  Signal<F> const& own = p.by_y ? p.y : p.x;
  SignalRange<F> const range = p.range(at.row, p.by_y);
  F const* const chunk = p.partial + 4 * int64_t(blockIdx.x);
  if (range.is_flat(p.binning.epsilon) || chunk[2] + chunk[3] == 0) return;  // the chunk has no minimum and no maximum
  double ends[4] = {};
  for (int64_t i = threadIdx.x; i < p.chunks; i += kThreads)
#pragma unroll
    for (int k = 0; k < 4; ++k) ends[k] += p.partial[4 * (at.row * p.chunks + i) + k];
  block_reduce<kSumThreads>(ends, Sum());
  F const inverse = 1 / (range.high - range.low);
  F const grad_low = F(ends[0] / ends[2]) * inverse, grad_high = F(ends[1] / ends[3]) * inverse;
  for (int64_t i = at.first + threadIdx.x; i < at.last; i += kThreads) {
    F const x = own.at(at.row, i);
    if (!own.counts(at.row, i) || (x != range.low && x != range.high)) continue;
    p.out[at.row * p.samples + i] += (x == range.low ? grad_low : F(0)) + (x == range.high ? grad_high : F(0));
  }
}

}  // namespace

template <class F>
int mutual_information(MutualInformation<F> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.rows * p.chunks);
  size_t const bytes = sizeof(*p.counts) * size_t(p.rows) * p.binning.bins * p.binning.bins;
  if (int const error = cudaMemsetAsync(p.counts, 0, bytes, stream)) return error;
  find_ranges<<<blocks, kThreads, 0, stream>>>(p);
  count_pairs<<<blocks, kThreads, 0, stream>>>(p);
  find_information<<<unsigned(p.rows), kFinalizeThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class F>
int mutual_information_backward(MutualInformationBackward<F> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.rows * p.chunks);
  sample_gradients<<<blocks, kThreads, 0, stream>>>(p);
  add_to_ends<<<blocks, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(mutual_information, MutualInformation)
KV_INSTANTIATE_COMPUTED(mutual_information_backward, MutualInformationBackward)

}  // namespace kv::losses::cuda
