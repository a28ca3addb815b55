// The gradient to the image on CUDA, in one of two ways.
//
// Gather: a pixel of the source looks for the places that have it as a tap. By the map the other way round they lie
// around the one where it goes, as far as its neighbours do: few, and as many for all pixels of a tile. The same bits
// every run, nothing is written twice. For warps by a matrix whose outside is the fill: else pixels at the rim would be
// taps of places all around.
//
// Scatter: every place adds to its taps by atomics, first to those of its tile in shared memory, which are then added
// to zeros in the type that computes. Where a tile looks at more of the image than a patch holds, there at once.
#include "patch.cuh"

namespace kv::cuda {
namespace {

// --- gather
// --------------------------------------------------------------------------------------------------------

// How many candidates beside each other are looked at together: for a turn that keeps sizes, all of them.
template <int K>
constexpr int kTogether = K == 4 ? 3 : K + 1;

// A tile of the source, in shared memory: where the places are that have its pixels as taps.
template <class F>
struct Sources {
  Homography<F> map, back;  // from places, which count from (u, v), to pixels, which count from (x, y), and back
  int64_t b;
  int x, y, u, v;
  F reach_x, reach_y;  // from where a pixel goes
  int columns, rows;   // to look at, from there on
  Box places;          // that all pixels look at

  // By four threads of the first half of a warp, of which each takes a corner, and the whole warp. Where the horizon is
  // near, all places are looked at.
  template <int K, class T>
  __device__ __forceinline__ void open(Tiles const& tiles, SampleTranspose<T> const& p, int number) {
    constexpr F reach = F(K) / 2;
    Tile<F> tile;  // of a warp from the source to the output
    tile.place(tiles, number);
    // Half of the warp inverts, half does not: both take as long as one.
    MatrixUse const use = threadIdx.x & 16 ? p.places.use : other_way(p.places.use);
    Homography<double> const way = homography(p.places.matrices + tile.b * p.places.matrix_stride, use);
    Homography<double> whole;
#pragma unroll
    for (int i = 0; i < 9; ++i) whole.m[i] = __shfl_xor_sync(0xffffffffu, way.m[i], 16);
    whole.affine = way.affine;  // both ways
    tile.see(way, use.source);
    b = tile.b;
    x = tile.x;
    y = tile.y;
    u = tile.u;
    v = tile.v;
    back = tile.map;
    F const at_x = F(threadIdx.x & 1 ? min(kTile, int(p.grad_x.width) - x) - 1 : 0);
    F const at_y = F(threadIdx.x & 2 ? min(kTile, int(p.grad_x.height) - y) - 1 : 0);
    F corner_u, corner_v, low = back.weight(at_x, at_y), high = low;
    back.at(at_x, at_y, corner_u, corner_v);
    reach_x = reach_y = 0;
#pragma unroll
    for (int i = 0; i < 4; ++i) {
      F const to_x = at_x + (i & 1 ? reach : -reach), to_y = at_y + (i & 2 ? reach : -reach);
      F to_u, to_v;
      back.at(to_x, to_y, to_u, to_v);
      reach_x = max(reach_x, vabs(to_u - corner_u));
      reach_y = max(reach_y, vabs(to_v - corner_v));
      low = min(low, back.weight(to_x, to_y));
      high = max(high, back.weight(to_x, to_y));
    }
#pragma unroll
    for (int lane = 1; lane < 4; lane *= 2) {
      reach_x = max(reach_x, __shfl_xor_sync(0xffffffffu, reach_x, lane));
      reach_y = max(reach_y, __shfl_xor_sync(0xffffffffu, reach_y, lane));
      low = min(low, __shfl_xor_sync(0xffffffffu, low, lane));
      high = max(high, __shfl_xor_sync(0xffffffffu, high, lane));
    }
    // A distance that goes from p to p + d is a linear function of p over the weights at both: so much it may be more
    // between the corners.
    F const least = min(vabs(low), vabs(high)), most = max(vabs(low), vabs(high));
    F const more = back.affine ? F(1) : most / least * (most / least);
    reach_x = reach_x * more + F(kMargin);
    reach_y = reach_y * more + F(kMargin);
    places = Box::empty();
    places.template add<2>(corner_u - reach_x, corner_v - reach_y, F(kMargin),
                           F(1 << 20));  // near where pixels begin to look
    places.template join<4>();
    int const width = int(p.grad.width), height = int(p.grad.height);
    bool const near = low * high > 0 && reach_x < F(width) && reach_y < F(height) && places.right < INT_MAX / 4;
    columns = near ? int(2 * reach_x) + 1 : width;
    rows = near ? int(2 * reach_y) + 1 : height;
    if (near) {
      places.move(u, v);
      places.right += (columns + kTogether<K> - 1) / kTogether<K> * kTogether<K> - 1;
      places.bottom += rows - 1;
    } else {
      places = Box::all();
      reach_x = reach_y = 0;
      u = v = 0;
#pragma unroll
      for (int i = 0; i < 9; ++i) back.m[i] = i == 8;
      back.affine = true;
    }
    map = seen_from<F>(whole, u, v, x, y);
  }
};

// The next whole number.
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

// The gradient of N channels of a pixel (x, y) in its tile, from the gradients where they are.
template <int K, int N, class T, class F>
__device__ __noinline__ void gather_where_they_are(SampleTranspose<T> const& p, Sources<F> const& tile, int first,
                                                   int y, int x) {
  F center_u, center_v, first_u, first_v, sums[N] = {};
  tile.back.at(F(x), F(y), center_u, center_v);
  int const u0 = above(center_u - tile.reach_x, first_u), v0 = above(center_v - tile.reach_y, first_v);
  int const width = int(p.grad.width), height = int(p.grad.height);
  for (int v = max(v0, -tile.v); v < min(v0 + tile.rows, height - tile.v); ++v)
    for (int u = max(u0, -tile.u); u < min(u0 + tile.columns, width - tile.u); ++u) {
      F place_x, place_y;
      tile.map.at(F(u), F(v), place_x, place_y);
      F const weight = weight_at<K>(place_x, x) * weight_at<K>(place_y, y);
      if (weight == 0) continue;
      T const* const grad = p.grad.row(tile.b, first, v + tile.v) + (u + tile.u) * p.grad.step;
#pragma unroll
      for (int k = 0; k < N; ++k) sums[k] += weight * F(read(grad[k * p.grad.channel_stride]));
    }
#pragma unroll
  for (int k = 0; k < N; ++k) p.grad_x.row(tile.b, first + k, tile.y + y)[tile.x + x] = round_to<T>(sums[k]);
}

template <class T, int K>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 2 : 5)
    gather_tiles(__grid_constant__ SampleTranspose<T> const p, Tiles tiles, bool aligned) {
  using F = Compute<T>;
  using Gradients = Patch<T>;
  __shared__ Sources<F> shared_tiles[kTileRow];
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  int const width = int(p.grad_x.width), height = int(p.grad_x.height);
  if (threadIdx.x < 32) {
    int const number = threadIdx.x / 4 % kTileRow;
    Sources<F> tile;
    tile.template open<K>(tiles, p, number);
    if (threadIdx.x % 4 == 0 && threadIdx.x < 4 * kTileRow) shared_tiles[number] = tile;
  }
  __syncthreads();
  Axis<F> const x_axis{int(p.grad.width), Padding::fill, true}, y_axis{int(p.grad.height), Padding::fill, true};
#pragma unroll 1
  for (int number = 0; number < int(tiles.row) && shared_tiles[number].x < width; ++number) {
    Sources<F> const& tile = shared_tiles[number];
    Gradients const patch(shared_pixels, tile.places);
    int const x = column_in_tile<T>();
    in_groups<Gradients::kChannels>(p.grad.channels, [&](int first, auto channels) {
      constexpr int N = channels.value;
      if (patch.fits) patch.template load<N>(p.grad, tile.b, first, x_axis, y_axis, aligned, [](int) { return T{}; });
      if (tile.x + x >= width) return;
      F poison = 0;  // NaN where one of the gradients is no finite number: it may have had no weight
      T* planes[N];
#pragma unroll
      for (int k = 0; k < N; ++k) planes[k] = p.grad_x.row(tile.b, first + k, 0);
      int to = (tile.y + row_in_tile<T>()) * width + tile.x + x;
      int const origin = patch.origin(tile.u, tile.v);
#pragma unroll 1
      for (int y = row_in_tile<T>(); patch.fits && y < min(kTile, height - tile.y);
           y += kRunRows, to += kRunRows * width) {
        F center_u, center_v, first_u, first_v, sums[N] = {};
        tile.back.at(F(x), F(y), center_u, center_v);
        int const u = above(center_u - tile.reach_x, first_u), v = above(center_v - tile.reach_y, first_v);
        T const* row = patch.pixels + (v * Gradients::kPitch + u + origin);
        auto const gather = [&](auto affine) {
          F const(&m)[9] = tile.map.m;
          F from_x = first_u * m[0] + (first_v * m[1] + m[2]), from_y = first_u * m[3] + (first_v * m[4] + m[5]);
          F from_weight = first_u * m[6] + (first_v * m[7] + m[8]);
#pragma unroll 1
          for (int j = 0; j < tile.rows; ++j, row += Gradients::kPitch) {
            F place_x = from_x, place_y = from_y, weight = from_weight;
            T const* grad = row;
#pragma unroll 1
            for (int i = 0; i < tile.columns; i += kTogether<K>)
#pragma unroll
              for (int n = 0; n < kTogether<K>; ++n, ++grad) {
                F const scale = affine.value ? F(1) : reciprocal(weight);
                F const share = weight_at<K>(place_x * scale, x) * weight_at<K>(place_y * scale, y);
#pragma unroll
                for (int k = 0; k < N; ++k) sums[k] += share * F(read(grad[k * Gradients::kSize]));
                place_x += m[0];
                place_y += m[3];
                if constexpr (!affine.value) weight += m[6];
              }
            from_x += m[1];
            from_y += m[4];
            from_weight += m[7];
          }
        };
        tile.map.affine ? gather(std::true_type{}) : gather(std::false_type{});
#pragma unroll
        for (int k = 0; k < N; ++k) {
          poison += sums[k] * 0;
          planes[k][to] = round_to<T>(sums[k]);
        }
      }
      if (!patch.fits || poison != 0)
#pragma unroll 1
        for (int y = row_in_tile<T>(); y < min(kTile, height - tile.y); y += kRunRows)
          gather_where_they_are<K, N>(p, tile, first, y, x);
    });
  }
}

// --- scatter
// ------------------------------------------------------------------------------------------------------

// N channels of the places of a thread, to the sums where they are.
template <int K, int N, class T, class F>
__device__ __noinline__ void scatter_where_they_are(SampleTranspose<T> const& p, Tile<F> const& tile, int first, int y,
                                                    int x) {
  int64_t const plane = p.grad_x.channel_stride;
  F* const sums = p.sums + tile.b * p.grad_x.batch_stride + first * plane;
#pragma unroll 1
  for (int run = 0; run < kRuns && x < p.grad.width && y < p.grad.height; ++run, y += kRunRows) {
    F u, v, wx[K], wy[K];
    PlacesOf<F>(p.places, tile).at(y, x, u, v);
    Window<K, F> const window(p, u, v);
    tap_weights(window.tx, wx);
    tap_weights(window.ty, wy);
    T const* const grad = p.grad.row(tile.b, first, y) + x * p.grad.step;
    window.for_each(p, p.grad_x.row_stride, 1, [&](int j, int i, int64_t at) {
      F const weight = wx[i] * wy[j];
      if (at < 0 || weight == 0) return;
#pragma unroll
      for (int k = 0; k < N; ++k) atomicAdd(sums + k * plane + at, weight * F(read(grad[k * p.grad.channel_stride])));
    });
  }
}

template <class T, int K>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 2 : 4)
    scatter_tiles(__grid_constant__ SampleTranspose<T> const p, Tiles tiles) {
  using F = Compute<T>;
  using Sums = Patch<F>;
  __shared__ View<F> view;
  extern __shared__ __align__(16) unsigned char shared_sums[];
  int const width = int(p.grad.width), height = int(p.grad.height), lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  view.template open<K>(tiles, p, width, height);
#pragma unroll 1
  for (int number = 0; number < int(tiles.row) && view.tiles[number].x < width; ++number) {
    Tile<F> const& tile = view.tiles[number];
    void* const kept = shared_sums + Sums::bytes(p.grad.channels);
    Sums const patch(shared_sums, view.template look<K>(number, p, width, height, kept), p, F());
    int const x = tile.x + column_in_tile<T>(), y = tile.y + row_in_tile<T>(), origin = patch.origin(tile.u, tile.v);
    in_groups<Sums::kChannels>(p.grad.channels, [&](int first, auto channels) {
      constexpr int N = channels.value;
      if (!patch.fits) return scatter_where_they_are<K, N>(p, tile, first, y, x);
      F g[kRuns][N];
#pragma unroll
      for (int run = 0; run < kRuns; ++run)
#pragma unroll
        for (int k = 0; k < N; ++k)
          g[run][k] = x < width && y + run * kRunRows < height
                          ? F(read(p.grad.row(tile.b, first + k, y + run * kRunRows)[x * p.grad.step]))
                          : F(0);
      __syncthreads();  // for those who read the sums before these
      for (int row = warp; row < patch.rows; row += kThreads / 32)
        for (int column = lane; column < patch.columns; column += 32)
#pragma unroll
          for (int k = 0; k < N; ++k) patch.pixels[k * Sums::kSize + row * Sums::kPitch + column] = 0;
      __syncthreads();
      Runs<F> const runs(tile, p.places, kept, column_in_tile<T>(), row_in_tile<T>());
#pragma unroll
      for (int run = 0; run < kRuns; ++run) {
        if (x >= width || y + run * kRunRows >= height) break;
        F u, v, tx, ty, wx[K], wy[K];
        runs.at(run, u, v);
        int const column = near_tap<K>(u, tx), row = near_tap<K>(v, ty);
        F* const taps = patch.pixels + (row * Sums::kPitch + column + origin);
        tap_weights(tx, wx);
        tap_weights(ty, wy);
#pragma unroll
        for (int j = 0; j < K; ++j)
#pragma unroll
          for (int i = 0; i < K; ++i) {
            F const weight = wx[i] * wy[j];
            if (weight == 0) continue;
#pragma unroll
            for (int k = 0; k < N; ++k) atomicAdd(taps + k * Sums::kSize + j * Sums::kPitch + i, weight * g[run][k]);
          }
      }
      __syncthreads();
      F* const sums = p.sums + tile.b * p.grad_x.batch_stride + first * p.grad_x.channel_stride;
      for (int row = warp; row < patch.rows; row += kThreads / 32) {
        int const to_y = pixel_at(p.y_axis, patch.top + row);
        if (unsigned(to_y) >= unsigned(p.y_axis.size)) continue;
        for (int column = lane; column < patch.columns; column += 32) {
          int const to_x = pixel_at(p.x_axis, patch.left + column);
          if (unsigned(to_x) >= unsigned(p.x_axis.size)) continue;
          F* const to = sums + to_y * p.grad_x.row_stride + to_x;
#pragma unroll
          for (int k = 0; k < N; ++k) {
            F const sum = patch.pixels[k * Sums::kSize + row * Sums::kPitch + column];
            if (sum != 0) atomicAdd(to + k * p.grad_x.channel_stride, sum);
          }
        }
      }
    });
  }
}

template <class T>
void gather(SampleTranspose<T> const& p, CUstream_st* stream) {
  auto const& x = p.grad_x;
  Tiles const tiles(x.batch, x.height, x.width, tile_row(x.batch, x.height, x.width));
  with_taps(p.interpolation, [&](auto taps) {
    gather_tiles<T, taps.value>
        <<<tiles.count, kThreads, Patch<T>::bytes(p.grad.channels), stream>>>(p, tiles, in_packs(p.grad));
  });
}

template <class T>
int scatter(SampleTranspose<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  int64_t const count = p.grad_x.batch * p.grad_x.channels * p.grad_x.height * p.grad_x.width;
  cudaError_t const error = cudaMemsetAsync(p.sums, 0, size_t(count) * sizeof(F), stream);
  if (error != cudaSuccess) return error;
  auto const& x = p.grad;
  Tiles const tiles(x.batch, x.height, x.width, 1);
  with_taps(p.interpolation, [&](auto taps) {
    scatter_tiles<T, taps.value><<<tiles.count, kThreads, Patch<F>::bytes(x.channels, p.places), stream>>>(p, tiles);
  });
  return cudaSuccess;
}

}  // namespace

template <class T>
int sample_transpose(SampleTranspose<T> const& p, CUstream_st* stream) {
  bool const gathers = !p.places.has_map() && p.x_axis.padding == Padding::fill;
  if (gathers)
    gather(p, stream);
  else if (int const error = scatter(p, stream))
    return error;
  return cudaGetLastError();
}

KV_INSTANTIATE(sample_transpose, SampleTranspose)

}  // namespace kv::cuda
