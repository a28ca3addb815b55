// Boxes of frames whose codes are integers, on CUDA. A block has a band: some rows of the result. Each of its warps has
// some columns of it, and all columns of the frame that these take, which are at most kSpan.
//
//   weights   The block computes those of its rows once, each warp those of its columns.
//   down      A thread has kOwn columns of the frame. It goes down the rows of codes, which asynchronous copies bring
//   to
//             shared memory kAhead rows ahead. Each is converted once, and added to the rows of the result that take
//             it.
//   across    A thread has a column of the result. It adds up the sums of the rows, which are in shared memory.
//
// Warps wait for each other behind the weights alone. Chroma is added up where it is, at half the resolution. Where a
// box takes more than the tables have room for, each thread computes the windows of its pixels.
#pragma once

#include "frame_steps.cuh"

namespace kv::color::cuda {
namespace {

// Warps of a block at most, and blocks at once on a multiprocessor. With a fifth warp each has 96 registers, not 128:
// bytes in vectors shrink 1.2x as fast, but uint16 and other rows 0.73x.
constexpr int band_warps(int code_bytes, bool is_plain) { return code_bytes == 1 && is_plain ? 5 : 4; }
constexpr int kBandBlocks = 4;
constexpr int kSpan = 32 * kOwn;
constexpr int kAtOnce = 2;  // rows of the result between down and across
// The sums of a row: even columns of luma, odd ones, pairs of chroma. Where a frame shrinks to a half, threads read
// every second column: then they read neighbors. Odd columns begin in another half of the banks.
constexpr int kOddColumns = kSpan / 2 + 16, kChromaSums = kSpan + 16, kRowSums = 2 * kSpan + 16;
constexpr int kFewLuma = 4, kFewChroma = 3;  // taps of small windows

struct BandPlan {
  CodeRowsPlan codes;
  int warps, columns, rows;  // of a block, of a warp, of a block
  // What tables have room for.
  int luma_taps, chroma_taps, steps;

  // Of a column: the weights and where they belong; of small windows all are there.
  KV_HD int column_size() const { return max(kFewLuma + kFewChroma, luma_taps + chroma_taps) + 1; }
  KV_HD int ring_words(int code_bytes) const { return kRing * 32 * slot_words(code_bytes, codes.is_plain); }
  // Of a warp: sums, ring, weights of columns.
  KV_HD int words(int code_bytes) const {
    return kAtOnce * kRowSums + ring_words(code_bytes) + (columns * column_size() + 3) / 4 * 4;
  }
  int64_t bytes(int code_bytes) const { return int64_t(4) * warps * words(code_bytes) + int64_t(16) * steps; }
};

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
__global__ void __launch_bounds__(32 * band_warps(sizeof(S), Plain), kBandBlocks)
    run_bands(__grid_constant__ PlanesToRgb<T> const p, __grid_constant__ BandPlan const plan) {
  extern __shared__ __align__(16) float memory[];
  __shared__ BandRows band;
  int const lane = int(threadIdx.x % 32), warp = int(threadIdx.x / 32);
  BandStep* const steps = reinterpret_cast<BandStep*>(memory);
  float* const sums = memory + 4 * plan.steps + warp * plan.words(sizeof(S));
  uint32_t* const ring = reinterpret_cast<uint32_t*>(sums + kAtOnce * kRowSums);
  float* const table = reinterpret_cast<float*>(ring + plan.ring_words(sizeof(S)));

  int const x0 = (int(blockIdx.x) * plan.warps + warp) * plan.columns, y0 = int(blockIdx.y) * plan.rows;
  int const columns = min(plan.columns, int(p.rgb.width) - x0), rows = min(plan.rows, int(p.rgb.height) - y0);
  for (int64_t frame = blockIdx.z; frame < p.rgb.count() / 3; frame += gridDim.z) {
    bool const is_mirrored = band.find(p, frame, y0, rows, plan.warps);
    __syncthreads();
    band.write(p, frame, y0, rows, plan.warps, plan.steps, sizeof(S), true, steps);

    // The columns of the frame, `own` threads of them from `from` on.
    BoxAxis<float> const box_x = p.box_axis(frame, false);
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
        own <= 32 && (is_small || (luma_taps <= plan.luma_taps && chroma_taps <= plan.chroma_taps));
    if (is_small) luma_taps = has_few ? 2 : kFewLuma, chroma_taps = has_few ? 2 : kFewChroma;  // a thread has so many
    if (has_columns)
      for (int x = lane; x < columns; x += 32) {
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
    __syncthreads();
    int const last_step = band.step_end[rows - 1];
    if (last_step > plan.steps || !has_columns) {
      if (columns > 0) run_each_window<S>(p, frame, x0, y0, columns, rows);
    } else if (columns > 0) {
      bool const is_own = lane < own;
      CodeRows<S, Plain> const codes(p, plan.codes, frame, from + kOwn * (is_own ? lane : 0));
      // Each step has a group of copies, which is empty behind the last one.
      using Rows = CodeRows<S, Plain>;
      uint32_t const* const own_ring = ring + Rows::kOfLane * lane;
      auto const ring_address = uint32_t(__cvta_generic_to_shared(own_ring));
      auto const ask = [&](int step) {
        if (step < last_step && is_own) {
          BandStep const& next_step = steps[step];
          codes.ask(next_step.offset(), next_step.is_chroma(),
                    ring_address + 4 * Rows::kOfSlot * (unsigned(step) % kRing));
        }
        __pipeline_commit();
      };
      float y[kLumaRows][kOwn]{}, c[kChromaRows][kOwn]{};
      for (int step = 0; step < kAhead; ++step) ask(step);
      int next = 0, luma_slot = 0, chroma_slot = 0;
      int64_t const plane = p.rgb.plane(1) - p.rgb.plane(0);  // the result is dense
      int64_t const stride = is_mirrored ? -p.rgb.row_stride : p.rgb.row_stride;
      T* to = p.rgb.row(3 * frame, is_mirrored ? y0 + rows - 1 : y0) + x0;
      for (int done = 0; done < rows; done += kAtOnce, to += kAtOnce * stride) {
        int const count = min(kAtOnce, rows - done);
#pragma unroll 1
        for (int r = 0; r < count; ++r) {
          int const end_of_row = band.step_end[done + r];
#pragma unroll 1
          for (; next < end_of_row; ++next) {
            ask(next + kAhead);
            BandStep const step = BandStep::load(steps + next);
            __pipeline_wait_prior(kAhead);
            uint32_t const* const slot = own_ring + Rows::kOfSlot * (unsigned(next) % kRing);
            if (step.is_chroma()) {
              OwnCodes<S> const row = codes.asked(step.offset(), true, slot);
#pragma unroll
              for (int j = 0; j < kOwn; ++j) {
                float const number = row.number(j, plan.codes.exponent);
#pragma unroll
                for (int n = 0; n < kChromaRows; ++n) c[n][j] += step.weights[n] * number;
              }
            } else {
              OwnCodes<S> const row = codes.asked(step.offset(), false, slot);
#pragma unroll
              for (int j = 0; j < kOwn; ++j) {
                float const number = row.number(j, plan.codes.exponent);
#pragma unroll
                for (int n = 0; n < kLumaRows; ++n) y[n][j] += step.weights[n] * number;
              }
            }
          }
          float* const to_sums = sums + r * kRowSums + kOwn / 2 * lane;
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
                *reinterpret_cast<Vector<float, 4>*>(to_sums + kChromaSums + kOwn / 2 * lane + 4 * k) = pairs;
              }
            }
          luma_slot = luma_slot + 1 < kLumaRows ? luma_slot + 1 : 0;
          chroma_slot = chroma_slot + 1 < kChromaRows ? chroma_slot + 1 : 0;
        }
        __syncwarp();
        auto const emit = [&](auto k, auto m) {
          for (int x = lane; x < columns; x += 32) {
            ColumnColors<decltype(k)::value, decltype(m)::value> colors;
            colors.add(sums, table, x, plan.columns, luma_taps, chroma_taps);
#pragma unroll
            for (int n = 0; n < 3; ++n) {
              float color[kAtOnce];
#pragma unroll
              for (int r = 0; r < kAtOnce; ++r)
                color[r] = p.colors.linear(n, colors.y[r], colors.u[r], colors.v[r], 1.f);
              store_rows(to + n * plane + x, stride, count > 1, color, p.colors.lowest[n], p.colors.highest[n]);
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
        __syncwarp();
      }
      __pipeline_wait_prior(0);
    }
    __syncthreads();
  }
}

// Whether bands serve a call, and how. Boxes within the frame have room.
template <class T>
bool plan_bands(PlanesToRgb<T> const& p, CodeRowsPlan const& codes, BandPlan& plan) {
  plan.codes = codes;
  int const width = int(p.rgb.width), height = int(p.rgb.height), most_warps = band_warps(p.code_bytes, codes.is_plain);
  BoxAxis<float> const across(0, float(p.x.size), width, p.x.size, p.antialias);
  BoxAxis<float> const down(0, float(p.y.size), height, p.y.size, p.antialias);
  int const window = whole_within(-floor_of(-2 * across.support), 1, p.x.size);
  plan.luma_taps = window;
  plan.chroma_taps = window / 2 + (p.x.site == ChromaSite::nearest ? 1 : 2);
  float const room = float(kSpan - kOwn - 4) - 2 * across.support;
  if (room < across.scale) return false;
  int const most_columns = whole_within(room / across.scale, 1, kSpan);
  for (int most = min(width, most_columns);; most /= 2) {
    plan.columns = divided(width, most);
    int const warps_across = int(ceil_div(width, plan.columns));
    plan.warps = divided(warps_across, most_warps);
    plan.rows = band_rows(p.rgb.count() / 3 * ceil_div(warps_across, plan.warps), height,
                          int64_t(kBandBlocks * most_warps / plan.warps) * multiprocessors());
    plan.steps = most_steps(p, down, plan.rows);
    if (plan.bytes(p.code_bytes) + int64_t(sizeof(BandRows)) <= max_shared_bytes(72 << 10)) return true;
    if (most < 16) return false;
  }
}

template <class S, class T>
int launch_bands(PlanesToRgb<T> const& p, BandPlan const& plan, CUstream_st* stream) {
  auto* const kernel = plan.codes.is_plain ? run_bands<S, T, true> : run_bands<S, T, false>;
  int const bytes = int(plan.bytes(sizeof(S)));
  if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes)) return error;
  dim3 const blocks(unsigned(ceil_div(p.rgb.width, plan.warps * plan.columns)),
                    unsigned(ceil_div(p.rgb.height, plan.rows)), unsigned(min(p.rgb.count() / 3, int64_t(65535))));
  kernel<<<blocks, 32 * plan.warps, bytes, stream>>>(p, plan);
  return cudaGetLastError();
}

}  // namespace
}  // namespace kv::color::cuda
