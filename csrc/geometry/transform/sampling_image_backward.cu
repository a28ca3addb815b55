// The gradient of the image on CUDA, by one of two methods.
//
// Gather: a pixel of the source reads the gradients of all output pixels that have it as a tap. The inverse map gives
// their neighborhood, which is small and of equal size for all pixels of a tile. Results are deterministic, and each is
// written once. It serves warps by a matrix with fill padding; with other paddings, border pixels would be taps of all
// output pixels out of bounds. Where several samples read an image, a block adds them to its tile one after the other.
//
// Scatter: a warp adds a blocklet of the output to its taps, in private sums in shared memory. These are then added by
// atomics to a zeroed buffer of the compute type. Where the taps of the blocklet exceed the sums, the warp adds
// directly to the buffer.
#include "geometry/transform/source_tile.cuh"

namespace kv::geometry::cuda {
namespace {

// --- gather ----------------------------------------------------------------------------------------------------------

// The number of adjacent candidates that are tested together: for a rotation without scaling, all of them.
template <int K>
constexpr int kCandidatesPerStep = K == 4 ? 3 : K + 1;

// A tile of the source, in shared memory: the output pixels that may have its pixels as taps.
template <class F>
struct GatherTile {
  Homography<F> map, back;  // from coords, which count from (u, v), to pixels, which count from (x, y), and back
  int64_t b, image;
  int x, y, u, v;
  F reach_x, reach_y;  // from the output coordinate of a pixel
  int columns, rows;   // of candidates, from there on
  TapBounds coords;    // candidates of all pixels

  // For a located tile of a warp from the source to the output. By four threads of the first half of a warp, of which
  // each takes a corner, and the whole warp. Where the horizon is near, all output pixels are candidates.
  template <int K, class T>
  __device__ __forceinline__ void init(Tile<F> tile, SampleImageBackward<T> const& p) {
    constexpr F reach = F(K) / 2;
    // Half of the warp inverts, half does not: both take as long as one.
    MatrixUse const use = threadIdx.x & 16 ? p.coords.use : inverse_use(p.coords.use);
    Homography<double> const way = homography(p.coords.matrices + tile.b * p.coords.matrix_stride, use);
    Homography<double> whole;
#pragma unroll
    for (int i = 0; i < 9; ++i) whole.m[i] = shuffle_xor(way.m[i], 16);
    whole.affine = way.affine;  // both ways
    tile.bind(way, use.source);
    b = tile.b;
    image = tile.image;
    x = tile.x;
    y = tile.y;
    u = tile.u;
    v = tile.v;
    back = tile.map;
    F const at_x = F(threadIdx.x & 1 ? min(kTile, int(p.grad_x.width) - x) - 1 : 0);
    F const at_y = F(threadIdx.x & 2 ? min(kTile, int(p.grad_x.height) - y) - 1 : 0);
    F corner_u, corner_v, low = back.weight(at_x, at_y), high = low;
    back.apply(at_x, at_y, corner_u, corner_v);
    reach_x = reach_y = 0;
#pragma unroll
    for (int i = 0; i < 4; ++i) {
      F const to_x = at_x + (i & 1 ? reach : -reach), to_y = at_y + (i & 2 ? reach : -reach);
      F to_u, to_v;
      back.apply(to_x, to_y, to_u, to_v);
      reach_x = max(reach_x, vabs(to_u - corner_u));
      reach_y = max(reach_y, vabs(to_v - corner_v));
      low = min(low, back.weight(to_x, to_y));
      high = max(high, back.weight(to_x, to_y));
    }
    struct Corners {
      F reach_x, reach_y, low, high;
    };
    auto const of_all =
        warp_reduce<4>(Corners{reach_x, reach_y, low, high}, [](Corners const& a, Corners const& b) -> Corners {
          return {max(a.reach_x, b.reach_x), max(a.reach_y, b.reach_y), min(a.low, b.low), max(a.high, b.high)};
        });
    reach_x = of_all.reach_x;
    reach_y = of_all.reach_y;
    low = of_all.low;
    high = of_all.high;
    // A distance that goes from p to p + d is a linear function of p over the weights at both: so much it may be more
    // between the corners.
    F const min_weight = min(vabs(low), vabs(high)), max_weight = max(vabs(low), vabs(high));
    F const more = back.affine ? F(1) : max_weight / min_weight * (max_weight / min_weight);
    reach_x = reach_x * more + F(kCoordRounding);
    reach_y = reach_y * more + F(kCoordRounding);
    coords = TapBounds::empty();
    coords.template add<2>(corner_u - reach_x, corner_v - reach_y, F(kCoordRounding),
                           F(1 << 20));  // near the first candidates
    coords.template merge_lanes<4>();
    int const width = int(p.grad.width), height = int(p.grad.height);
    bool const near = low * high > 0 && reach_x < F(width) && reach_y < F(height) && coords.right < INT_MAX / 4;
    columns = near ? int(2 * reach_x) + 1 : width;
    rows = near ? int(2 * reach_y) + 1 : height;
    if (near) {
      coords.move(u, v);
      coords.right += (columns + kCandidatesPerStep<K> - 1) / kCandidatesPerStep<K> * kCandidatesPerStep<K> - 1;
      coords.bottom += rows - 1;
    } else {
      coords = TapBounds::all();
      reach_x = reach_y = 0;
      u = v = 0;
#pragma unroll
      for (int i = 0; i < 9; ++i) back.m[i] = i == 8;
      back.affine = true;
    }
    map = bind_to_tile<F>(whole, u, v, x, y);
  }
  // Whether no output pixel has a pixel of the tile as a tap.
  __device__ __forceinline__ bool is_unread(int width, int height) const {
    return coords.right < 0 || coords.left >= width || coords.bottom < 0 || coords.top >= height;
  }
};

// The next integer.
__device__ __forceinline__ int above(float x, float& whole) {
  constexpr float kLarge = 0x1.8p23f;
  float const sum = __fadd_ru(x, kLarge);
  whole = sum - kLarge;
  return __float_as_int(sum) - 0x4b400000;
}
__device__ __forceinline__ int above(double x, double& whole) {
  whole = ::ceil(x);
  return int(whole);
}

// 1 / x, of a weight; NaN, which is no valid coordinate, where there is none.
__device__ __forceinline__ float reciprocal_or_nan(float x) {
  float y;
  asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return fmaf(y, fmaf(-x, y, 1), y);
}
__device__ __forceinline__ double reciprocal_or_nan(double x) { return 1 / x; }

// Writes the gradient of a pixel, or adds it to that of earlier samples.
template <bool kAdds, class T, class F>
__device__ __forceinline__ void put(T& to, F sum) {
  if constexpr (kAdds)
    to += sum;
  else
    to = round_to<T>(sum);
}

// The gradient of N channels of a pixel (x, y) in its tile, from the gradients where they are.
template <int K, int N, bool kAdds, class T, class F, class Out>
__device__ __noinline__ void gather_unstaged(SampleImageBackward<T> const& p, GatherTile<F> const& tile,
                                             Images<Out> const& out, int first, int y, int x) {
  F center_u, center_v, first_u, first_v, sums[N] = {};
  tile.back.apply(F(x), F(y), center_u, center_v);
  int const u0 = above(center_u - tile.reach_x, first_u), v0 = above(center_v - tile.reach_y, first_v);
  int const width = int(p.grad.width), height = int(p.grad.height);
  for (int v = max(v0, -tile.v); v < min(v0 + tile.rows, height - tile.v); ++v)
    for (int u = max(u0, -tile.u); u < min(u0 + tile.columns, width - tile.u); ++u) {
      F coord_x, coord_y;
      tile.map.apply(F(u), F(v), coord_x, coord_y);
      F const weight = weight_at<K>(coord_x, x) * weight_at<K>(coord_y, y);
      if (weight == 0) continue;
      T const* const grad = p.grad.row(tile.b, first, v + tile.v) + (u + tile.u) * p.grad.step;
#pragma unroll
      for (int k = 0; k < N; ++k) sums[k] += weight * F(read(grad[k * p.grad.channel_stride]));
    }
#pragma unroll
  for (int k = 0; k < N; ++k) put<kAdds>(out.row(tile.image, first + k, tile.y + y)[tile.x + x], sums[k]);
}

// Zeros for a tile of all channels. `aligned`: rows are vectors of 16 bytes; a warp writes adjacent pixels otherwise.
template <class T>
__device__ __forceinline__ void clear_tile(Images<T> const& to, int64_t b, int x0, int y0, bool aligned) {
  auto const clear = [&](auto zero) {
    constexpr int kPixels = int(sizeof(zero) / sizeof(T)), kAcross = kTile / kPixels;
    int const x = x0 + threadIdx.x % kAcross * kPixels, width = int(to.width), bottom = min(y0 + kTile, int(to.height));
    for (int y = y0 + threadIdx.x / kAcross; x < width && y < bottom; y += kThreads / kAcross)
      for (int c = 0; c < to.channels; ++c) *reinterpret_cast<decltype(zero)*>(to.row(b, c, y) + x) = zero;
  };
  aligned ? clear(Vector<T, 16 / int(sizeof(T))>{}) : clear(T{});
}

// The gradients of a tile by one sample: `channels` of them from `begin` on, to `out`.
template <int K, bool kAdds, bool Aligned, class T, class F, class Out>
__device__ __forceinline__ void gather_tile(SampleImageBackward<T> const& p, GatherTile<F> const& tile,
                                            Images<Out> const& out, int begin, int channels, void* shared_pixels) {
  using Gradients = SourceTile<T, Aligned>;
  int const width = int(p.grad_x.width), height = int(p.grad_x.height);
  Axis<F> const x_axis{int(p.grad.width), Padding::fill, true}, y_axis{int(p.grad.height), Padding::fill, true};
  Gradients source_tile(shared_pixels, tile.coords, p.grad);
  int const x = column_in_tile<T>();
  for_each_channel_group<Gradients::kChannels>(channels, [&](int group, auto number) {
    constexpr int N = number.value;
    int const first = begin + group;
    if (source_tile.fits) source_tile.template load<N>(p.grad, tile.b, first, x_axis, y_axis, [](int) { return T{}; });
    if (tile.x + x >= width) return;
    F poison = 0;  // NaN where one of the gradients is no finite number: it may have had no weight
    Out* planes[N];
#pragma unroll
    for (int k = 0; k < N; ++k) planes[k] = out.row(tile.image, first + k, 0);
    int to = (tile.y + row_in_tile<T>()) * width + tile.x + x;
    T const* const origin = source_tile.origin(tile.u, tile.v);
    int const pitch = source_tile.pitch(), plane = source_tile.plane();
#pragma unroll 1
    for (int y = row_in_tile<T>(); source_tile.fits && y < min(kTile, height - tile.y);
         y += kRowStep, to += kRowStep * width) {
      F center_u, center_v, first_u, first_v, sums[N] = {};
      tile.back.apply(F(x), F(y), center_u, center_v);
      int const u = above(center_u - tile.reach_x, first_u), v = above(center_v - tile.reach_y, first_v);
      auto const gather = [&](auto affine) {
        T const* row = origin + (v * pitch + u);
        F const(&m)[9] = tile.map.m;
        F from_x = first_u * m[0] + (first_v * m[1] + m[2]), from_y = first_u * m[3] + (first_v * m[4] + m[5]);
        // Of an affine map coordinates count from the pixel: one addition less for each. Not those of the nearest
        // pixel, where halves go to even ones.
        int const pixel_x = K > 1 && affine.value ? 0 : x, pixel_y = K > 1 && affine.value ? 0 : y;
        from_x -= F(x - pixel_x);
        from_y -= F(y - pixel_y);
        F from_weight = first_u * m[6] + (first_v * m[7] + m[8]);
#pragma unroll 1
        for (int j = 0; j < tile.rows; ++j, row += pitch) {
          F coord_x = from_x, coord_y = from_y, weight = from_weight;
          T const* grad = row;
#pragma unroll 1
          for (int i = 0; i < tile.columns; i += kCandidatesPerStep<K>)
#pragma unroll
            for (int n = 0; n < kCandidatesPerStep<K>; ++n, ++grad) {
              F const scale = affine.value ? F(1) : reciprocal_or_nan(weight);
              F const tap_weight = weight_at<K>(coord_x * scale, pixel_x) * weight_at<K>(coord_y * scale, pixel_y);
#pragma unroll
              for (int k = 0; k < N; ++k) sums[k] += tap_weight * F(read(grad[k * plane]));
              coord_x += m[0];
              coord_y += m[3];
              if constexpr (!affine.value) weight += m[6];
            }
          from_x += m[1];
          from_y += m[4];
          from_weight += m[7];
        }
      };
      tile.map.affine ? gather(std::true_type{}) : gather(std::false_type{});
      if constexpr (kAdds) {
        F own = 0;
#pragma unroll
        for (int k = 0; k < N; ++k) own += sums[k] * 0;
        if (own != 0) {  // what is added cannot be written again afterwards
          gather_unstaged<K, N, kAdds>(p, tile, out, first, y, x);
          continue;
        }
      }
#pragma unroll
      for (int k = 0; k < N; ++k) {
        if constexpr (!kAdds) poison += sums[k] * 0;
        put<kAdds>(planes[k][to], sums[k]);
      }
    }
    if (!source_tile.fits || poison != 0)
#pragma unroll 1
      for (int y = row_in_tile<T>(); y < min(kTile, height - tile.y); y += kRowStep)
        gather_unstaged<K, N, kAdds>(p, tile, out, first, y, x);
  });
}

// One sample an image.
template <class T, int K, bool Aligned>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 2 : 5)
    gather_tiles(__grid_constant__ SampleImageBackward<T> const p, TileGrid tiles, bool aligned_out) {
  using F = Compute<T>;
  __shared__ GatherTile<F> shared_tiles[kMaxTilesPerBlock];
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  if (threadIdx.x < 32) {
    int const number = threadIdx.x / 4 % kMaxTilesPerBlock;
    Tile<F> located;
    located.locate(tiles, number);
    GatherTile<F> tile;
    tile.template init<K>(located, p);
    if (threadIdx.x % 4 == 0 && threadIdx.x < 4 * kMaxTilesPerBlock) shared_tiles[number] = tile;
  }
  __syncthreads();
#pragma unroll 1
  for (int number = 0; number < int(tiles.per_block) && shared_tiles[number].x < int(p.grad_x.width); ++number) {
    GatherTile<F> const& tile = shared_tiles[number];
    if (tile.is_unread(int(p.grad.width), int(p.grad.height)))
      clear_tile(p.grad_x, tile.b, tile.x, tile.y, aligned_out);
    else
      gather_tile<K, false, Aligned>(p, tile, p.grad_x, 0, p.grad.channels, shared_pixels);
  }
}

// Whether a sample may read the tile of its image at (x, y): the box around the corners of the output overlaps it, or
// the horizon runs through the output.
template <int K, class T>
__device__ __noinline__ bool may_read_tile(SampleImageBackward<T> const& p, int64_t b, int x, int y) {
  auto const map = homography(p.coords.matrices + b * p.coords.matrix_stride, p.coords.use);
  double left = INFINITY, top = INFINITY, right = -INFINITY, bottom = -INFINITY;
  int before = 0;
#pragma unroll 1
  for (int i = 0; i < 4; ++i) {
    double const column = i & 1 ? double(p.grad.width - 1) : 0, row = i & 2 ? double(p.grad.height - 1) : 0;
    double u, v;
    map.apply(column, row, u, v);
    before += map.weight(column, row) > 0;
    left = fmin(left, u);
    right = fmax(right, u);
    top = fmin(top, v);
    bottom = fmax(bottom, v);
  }
  constexpr double margin = K / 2. + 1;  // the taps, and more than the rounding of coordinates
  return before % 4 != 0 ||
         (left - margin < x + kTile && right + margin > x && top - margin < y + kTile && bottom + margin > y);
}

// Several samples an image. A block takes a tile of an image and some of its channels. It looks through the samples, as
// many at a time as it has threads, and adds those that read the tile in their order, so that all runs give the same
// bits. Each sum belongs to one thread.
template <class T, int K, bool Aligned>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 2 : 5)
    gather_samples(__grid_constant__ SampleImageBackward<T> const p, TileGrid tiles, int channels_per_block) {
  using F = Compute<T>;
  constexpr int kWarps = kThreads / 32;
  __shared__ GatherTile<F> shared_tiles[kMaxTilesPerBlock];
  __shared__ int counts[kWarps], readers[kThreads];
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  Tile<F> located;
  located.locate(tiles, 0);
  int64_t const image = located.b;
  int const begin = int(blockIdx.y) * channels_per_block, channels = min(channels_per_block, p.grad.channels - begin);
  Images<F> const out{p.sums,           p.grad_x.batch_stride, p.grad_x.channel_stride, p.grad_x.row_stride,
                      p.grad_x.step,    p.grad_x.batch,        p.grad_x.height,         p.grad_x.width,
                      p.grad_x.channels};
#pragma unroll 1
  for (int64_t first = 0; first < p.grad.batch; first += kThreads) {
    int64_t const candidate = first + threadIdx.x;
    bool const reads = candidate < p.grad.batch && p.image_of(candidate) == image &&
                       may_read_tile<K>(p, candidate, located.x, located.y);
    unsigned const lanes = __ballot_sync(0xffffffffu, reads);
    if (threadIdx.x % 32 == 0) counts[threadIdx.x / 32] = __popc(lanes);
    __syncthreads();
    int position = __popc(lanes & ((1u << threadIdx.x % 32) - 1)), count = 0;
    for (int warp = 0; warp < kWarps; ++warp) {
      if (warp < int(threadIdx.x) / 32) position += counts[warp];
      count += counts[warp];
    }
    if (reads) readers[position] = threadIdx.x;
    __syncthreads();
#pragma unroll 1
    for (int next = 0; next < count; next += kMaxTilesPerBlock) {
      if (threadIdx.x < 32) {
        int const number = threadIdx.x / 4 % kMaxTilesPerBlock;
        Tile<F> of_sample = located;
        of_sample.b = first + readers[min(next + number, count - 1)];
        GatherTile<F> tile;
        tile.template init<K>(of_sample, p);
        if (threadIdx.x % 4 == 0 && threadIdx.x < 4 * kMaxTilesPerBlock) shared_tiles[number] = tile;
      }
      __syncthreads();
#pragma unroll 1
      for (int number = 0; number < min(kMaxTilesPerBlock, count - next); ++number) {
        GatherTile<F> const& tile = shared_tiles[number];
        if (!tile.is_unread(int(p.grad.width), int(p.grad.height)))
          gather_tile<K, true, Aligned>(p, tile, out, begin, channels, shared_pixels);
      }
      __syncthreads();  // before the tiles are overwritten
    }
  }
}

// --- scatter ---------------------------------------------------------------------------------------------------------

constexpr int kScatterWarps = 4;                         // of a block, which work alone
constexpr int kBlockletWidth = 16, kBlockletHeight = 8;  // output pixels that a warp takes at a time
constexpr int kCoordsPerLane = kBlockletWidth * kBlockletHeight / 32;

// A warp's sums, in shared memory: of pixels in rows of `pitch`, for some channels.
template <class F>
struct Sums {
  static constexpr int kCells = 576;  // of a channel: a blocklet rotated by any angle, or 1.5 times as large
  static constexpr int kChannels = sizeof(F) == 8 ? 1 : 3;  // at a time
  static __host__ __device__ int channels(int of) { return min(of, kChannels); }
  static size_t bytes(int of) { return kScatterWarps * kCells * (channels(of) * sizeof(F) + sizeof(int)); }
};

// Adds four sums to memory, at a multiple of their size.
template <class F>
__device__ __forceinline__ void add_four(F* to, Vector<F, 4> const& sums) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
  constexpr bool at_once = sizeof(F) == 4;
#else
  constexpr bool at_once = false;
#endif
  if constexpr (at_once) {
    asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};" ::"l"(__cvta_generic_to_global(to)), "f"(sums.v[0]),
                 "f"(sums.v[1]), "f"(sums.v[2]), "f"(sums.v[3])
                 : "memory");
  } else {
#pragma unroll
    for (int i = 0; i < 4; ++i)
      if (sums.v[i] != 0) atomicAdd(to + i, sums.v[i]);
  }
}

// A coordinate of the same value under reflection, whose taps pixel_at supports. Relative to `origin`; NaN is 0. A
// coordinate near the image does not change, so that adjacent ones stay adjacent.
template <class F>
__device__ __noinline__ F reflected_near(Axis<F> const& axis, F x, int origin) {
  F const first = F(-origin), reach = F(axis.size < 8 ? 1 : axis.size / 2);
  return x >= first - reach && x < first + (F(axis.size - 1) + reach) ? x : reflected(axis, x + F(origin)) - F(origin);
}

// Adds N channels of one output pixel directly to the sums in memory.
template <int K, int N, class T, class F>
__device__ __forceinline__ void scatter_pixel(SampleImageBackward<T> const& p, F* sums, F u, F v, Tile<F> const& tile,
                                              F const (&g)[N]) {
  F wx[K], wy[K], tx, ty;
  int const column = first_tap<K, F>(u, tx) + tile.u, row = first_tap<K, F>(v, ty) + tile.v;
  int const width = p.x_axis.size, stride = int(p.grad_x.row_stride);
  [[maybe_unused]] bool const rows_are_aligned = stride % 4 == 0 && column >= 0 && column + K <= width;
  tap_weights(tx, wx);
  tap_weights(ty, wy);
#pragma unroll
  for (int j = 0; j < K; ++j) {
    int const y = pixel_at(p.y_axis, row + j);
    if (unsigned(y) >= unsigned(p.y_axis.size)) continue;
#pragma unroll
    for (int k = 0; k < N; ++k) {
      F* const line = sums + k * p.grad_x.channel_stride + y * stride;
      F taps[8] = {};  // from the beginning of a vector on
#pragma unroll
      for (int i = 0; i < K; ++i) {
        F const weight = wx[i] * wy[j];
        taps[i] = weight == 0 ? F(0) : weight * g[k];
      }
      if constexpr (K > 1 && sizeof(F) == 4)
        if (rows_are_aligned) {
#pragma unroll
          for (int by = 1; by <= 2; by *= 2)
#pragma unroll
            for (int i = 7; i >= 0; --i)
              if (column & by) taps[i] = i < by ? F(0) : taps[max(i - by, 0)];
          F* const to = line + (column & -4);
          add_four(to, Vector<F, 4>{taps[0], taps[1], taps[2], taps[3]});
          if (taps[4] != 0 || taps[5] != 0 || taps[6] != 0)
            add_four(to + 4, Vector<F, 4>{taps[4], taps[5], taps[6], 0});
          continue;
        }
#pragma unroll
      for (int i = 0; i < K; ++i) {
        int const x = pixel_at(p.x_axis, column + i);
        if (unsigned(x) < unsigned(width) && taps[i] != 0) atomicAdd(line + x, taps[i]);
      }
    }
  }
}

// The output pixels of a run are two apart, so that few of them have a tap in common, and their sums in different
// banks:
//
//   0 1 0 1      those that do take turns: each writes its index to the cell of its first tap, and the one whose
//   2 3 2 3      index stays adds. Only the warp itself accesses its sums: plain additions, where atomics on floats are
//   1 0 1 0      loops.
//   3 2 3 2
template <class T, int K>
__global__ void __launch_bounds__(32 * kScatterWarps, sizeof(T) == 8 ? 4 : 6)
    scatter_tiles(__grid_constant__ SampleImageBackward<T> const p, TileGrid tiles) {
  using F = Compute<T>;
  constexpr int kCells = Sums<F>::kCells;
  __shared__ Tile<F> tile;
  extern __shared__ __align__(16) unsigned char shared_sums[];
  if (threadIdx.x == 0) {
    tile.init(tiles, p.coords);
    tile.image = p.image_of(tile.b);
  }
  __syncthreads();
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32, lane_x = lane % 8, lane_y = lane / 8;
  int const width = int(p.grad.width), height = int(p.grad.height),
            pixels = Sums<F>::channels(p.grad.channels) * kCells;
  F* const sums = reinterpret_cast<F*>(shared_sums) + warp * pixels;
  int* const numbers =
      reinterpret_cast<int*>(reinterpret_cast<F*>(shared_sums) + kScatterWarps * pixels) + warp * kCells;
  TileCoords<F> const coords(p.coords, tile);
  bool const filled = p.x_axis.padding == Padding::fill, reflects = p.x_axis.padding == Padding::reflection;
  // The coordinates next to the image that represent all those out of bounds; none under reflection.
  F const first_u = reflects ? -INFINITY : F(-4 - tile.u), last_u = reflects ? INFINITY : F(p.x_axis.size + 3 - tile.u);
  F const first_v = reflects ? -INFINITY : F(-4 - tile.v), last_v = reflects ? INFINITY : F(p.y_axis.size + 3 - tile.v);
#pragma unroll 1
  for (int blocklet = warp; blocklet < kTile * kTile / (kBlockletWidth * kBlockletHeight); blocklet += kScatterWarps) {
    int const x0 = tile.x + blocklet % (kTile / kBlockletWidth) * kBlockletWidth + 2 * lane_x;
    int const y0 = tile.y + blocklet / (kTile / kBlockletWidth) * kBlockletHeight + 2 * lane_y;
    auto const x_of = [&](int run) { return x0 + ((lane_y + run) & 1); };
    auto const y_of = [&](int run) { return y0 + run / 2; };

    // The sampling coordinates, which of them have taps, and the bounding box of the first taps.
    F u[kCoordsPerLane], v[kCoordsPerLane];
    if (!p.coords.has_map()) {
#pragma unroll
      for (int run = 0; run < kCoordsPerLane; ++run)
        tile.map.apply(F(x_of(run) - tile.x), F(y_of(run) - tile.y), u[run], v[run]);
    } else {
#pragma unroll
      for (int run = 0; run < kCoordsPerLane; ++run)
        coords.near(min(y_of(run), height - 1), min(x_of(run), width - 1), u[run], v[run]);
    }
    if (reflects) {
#pragma unroll
      for (int run = 0; run < kCoordsPerLane; ++run) {
        u[run] = reflected_near(p.x_axis, u[run], tile.u);
        v[run] = reflected_near(p.y_axis, v[run], tile.v);
      }
    }
    TapBounds box = TapBounds::empty();
    unsigned count = 0;
    bool far = false;
#pragma unroll
    for (int run = 0; run < kCoordsPerLane; ++run) {
      u[run] = vclamp(u[run], first_u, last_u);
      v[run] = vclamp(v[run], first_v, last_v);
      F t;
      int const column = near_tap<K>(u[run], t), row = near_tap<K>(v[run], t);
      bool const is_far = max(vabs(u[run]), vabs(v[run])) >= F(1 << 20);  // where near_tap is none
      bool const has_taps = !filled || (unsigned(column + tile.u + K - 1) < unsigned(p.x_axis.size + K - 1) &&
                                        unsigned(row + tile.v + K - 1) < unsigned(p.y_axis.size + K - 1));
      if (x_of(run) >= width || y_of(run) >= height || !(has_taps || is_far)) continue;
      count |= 1u << run;
      far |= is_far;
      box = {min(box.left, column), min(box.top, row), max(box.right, column), max(box.bottom, row)};
    }
    box = {warp_reduce(box.left, Min()), warp_reduce(box.top, Min()), -warp_reduce(-box.right, Min()),
           -warp_reduce(-box.bottom, Min())};
    if (box.left > box.right) continue;  // none
    far = __any_sync(0xffffffffu, far) || box.right - box.left > 64 || box.bottom - box.top > 64;
    // Vectors of four begin where those of the image do. Rows are an odd multiple of four: those of a run in other
    // banks.
    int const left = far ? 0 : ((box.left + tile.u) & -4) - tile.u, top = box.top, rows = box.bottom - top + K;
    int const columns = box.right - left + K, pitch = columns <= 20 ? 20 : ((columns + 3) & -8) | 4;
    bool const fits = !far && rows * pitch <= kCells;

    for_each_channel_group<Sums<F>::kChannels>(p.grad.channels, [&](int first, auto channels) {
      constexpr int N = channels.value;
      T const* const grad = p.grad.row(tile.b, first, 0);
      auto const offset_of = [&](int run) { return y_of(run) * int(p.grad.row_stride) + x_of(run) * int(p.grad.step); };
      F g[kCoordsPerLane][N];
#pragma unroll
      for (int run = 0; run < kCoordsPerLane; ++run)
#pragma unroll
        for (int k = 0; k < N; ++k)
          g[run][k] = count >> run & 1 ? F(read(grad[k * p.grad.channel_stride + offset_of(run)])) : F(0);
      F* const to = p.sums + tile.image * p.grad_x.batch_stride + first * p.grad_x.channel_stride;
      F to_u[kCoordsPerLane], to_v[kCoordsPerLane];
#pragma unroll
      for (int run = 0; run < kCoordsPerLane; ++run) to_u[run] = u[run], to_v[run] = v[run];
      auto const next_run = [&] {
#pragma unroll
        for (int next = 1; next < kCoordsPerLane; ++next) {
          to_u[next - 1] = to_u[next], to_v[next - 1] = to_v[next];
#pragma unroll
          for (int k = 0; k < N; ++k) g[next - 1][k] = g[next][k];
        }
      };
      if (!fits) {
#pragma unroll 1
        for (int run = 0; run < kCoordsPerLane; ++run, next_run())
          if (count >> run & 1) scatter_pixel<K, N>(p, to, to_u[0], to_v[0], tile, g[0]);
        return;
      }
      __syncwarp();  // before the previous sums are overwritten
      for (int i = 4 * lane; i < rows * pitch; i += 4 * 32)
#pragma unroll
        for (int k = 0; k < N; ++k) *reinterpret_cast<Vector<F, 4>*>(sums + k * kCells + i) = {};
      __syncwarp();

#pragma unroll 1
      for (int run = 0; run < kCoordsPerLane; ++run, next_run()) {
        F tx, ty, wx[K], wy[K];
        int const column = near_tap<K>(to_u[0], tx), row = near_tap<K>(to_v[0], ty);
        int const at = (row - top) * pitch + (column - left);
        tap_weights(tx, wx);
        tap_weights(ty, wy);
        bool waits = count >> run & 1;
        do {
          if (waits) atomicExch(numbers + at, lane);
          __syncwarp();
          bool const adds = waits && numbers[at] == lane;
#pragma unroll
          for (int j = 0; j < K; ++j)
#pragma unroll
            for (int i = 0; i < K; ++i) {
              F const weight = wx[i] * wy[j];
              F* const sum = sums + (at + j * pitch + i);
              if (adds && weight != 0)
#pragma unroll
                for (int k = 0; k < N; ++k) sum[k * kCells] += weight * g[0][k];
              __syncwarp();
            }
          waits = waits && !adds;
        } while (__any_sync(0xffffffffu, waits));
      }

      int const stride = int(p.grad_x.row_stride), to_left = left + tile.u, to_top = top + tile.v;
      if (stride % 4 == 0 && to_left >= 0 && to_top >= 0 && to_left + columns <= p.x_axis.size &&
          to_top + rows <= p.y_axis.size) {
        for (int row = lane_y; row < rows; row += 4)
          for (int column = 4 * lane_x; column < columns; column += 32)
#pragma unroll
            for (int k = 0; k < N; ++k) {
              Vector<F, 4> const four =
                  *reinterpret_cast<Vector<F, 4> const*>(sums + k * kCells + row * pitch + column);
              if (four.v[0] != 0 || four.v[1] != 0 || four.v[2] != 0 || four.v[3] != 0)
                add_four(to + k * p.grad_x.channel_stride + ((to_top + row) * stride + to_left + column), four);
            }
      } else {
        for (int row = 0; row < rows; ++row) {
          int const to_y = pixel_at(p.y_axis, to_top + row);
          if (unsigned(to_y) >= unsigned(p.y_axis.size)) continue;
          for (int column = lane; column < columns; column += 32) {
            int const to_x = pixel_at(p.x_axis, to_left + column);
            if (unsigned(to_x) >= unsigned(p.x_axis.size)) continue;
#pragma unroll
            for (int k = 0; k < N; ++k) {
              F const sum = sums[k * kCells + row * pitch + column];
              if (sum != 0) atomicAdd(to + k * p.grad_x.channel_stride + (to_y * stride + to_x), sum);
            }
          }
        }
      }
    });
  }
}

template <class T>
void gather(SampleImageBackward<T> const& p, CUstream_st* stream) {
  auto const& x = p.grad_x;
  TileGrid const tiles(x.batch, x.height, x.width, tiles_per_block(x.batch, x.height, x.width));
  with_alignment_of(p.grad, [&](auto aligned) {
    dispatch_taps(p.interpolation, [&](auto taps) {
      gather_tiles<T, taps.value, aligned.value>
          <<<tiles.blocks, kThreads, SourceTile<T, aligned.value>::bytes(p.grad.channels), stream>>>(
              p, tiles, rows_are_aligned(p.grad_x));
    });
  });
}

// Enough blocks to fill a large GPU: where the images have few tiles, each block takes some of the channels.
constexpr int64_t kGatherBlocks = 1024;

template <class T>
void add_gathered(SampleImageBackward<T> const& p, CUstream_st* stream) {
  auto const& x = p.grad_x;
  TileGrid const tiles(x.batch, x.height, x.width, 1);
  int64_t const groups = ceil_div(x.channels, SourceTile<T, true>::kChannels);
  int64_t const parts = min(groups, ceil_div(kGatherBlocks, int64_t(tiles.blocks)));
  int const channels_per_block = int(ceil_div(groups, parts)) * SourceTile<T, true>::kChannels;
  dim3 const blocks(tiles.blocks, unsigned(ceil_div(int64_t(x.channels), int64_t(channels_per_block))));
  with_alignment_of(p.grad, [&](auto aligned) {
    dispatch_taps(p.interpolation, [&](auto taps) {
      gather_samples<T, taps.value, aligned.value>
          <<<blocks, kThreads, SourceTile<T, aligned.value>::bytes(min(channels_per_block, x.channels)), stream>>>(
              p, tiles, channels_per_block);
    });
  });
}

template <class T>
void scatter(SampleImageBackward<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  auto const& x = p.grad;
  TileGrid const tiles(x.batch, x.height, x.width, 1);
  dispatch_taps(p.interpolation, [&](auto taps) {
    scatter_tiles<T, taps.value><<<tiles.blocks, 32 * kScatterWarps, Sums<F>::bytes(x.channels), stream>>>(p, tiles);
  });
}

}  // namespace

template <class T>
int sample_image_backward(SampleImageBackward<T> const& p, CUstream_st* stream) {
  bool const gathers = !p.coords.has_map() && p.x_axis.padding == Padding::fill;
  if (gathers && p.is_one_sample_per_image()) {
    gather(p, stream);
    return cudaGetLastError();
  }
  int64_t const count = p.grad_x.batch * p.grad_x.channels * p.grad_x.height * p.grad_x.width;
  cudaError_t const error = cudaMemsetAsync(p.sums, 0, size_t(count) * sizeof(Compute<T>), stream);
  if (error != cudaSuccess) return error;
  if (p.grad.batch > 0) gathers ? add_gathered(p, stream) : scatter(p, stream);
  return cudaGetLastError();
}

KV_INSTANTIATE(sample_image_backward, SampleImageBackward)

}  // namespace kv::geometry::cuda
