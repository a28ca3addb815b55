// Sampling on CUDA: a thread takes sampling coordinates of a tile one after the other, and all channels of each. Taps
// are read from a source tile in shared memory, or from global memory when the taps exceed what a source tile holds.
#include "geometry/transform/matrix_formula.cuh"
#include "geometry/transform/source_tile.cuh"

namespace kv::geometry::cuda {
namespace {

// The value of K x K taps, rows `pitch` apart and pixels `step`, with the weights of (tx, ty).
template <int K, class T, class F>
__device__ __forceinline__ F mean(T const* taps, int pitch, int step, F tx, F ty, F const (&wx)[K], F const (&wy)[K]) {
  auto const at = [&](int j, int i) { return F(read(taps[j * pitch + i * step])); };
  if constexpr (K == 2) {
    F const above = at(0, 0) + tx * (at(0, 1) - at(0, 0)), below = at(1, 0) + tx * (at(1, 1) - at(1, 0));
    return above + ty * (below - above);
  } else {
    F sum = 0;
#pragma unroll
    for (int j = 0; j < K; ++j) {
      F line = 0;
#pragma unroll
      for (int i = 0; i < K; ++i) line += at(j, i) * wx[i];
      sum += line * wy[j];
    }
    return sum;
  }
}

// N channels at a sampling coordinate, from global memory. Tap by tap at the border, and where a tap of weight 0, which
// contributes nothing, may be NaN or inf.
template <int K, int N, class T, class F>
__device__ __noinline__ void sample_unstaged(Sample<T> const& p, Tile<F> const& tile, int first, int y, int x) {
  F u, v, wx[K], wy[K], poison = 0;
  TileCoords<F>(p.coords, tile).at(y, x, u, v);
  TapWindow<K, F> const window(p, u, v);
  tap_weights(window.tx, wx);
  tap_weights(window.ty, wy);
  int64_t const row = p.x.row_stride, step = p.x.step;
  T* const result = p.y.row(tile.b, first, y) + x * p.y.step;
  if (window.inside) {
    T const* const taps = p.x.row(tile.image, first, window.y) + window.x * step;
#pragma unroll
    for (int k = 0; k < N; ++k) {
      F const sum = mean<K>(taps + k * p.x.channel_stride, int(row), int(step), window.tx, window.ty, wx, wy);
      poison += sum * 0;
      result[k * p.y.channel_stride] = round_to<T>(sum);
    }
    if (poison == 0) return;
  }
#pragma unroll 1
  for (int k = 0; k < N; ++k) {
    T const* const plane = p.x.row(tile.image, first + k, 0);
    F const fill = p.fill_value(tile.b, first + k);
    F sum = 0;
    window.for_each(p, row, step, [&](int j, int i, int64_t at) {
      F const weight = wx[i] * wy[j];
      if (weight != 0) sum += weight * (at < 0 ? fill : F(read(plane[at])));
    });
    result[k * p.y.channel_stride] = round_to<T>(sum);
  }
}

template <class T, int K>
constexpr int kBlocks = sizeof(T) == 8 ? 2
                        : K == 4       ? 4
                                       : 5;  // on a multiprocessor at once; six are slower

// A separate kernel computes its matrices by a formula: its blocks wait for theirs first, and a run-time choice of
// where a matrix comes from would cost 2 to 4 % of the time.
template <class T, int K, bool ByFormula, bool Aligned>
__global__ void __launch_bounds__(kThreads, kBlocks<T, K>)
    sample_tiles(__grid_constant__ Sample<T> const p, TileGrid tiles) {
  using F = Compute<T>;
  using Source = SourceTile<T, Aligned>;
  constexpr int across = !Aligned && sizeof(T) == 4 && K <= 2 ? kWholeRow : kAcross<T>;
  __shared__ BlockTiles<F> block;
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  int const width = int(p.y.width), height = int(p.y.height);
  if constexpr (ByFormula) {
    F made[9];
    block.template prepare<K>(tiles, p, p.y.batch, width, height, [&](int64_t b) {
      make_plane_matrix(p.formula, b, made);
      return made;
    });
  } else {
    block.template prepare<K>(tiles, p, p.y.batch, width, height);
  }

#pragma unroll 1
  for (int number = 0; number < int(tiles.per_block); ++number) {
    Tile<F> const& tile = block.tiles[number];
    if (tile.x >= width || tile.b >= p.y.batch) break;
    void* const kept = shared_pixels + Source::bytes(p.x.channels);
    if (!tiles.of_samples || number == 0) block.template find_taps<K>(number, p, width, height, kept, across);
    Source source_tile(shared_pixels, block.taps[tiles.of_samples ? 0 : number], p.x, p, F());
    int64_t const b = tile.b;
    int const x = tile.x + column_in_tile(across), y = tile.y + row_in_tile(across);
    for_each_channel_group<Source::kChannels>(p.x.channels, [&](int first, auto number) {
      constexpr int N = number.value;
      if (source_tile.fits)
        source_tile.template load<N>(p.x, tile.image, first, p.x_axis, p.y_axis,
                                     [&](int c) { return p.fill ? round_to<T>(p.fill_value(b, c)) : T{}; });
      if (x >= width) return;
      F poison = 0;  // NaN where a tap is no finite number
      if (source_tile.fits) {
        T const* const origin = source_tile.origin(tile.u, tile.v);
        ThreadCoords<F> const thread_coords(tile, p.coords, kept, column_in_tile(across), row_in_tile(across));
        T* planes[N];
#pragma unroll
        for (int k = 0; k < N; ++k) planes[k] = p.y.row(b, first + k, 0);
        int to = y * int(p.y.row_stride) + x * int(p.y.step);  // a plane has less than 2^31 elements
        int const pitch = source_tile.pitch(), plane = source_tile.plane();
#pragma unroll 1
        for (int run = 0; run < kPixelsPerThread && y + run * kRowStep < height;
             ++run, to += kRowStep * int(p.y.row_stride)) {
          F u, v, tx, ty, wx[K], wy[K];
          thread_coords.at(run, u, v);
          int const column = near_tap<K>(u, tx), row = near_tap<K>(v, ty);
          T const* const taps = origin + (row * pitch + column);
          tap_weights(tx, wx);
          tap_weights(ty, wy);
#pragma unroll
          for (int k = 0; k < N; ++k) {
            F const sum = mean<K>(taps + k * plane, pitch, 1, tx, ty, wx, wy);
            if constexpr (sizeof(T) > 1 && K > 1) poison += sum * 0;
            planes[k][to] = round_to<T>(sum);
          }
        }
      }
      if (!source_tile.fits || poison != 0)
#pragma unroll 1
        for (int run = 0; run < kPixelsPerThread && y + run * kRowStep < height; ++run)
          sample_unstaged<K, N>(p, tile, first, y + run * kRowStep, x);
    });
  }
}

}  // namespace

template <class T>
int sample(Sample<T> const& p, CUstream_st* stream) {
  int const per_block = tiles_per_block(p.y.batch, p.y.height, p.y.width);
  bool const one_map = p.coords.has_map() && p.coords.x.batch_stride == 0 && p.coords.y.batch_stride == 0;
  TileGrid const tiles(p.y.batch, p.y.height, p.y.width, per_block, one_map && p.y.batch >= per_block);
  with_alignment_of(p.x, [&](auto aligned) {
    auto const run = [&](auto kernel) {
      kernel<<<tiles.blocks, kThreads, SourceTile<T, aligned.value>::bytes(p.x.channels, p.coords), stream>>>(p, tiles);
    };
    dispatch_taps(p.interpolation, [&](auto taps) {
      constexpr int K = taps.value;
      p.formula.id == WarpFormula::none ? run(sample_tiles<T, K, false, aligned.value>)
                                        : run(sample_tiles<T, K, true, aligned.value>);
    });
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(sample, Sample)

}  // namespace kv::geometry::cuda
