// Antialiased samples by affine maps whose weights are products of those along both axes, on CUDA: parts of a tile as
// those of covered_parts.cuh, channel by channel.
//
// A channel of a part is a stage. Shared memory is a ring of the source pixels of three stages, in the type of the
// image: while one stage is sampled, those of the next two arrive, of the next part, too. A thread has taps of one
// pixel, whose weights along x it keeps for all channels, divided by the sum of all weights.
#pragma once

#include "geometry/transform/antialiased/covered_parts.cuh"

namespace kv::geometry::cuda {
namespace {

// A part whose taps are pixels of the image, not padding.
template <class F>
struct alignas(16) RingPart {
  int x, y, at;             // its first pixel, and where its source pixels begin in a plane
  int last_left, last_top;  // of windows, counted from there
  int rows;
  F u, v;  // of the first pixel, counted from there

  // The part at (x, y); whether it is such.
  template <class T>
  __device__ __forceinline__ bool init(Sample<T> const& p, TileInParts<F> const& whole, int x, int y) {
    Tile<F> const& tile = whole.tile;
    PartBounds<F> const bounds = whole.bounds(x, y, int(p.y.width), int(p.y.height));
    tile.map.apply(F(x - tile.x), F(y - tile.y), u, v);
    u -= F(bounds.left);
    v -= F(bounds.top);
    this->x = x;
    this->y = y;
    at = (bounds.top + tile.v) * int(p.x.row_stride) + bounds.left + tile.u;
    last_left = bounds.columns - whole.plan.taps_x;
    last_top = bounds.rows - whole.plan.taps_y;
    rows = bounds.rows;
    return bounds.template is_inside<4>(tile, p);
  }
};

// A tile, and those of its parts that are sampled in turn.
template <class F>
struct PartsRing {
  static constexpr int kStages = 3, kPitch = PartTiles::kPitch, kSize = kPitch * PartTiles::kRows;  // of pixels
  static constexpr int kLogSide = 4;  // of parts: at least a thread a pixel
  static_assert(1 << 2 * kLogSide == kThreads);
  static constexpr int kParts = 32;  // located at once

  RingPart<F> parts[kParts];
  TileInParts<F> whole;
};

// A thread's source pixels of parts, in vectors of four.
template <class T>
struct RingLoader {
  using F = Compute<T>;
  using Ring = PartsRing<F>;
  static constexpr int kAcross = Ring::kPitch / 4, kRowsAtOnce = kThreads / kAcross;
  static constexpr int kVectors = ceil_div(PartTiles::kRows, kRowsAtOnce);

  int64_t const stride;  // from one vector to the next
  int const own;         // what the first one is behind the part's first pixel
  T* const to;
  T const* from;
  unsigned mask;  // which of them are read

  __device__ __forceinline__ RingLoader(Sample<T> const& p, T* memory)
      : stride(kRowsAtOnce * p.x.row_stride),
        own(int(threadIdx.x) / kAcross * int(p.x.row_stride) + int(threadIdx.x) % kAcross * 4),
        to(memory + int(threadIdx.x) / kAcross * Ring::kPitch + int(threadIdx.x) % kAcross * 4) {}

  __device__ __forceinline__ void locate(PartPlan<F> const& plan, RingPart<F> const& part, T const* plane) {
    int const column = threadIdx.x % kAcross * 4, first_row = threadIdx.x / kAcross;
    from = plane + (part.at + own);
    // How far the output's pixel whose sampling coordinates are in the middle of the vector is from the middle of the
    // part.
    F const du = F(column) + F(1.5) - (part.u + plan.middle_u), dv = F(first_row) - (part.v + plan.middle_v);
    F x = plan.back[0] * du + plan.back[1] * dv, y = plan.back[2] * du + plan.back[3] * dv;
    F const step_x = plan.back[1] * F(kRowsAtOnce), step_y = plan.back[3] * F(kRowsAtOnce);
    int const rows = column < part.last_left + plan.taps_x ? part.rows - first_row : 0;
    mask = 0;
#pragma unroll
    for (int r = 0; r < kVectors; ++r) {
      if (r * kRowsAtOnce < rows && vabs(x) <= plan.limit_x && vabs(y) <= plan.limit_y) mask |= 1u << r;
      x += step_x;
      y += step_y;
    }
  }
  __device__ __forceinline__ void load(int stage) const {
    T const* vector = from;
#pragma unroll
    for (int r = 0; r < kVectors; ++r) {
      if (mask & 1u << r)
        __pipeline_memcpy_async(to + (stage * Ring::kSize + r * kRowsAtOnce * Ring::kPitch), vector, 4 * sizeof(T));
      vector += stride;
    }
  }
};

// The sum over 2^A adjacent threads, for all of them.
template <int A, class F>
__device__ __forceinline__ F sum_of_adjacent(F x) {
#pragma unroll
  for (int step = 1; step < 1 << A; step *= 2) x += __shfl_xor_sync(kAllLanes, x, step);
  return x;
}

// Samples N channels from `first` on of the first `count` parts of the ring, with 2^A threads and Taps << A columns for
// each pixel.
template <int A, int Taps, int N, class T, class F>
__device__ __forceinline__ void sample_stages(Sample<T> const& p, PartsRing<F> const& ring, int count, int first,
                                              T* memory) {
  using Ring = PartsRing<F>;
  static_assert(N == 1 || N == Ring::kStages);
  Tile<F> const& tile = ring.whole.tile;
  PartPlan<F> const& plan = ring.whole.plan;
  int const own = threadIdx.x & ((1 << A) - 1), number = int(threadIdx.x) >> A;
  int const log_line = plan.along_x ? plan.log_columns : plan.log_rows, along = number & ((1 << log_line) - 1);
  int const in_x = plan.along_x ? along : number >> log_line, in_y = plan.along_x ? number >> log_line : along;
  F const(&m)[9] = tile.map.m;
  F const in_u = m[0] * F(in_x) + m[1] * F(in_y), in_v = m[3] * F(in_x) + m[4] * F(in_y);
  F const by_x = plan.footprint.xx, by_y = plan.footprint.yy, reach_x = plan.reach_x, reach_y = plan.reach_y;
  int const taps_y = plan.taps_y, row_stride = int(p.y.row_stride), step = int(p.y.step);
  int64_t const channel_stride = p.x.channel_stride, channel_step = p.y.channel_stride;
  int const last_x = own == 0 && number < 1 << (plan.log_columns + plan.log_rows) ? int(p.y.width) - in_x : 0;
  int const last_y = int(p.y.height) - in_y;
  T const* const source = p.x.row(tile.image, first, 0);
  T* const result = p.y.row(tile.b, first, 0) + (in_y * row_stride + in_x * step);

  RingLoader<T> loader(p, memory);
  unsigned failed = 0;  // parts
  __syncthreads();      // before the ring is overwritten
  loader.locate(plan, ring.parts[0], source);
  loader.load(0);
  __pipeline_commit();
  if (N > 1)
    loader.from += channel_stride;
  else if (count > 1)
    loader.locate(plan, ring.parts[1], source);
  if (N > 1 || count > 1) loader.load(1);
  __pipeline_commit();
  int stage = 0;  // of the part, if it has one
#pragma unroll 1
  for (int part = 0; part < count; ++part) {
    RingPart<F> const now = ring.parts[part];
    bool const is_pixel = now.x < last_x && now.y < last_y;
    T* to = result + (now.y * row_stride + now.x * step);
    F const u = now.u + in_u, v = now.v + in_v;
    F left_of, top_of;
    int const left = floor_near(u - reach_x, left_of) + 1, top = floor_near(v - reach_y, top_of) + 1;
    bool const fits = unsigned(left) <= unsigned(now.last_left) && unsigned(top) <= unsigned(now.last_top);
    F const dx = left_of + F(own + 1) - u, first_q = by_y * (top_of + 1 - v);
    F weights[Taps], sum = 0, down = 0, q = first_q, rest = 0;
#pragma unroll
    for (int i = 0; i < Taps; ++i) {
      weights[i] = vsaturate(1 - vabs(by_x * (dx + F(i << A))));
      sum += weights[i];
    }
#pragma unroll 2
    for (int j = 0; j < taps_y; ++j) {
      down += vsaturate(1 - vabs(q));
      q += by_y;
    }
    F const scale = reciprocal(sum_of_adjacent<A>(sum) * down);
#pragma unroll
    for (int i = 0; i < Taps; ++i) weights[i] *= scale;
    T const* const at = memory + ((fits ? top * Ring::kPitch + left : 0) + own);
#pragma unroll
    for (int k = 0; k < N; ++k) {
      __pipeline_wait_prior(Ring::kStages - 2);
      __syncthreads();
      // The memory of the stage before this one is free.
      int const next = part + (N > 1 ? (k + 2) / N : 2);
      if (next < count) {
        if (N == 1 || k == 1)
          loader.locate(plan, ring.parts[next], source);
        else
          loader.from += channel_stride;
        loader.load(N > 1 ? (k + 2) % N : stage > 0 ? stage - 1 : Ring::kStages - 1);
      }
      __pipeline_commit();
      T const* row = at + (N > 1 ? k : stage) * Ring::kSize;
      F total = 0, q = first_q;
#pragma unroll 2
      for (int j = 0; j < taps_y; ++j) {
        F across = weights[0] * F(read(row[0]));
#pragma unroll
        for (int i = 1; i < Taps; ++i) across += weights[i] * F(read(row[i << A]));
        total += vsaturate(1 - vabs(q)) * across;
        q += by_y;
        row += Ring::kPitch;
      }
      total = sum_of_adjacent<A>(total);
      rest += total - total;
      if (is_pixel) to[k * channel_step] = round_to<T>(total);
    }
    if (is_pixel && !(fits && rest == 0)) failed |= 1u << part;
    if (N == 1) stage = stage + 1 < Ring::kStages ? stage + 1 : 0;
  }
#pragma unroll 1
  for (; failed != 0; failed &= failed - 1) {
    RingPart<F> const& part = ring.parts[__ffs(int(failed)) - 1];
#pragma unroll 1
    for (int k = 0; k < N; ++k) sample_carefully(p, tile, first + k, part.x + in_x, part.y + in_y);
  }
}

// Samples the split-th of `splits` equal numbers of parts of a tile, those that can be by the ring. `aligned`: rows
// begin with vectors of four pixels.
template <class T, class F>
__device__ __forceinline__ void sample_parts(Sample<T> const& p, PartsRing<F>& ring, bool aligned, int split,
                                             int splits, unsigned char* memory) {
  auto const& whole = ring.whole;
  auto const& plan = whole.plan;
  int const count = whole.count(), end = (split + 1) * count / splits, lane = int(threadIdx.x) % 32;
  int const width = int(p.y.width), height = int(p.y.height);
  bool const uses_ring = plan.separable && aligned;
#pragma unroll 1
  for (int from = split * count / splits; from < end; from += PartsRing<F>::kParts) {
    // Each warp finds the same; the first one stores it.
    int x, y;
    whole.locate(from + lane, x, y);
    bool const exists = from + lane < end && x < width && y < height;
    RingPart<F> part;
    bool const inside = uses_ring && exists && part.init(p, whole, x, y);
    unsigned const parts = __ballot_sync(kAllLanes, inside);
    unsigned others = __ballot_sync(kAllLanes, exists && !inside);
    if (parts != 0) {
      __syncthreads();  // before parts are overwritten
      if (threadIdx.x < 32 && inside) ring.parts[__popc(parts & ((1u << lane) - 1))] = part;
      __syncthreads();
      for_each_channel_group<PartsRing<F>::kStages>(p.x.channels, [&](int first, auto number) {
        dispatch_shape(plan, [&](auto across, auto taps) {
          sample_stages<across.value, taps.value, number.value>(p, ring, __popc(parts), first,
                                                                reinterpret_cast<T*>(memory));
        });
      });
    }
#pragma unroll 1
    for (; others != 0; others &= others - 1) {
      whole.locate(from + __ffs(int(others)) - 1, x, y);
      sample_whole_part(p, whole, x, y, aligned, reinterpret_cast<F*>(memory));
    }
  }
}

}  // namespace
}  // namespace kv::geometry::cuda
