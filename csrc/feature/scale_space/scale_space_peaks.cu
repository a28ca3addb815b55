// Peaks of scale spaces on CUDA. Threads search the voxels of all levels and list the ranks of those that are peaks,
// in any order. Then a block for each sample selects the strongest digit by digit, sorts them, and refines them again:
// the same peaks in the same order every run.
#include "core/block_reduce.cuh"
#include "feature/scale_space/scale_space_peaks.h"

namespace kv::feature::cuda {
namespace {

constexpr int kThreads = 256, kChooseThreads = 1024;
constexpr int kSharedBytes = 32768;  // of ranks that are sorted in shared memory

template <class T>
__device__ __forceinline__ auto response_of(bool differences, int64_t plane) {
  auto const load_one = [](T const* level) { return read(*level); };
  return ResponseAt<T, decltype(load_one)>{differences ? plane : 0, load_one};
}

// The response around a voxel in its level.
template <class F>
struct Neighborhood {
  F center, lowest, highest;  // the extrema of the other eight
  bool all_numbers;

  template <class At>
  __device__ __forceinline__ explicit Neighborhood(At at) : center(at(0, 0)), all_numbers(center == center) {
    lowest = highest = at(0, 1);
#pragma unroll
    for (int j = -1; j <= 1; ++j)
#pragma unroll
      for (int i = -1; i <= 1; ++i)
        if (i != 0 || j != 0) {
          F const other = at(j, i);
          lowest = min(lowest, other), highest = max(highest, other);  // which skip NaN
          all_numbers = all_numbers && other == other;
        }
  }
  __device__ __forceinline__ bool is_below(F value) const { return value > highest && value > center && all_numbers; }
  __device__ __forceinline__ bool is_above(F value) const { return value < lowest && value < center && all_numbers; }
};

// Adds an extremum to the list of its sample, if it is a peak.
template <class T, class Response, class At>
__device__ __forceinline__ void list_if_peak(ScaleSpacePeaks<T> const& p, PeakOctave<T> const& octave, int64_t sample,
                                             T const* levels, int z, int y, int x, bool is_maximum, Response response,
                                             At around) {
  refine_peak(p, octave, sample, levels, z, y, x, is_maximum, response, around,
              [&](ScaleSpacePeak<Compute<T>> const& peak) {
                auto* const size = reinterpret_cast<unsigned long long*>(p.sizes + sample);
                int64_t const slot = int64_t(atomicAdd(size, 1ull));
                if (slot < p.capacity) p.ranks[sample * p.capacity + slot] = {peak.score, int(peak.voxel)};
              });
}

template <class T, class Response>
__device__ __forceinline__ auto response_around(T const* levels, PeakOctave<T> const& octave, int z, int y, int x,
                                                Response response) {
  int const width = octave.size[2];
  T const* const center = levels + z * octave.plane() + int64_t(y) * width + x;
  return [=](int dy, int dx) { return response(center[int64_t(dy) * width + dx]); };
}

// Lists the peaks of octaves with any number of levels. One block per tile, of all octaves one after the other; samples
// are along y.
template <class T>
__global__ void __launch_bounds__(kThreads) list_peaks(__grid_constant__ ScaleSpacePeaks<T> const p) {
  using F = Compute<T>;
  PeakOctave<T> const& octave = p.octave_of_part(int(blockIdx.x));
  int const depth = octave.size[0], height = octave.size[1], width = octave.size[2];
  int const tile = int(blockIdx.x) - octave.first_part, across = peak_tiles_across(width);
  auto const response = response_of<T>(p.differences, octave.plane());
  for (int64_t sample = blockIdx.y; sample < p.samples; sample += gridDim.y) {
    T const* const levels = octave.of_sample(sample, p.differences);
    for (int at = int(threadIdx.x); at < kPeakTileWidth * kPeakTileHeight; at += kThreads) {
      int const x = 1 + tile % across * kPeakTileWidth + at % kPeakTileWidth;
      int const y = 1 + tile / across * kPeakTileHeight + at / kPeakTileWidth;
      if (x > width - 2 || y > height - 2) continue;
      auto const around = [&](int z) { return response_around(levels, octave, z, y, x, response); };
      Neighborhood<F> lower(around(0)), here(around(1));
      for (int z = 1; z + 1 < depth; ++z) {
        Neighborhood<F> const upper(around(z + 1));
        F const v = here.center;
        bool const numbers = here.all_numbers;
        bool const is_maximum = v > here.highest && numbers && lower.is_below(v) && upper.is_below(v);
        bool const is_minimum = p.minima && v < here.lowest && numbers && lower.is_above(v) && upper.is_above(v);
        if (is_maximum || is_minimum) list_if_peak(p, octave, sample, levels, z, y, x, is_maximum, response, around(z));
        lower = here, here = upper;
      }
    }
  }
}

// A pixel and its two neighbors in a row, in all levels: the values of the pixel, and the extrema of the three pixels
// and of the two neighbors. Bit z of `odd` is set if one of the three is NaN in level z, because minima and maxima skip
// NaN.
template <class F, int Levels>
struct RowExtrema {
  F own[Levels], highest[Levels], lowest[Levels], highest_other[Levels], lowest_other[Levels];
  unsigned odd;
};

// Lists the peaks of octaves with a fixed number of levels. A lane has a column, and the outermost two columns of a
// warp belong to adjacent tiles. A warp traverses some rows downwards, so that a voxel is read once.
template <class T, int Levels>
__global__ void __launch_bounds__(kThreads) list_peaks_of_rows(__grid_constant__ ScaleSpacePeaks<T> const p) {
  using F = Compute<T>;
  constexpr int kRows = kPeakTileHeight / (kThreads / 32);
  constexpr unsigned kAllLanes = 0xffffffffu;
  PeakOctave<T> const& octave = p.octave_of_part(int(blockIdx.x));
  int const height = octave.size[1], width = octave.size[2], lane = int(threadIdx.x) % 32;
  int const tile = int(blockIdx.x) - octave.first_part, across = peak_tiles_across(width);
  int const x = tile % across * kPeakTileWidth + lane;
  int const y0 = 1 + tile / across * kPeakTileHeight + int(threadIdx.x) / 32 * kRows;
  bool const is_inside = lane > 0 && lane < 31 && x < width - 1;
  if (y0 > height - 2) return;  // a warp as a whole
  int64_t const plane = octave.plane();
  auto const response = response_of<T>(p.differences, plane);
  for (int64_t sample = blockIdx.y; sample < p.samples; sample += gridDim.y) {
    T const* const levels = octave.of_sample(sample, p.differences);
    auto const read_row = [&](int y, RowExtrema<F, Levels>& row) {
      T const* const at = levels + int64_t(y) * width + min(x, width - 1);
      F values[Levels + 1];
#pragma unroll
      for (int z = 0; z <= Levels; ++z)
        if (z < Levels || p.differences) values[z] = read(at[z * plane]);
      unsigned odd = 0;
#pragma unroll
      for (int z = 0; z < Levels; ++z) {
        row.own[z] = p.differences ? values[z + 1] - values[z] : values[z];
        odd |= row.own[z] == row.own[z] ? 0u : 1u << z;
      }
      row.odd = odd | __shfl_up_sync(kAllLanes, odd, 1) | __shfl_down_sync(kAllLanes, odd, 1);
#pragma unroll
      for (int z = 0; z < Levels; ++z) {
        F const left = __shfl_up_sync(kAllLanes, row.own[z], 1), right = __shfl_down_sync(kAllLanes, row.own[z], 1);
        row.highest_other[z] = max(left, right), row.lowest_other[z] = min(left, right);
        row.highest[z] = max(row.highest_other[z], row.own[z]), row.lowest[z] = min(row.lowest_other[z], row.own[z]);
      }
    };
    RowExtrema<F, Levels> rows[3];
    read_row(y0 - 1, rows[0]);
    read_row(y0, rows[1]);
    int const y1 = min(y0 + kRows, height - 1);
#pragma unroll 1
    for (int y = y0; y < y1; ++y) {
      read_row(y + 1, rows[2]);
      unsigned const odd = rows[0].odd | rows[1].odd | rows[2].odd;
      F highest[Levels], lowest[Levels];
#pragma unroll
      for (int z = 0; z < Levels; ++z) {
        highest[z] = max(max(rows[0].highest[z], rows[1].highest[z]), rows[2].highest[z]);
        lowest[z] = min(min(rows[0].lowest[z], rows[1].lowest[z]), rows[2].lowest[z]);
      }
#pragma unroll
      for (int z = 1; z + 1 < Levels; ++z) {
        F const v = rows[1].own[z];
        F const highest_other = max(max(rows[0].highest[z], rows[2].highest[z]), rows[1].highest_other[z]);
        F const lowest_other = min(min(rows[0].lowest[z], rows[2].lowest[z]), rows[1].lowest_other[z]);
        bool const numbers = is_inside && (odd >> (z - 1) & 7) == 0;
        bool const is_maximum = numbers && v > highest_other && v > highest[z - 1] && v > highest[z + 1];
        bool const is_minimum = numbers && p.minima && v < lowest_other && v < lowest[z - 1] && v < lowest[z + 1];
        if (is_maximum || is_minimum)
          list_if_peak(p, octave, sample, levels, z, y, x, is_maximum, response,
                       response_around(levels, octave, z, y, x, response));
      }
      rows[0] = rows[1], rows[1] = rows[2];
    }
  }
}

// Digit i of a rank in base 256, the most significant first; the strongest rank has the largest digits.
template <class F>
__device__ __forceinline__ unsigned digit_of(PeakRank<F> const& rank, int i) {
  using Bits = std::conditional_t<sizeof(F) == 4, unsigned, unsigned long long>;
  constexpr int bytes = sizeof(F);
  if (i >= bytes) return unsigned(INT32_MAX - rank.voxel) >> 8 * (bytes + 3 - i) & 255;
  Bits const bits = __builtin_bit_cast(Bits, rank.score + F(0)), sign = Bits(1) << (8 * bytes - 1);  // -0 is 0
  return unsigned((bits & sign ? ~bits : bits | sign) >> 8 * (bytes - 1 - i) & 255);
}

// The first digits of the weakest rank that is chosen.
struct RankPrefix {
  unsigned char digits[12];
  int length;

  // Below 0, 0, above 0: whether the first digits of a rank are weaker, the same, stronger.
  template <class F>
  __device__ __forceinline__ int compare(PeakRank<F> const& rank) const {
    for (int i = 0; i < length; ++i)
      if (int const apart = int(digit_of(rank, i)) - int(digits[i])) return apart;
    return 0;
  }
};

// Finds the prefix that `num_chosen` of n ranks reach, fewer than n. Called by all threads of a block.
template <class F>
__device__ void choose(PeakRank<F> const* ranks, int64_t n, int num_chosen, RankPrefix& prefix) {
  __shared__ int counts[256], missing;
  __shared__ bool done;
  if (threadIdx.x == 0) prefix.length = 0, missing = num_chosen, done = false;
  __syncthreads();
  for (int d = 0; d < int(sizeof(F)) + 4 && !done; ++d) {
    for (int i = threadIdx.x; i < 256; i += kChooseThreads) counts[i] = 0;
    __syncthreads();
    for (int64_t i = threadIdx.x; i < n; i += kChooseThreads)
      if (prefix.compare(ranks[i]) == 0) atomicAdd(counts + digit_of(ranks[i], d), 1);
    __syncthreads();
    if (threadIdx.x < 32) {  // eight digits a lane, the largest in lane 0
      int const largest = 255 - 8 * int(threadIdx.x), goal = missing;
      int own = 0;
      for (int i = 0; i < 8; ++i) own += counts[largest - i];
      int const through = warp_prefix_sum(own);
      int above = through - own;
      __syncwarp();  // before `missing` changes
      if (above < goal && goal <= through) {
        int last = largest;
        for (; above + counts[last] < goal; --last) above += counts[last];
        prefix.digits[d] = static_cast<unsigned char>(last);
        prefix.length = d + 1;
        missing = goal - above;
        done = counts[last] == missing;
      }
    }
    __syncthreads();
  }
}

// Sorts a power of two of ranks. Called by all threads of a block.
template <class F>
__device__ void bitonic_sort(PeakRank<F>* ranks, int64_t size) {
  for (int64_t run = 2; run <= size; run *= 2)
    for (int64_t apart = run / 2; apart > 0; apart /= 2) {
      for (int64_t pair = threadIdx.x; pair < size / 2; pair += kChooseThreads) {
        int64_t const i = 2 * apart * (pair / apart) + pair % apart, j = i + apart;
        PeakRank<F> const a = ranks[i], b = ranks[j];
        if ((i & run) == 0 ? b < a : a < b) ranks[i] = b, ranks[j] = a;
      }
      __syncthreads();
    }
}

// Whether a pixel of an image differs from its first one. Called by all threads of a block.
template <class T>
__device__ bool varies(T const* image, int64_t pixels) {
  auto const first = pixels > 0 ? read(image[0]) : 0;
  for (int64_t start = 0; start < pixels; start += kChooseThreads) {
    int64_t const i = start + threadIdx.x;
    if (__syncthreads_or(i < pixels && !(read(image[i]) == first))) return true;
  }
  return false;
}

extern __shared__ double shared_ranks[];

// One block per sample.
template <class T>
__global__ void __launch_bounds__(kChooseThreads) choose_peaks(__grid_constant__ ScaleSpacePeaks<T> const p) {
  using F = Compute<T>;
  __shared__ RankPrefix prefix;
  __shared__ int chosen;
  int64_t const sample = blockIdx.x, n = min(p.sizes[sample], p.capacity);
  int64_t const kept = !p.images || varies(p.images + sample * p.pixels, p.pixels) ? min(n, p.count) : 0;
  PeakRank<F> const* const listed = p.ranks + sample * p.capacity;
  PeakRank<F>* sorted = reinterpret_cast<PeakRank<F>*>(shared_ranks);
  int64_t const room = sorted_ranks(p.count, p.capacity), size = sorted_ranks(kept, kept);
  if (room * int64_t(sizeof(PeakRank<F>)) > kSharedBytes) sorted = p.ranks + p.samples * p.capacity + sample * room;
  if (threadIdx.x == 0) prefix.length = 0, chosen = 0;
  __syncthreads();
  if (kept > 0 && kept < n) choose(listed, n, int(kept), prefix);
  for (int64_t i = threadIdx.x; i < n && kept > 0; i += kChooseThreads)
    if (prefix.compare(listed[i]) >= 0) sorted[atomicAdd(&chosen, 1)] = listed[i];
  for (int64_t i = kept + threadIdx.x; i < size; i += kChooseThreads) sorted[i] = {-INFINITY, INT32_MAX};
  __syncthreads();
  bitonic_sort(sorted, size);

  for (int64_t i = threadIdx.x; i < p.count; i += kChooseThreads) {
    ScaleSpacePeak<F> peak{0, 0, 0, 0, 0, -1};
    if (i < kept) {
      PeakOctave<T> const& octave = p.octave_of_voxel(sorted[i].voxel);
      auto const response = response_of<T>(p.differences, octave.plane());
      T const* const levels = octave.of_sample(sample, p.differences);
      int const voxel = sorted[i].voxel - octave.first_voxel, plane = int(octave.plane()), width = octave.size[2];
      peak = refine_extremum(p.search_in(octave), levels, voxel / plane, voxel / width % octave.size[1], voxel % width,
                             is_maximum_at(levels, voxel, response), response);
      peak.voxel += octave.first_voxel;
    }
    store_peak(p, sample * p.count + i, peak);
  }
}

// One thread per slot. Gradients of peaks that share voxels are added by atomics.
template <class T>
__global__ void __launch_bounds__(kThreads) add_gradients(__grid_constant__ ScaleSpacePeaksBackward<T> const p) {
  using F = Compute<T>;
  int64_t const k = int64_t(blockIdx.x) * kThreads + threadIdx.x;
  if (k >= p.samples * p.count) return;
  int64_t const plane = int64_t(p.search.size[1]) * p.search.size[2], size = (p.search.size[0] + p.differences) * plane;
  T const* const levels = p.levels + k / p.count * size;
  F* const grad = p.grad_levels + k / p.count * size;
  peak_vjp(p, k, levels, response_of<T>(p.differences, plane), [&](int64_t voxel, F number) {
    if (p.differences) {
      atomicAdd(grad + voxel + plane, number);
      atomicAdd(grad + voxel, -number);
    } else {
      atomicAdd(grad + voxel, number);
    }
  });
}

}  // namespace

template <class T>
int find_scale_space_peaks(ScaleSpacePeaks<T> const& p, CUstream_st* stream) {
  if (int const error = cudaMemsetAsync(p.sizes, 0, size_t(p.samples) * sizeof(int64_t), stream)) return error;
  if (p.parts_of_sample == 0) return cudaSuccess;
  dim3 const grid(unsigned(p.parts_of_sample), unsigned(p.samples < 65535 ? p.samples : 65535));
  constexpr int kLevels =
      5;  // of octaves with three levels, besides the two that the first and the last one compare with
  bool has_levels = true;
  for (int o = 0; o < p.octave_count; ++o) has_levels = has_levels && p.octaves[o].size[0] == kLevels;
  if (has_levels)
    list_peaks_of_rows<T, kLevels><<<grid, kThreads, 0, stream>>>(p);
  else
    list_peaks<T><<<grid, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int sort_scale_space_peaks(ScaleSpacePeaks<T> const& p, CUstream_st* stream) {
  choose_peaks<T><<<unsigned(p.samples), kChooseThreads, kSharedBytes, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int scale_space_peaks_backward(ScaleSpacePeaksBackward<T> const& p, CUstream_st* stream) {
  size_t const voxels = size_t(p.search.size[0] + p.differences) * size_t(p.search.size[1]) * size_t(p.search.size[2]);
  size_t const bytes = size_t(p.samples) * voxels * sizeof(Compute<T>);
  if (int const error = cudaMemsetAsync(p.grad_levels, 0, bytes, stream)) return error;
  int64_t const blocks = ceil_div(p.samples * p.count, kThreads);
  if (blocks > 0) add_gradients<T><<<unsigned(blocks), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(find_scale_space_peaks, ScaleSpacePeaks)
KV_INSTANTIATE(sort_scale_space_peaks, ScaleSpacePeaks)
KV_INSTANTIATE(scale_space_peaks_backward, ScaleSpacePeaksBackward)

}  // namespace kv::feature::cuda
