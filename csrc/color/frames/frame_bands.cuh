// Boxes of frames whose codes are integers, on CUDA. A block has a band: some rows of some columns of the result, and
// all columns of the frame that these take, which are at most kSpan.
//
//   weights   The block computes those of its columns and of its rows once, and asks for the codes it will read.
//   down      A thread has kOwn columns of the frame. It goes down the rows of codes, which it reads by words. Each is
//             converted once, and added to the rows of the result that take it.
//   across    A thread has a column of the result. It adds up the sums of the rows, which are in shared memory.
//
// Chroma is added up where it is, at half the resolution. Where a box takes more than the tables have room for, each
// thread computes the windows of its pixels.
#pragma once

#include "frames.cuh"

namespace kv::color::cuda {
namespace {

constexpr int kBandThreads = 128, kBandBlocks = 5;  // of a block; at once on a multiprocessor
constexpr int kOwn = 8, kSpan = kBandThreads * kOwn;
constexpr int kAtOnce = 2;  // rows of the result between barriers
constexpr int kMinBandRows = 4, kMaxBandRows = 32, kMaxBandColumns = 512;
// Rows of codes are added to at most as many rows of the result at once, of luma and of chroma.
constexpr int kLumaRows = 2, kChromaRows = 3;
// The sums of a row: even columns of luma, odd ones, pairs of chroma. Where a frame shrinks to a half, threads read
// every second column: then they read neighbors. Odd columns begin in another half of the banks.
constexpr int kOddColumns = kSpan / 2 + 16, kChromaSums = kSpan + 16, kRowSums = 2 * kSpan + 16;
constexpr int kFewLuma = 4, kFewChroma = 3;  // taps of small windows

enum class CodeLayout : int { pairs, swapped_pairs, planes, packed };

struct BandPlan {
  CodeLayout layout;
  bool luma_vectors, chroma_vectors;  // rows begin at multiples of a thread's codes
  int columns, rows;                  // of a block
  // What tables have room for.
  int luma_taps, chroma_taps, luma_steps, chroma_steps;

  // Of a column: the weights and where they belong; of small windows all are there.
  int column_size() const { return max(kFewLuma + kFewChroma, luma_taps + chroma_taps) + 1; }
  int64_t bytes() const {
    return 4 * (kAtOnce * kRowSums + int64_t(columns) * column_size()) + int64_t(16) * (luma_steps + chroma_steps);
  }
};

// A row of codes, and its weights in the rows of the result, which are numbered from 0 again after the last one that
// takes rows of codes at once.
struct alignas(16) BandStep {
  float weights[3];
  int row;

  static __device__ __forceinline__ BandStep load(BandStep const* from) {
    auto const words = *reinterpret_cast<Vector<uint32_t, 4> const*>(from);
    return {{__uint_as_float(words.v[0]), __uint_as_float(words.v[1]), __uint_as_float(words.v[2])}, int(words.v[3])};
  }
};

// Words of which `bytes` bytes exist, at least one. `vectors`: all words are one aligned vector where they all exist.
template <int N>
__device__ __forceinline__ void fetch_words(char const* from, int bytes, bool vectors, uint32_t (&words)[N]) {
  if (vectors && bytes >= 4 * N) {
    auto const vector = *reinterpret_cast<Vector<uint32_t, N> const*>(from);
#pragma unroll
    for (int k = 0; k < N; ++k) words[k] = vector.v[k];
    return;
  }
  int const skew = int(reinterpret_cast<uintptr_t>(from) % 4), count = (min(bytes, 4 * N) + skew + 3) / 4;
  auto const* const aligned = reinterpret_cast<uint32_t const*>(from - skew);
  uint32_t own[N + 1];
#pragma unroll
  for (int k = 0; k <= N; ++k) own[k] = k < count ? aligned[k] : 0;
#pragma unroll
  for (int k = 0; k < N; ++k) words[k] = __funnelshift_r(own[k], own[k + 1], 8 * skew);
}

// The codes of a thread's columns in a row: of luma, or u and v in turns.
template <class S>
struct OwnCodes {
  static constexpr int kWords = kOwn * int(sizeof(S)) / 4;
  uint32_t words[kWords];

  // By an or and a subtraction: the conversion instruction has a quarter of their rate.
  __device__ __forceinline__ float number(int j) const {
    uint32_t const selector = sizeof(S) == 1 ? 0x7440u + uint32_t(j % 4) : j % 2 ? 0x7432u : 0x7410u;
    uint32_t const word = words[j * int(sizeof(S)) / 4];
    return __uint_as_float(__byte_perm(word, 0x4b000000u, selector)) - 8388608.f;
  }
};

// Plain: pairs of chroma, all rows begin at vectors, and end with one.
template <class S, bool Plain>
struct BandRows {
  CodeLayout layout;
  char const *luma, *chroma, *v;  // the first own column of the first row
  int luma_stride, chroma_stride, v_stride;
  int luma_bytes, chroma_bytes;  // of own columns that exist, and those behind them
  bool luma_vectors, chroma_vectors;

  template <class T>
  __device__ __forceinline__ BandRows(PlanesToRgb<T> const& p, BandPlan const& plan, int64_t frame, int x)
      : layout(plan.layout), luma_vectors(plan.luma_vectors), chroma_vectors(plan.chroma_vectors) {
    constexpr int kBytes = sizeof(S);
    auto const plane = [&](int k) { return reinterpret_cast<char const*>(p.planes[k].template row<S>(frame, 0)); };
    auto const stride = [&](int k) { return int(p.planes[k].row_stride) * kBytes; };
    bool const is_packed = layout == CodeLayout::packed, has_planes = layout == CodeLayout::planes;
    luma = plane(0) + x * kBytes * (is_packed ? 2 : 1);
    chroma = is_packed ? luma : plane(layout == CodeLayout::swapped_pairs ? 2 : 1) + (has_planes ? x / 2 : x * kBytes);
    v = plane(2) + x / 2;
    luma_stride = stride(0), chroma_stride = stride(1), v_stride = stride(2);
    luma_bytes = (p.x.size - x) * kBytes * (is_packed ? 2 : 1);
    chroma_bytes = is_packed ? luma_bytes : has_planes ? p.x.chroma_size - x / 2 : (2 * p.x.chroma_size - x) * kBytes;
  }

  __device__ __forceinline__ char const* luma_row(int row) const { return luma + int64_t(row) * luma_stride; }
  __device__ __forceinline__ char const* chroma_row(int row) const { return chroma + int64_t(row) * chroma_stride; }

  static __device__ __forceinline__ void swap(OwnCodes<S>& codes) {
#pragma unroll
    for (uint32_t& word : codes.words) word = __byte_perm(word, 0, sizeof(S) == 1 ? 0x2301 : 0x1032);
  }
  // One code of each two of a packed row.
  __device__ __forceinline__ void unpack(char const* row, uint32_t selector, OwnCodes<S>& codes) const {
    uint32_t both[2 * OwnCodes<S>::kWords];
    fetch_words(row, luma_bytes, luma_vectors, both);
#pragma unroll
    for (int k = 0; k < OwnCodes<S>::kWords; ++k) codes.words[k] = __byte_perm(both[2 * k], both[2 * k + 1], selector);
  }
  __device__ __forceinline__ static void fetch_vector(char const* from, OwnCodes<S>& codes) {
    constexpr int N = OwnCodes<S>::kWords;
    auto const vector = *reinterpret_cast<Vector<uint32_t, N> const*>(from);
#pragma unroll
    for (int k = 0; k < N; ++k) codes.words[k] = vector.v[k];
  }
  __device__ __forceinline__ OwnCodes<S> fetch_luma(int row) const {
    OwnCodes<S> codes;
    if constexpr (Plain)
      fetch_vector(luma_row(row), codes);
    else if (sizeof(S) == 1 && layout == CodeLayout::packed)
      unpack(luma_row(row), 0x6420, codes);
    else
      fetch_words(luma_row(row), luma_bytes, luma_vectors, codes.words);
    return codes;
  }
  __device__ __forceinline__ OwnCodes<S> fetch_chroma(int row) const {
    OwnCodes<S> codes;
    if constexpr (Plain) {
      fetch_vector(chroma_row(row), codes);
      if (layout == CodeLayout::swapped_pairs) swap(codes);
    } else if (sizeof(S) == 1 && layout == CodeLayout::packed) {
      unpack(chroma_row(row), 0x7531, codes);
    } else if (sizeof(S) == 1 && layout == CodeLayout::planes) {
      uint32_t a[1], b[1];
      fetch_words(chroma_row(row), chroma_bytes, chroma_vectors, a);
      fetch_words(v + int64_t(row) * v_stride, chroma_bytes, chroma_vectors, b);
      codes.words[0] = __byte_perm(a[0], b[0], 0x5140);
      codes.words[1] = __byte_perm(a[0], b[0], 0x7362);
    } else {
      fetch_words(chroma_row(row), chroma_bytes, chroma_vectors, codes.words);
      if (layout == CodeLayout::swapped_pairs) swap(codes);
    }
    return codes;
  }
};

// The rows of codes that rows of the result take, in their order; a block has two.
struct BandSteps {
  int first[kMaxBandRows], last[kMaxBandRows];  // that a row of the result takes
  int end[kMaxBandRows];                        // of its steps

  __device__ __forceinline__ int begin_of(int i, bool rolling) const {
    return rolling && i > 0 ? max(first[i], last[i - 1]) : first[i];
  }
  // Whether no row of codes is taken by more than N rows of the result, which are neighbors.
  template <int N>
  __device__ __forceinline__ bool can_roll(int i, int count) const {
    return (i + N >= count || last[i] <= first[i + N]) &&
           (i + 1 >= count || (first[i] <= first[i + 1] && last[i] <= last[i + 1]));
  }
  // The steps of row i. False if there are more than `room`.
  template <int N, class Weight>
  __device__ __forceinline__ bool write(BandStep* steps, int room, int i, int count, bool rolling, Weight weight) {
    int at = 0;
    for (int k = 0; k < i; ++k) at += max(last[k] - begin_of(k, rolling), 0);
    int const begin = begin_of(i, rolling), steps_of_row = max(last[i] - begin, 0);
    end[i] = at + steps_of_row;
    if (end[i] > room) return false;
    for (int k = 0; k < steps_of_row; ++k) {
      BandStep step{{}, begin + k};
#pragma unroll
      for (int n = 0; n < N; ++n)
        if (n == 0 || (rolling && i + n < count)) {
          float const w = weight(n, begin + k);
#pragma unroll
          for (int slot = 0; slot < N; ++slot)
            if ((i + n) % N == slot) step.weights[slot] = w;
        }
      steps[at + k] = step;
    }
    return true;
  }
};

// Exact for 1, else within an ulp.
__device__ __forceinline__ float inverse(float x) { return __fdividef(1.f, x); }
__device__ __forceinline__ void prefetch_l2(void const* at) { asm volatile("prefetch.global.L2 [%0];" ::"l"(at)); }

template <class S, class T>
__device__ __noinline__ void run_each_window(PlanesToRgb<T> const& p, int64_t frame, int x0, int y0, int columns,
                                             int rows) {
  BoxAxis<float> const box_x = p.box_axis(frame, false), box_y = p.box_axis(frame, true);
  for (int i = int(threadIdx.x); i < columns * rows; i += kBandThreads) {
    int const x = x0 + i % columns, y = y0 + i / columns;
    PixelWindow<float> const wx = box_x.window(x), wy = box_y.window(y);
    float sums[3];
    sum_windows(wx, wy, p.x, p.y, Reader<S, T>{p, frame}, sums);
    float const factor = 1 / (wx.sum() * wy.sum());
#pragma unroll
    for (float& sum : sums) sum *= factor;
#pragma unroll
    for (int k = 0; k < 3; ++k)
      p.rgb.row(3 * frame + k, y)[x] = round_to<T>(channel_of(p.colors, k, sums[0], sums[1], sums[2]));
  }
}

// Where the sums that a column takes begin: of even taps of luma, of odd ones, and of chroma.
struct ColumnSums {
  uint32_t packed;
  static __device__ __forceinline__ int luma_at(int i) { return i / 2 + (i % 2 ? kOddColumns : 0); }
  static __device__ __forceinline__ ColumnSums of(int luma, int chroma) {
    return {uint32_t(luma_at(luma) | luma_at(luma + 1) << 11 | chroma << 22)};
  }
  __device__ __forceinline__ int even() const { return int(packed & 2047); }
  __device__ __forceinline__ int odd() const { return int(packed >> 11 & 2047); }
  __device__ __forceinline__ int chroma() const { return kChromaSums + 2 * int(packed >> 22); }
};
static_assert(kOddColumns + kSpan / 2 <= 2048 && kSpan / 2 <= 1024);

// The luma and chroma of a column in the rows at once. K, M: the numbers of taps; 0 for any.
template <int K, int M>
struct ColumnColors {
  float y[kAtOnce]{}, u[kAtOnce]{}, v[kAtOnce]{};

  __device__ __forceinline__ void add_luma(float const* from, float weight) {
#pragma unroll
    for (int r = 0; r < kAtOnce; ++r) y[r] += weight * from[r * kRowSums];
  }
  __device__ __forceinline__ void add_chroma(float const* from, float weight) {
#pragma unroll
    for (int r = 0; r < kAtOnce; ++r) {
      auto const pair = *reinterpret_cast<Vector<float, 2> const*>(from + r * kRowSums);
      u[r] += weight * pair.v[0];
      v[r] += weight * pair.v[1];
    }
  }
  // Of column x of a table.
  __device__ __forceinline__ void add(float const* sums, float const* table, int x, int columns, int luma_taps,
                                      int chroma_taps) {
    if constexpr (K > 0) {
      auto const* const vectors = reinterpret_cast<Vector<float, 4> const*>(table) + 2 * x;
      auto const luma = vectors[0], chroma = vectors[1];
      ColumnSums const at{__float_as_uint(chroma.v[3])};
#pragma unroll
      for (int k = 0; k < K; ++k) add_luma(sums + (k % 2 ? at.odd() : at.even()) + k / 2, luma.v[k]);
#pragma unroll
      for (int k = 0; k < M; ++k) add_chroma(sums + at.chroma() + 2 * k, chroma.v[k]);
    } else {
      float const* weight = table + x;
      ColumnSums const at{__float_as_uint(*weight)};
      float const *const even = sums + at.even(), *const odd = sums + at.odd();
#pragma unroll 4
      for (int k = 0; k < luma_taps; ++k) add_luma((k % 2 ? odd : even) + k / 2, *(weight += columns));
      float const* chroma = sums + at.chroma();
#pragma unroll 2
      for (int k = 0; k < chroma_taps; ++k, chroma += 2) add_chroma(chroma, *(weight += columns));
    }
  }
};

template <class S, class T, bool Plain>
__global__ void __launch_bounds__(kBandThreads, kBandBlocks)
    run_bands(__grid_constant__ PlanesToRgb<T> const p, __grid_constant__ BandPlan const plan) {
  extern __shared__ __align__(16) float memory[];
  __shared__ BandSteps luma_rows, chroma_rows;
  float* const sums = memory;
  BandStep* const luma_steps = reinterpret_cast<BandStep*>(sums + kAtOnce * kRowSums);
  BandStep* const chroma_steps = luma_steps + plan.luma_steps;
  float* const table = reinterpret_cast<float*>(chroma_steps + plan.chroma_steps);

  int const t = int(threadIdx.x), x0 = int(blockIdx.x) * plan.columns, y0 = int(blockIdx.y) * plan.rows;
  int const columns = min(plan.columns, int(p.rgb.width) - x0), rows = min(plan.rows, int(p.rgb.height) - y0);
  for (int64_t frame = blockIdx.z; frame < p.rgb.count() / 3; frame += gridDim.z) {
    BoxAxis<float> const box_x = p.box_axis(frame, false), box_y = p.box_axis(frame, true);
    // The columns of the frame, `own` threads of them from `from` on.
    PixelWindow<float> const left = box_x.window(x0), right = box_x.window(x0 + columns - 1);
    int const from =
        min(min(left.first, right.first), 2 * min(left.first_chroma(p.x), right.first_chroma(p.x))) / kOwn * kOwn;
    int const end = max(max(left.last, right.last), 2 * max(left.last_chroma(p.x), right.last_chroma(p.x)));
    int const own = (end - from + kOwn - 1) / kOwn;
    int const window = whole_within(-floor_of(-2 * box_x.support), 1, p.x.size);
    int luma_taps = min(window, kOwn * own);
    int chroma_taps = min(window / 2 + (p.x.site == ChromaSite::nearest ? 1 : 2), kOwn / 2 * own);
    bool const is_small = luma_taps <= kFewLuma && chroma_taps <= kFewChroma;
    bool const has_few = luma_taps <= 2 && chroma_taps <= 2;
    bool const has_columns =
        own <= kBandThreads && (is_small || (luma_taps <= plan.luma_taps && chroma_taps <= plan.chroma_taps));
    if (is_small) luma_taps = has_few ? 2 : kFewLuma, chroma_taps = has_few ? 2 : kFewChroma;  // a thread has so many

    // The rows of the band are taken from the top of the frame to its bottom.
    bool const is_mirrored = box_y.scale < 0, is_chroma = t >= 32;
    auto const window_of = [&](int i) { return box_y.window(is_mirrored ? y0 + rows - 1 - i : y0 + i); };
    int const i = t % 32;
    bool const has_row = t < 64 && i < rows;
    if (has_row) {
      PixelWindow<float> const w = window_of(i);
      BandSteps& own_rows = is_chroma ? chroma_rows : luma_rows;
      own_rows.first[i] = is_chroma ? w.first_chroma(p.y) : w.first;
      own_rows.last[i] = is_chroma ? w.last_chroma(p.y) : w.last;
    }
    __syncthreads();
    // Each warp asks for what it writes.
    bool rolls =
        !has_row || (is_chroma ? chroma_rows.can_roll<kChromaRows>(i, rows) : luma_rows.can_roll<kLumaRows>(i, rows));
    rolls = __all_sync(0xffffffffu, rolls);
    bool fits = has_columns;
    if (has_row) {
      PixelWindow<float> const w[] = {window_of(i), window_of(min(i + 1, rows - 1)), window_of(min(i + 2, rows - 1))};
      float const factor[] = {inverse(w[0].sum()), inverse(w[1].sum()), inverse(w[2].sum())};
      auto const luma_weight = [&](int n, int row) { return w[n].weight(row) * factor[n]; };
      auto const chroma_weight = [&](int n, int row) { return w[n].chroma_weight(p.y, row) * factor[n]; };
      bool const has_room =
          is_chroma ? chroma_rows.write<kChromaRows>(chroma_steps, plan.chroma_steps, i, rows, rolls, chroma_weight)
                    : luma_rows.write<kLumaRows>(luma_steps, plan.luma_steps, i, rows, rolls, luma_weight);
      fits = fits && has_room;
    }
    if (has_columns)
      // The warps of the rows come last.
      for (int x = kBandThreads - 1 - t; x < columns; x += kBandThreads) {
        PixelWindow<float> const w = box_x.window(x0 + x);
        float const factor = inverse(w.sum());
        int const luma = min(w.first, from + kOwn * own - luma_taps);
        int const chroma = min(w.first_chroma(p.x), (from + kOwn * own) / 2 - chroma_taps), last = w.last_chroma(p.x);
        float const at = __uint_as_float(ColumnSums::of(luma - from, chroma - from / 2).packed);
        auto const chroma_weight = [&](int k) {
          return chroma + k < last ? w.chroma_weight(p.x, chroma + k) * factor : 0.f;
        };
        if (is_small) {
          auto* const to = reinterpret_cast<Vector<float, 4>*>(table) + 2 * x;
          Vector<float, 4> vector;
#pragma unroll
          for (int k = 0; k < kFewLuma; ++k) vector.v[k] = w.weight(luma + k) * factor;
          to[0] = vector;
#pragma unroll
          for (int k = 0; k < kFewChroma; ++k) vector.v[k] = chroma_weight(k);
          vector.v[3] = at;
          to[1] = vector;
        } else {
          float* to = table + x;
          *to = at;
          for (int k = 0; k < luma_taps; ++k) *(to += plan.columns) = w.weight(luma + k) * factor;
          for (int k = 0; k < chroma_taps; ++k) *(to += plan.columns) = chroma_weight(k);
        }
      }
    fits = __syncthreads_and(fits);
    if (!fits) {
      run_each_window<S>(p, frame, x0, y0, columns, rows);
      __syncthreads();
      continue;
    }

    bool const is_own = t < own;
    BandRows<S, Plain> const codes(p, plan, frame, from + kOwn * (is_own ? t : 0));
    int const luma_end = luma_rows.end[rows - 1], chroma_end = chroma_rows.end[rows - 1];
    {  // a line of 128 bytes each
      BandRows<S, Plain> const first(p, plan, frame, from);
      int const bytes = own * kOwn * int(sizeof(S)) * (plan.layout == CodeLayout::packed ? 2 : 1);
      int const lines = bytes / 128 + 1;
      for (int line = t % 32; line < lines; line += 32) {
        int const at = min(line * 128, bytes - 1);
        for (int k = t / 32; k < luma_end; k += kBandThreads / 32) prefetch_l2(first.luma_row(luma_steps[k].row) + at);
        if (plan.layout <= CodeLayout::swapped_pairs)
          for (int k = t / 32; k < chroma_end; k += kBandThreads / 32)
            prefetch_l2(first.chroma_row(chroma_steps[k].row) + at);
      }
    }
    float y[kLumaRows][kOwn]{}, c[kChromaRows][kOwn]{};
    OwnCodes<S> next_luma{}, next_chroma{};
    BandStep luma_step{}, chroma_step{};
    if (is_own) {
      luma_step = BandStep::load(luma_steps), chroma_step = BandStep::load(chroma_steps);
      next_luma = codes.fetch_luma(luma_step.row), next_chroma = codes.fetch_chroma(chroma_step.row);
    }
    int next = 0, next_of_chroma = 0, luma_slot = 0, chroma_slot = 0;
    int64_t const plane = p.rgb.plane(1) - p.rgb.plane(0);  // the result is dense
    int64_t const stride = is_mirrored ? -p.rgb.row_stride : p.rgb.row_stride;
    T* to = p.rgb.row(3 * frame, is_mirrored ? y0 + rows - 1 : y0) + x0;
    for (int done = 0; done < rows; done += kAtOnce, to += kAtOnce * stride) {
      int const count = min(kAtOnce, rows - done);
      if (is_own)
#pragma unroll 1
        for (int r = 0; r < count; ++r) {
          int const end_luma = luma_rows.end[done + r], end_chroma = chroma_rows.end[done + r];
#pragma unroll 1
          while (next < end_luma) {
            BandStep const step = luma_step;
            OwnCodes<S> const row = next_luma;
            if (++next < luma_end) {
              luma_step = BandStep::load(luma_steps + next);
              next_luma = codes.fetch_luma(luma_step.row);
            }
#pragma unroll
            for (int j = 0; j < kOwn; ++j) {
              float const number = row.number(j);
#pragma unroll
              for (int n = 0; n < kLumaRows; ++n) y[n][j] += step.weights[n] * number;
            }
          }
#pragma unroll 1
          while (next_of_chroma < end_chroma) {
            BandStep const step = chroma_step;
            OwnCodes<S> const row = next_chroma;
            if (++next_of_chroma < chroma_end) {
              chroma_step = BandStep::load(chroma_steps + next_of_chroma);
              next_chroma = codes.fetch_chroma(chroma_step.row);
            }
#pragma unroll
            for (int j = 0; j < kOwn; ++j) {
              float const number = row.number(j);
#pragma unroll
              for (int n = 0; n < kChromaRows; ++n) c[n][j] += step.weights[n] * number;
            }
          }
          float* const to_sums = sums + r * kRowSums + kOwn / 2 * t;
          // Stored, and 0 for the next row that is added up there.
          auto const take = [](float& x) {
            float const value = x;
            x = 0;
            return value;
          };
#pragma unroll
          for (int n = 0; n < kLumaRows; ++n)
            if (n == luma_slot) {
#pragma unroll
              for (int k = 0; k < 2; ++k) {
                Vector<float, 4> luma;
#pragma unroll
                for (int j = 0; j < 4; ++j) luma.v[j] = take(y[n][2 * j + k]);
                *reinterpret_cast<Vector<float, 4>*>(to_sums + k * kOddColumns) = luma;
              }
            }
#pragma unroll
          for (int n = 0; n < kChromaRows; ++n)
            if (n == chroma_slot) {
#pragma unroll
              for (int k = 0; k < 2; ++k) {
                Vector<float, 4> pairs;
#pragma unroll
                for (int j = 0; j < 4; ++j) pairs.v[j] = take(c[n][4 * k + j]);
                *reinterpret_cast<Vector<float, 4>*>(to_sums + kChromaSums + kOwn / 2 * t + 4 * k) = pairs;
              }
            }
          luma_slot = luma_slot + 1 < kLumaRows ? luma_slot + 1 : 0;
          chroma_slot = chroma_slot + 1 < kChromaRows ? chroma_slot + 1 : 0;
        }
      __syncthreads();
      auto const emit = [&](auto k, auto m) {
        for (int x = t; x < columns; x += kBandThreads) {
          ColumnColors<decltype(k)::value, decltype(m)::value> colors;
          colors.add(sums, table, x, plan.columns, luma_taps, chroma_taps);
#pragma unroll
          for (int r = 0; r < kAtOnce; ++r)
            if (r < count) {
#pragma unroll
              for (int n = 0; n < 3; ++n)
                to[n * plane + r * stride + x] =
                    round_to<T>(channel_of(p.colors, n, colors.y[r], colors.u[r], colors.v[r]));
            }
        }
      };
      using std::integral_constant;
      if (has_few)
        emit(integral_constant<int, 2>{}, integral_constant<int, 2>{});
      else if (is_small)
        emit(integral_constant<int, kFewLuma>{}, integral_constant<int, kFewChroma>{});
      else
        emit(integral_constant<int, 0>{}, integral_constant<int, 0>{});
      __syncthreads();
    }
  }
}

// Whether bands serve a call, and how. Boxes within the frame have room.
template <class T>
bool plan_bands(PlanesToRgb<T> const& p, BandPlan& plan) {
  CodePlane const &y = p.planes[0], &u = p.planes[1], &v = p.planes[2];
  int const size = p.code_bytes;
  if (size == 0 || !p.x.is_halved()) return false;
  auto const address = [](CodePlane const& x) { return reinterpret_cast<intptr_t>(x.data); };
  intptr_t const apart = address(v) - address(u);
  bool const same_rows = u.row_stride == v.row_stride && u.frame_stride == v.frame_stride;
  bool const are_pairs = y.column_stride == 1 && u.column_stride == 2 && v.column_stride == 2 && same_rows;
  if (are_pairs && (apart == size || apart == -size))
    plan.layout = apart > 0 ? CodeLayout::pairs : CodeLayout::swapped_pairs;
  else if (size == 1 && y.column_stride == 1 && u.column_stride == 1 && v.column_stride == 1)
    plan.layout = CodeLayout::planes;
  else if (size == 1 && y.column_stride == 2 && u.column_stride == 4 && v.column_stride == 4 && same_rows &&
           y.row_stride == u.row_stride && address(u) - address(y) == 1 && apart == 2 && p.x.size % 2 == 0)
    plan.layout = CodeLayout::packed;
  else
    return false;
  int64_t const longest = max(y.row_stride, max(u.row_stride, v.row_stride));
  if (longest > INT32_MAX / size || min(y.row_stride, min(u.row_stride, v.row_stride)) < 0) return false;
  auto const are_vectors = [&](CodePlane const& x, int bytes, intptr_t first) {
    return (first | x.row_stride * size | x.frame_stride * size) % bytes == 0;
  };
  bool const is_packed = plan.layout == CodeLayout::packed, has_planes = plan.layout == CodeLayout::planes;
  plan.luma_vectors = are_vectors(y, kOwn * size * (is_packed ? 2 : 1), address(y));
  plan.chroma_vectors = has_planes ? are_vectors(u, kOwn / 2, address(u)) && are_vectors(v, kOwn / 2, address(v))
                                   : are_vectors(u, kOwn * size, min(address(u), address(v)));

  int const width = int(p.rgb.width), height = int(p.rgb.height);
  BoxAxis<float> const across(0, float(p.x.size), width, p.x.size, p.antialias);
  BoxAxis<float> const down(0, float(p.y.size), height, p.y.size, p.antialias);
  int const window = whole_within(-floor_of(-2 * across.support), 1, p.x.size);
  plan.luma_taps = window;
  plan.chroma_taps = window / 2 + (p.x.site == ChromaSite::nearest ? 1 : 2);
  float const room = float(kSpan - kOwn - 4) - 2 * across.support;
  if (room < across.scale) return false;
  int const most_columns = whole_within(room / across.scale, 1, kMaxBandColumns);
  auto const divided = [](int size, int most) { return int(ceil_div(size, ceil_div(size, most))); };
  for (int most = min(width, most_columns);; most /= 2) {
    plan.columns = divided(width, most);
    // As many rows as fill all multiprocessors a whole number of times.
    int64_t const columns_of_bands = p.rgb.count() / 3 * ceil_div(width, plan.columns);
    int64_t const at_once = kBandBlocks * multiprocessors();
    int64_t const times = ceil_div(columns_of_bands * height, at_once * kMaxBandRows);
    int64_t const down_count = clamp(times * at_once / columns_of_bands, int64_t(1), int64_t(height));
    plan.rows =
        int(clamp(ceil_div(int64_t(height), down_count), int64_t(min(kMinBandRows, height)), int64_t(kMaxBandRows)));
    int const reads = p.antialias ? int(float(plan.rows) * down.scale + 2 * down.support) + 3 : 0;
    plan.luma_steps = max(2 * plan.rows, reads);
    // Rows of interpolated chroma are taken by more rows of the result than are added up at once.
    int const each_row = p.y.site == ChromaSite::nearest ? 3 : max(3, int(down.support) + 3);
    plan.chroma_steps = max(each_row * plan.rows, reads);
    if (plan.bytes() <= max_shared_bytes(54 << 10)) return true;
    if (most < 64) return false;
  }
}

template <class S, class T>
int launch_bands(PlanesToRgb<T> const& p, BandPlan const& plan, CUstream_st* stream) {
  bool const is_plain =
      plan.layout <= CodeLayout::swapped_pairs && plan.luma_vectors && plan.chroma_vectors && p.x.size % kOwn == 0;
  auto* const kernel = is_plain ? run_bands<S, T, true> : run_bands<S, T, false>;
  int const bytes = int(plan.bytes());
  if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes)) return error;
  dim3 const blocks(unsigned(ceil_div(p.rgb.width, plan.columns)), unsigned(ceil_div(p.rgb.height, plan.rows)),
                    unsigned(min(p.rgb.count() / 3, int64_t(65535))));
  kernel<<<blocks, kBandThreads, bytes, stream>>>(p, plan);
  return cudaGetLastError();
}

}  // namespace
}  // namespace kv::color::cuda
