// Lovász losses on CUDA. Segments are sorted by a stable radix sort from the least significant digit. A block counts
// the digits of its chunk of a segment. A second kernel turns these counts into offsets, by prefix sums over chunks and
// digits. Then a block sorts its chunk in shared memory and scatters it to the offsets. Equal keys keep their order, so
// that all runs give the same bits.
#include "core/row_sums.cuh"
#include "lovasz.h"

namespace kv::losses::cuda {
namespace {

constexpr int kThreads = kRankedThreads, kWarps = kThreads / 32, kDigits = kRankedDigits;
constexpr int kScanThreads = 1024;

template <class F>
struct LovaszMath {
  __device__ __forceinline__ static F one() { return 1; }
  __device__ __forceinline__ static F exp(F x) {
    if constexpr (sizeof(F) == 4)
      return fast_exp2(x * F(1.44269504088896340736));
    else
      return ::exp(x);
  }
};

// --- errors and gradients: one thread per pixel ----------------------------------------------------------------------

template <class T>
__global__ void __launch_bounds__(kThreads)
    find_lovasz_errors(__grid_constant__ LovaszErrors<T> const p, unsigned blocks) {
  using F = Compute<T>;
  LovaszLabels const& labels = p.labels;
  int64_t const b = blockIdx.x / blocks, i = (blockIdx.x - b * blocks) * int64_t(kThreads) + threadIdx.x;
  if (i >= labels.pixels) return;
  T const* const x = p.logits + b * labels.classes * labels.pixels + i;
  F* const to = p.errors + b * labels.classes * labels.pixels + i;
  errors_of_pixels<F, LovaszMath<F>>(
      labels.hinge, labels.classes, labels.number<F>(b, i), [&](int64_t c) { return read(x[c * labels.pixels]); },
      [&](int64_t c, F e) { to[c * labels.pixels] = e; });
}

template <class T>
__global__ void __launch_bounds__(kThreads)
    find_lovasz_gradients(__grid_constant__ LovaszBackward<T> const p, unsigned blocks) {
  using F = Compute<T>;
  LovaszLabels const& labels = p.labels;
  int64_t const b = blockIdx.x / blocks, i = (blockIdx.x - b * blocks) * int64_t(kThreads) + threadIdx.x;
  if (i >= labels.pixels) return;
  int64_t const at = b * labels.classes * labels.pixels + i;
  F const* const grad = p.grad + b * labels.classes;
  gradients_of_pixels<F, LovaszMath<F>>(
      labels.hinge, labels.classes, labels.number<F>(b, i),
      [&](int64_t c) { return read(p.logits[at + c * labels.pixels]); },
      [&](int64_t c) { return p.gradients[at + c * labels.pixels] * grad[c]; },
      [&](int64_t c, F d) { p.grad_logits[at + c * labels.pixels] = round_to<T>(d); });
}

// --- sorting ---------------------------------------------------------------------------------------------------------

// Chunks of the segments from `first` on; the first pass reads the errors, and later passes read `from`.
template <class F>
struct Sorting {
  LovaszLabels labels;
  F const* errors;
  int64_t first;
  unsigned chunks;
  Ranked<F> const* from;  // or null
  Ranked<F>* to;
  uint32_t* counts;  // (segments, chunks, digits), followed by (segments, digits)
  uint32_t* starts;
  int shift;  // of the digit, in bits

  // The index of the block's segment within the group, and of its chunk within the segment.
  __device__ __forceinline__ unsigned segment() const { return blockIdx.x / chunks; }
  __device__ __forceinline__ int64_t start() const {
    return int64_t(blockIdx.x - segment() * chunks) * kRankedChunk<F>;
  }
  // Element i of the segment; past its end, a key that sorts last.
  __device__ __forceinline__ Ranked<F> at(int64_t i) const {
    if (i >= labels.pixels) return {typename Ranked<F>::Bits(-1), 0};
    if (from) return from[segment() * labels.pixels + i];
    int64_t const s = first + segment(), b = s / labels.classes;
    bool const inside = labels.is_inside(b, s - b * labels.classes, i);
    return Ranked<F>::of(errors[s * labels.pixels + i], i, inside);
  }
  __device__ __forceinline__ unsigned digit(Ranked<F> const& r) const { return unsigned(r.key >> shift) % kDigits; }
};

// The elements of a thread in a chunk: one of 32 adjacent elements per row of its warp, row after row.
template <class F>
struct Rows {
  static constexpr int kCount = kRankedChunk<F> / kThreads;
  __device__ __forceinline__ static int locate(int row) {
    return (threadIdx.x / 32 * kCount + row) * 32 + threadIdx.x % 32;
  }
};

// A mask of the threads of the warp that have the same digit.
__device__ __forceinline__ unsigned same_digit(unsigned digit) {
  unsigned same = 0xffffffffu;
#pragma unroll
  for (int bit = 1; bit < kDigits; bit *= 2) {
    unsigned const set = __ballot_sync(0xffffffffu, digit & bit);
    same &= digit & bit ? set : ~set;
  }
  return same;
}

__device__ __forceinline__ unsigned lanes_before() { return (1u << threadIdx.x % 32) - 1; }

// Adds the digits of a warp's rows to `counts`, and returns for every row the number of earlier elements with the
// thread's digit.
template <class F>
struct Digits {
  static constexpr int kRows = Rows<F>::kCount;
  Ranked<F> element[kRows];
  unsigned before[kRows];

  __device__ __forceinline__ Digits(Sorting<F> const& p, unsigned (&counts)[kWarps][kDigits]) {
    unsigned* const own = counts[threadIdx.x / 32];
    for (int i = threadIdx.x % 32; i < kDigits; i += 32) own[i] = 0;
    int64_t const start = p.start();
#pragma unroll
    for (int row = 0; row < kRows; ++row) element[row] = p.at(start + Rows<F>::locate(row));
    __syncwarp();
#pragma unroll
    for (int row = 0; row < kRows; ++row) {
      unsigned const digit = p.digit(element[row]), same = same_digit(digit), others = __popc(same & lanes_before());
      unsigned const count = own[digit];
      before[row] = count + others;
      __syncwarp();
      if (others == 0) own[digit] = count + __popc(same);
      __syncwarp();
    }
  }
};

template <class F>
__global__ void __launch_bounds__(kThreads) count_digits(__grid_constant__ Sorting<F> const p) {
  __shared__ unsigned counts[kWarps][kDigits];
  Digits<F> const digits(p, counts);
  __syncthreads();
  unsigned sum = 0;
  for (int w = 0; w < kWarps; ++w) sum += counts[w][threadIdx.x];
  // Padding of the last chunk is sorted behind all elements of the last digit, where nothing follows.
  p.counts[int64_t(blockIdx.x) * kDigits + threadIdx.x] = sum;
}

// One block per segment turns counts (chunks, digits) into the counts of the preceding chunks and the start of each
// digit. The groups of kDigits threads in a block split the chunks.
__global__ void __launch_bounds__(kScanThreads) scan_digits(uint32_t* counts, uint32_t* starts, unsigned chunks) {
  constexpr int kGroups = kScanThreads / kDigits;
  __shared__ unsigned sums[kGroups][kDigits];
  unsigned const digit = threadIdx.x % kDigits, group = threadIdx.x / kDigits;
  unsigned const chunks_per_group = (chunks + kGroups - 1) / kGroups, first = min(group * chunks_per_group, chunks);
  unsigned const last = min(first + chunks_per_group, chunks);
  counts += int64_t(blockIdx.x) * chunks * kDigits + digit;
  unsigned sum = 0;
#pragma unroll 8
  for (unsigned i = first; i < last; ++i) sum += counts[int64_t(i) * kDigits];
  sums[group][digit] = sum;
  __syncthreads();
  unsigned before = 0;
  for (unsigned g = 0; g < group; ++g) before += sums[g][digit];
#pragma unroll 8
  for (unsigned i = first; i < last; ++i) {
    unsigned const count = counts[int64_t(i) * kDigits];
    counts[int64_t(i) * kDigits] = before;
    before += count;
  }
  // The last group has the totals; a scan in shared memory sums those of smaller digits.
  __syncthreads();
  if (group == kGroups - 1) sums[0][digit] = before;
  __syncthreads();
  for (unsigned step = 1; step < kDigits; step *= 2) {
    unsigned const other = group == 0 && digit >= step ? sums[0][digit - step] : 0;
    __syncthreads();
    if (group == 0) sums[0][digit] += other;
    __syncthreads();
  }
  if (group == 0) starts[blockIdx.x * kDigits + digit] = digit > 0 ? sums[0][digit - 1] : 0;
}

template <class F>
__global__ void __launch_bounds__(kThreads, 3) move_digits(__grid_constant__ Sorting<F> const p) {
  constexpr int kChunk = kRankedChunk<F>;
  __shared__ unsigned counts[kWarps][kDigits], goes[kDigits], warp_sums[kWarps];
  __shared__ Ranked<F> sorted[kChunk];
  Digits<F> const digits(p, counts);
  __syncthreads();
  // For the digit of the thread: the count in preceding warps, and the end of the chunk's smaller digits.
  unsigned const digit = threadIdx.x, lane = threadIdx.x % 32;
  unsigned sum = 0;
#pragma unroll
  for (int w = 0; w < kWarps; ++w) {
    unsigned const count = counts[w][digit];
    counts[w][digit] = sum;
    sum += count;
  }
  unsigned const up_to = warp_prefix_sum(sum);
  if (lane == 31) warp_sums[threadIdx.x / 32] = up_to;
  __syncthreads();
  unsigned start = up_to - sum;
  for (unsigned w = 0; w < threadIdx.x / 32; ++w) start += warp_sums[w];
#pragma unroll
  for (int w = 0; w < kWarps; ++w) counts[w][digit] += start;
  goes[digit] = p.starts[p.segment() * kDigits + digit] + p.counts[int64_t(blockIdx.x) * kDigits + digit] - start;
  __syncthreads();
#pragma unroll
  for (int row = 0; row < Digits<F>::kRows; ++row) {
    Ranked<F> const r = digits.element[row];
    sorted[counts[threadIdx.x / 32][p.digit(r)] + digits.before[row]] = r;
  }
  __syncthreads();
  int const size = int(min(int64_t(kChunk), p.labels.pixels - p.start()));
  Ranked<F>* const to = p.to + p.segment() * p.labels.pixels;
#pragma unroll 4
  for (int i = threadIdx.x; i < size; i += kThreads) {
    Ranked<F> const r = sorted[i];
    to[goes[p.digit(r)] + unsigned(i)] = r;
  }
}

// --- gradients of sorted segments ------------------------------------------------------------------------------------

template <class F>
__global__ void __launch_bounds__(kThreads)
    count_inside(Ranked<F> const* ranked, int64_t pixels, unsigned chunks, uint32_t* counts) {
  constexpr int kChunk = kRankedChunk<F>;
  unsigned const segment = blockIdx.x / chunks;
  int64_t const start = int64_t(blockIdx.x - segment * chunks) * kChunk;
  unsigned count = 0;
#pragma unroll 4
  for (int64_t i = start + threadIdx.x; i < min(start + kChunk, pixels); i += kThreads)
    count += ranked[segment * pixels + i].inside();
  count = block_sum<kSumThreads>(count);
  if (threadIdx.x == 0) counts[blockIdx.x] = count;
}

// One block per chunk of a segment: scatters the gradients of its elements to the pixels, and sums its part of the
// loss.
template <class F>
__global__ void __launch_bounds__(kThreads) compute_gradients(Ranked<F> const* ranked, int64_t pixels, unsigned chunks,
                                                              uint32_t const* counts, F* gradients, F* partial) {
  constexpr int kRows = Rows<F>::kCount;
  __shared__ unsigned sums[2][kWarps], warp_sums[kWarps];
  unsigned const segment = blockIdx.x / chunks, chunk = blockIdx.x - segment * chunks;
  unsigned const warp = threadIdx.x / 32, lane = threadIdx.x % 32;
  int64_t const start = int64_t(chunk) * kRankedChunk<F>;
  ranked += segment * pixels, gradients += segment * pixels, counts += segment * chunks;

  unsigned total = 0, before = 0;  // the totals of all chunks, and of the preceding ones
  for (unsigned i = threadIdx.x; i < chunks; i += kThreads) {
    unsigned const count = counts[i];
    total += count, before += i < chunk ? count : 0;
  }
  total = warp_reduce(total, Sum()), before = warp_reduce(before, Sum());
  Ranked<F> element[kRows];
  unsigned inside[kRows], of_warp = 0;
#pragma unroll
  for (int row = 0; row < kRows; ++row) {
    int64_t const i = start + Rows<F>::locate(row);
    element[row] = i < pixels ? ranked[i] : Ranked<F>{0, 0};
    inside[row] = __ballot_sync(0xffffffffu, element[row].inside());
    of_warp += __popc(inside[row]);
  }
  if (lane == 0) sums[0][warp] = total, sums[1][warp] = before, warp_sums[warp] = of_warp;
  __syncthreads();
  unsigned all = 0, result = 0;
  for (unsigned w = 0; w < kWarps; ++w) {
    all += sums[0][w], result += sums[1][w];
    if (w < warp) result += warp_sums[w];
  }
  F loss = 0;
#pragma unroll
  for (int row = 0; row < kRows; ++row) {
    int64_t const i = start + Rows<F>::locate(row);
    Ranked<F> const r = element[row];
    unsigned const with_it = result + __popc(inside[row] & (lanes_before() | 1u << lane));
    result += __popc(inside[row]);
    if (i >= pixels) continue;
    F const derivative = jaccard_derivative<F>(r.inside(), all, with_it, unsigned(i + 1) - with_it);
    loss += r.error() * derivative;
    gradients[r.pixel()] = derivative;
  }
  loss = block_sum<kSumThreads>(loss);
  if (threadIdx.x == 0) partial[blockIdx.x] = loss;
}

}  // namespace

template <class T>
int lovasz_errors(LovaszErrors<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(ceil_div(p.labels.pixels, kThreads));
  find_lovasz_errors<<<unsigned(p.labels.batch * blocks), kThreads, 0, stream>>>(p, blocks);
  return cudaGetLastError();
}

template <class T>
int lovasz_backward(LovaszBackward<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(ceil_div(p.labels.pixels, kThreads));
  find_lovasz_gradients<<<unsigned(p.labels.batch * blocks), kThreads, 0, stream>>>(p, blocks);
  return cudaGetLastError();
}

template <class F>
int lovasz_gradients(LovaszGradients<F> const& p, CUstream_st* stream) {
  int64_t const n = p.labels.pixels, segments = p.labels.segments();
  unsigned const chunks = unsigned(ceil_div(n, kRankedChunk<F>));
  for (int64_t first = 0; first < segments; first += p.at_once) {
    int64_t const count = min(p.at_once, segments - first);
    unsigned const blocks = unsigned(count * chunks);
    Sorting<F> sorting{
        p.labels, p.gradients, first, chunks, nullptr, p.ranked[0], p.counts, p.counts + int64_t(blocks) * kDigits, 0};
    for (; sorting.shift < 8 * int(sizeof(F)); sorting.shift += 8) {
      count_digits<<<blocks, kThreads, 0, stream>>>(sorting);
      scan_digits<<<unsigned(count), kScanThreads, 0, stream>>>(sorting.counts, sorting.starts, chunks);
      move_digits<<<blocks, kThreads, 0, stream>>>(sorting);
      sorting.from = sorting.to;
      sorting.to = p.ranked[sorting.to == p.ranked[0]];
    }
    count_inside<<<blocks, kThreads, 0, stream>>>(sorting.from, n, chunks, p.counts);
    compute_gradients<<<blocks, kThreads, 0, stream>>>(sorting.from, n, chunks, p.counts, p.gradients + first * n,
                                                       p.partial + first * chunks);
  }
  return sum_chunks(p.partial, segments, int64_t(chunks), p.losses, stream);
}

KV_INSTANTIATE(lovasz_errors, LovaszErrors)
KV_INSTANTIATE_COMPUTED(lovasz_gradients, LovaszGradients)
KV_INSTANTIATE(lovasz_backward, LovaszBackward)

}  // namespace kv::losses::cuda
