// Window sums on CUDA. Small windows: each warp walks down a strip of the image with the rows of its window in
// registers. All others: a block walks down a tile in batches of eight rows, and sums along the rows and down the columns
// from the sums of beginnings and ends of blocks of eight pixels, at a cost that hardly depends on the window's size.
#include "box.h"
#include "core/launch.cuh"

namespace kv::cuda {
namespace {

constexpr int kStripRows = 16;  // of a strip

// --- windows of up to 7 x 7 pixels
// ------------------------------------------------------------------------------------

template <class T, int K>
__global__ void __launch_bounds__(256) box_strip(Box<T> p, Border border, bool doubled, Strips<kPixels<T>> strips) {
  constexpr int P = kPixels<T>, R = K / 2;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.place(plane, x, y0)) return;
  int const width = int(p.x.width), height = int(p.x.height), y1 = min(y0 + int(strips.rows), height);
  Strip<R, true, P> const strip(x, width, border);
  T const* const in = p.x.plane(plane);
  T* out = p.y.row(plane, y0);
  auto const is_rim = [](int i, int n) { return i == 0 || i == n - 1; };
  // The columns of the rim count twice; see BoxAxis. Bit i: the value at x - R + i is one of them.
  unsigned twice = 0;
  if (doubled)
#pragma unroll
    for (int i = 0; i < P + 2 * R; ++i)
      if (x - R + i < width + R && is_rim(border_index(border, x - R + i, width), width)) twice |= 1u << i;

  struct Row {
    typename Strip<R, true, P>::template Fetched<T> fetched;
    F weight;
  };
  auto const fetch = [&](int y) {
    int const at = y < y1 + R ? border_index(border, y, height) : -1;
    Row row{};
    if (at >= 0) row.fetched = strip.fetch(in + at * p.x.row_stride);
    row.weight = doubled && is_rim(at, height) ? F(2) : F(1);
    return row;
  };
  // A row's sums along x, and its own pixels.
  auto const along = [&](Row const& row, F(&sums)[P], F(&own)[P]) {
    F v[P + 2 * R];
    strip.spread(row.fetched, v);
#pragma unroll
    for (int i = 0; i < P; ++i) own[i] = v[R + i];
    if (twice)
#pragma unroll
      for (int i = 0; i < P + 2 * R; ++i)
        if (twice >> i & 1) v[i] *= 2;
#pragma unroll
    for (int i = 0; i < P; ++i) {
      sums[i] = v[i];
#pragma unroll
      for (int t = 1; t < K; ++t) sums[i] += v[i + t];
      sums[i] *= row.weight;
    }
  };

  F sums[K][P], own[R + 1][P];  // of the rows around y, and of y to y + R
#pragma unroll
  for (int i = 0; i < K - 1; ++i) {
    F centre[P];
    along(fetch(y0 - R + i), sums[i], centre);
    if (i >= R)
#pragma unroll
      for (int c = 0; c < P; ++c) own[i - R][c] = centre[c];
  }
  F const scale = 1 / p.divisor;
  Row ahead = fetch(y0 + R);
#pragma unroll K
  for (int y = y0; y < y1; ++y) {
    Row const now = ahead;
    ahead = fetch(y + R + 1);
    along(now, sums[K - 1], own[R]);
    F const row_scale = doubled && is_rim(y, height) ? scale / 2 : scale;
    F result[P];
#pragma unroll
    for (int i = 0; i < P; ++i) {
      F sum = sums[0][i];
#pragma unroll
      for (int t = 1; t < K; ++t) sum += sums[t][i];
      result[i] = box_value<T>(sum, own[0][i], p.centre, p.divisor, scale,
                               doubled && is_rim(x + i, width) ? row_scale / 2 : row_scale);
    }
    strip.store(out, result);
    out += p.y.row_stride;
#pragma unroll
    for (int t = 0; t + 1 < K; ++t)
#pragma unroll
      for (int i = 0; i < P; ++i) sums[t][i] = sums[t + 1][i];
#pragma unroll
    for (int t = 0; t < R; ++t)
#pragma unroll
      for (int i = 0; i < P; ++i) own[t][i] = own[t + 1][i];
  }
}

// --- windows of any size
// ----------------------------------------------------------------------------------------------

constexpr int kBlock = 8;   // pixels of a block along either axis; also warps of a thread block, one a row of a batch
constexpr int kRounds = 2;  // blocks of a row that a thread makes

// A tile is `width` columns of pixels by `height` rows.
struct Tiles {
  int width, height, across, down;
  int pitch;  // blocks that a row of sums has room for
  int depth;  // blocks of column sums that are kept

  // Windows of up to kBlock pixels may lie inside one block; those are summed pixel by pixel from two blocks.
  static int blocks_kept(int64_t k) { return k > kBlock ? int(ceil_div(k - 1, kBlock)) : 2; }
  int64_t bytes(int size) const { return (2 * kBlock * kBlock * int64_t(pitch) + int64_t(depth) * kBlock * width) * size; }
};

template <class T>
__global__ void __launch_bounds__(256, sizeof(Compute<T>) == 8 ? 1 : 3)
    box_tile(Box<T> p, BoxAxis across, BoxAxis down, Tiles tiles, bool packed) {
  using F = Compute<T>;
  extern __shared__ __align__(16) unsigned char memory[];
  int const pitch = tiles.pitch, warp = threadIdx.x / 32, lane = threadIdx.x % 32;
  // Sums of rows, of one batch: [row][pixel of the block][block], which keeps threads on different banks.
  F* const sums = reinterpret_cast<F*>(memory);
  F* const heads = sums + kBlock * kBlock * pitch;   // the same for a block's pixels up to one
  F* const tails = heads + kBlock * kBlock * pitch;  // column sums of a block's rows from one on: [block][row][column]

  int const q = blockIdx.x / tiles.across, x0 = (blockIdx.x - q * tiles.across) * tiles.width;
  int const plane = q / tiles.down, y0 = (q - plane * tiles.down) * tiles.height;
  int const width = int(across.size), height = int(down.size), step = int(p.x.step);
  T const* const in = p.x.plane(plane / step) + plane % step;
  T* const out = p.y.plane(plane / step) + plane % step;

  // Where the transpose folds, the positions around the image have their sums, too, which go to the rim.
  bool const fold_x = across.rim > 0 && !across.doubled, fold_y = down.rim > 0 && !down.doubled;
  int const x1 = min(x0 + tiles.width, width), y1 = min(y0 + tiles.height, height);
  int const first_x = x0 == 0 && fold_x ? -int(across.after) : x0;
  int const last_x = x1 == width && fold_x ? width + int(across.before) : x1;
  int const first_y = y0 == 0 && fold_y ? -int(down.after) : y0;
  int const last_y = y1 == height && fold_y ? height + int(down.before) : y1;

  // Blocks begin at multiples of their size; block b makes the sums of the windows that begin in it.
  int const kx = int(across.count()), ky = int(down.count());
  int const left = (first_x - int(across.before)) & -kBlock, shift = first_x - int(across.before) - left;
  int const blocks = (last_x + int(across.after) - left + kBlock - 1) / kBlock;
  int const results = (last_x - first_x + shift + kBlock - 1) / kBlock;
  int const top = first_y - int(down.before), bottom = last_y + int(down.after);

  bool whole[kRounds];           // the block is inside the image and can be read at once,
  int columns[kRounds][kBlock];  // else its pixels, -1 for the constant
  unsigned twice[kRounds];       // the pixels that count twice
#pragma unroll
  for (int r = 0; r < kRounds; ++r) {
    int const b = lane + 32 * r, x = left + b * kBlock;
    whole[r] = packed && b < blocks && x >= 0 && x + kBlock <= width;
    twice[r] = 0;
#pragma unroll
    for (int i = 0; i < kBlock; ++i) {
      int const at = b < blocks && x + i < last_x + int(across.after) ? border_index(across.border, x + i, width) : -1;
      columns[r][i] = at < 0 ? -1 : at * step;
      if (across.doubled && (at == 0 || at == width - 1)) twice[r] |= 1u << i;
    }
  }

  struct Row {
    Pack<T, kBlock> block[kRounds];
    F weight;
  };
  auto const fetch = [&](int y) {
    int const at = y < bottom ? border_index(down.border, y, height) : -1;
    Row row{};
    row.weight = down.doubled && (at == 0 || at == height - 1) ? F(2) : F(1);
    if (at < 0) return row;
    T const* const from = in + at * p.x.row_stride;
#pragma unroll
    for (int r = 0; r < kRounds; ++r) {
      if (whole[r])
        row.block[r] = *reinterpret_cast<Pack<T, kBlock> const*>(from + left + (lane + 32 * r) * kBlock);
      else
#pragma unroll
        for (int i = 0; i < kBlock; ++i)
          if (columns[r][i] >= 0) row.block[r].v[i] = from[columns[r][i]];
    }
    return row;
  };

  F const scale = 1 / p.divisor;
  int const column = threadIdx.x, x = x0 + column;
  F const column_scale = across.doubled && (x == 0 || x == width - 1) ? scale / 2 : scale;
  F* const tail = tails + column;  // of this thread's column
  F carry = 0;                     // what the rim is still to get
  int oldest = 0;
  Row ahead = fetch(top + warp);
  for (int batch = top; batch < bottom; batch += kBlock) {
    Row const now = ahead;
    ahead = fetch(batch + kBlock + warp);

    // 1. Along the rows: warp by warp.
    F v[kRounds][kBlock];
    F* const head = heads + warp * kBlock * pitch;
    F* const sum = sums + warp * kBlock * pitch;
#pragma unroll
    for (int r = 0; r < kRounds; ++r) {
      int const b = lane + 32 * r;
#pragma unroll
      for (int i = 0; i < kBlock; ++i) v[r][i] = read(now.block[r].v[i]) * (twice[r] >> i & 1 ? 2 * now.weight : now.weight);
      if (b >= blocks) continue;
      F before = 0;
#pragma unroll
      for (int i = 0; i < kBlock; ++i) head[i * pitch + b] = before = kx > kBlock ? before + v[r][i] : v[r][i];
      if (kx > kBlock)
#pragma unroll
        for (int i = kBlock - 1; i > 0; --i) v[r][i - 1] += v[r][i];
    }
    __syncwarp();
#pragma unroll
    for (int r = 0; r < kRounds; ++r) {
      int const b = lane + 32 * r, far = (kx - 1) / kBlock, past = (kx - 1) % kBlock;
      if (b >= results) continue;
      if (kx > kBlock) {
        F middle = 0;
        for (int m = 1; m < far; ++m) middle += head[(kBlock - 1) * pitch + b + m];
        F const longer = middle + head[(kBlock - 1) * pitch + b + far];
#pragma unroll
        for (int i = 0; i < kBlock; ++i) {
          bool const over = i + past >= kBlock;
          sum[i * pitch + b] = v[r][i] + (over ? longer : middle) + head[(i + past) % kBlock * pitch + b + far + over];
        }
      } else {
#pragma unroll
        for (int i = 0; i < kBlock; ++i) {
          F s = v[r][i];
          for (int t = i + 1; t < i + kx; ++t) s += head[t % kBlock * pitch + b + t / kBlock];
          sum[i * pitch + b] = s;
        }
      }
    }
    auto const of = [&](int position) {
      int const i = position - first_x + shift;
      return i % kBlock * pitch + i / kBlock;
    };
    auto const fold = [&](int from, int to, int pixel) {
      __syncwarp();
      F s = 0;
      for (int i = from + lane; i < to; i += 32) s += sum[of(i)];
#pragma unroll
      for (int d = 16; d > 0; d /= 2) s += __shfl_xor_sync(0xffffffffu, s, d);
      if (lane == 0) sum[of(pixel)] = s;
    };
    if (width == 1 && first_x < last_x - 1) {
      fold(first_x, last_x, 0);
    } else {
      if (first_x < x0) fold(first_x, 1, 0);
      if (last_x > x1) fold(width - 1, last_x, width - 1);
    }
    __syncthreads();

    // 2. Down the columns: thread by thread.
    F h[kBlock];
#pragma unroll
    for (int j = 0; j < kBlock; ++j) h[j] = x < x1 ? sums[j * kBlock * pitch + of(x)] : F(0);
    __syncthreads();
    if (x >= x1) continue;
    if (ky > kBlock) {
      int const stride = kBlock * tiles.width, past = tiles.depth * kBlock - (ky - 1);
      F longer = 0, middle = 0;
      for (int m = 1, at = oldest; m < tiles.depth; ++m) {
        at = at + 1 == tiles.depth ? 0 : at + 1;
        (m == 1 ? longer : middle) += tail[at * stride];
      }
      longer += middle;
      int const next = oldest + 1 == tiles.depth ? 0 : oldest + 1;
      F before = 0, result[kBlock];
#pragma unroll
      for (int j = 0; j < kBlock; ++j) {
        bool const over = j + past >= kBlock;
        before += h[j];
        result[j] = tail[(over ? next : oldest) * stride + (j + past) % kBlock * tiles.width] + (over ? middle : longer) +
                    before;
      }
      F after = 0;
#pragma unroll
      for (int j = kBlock - 1; j >= 0; --j) tail[oldest * stride + j * tiles.width] = after += h[j];
      oldest = next;
#pragma unroll
      for (int j = 0; j < kBlock; ++j) h[j] = result[j];
    } else {
      int const stride = kBlock * tiles.width;
#pragma unroll
      for (int j = 0; j < kBlock; ++j) tail[oldest * stride + j * tiles.width] = h[j];
#pragma unroll
      for (int j = 0; j < kBlock; ++j) {
        for (int t = 1; t < ky; ++t)
          h[j] += tail[(t <= j ? oldest : 1 - oldest) * stride + (j - t + kBlock) % kBlock * tiles.width];
      }
      oldest = 1 - oldest;
    }
#pragma unroll
    for (int j = 0; j < kBlock; ++j) {
      int const y = batch + j - int(down.after);
      if (y < first_y || y >= last_y) continue;
      F const total = h[j] + carry;
      bool const more = y < 0 || (y >= height - 1 && y + 1 < last_y);
      carry = more ? total : F(0);
      if (more) continue;
      int const row = min(y, height - 1);
      F const own = p.centre != 0 ? read(in[row * p.x.row_stride + x * step]) : F(0);
      bool const half = down.doubled && (row == 0 || row == height - 1);
      out[row * p.y.row_stride + x * step] = round_to<T>(
          box_value<T>(total, own, p.centre, p.divisor, scale, half ? column_scale / 2 : column_scale));
    }
  }
}

// --- what is left: windows that no tile has room for, and the transpose of even windows with a reflected border
// ---------

template <class T>
__global__ void box_any(Box<T> p, bool transposed) {
  using F = Compute<T>;
  int64_t const i = int64_t(blockIdx.x) * blockDim.x + threadIdx.x, size = p.x.row_size(), step = p.x.step;
  if (i >= p.x.rows() * size) return;
  int64_t const e = i % size, r = i / size, plane = r / p.x.height, y = r % p.x.height, x = e / step, c = e % step;
  BoxAxis const across(p.kx, p.x.width, p.border, transposed), down(p.ky, p.x.height, p.border, transposed);
  // Calls f(pixel, how often) for the pixels that the window of pixel j reads, or that read it.
  auto const for_each = [&](BoxAxis const& axis, int64_t j, auto f) {
    for (int64_t q = j - axis.before; q <= j + max(axis.before, axis.after); ++q) {
      if (!transposed || axis.rim == 0) {
        int64_t const at = q <= j + axis.after ? border_index(axis.border, q, axis.size) : -1;
        if (at >= 0) f(at, F(1));
      } else if (q >= 0 && q < axis.size) {
        int64_t const times = reads(p.border, q, j, axis.size, axis.after, axis.before);
        if (times > 0) f(q, F(times));
      }
    }
  };
  F sum = 0;
  for_each(down, y, [&](int64_t at_y, F times_y) {
    T const* const row = p.x.row(plane, at_y);
    F s = 0;
    for_each(across, x, [&](int64_t at_x, F times_x) { s += times_x * read(row[at_x * step + c]); });
    sum += times_y * s;
  });
  F const scale = 1 / p.divisor;
  p.y.row(plane, y)[e] = round_to<T>(box_value<T>(sum, read(p.x.row(plane, y)[e]), p.centre, p.divisor, scale, scale));
}

// --- launchers
// --------------------------------------------------------------------------------------------------------

template <int K, class T>
int launch_strip(Box<T> const& p, BoxAxis const& axis, CUstream_st* stream) {
  Strips<kPixels<T>> const strips(p.x.count(), p.x.height, p.x.width, kStripRows);
  box_strip<T, K><<<strips.blocks(), 256, 0, stream>>>(p, axis.border, axis.doubled, strips);
  return cudaGetLastError();
}

template <class T>
int launch(Box<T> const& p, bool transposed, CUstream_st* stream) {
  using F = Compute<T>;
  constexpr int64_t kShared = 224 * 1024, kPreferred = 112 * 1024;  // of a multiprocessor, of a block
  BoxAxis const across(p.kx, p.x.width, p.border, transposed), down(p.ky, p.x.height, p.border, transposed);
  bool const folds = across.rim + down.rim > 0 && !(across.doubled && down.doubled);

  if constexpr (sizeof(T) <= 4)
    if (p.kx == p.ky && !folds && is_strip<kPixels<T>>(p.x) && is_strip<kPixels<T>>(p.y)) {
      if (p.kx == 3) return launch_strip<3>(p, across, stream);
      if (p.kx == 5) return launch_strip<5>(p, across, stream);
      if (p.kx == 7) return launch_strip<7>(p, across, stream);
    }

  int64_t const planes = p.x.count() * p.x.step;
  Tiles tiles{};
  tiles.depth = Tiles::blocks_kept(p.ky);
  int64_t blocks = 0;
  for (tiles.width = 256; tiles.width >= 32; tiles.width /= 2) {
    tiles.across = int(ceil_div(p.x.width, tiles.width));
    blocks = ceil_div(ceil_div(p.x.width, tiles.across) + 2 * p.kx + kBlock, kBlock) + 2;
    tiles.pitch = int(ceil_div(blocks, kBlock) * kBlock + kBlock / 2);
    if (blocks <= 32 * kRounds && tiles.bytes(sizeof(F)) <= (tiles.width > 32 ? kPreferred : kShared)) break;
  }
  bool const even_reflect = transposed && p.border == Border::reflect && folds;
  if (tiles.width < 32 || even_reflect) {
    box_any<<<unsigned(ceil_div(p.x.rows() * p.x.row_size(), 256)), 256, 0, stream>>>(p, transposed);
    return cudaGetLastError();
  }
  tiles.width = int(ceil_div(p.x.width, tiles.across));
  // Enough tiles for all multiprocessors, as long as the rows above a tile, which are summed again, are not most of it.
  int64_t const wanted = ceil_div(3 * 132, planes * tiles.across), most = ceil_div(p.x.height, max(p.ky, int64_t(32)));
  tiles.height = int(ceil_div(p.x.height, clamp(wanted, int64_t(1), most)));
  tiles.down = int(ceil_div(p.x.height, tiles.height));
  int64_t const bytes = tiles.bytes(sizeof(F));
  if (int const error = cudaFuncSetAttribute(box_tile<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  box_tile<<<unsigned(planes * tiles.across * tiles.down), 256, unsigned(bytes), stream>>>(p, across, down, tiles,
                                                                                           is_pack<kBlock>(p.x));
  return cudaGetLastError();
}

}  // namespace

template <class T>
int box(Box<T> const& p, CUstream_st* stream) {
  return launch(p, false, stream);
}
template <class T>
int box_backward(Box<T> const& p, CUstream_st* stream) {
  return launch(p, true, stream);
}

KV_INSTANTIATE_WITH_BYTES(box, Box)
KV_INSTANTIATE(box_backward, Box)

}  // namespace kv::cuda
