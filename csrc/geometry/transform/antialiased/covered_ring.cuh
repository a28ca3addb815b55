// Antialiased samples by affine maps whose weights are products of those along both axes, on CUDA: parts of a tile as
// those of covered_parts.cuh, channel by channel.
//
// A channel of a part is a stage. Shared memory is a ring of the source pixels of three stages, in the type of the
// image, with the fill around it: while one stage is sampled, those of the next two arrive, of the next part, too. A
// thread has taps of one pixel, whose weights along x it keeps for all channels, divided by the sum of all weights.
#pragma once

#include "geometry/transform/antialiased/covered_parts.cuh"

namespace kv::geometry::cuda {
namespace {

// A part that is sampled by the ring.
template <class F>
struct alignas(16) RingPart {
  int x, y;                 // its first pixel
  int left, top;            // where its source pixels begin in the image
  int last_left, last_top;  // of windows, counted from there
  F u, v;                   // of the first pixel, counted from there

  // The part at (x, y); whether it is such: its vectors are pixels of the image or, where `filled`, the fill.
  template <class T>
  __device__ __forceinline__ bool init(Sample<T> const& p, TileInParts<F> const& whole, bool filled, int x, int y) {
    Tile<F> const& tile = whole.tile;
    PartBounds<F> const bounds = whole.bounds(x, y, int(p.y.width), int(p.y.height));
    tile.map.apply(F(x - tile.x), F(y - tile.y), u, v);
    u -= F(bounds.left);
    v -= F(bounds.top);
    this->x = x;
    this->y = y;
    left = bounds.left + tile.u;
    top = bounds.top + tile.v;
    last_left = bounds.columns - whole.plan.taps_x;
    last_top = bounds.rows - whole.plan.taps_y;
    return filled ? !bounds.is_outside(tile, p) : bounds.template is_inside<4>(tile, p);
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
  unsigned staged, others;  // those of the parts located at once that are sampled by the ring, and those that are not
};

// A thread's source pixels of parts, in vectors of four.
template <class T>
struct RingLoader {
  using F = Compute<T>;
  using Ring = PartsRing<F>;
  static constexpr int kAcross = Ring::kPitch / 4, kRowsAtOnce = kThreads / kAcross;
  static constexpr int kVectors = ceil_div(PartTiles::kRows, kRowsAtOnce);

  int64_t const stride;  // from one vector to the next
  T* const to;
  T const* from;
  unsigned copied, filled;  // which of them are needed, inside the image and outside

  __device__ __forceinline__ RingLoader(Sample<T> const& p, T* memory)
      : stride(kRowsAtOnce * p.x.row_stride),
        to(memory + int(threadIdx.x) / kAcross * Ring::kPitch + int(threadIdx.x) % kAcross * 4) {}

  __device__ __forceinline__ void locate(Sample<T> const& p, PartPlan<F> const& plan, RingPart<F> const& part,
                                         T const* plane) {
    int const column = threadIdx.x % kAcross * 4, first_row = threadIdx.x / kAcross, top = part.top + first_row;
    from = plane + (top * int(p.x.row_stride) + (part.left + column));
    // How far the output's pixel whose sampling coordinates are in the middle of the vector is from the middle of the
    // part.
    F const du = F(column) + F(1.5) - (part.u + plan.middle_u), dv = F(first_row) - (part.v + plan.middle_v);
    F x = plan.back[0] * du + plan.back[1] * dv, y = plan.back[2] * du + plan.back[3] * dv;
    F const step_x = plan.back[1] * F(kRowsAtOnce), step_y = plan.back[3] * F(kRowsAtOnce);
    int const rows = column < part.last_left + plan.taps_x ? part.last_top + plan.taps_y - first_row : 0;
    unsigned const height = unsigned(part.left + column) < unsigned(p.x_axis.size) ? unsigned(p.y_axis.size) : 0;
    copied = filled = 0;
#pragma unroll
    for (int r = 0; r < kVectors; ++r) {
      if (r * kRowsAtOnce < rows && vabs(x) <= plan.limit_x && vabs(y) <= plan.limit_y)
        (unsigned(top + r * kRowsAtOnce) < height ? copied : filled) |= 1u << r;
      x += step_x;
      y += step_y;
    }
  }
  // A thread overwrites what it had copied three stages ago, which it has waited for.
  __device__ __forceinline__ void load(Sample<T> const& p, int b, int channel, int stage) const {
    T const* vector = from;
    T* const first = to + stage * Ring::kSize;
#pragma unroll
    for (int r = 0; r < kVectors; ++r) {
      if (copied & 1u << r) __pipeline_memcpy_async(first + r * kRowsAtOnce * Ring::kPitch, vector, 4 * sizeof(T));
      vector += stride;
    }
    if (filled == 0) return;
    T const fill = round_to<T>(p.fill_value(b, channel));
    Vector<T, 4> const fills{fill, fill, fill, fill};
#pragma unroll 1
    for (unsigned rest = filled; rest != 0; rest &= rest - 1)
      *reinterpret_cast<Vector<T, 4>*>(first + (__ffs(int(rest)) - 1) * (kRowsAtOnce * Ring::kPitch)) = fills;
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
// each pixel, of Rows rows where that is not 0.
template <int A, int Taps, int Rows, int N, class T, class F>
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
  loader.locate(p, plan, ring.parts[0], source);
  loader.load(p, tile.b, first, 0);
  __pipeline_commit();
  if (N > 1)
    loader.from += channel_stride;
  else if (count > 1)
    loader.locate(p, plan, ring.parts[1], source);
  if (N > 1 || count > 1) loader.load(p, tile.b, first + (N > 1), 1);
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
    [[maybe_unused]] F rows[Rows > 0 ? Rows : 1];  // weights along y
    if constexpr (Rows > 0) {
#pragma unroll
      for (int j = 0; j < Rows; ++j) {
        rows[j] = vsaturate(1 - vabs(q));
        down += rows[j];
        q += by_y;
      }
    } else {
#pragma unroll 2
      for (int j = 0; j < taps_y; ++j) {
        down += vsaturate(1 - vabs(q));
        q += by_y;
      }
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
      int const free = N > 1 ? (k + 2) % N : stage > 0 ? stage - 1 : 2;
      if (next < count) {
        if (N == 1 || k == 1)
          loader.locate(p, plan, ring.parts[next], source);
        else
          loader.from += channel_stride;
        loader.load(p, tile.b, first + (N > 1 ? free : 0), free);
      }
      __pipeline_commit();
      T const* row = at + (N > 1 ? k : stage) * Ring::kSize;
      F total = 0, q = first_q;
      auto const sum_of_row = [&] {
        F across = weights[0] * F(read(row[0]));
#pragma unroll
        for (int i = 1; i < Taps; ++i) across += weights[i] * F(read(row[i << A]));
        row += Ring::kPitch;
        return across;
      };
      if constexpr (Rows > 0) {
#pragma unroll
        for (int j = 0; j < Rows; ++j) total += rows[j] * sum_of_row();
      } else {
#pragma unroll 2
        for (int j = 0; j < taps_y; ++j) {
          total += vsaturate(1 - vabs(q)) * sum_of_row();
          q += by_y;
        }
      }
      total = sum_of_adjacent<A>(total);
      rest += total;
      if (is_pixel) *to = round_to<T>(total);
      to += channel_step;
    }
    if (is_pixel && !(fits && rest - rest == 0)) failed |= 1u << part;
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
  // Vectors are inside the image or outside, and the fill is exact in its type.
  bool const filled =
      p.x_axis.padding == Padding::fill && p.x_axis.size % 4 == 0 && (sizeof(T) == sizeof(F) || !p.fill);
#pragma unroll 1
  for (int from = split * count / splits; from < end; from += PartsRing<F>::kParts) {
    __syncthreads();  // before parts are overwritten
    if (threadIdx.x < 32) {
      int x, y;
      whole.locate(from + lane, x, y);
      bool const exists = from + lane < end && x < width && y < height;
      RingPart<F> part;
      bool const is_staged = uses_ring && exists && part.init(p, whole, filled, x, y);
      unsigned const staged = __ballot_sync(kAllLanes, is_staged);
      unsigned const others = __ballot_sync(kAllLanes, exists && !is_staged);
      if (is_staged) ring.parts[__popc(staged & ((1u << lane) - 1))] = part;
      if (lane == 0) {
        ring.staged = staged;
        ring.others = others;
      }
    }
    __syncthreads();
    int const parts = __popc(ring.staged);
    unsigned others = ring.others;
    if (parts != 0) {
      for_each_channel_group<PartsRing<F>::kStages>(p.x.channels, [&](int first, auto number) {
        dispatch_shape(plan, [&](auto across, auto taps) {
          constexpr int A = across.value, Taps = taps.value, N = number.value;
          auto const sample = [&](auto rows) {
            sample_stages<A, Taps, rows.value, N>(p, ring, parts, first, reinterpret_cast<T*>(memory));
          };
          // Rows of images that shrink by one factor are known.
          constexpr bool kIsKnown = N > 1 && Taps << A <= 8;
          if (kIsKnown && plan.taps_y == Taps << A)
            sample(std::integral_constant<int, kIsKnown ? Taps << A : 0>{});
          else
            sample(std::integral_constant<int, 0>{});
        });
      });
    }
#pragma unroll 1
    for (; others != 0; others &= others - 1) {
      int x, y;
      whole.locate(from + __ffs(int(others)) - 1, x, y);
      sample_whole_part(p, whole, x, y, aligned, reinterpret_cast<F*>(memory));
    }
  }
}

}  // namespace
}  // namespace kv::geometry::cuda
