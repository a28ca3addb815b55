// What a block of threads samples of bytes by a matrix on CUDA, bilinearly and in fixed point. The source tile has a
// word for each pixel, whose bytes are up to four of its channels: a tap is one load, and two instructions add the four
// taps of a channel. The result of a pixel depends on neither tiles nor the alignment of rows.
// Special case: bytes. H200: 1.5 (335x513) to 1.6 (336x512) times as fast as the tiles of any type, 3 and more in
// channels_last; 1.2 where images shrink by half, as taps fit no source tile.
#pragma once

#include "geometry/transform/matrix_formula.cuh"
#include "geometry/transform/sample_unstaged.cuh"
#include "geometry/transform/source_tile.cuh"

namespace kv::geometry::cuda {
namespace {

constexpr int kByteBlocks = 4;  // on a multiprocessor at once

// --- fixed point -----------------------------------------------------------------------------------------------------

// A coordinate, relative to the (u, v) of its tile, in multiples of 2^-15. Coordinates within kByteReach are the last
// bits of a float.
constexpr int kCoordBits = 15;
constexpr int kByteReach = 126;
constexpr uint32_t kFirstCell = 0x43c00000u >> kCoordBits;  // of coordinate 0
__device__ __forceinline__ uint32_t near_fixed(float x) { return __float_as_uint(x + 384.f); }

// Whether coordinates are multiples of 1/16 wherever the output's pixel lies. Many results are then midway between two
// levels. In floats they are exact, and rounded to the even one.
__device__ __forceinline__ bool is_dyadic(Homography<float> const& map) {
  bool dyadic = map.affine;
#pragma unroll
  for (int i = 0; i < 6; ++i) dyadic = dyadic && vfloor(map.m[i] * 16) == map.m[i] * 16;
  return dyadic;
}

// The weights of four taps: 16 bits for each of the two pixels of a row. They are not negative and add up to 2^16 - 1.
struct ByteWeights {
  uint32_t upper, lower;

  __device__ __forceinline__ ByteWeights(uint32_t u, uint32_t v) {
    uint32_t const x = u & 0x7fff, y = v & 0x7fff, both = (x * y + 0x3fff) >> 14;
    lower = both * 0xffff + 2 * y;
    upper = x * (2 * 0xffff) + 0xffff - lower;
  }
  // The means of N channels, in the third byte. The error before rounding is at most 0.02, and halves are rounded up.
  template <int N>
  __device__ __forceinline__ void means(uint32_t a, uint32_t b, uint32_t c, uint32_t d, uint32_t (&mean)[N]) const {
    constexpr uint32_t kHalf = (1 << 15) + 255;
    uint32_t const ab = __byte_perm(a, b, 0x5140), cd = __byte_perm(c, d, 0x5140);
    mean[0] = __dp2a_lo(lower, cd, __dp2a_lo(upper, ab, kHalf));
    if constexpr (N > 1) mean[1] = __dp2a_hi(lower, cd, __dp2a_hi(upper, ab, kHalf));
    if constexpr (N > 2)
      mean[2] = __dp2a_lo(lower, __byte_perm(c, d, 0x7362), __dp2a_lo(upper, __byte_perm(a, b, 0x7362), kHalf));
  }
};

// N channels at a pixel of the output, from global memory: the bits of those from a source tile.
template <int N>
__device__ __noinline__ void sample_bytes_unstaged(Sample<uint8_t> const& p, Tile<float> const& tile, int first, int y,
                                                   int x) {
  float u, v;
  tile.map.apply(float(x - tile.x), float(y - tile.y), u, v);
  int const to_u = __float2int_rn(u * (1 << kCoordBits)), to_v = __float2int_rn(v * (1 << kCoordBits));
  int const column = (to_u >> kCoordBits) + tile.u, row = (to_v >> kCoordBits) + tile.v;
  bool const is_near = vabs(u) < 32768 && vabs(v) < 32768;
  bool const inside = column >= 0 && row >= 0 && column < p.x_axis.size - 1 && row < p.y_axis.size - 1;
  if (!is_near || is_dyadic(tile.map) || (!inside && (p.fill || p.x_axis.padding == Padding::reflection))) {
    sample_unstaged<2, N>(p, tile, first, y, x);
    return;
  }
  ByteWeights const weights(to_u, to_v);
  uint32_t taps[4], mean[1];
#pragma unroll 1
  for (int k = 0; k < N; ++k) {
    uint8_t const* const plane = p.x.row(tile.image, first + k, 0);
#pragma unroll
    for (int i = 0; i < 4; ++i) {
      int const at_x = pixel_at(p.x_axis, column + i % 2), at_y = pixel_at(p.y_axis, row + i / 2);
      bool const exists = unsigned(at_x) < unsigned(p.x_axis.size) && unsigned(at_y) < unsigned(p.y_axis.size);
      taps[i] = exists ? plane[at_y * p.x.row_stride + at_x * p.x.step] : 0;
    }
    weights.means<1>(taps[0], taps[1], taps[2], taps[3], mean);
    p.y.row(tile.b, first + k, y)[x * p.y.step] = uint8_t(mean[0] >> 16);
  }
}

// --- source tiles ----------------------------------------------------------------------------------------------------

struct ByteSource {
  static constexpr int kPitch = 100, kRows = 96;  // of 64 x 64 pixels rotated by any angle
  static constexpr int kGroup = 8;                // pixels that a thread loads at a time
  static constexpr int kBytes = kPitch * kRows * 4;

  uint32_t* const words;
  int left, top, columns, rows;  // of the image
  bool fits;

  // For the box of the taps, relative to (u, v).
  __device__ __forceinline__ ByteSource(void* memory, TapBounds const& box, int u, int v, Sample<uint8_t> const& p)
      : words(static_cast<uint32_t*>(memory)),
        left((box.left + u) & -kGroup),
        top(box.top + v),
        columns(box.right + u - left + 1),
        rows(box.bottom - box.top + 1) {
    bool const inside = left >= 0 && top >= 0 && box.right + u < p.x_axis.size && box.bottom + v < p.y_axis.size;
    fits = box.left >= -kByteReach && box.top >= -kByteReach && box.right <= kByteReach && box.bottom <= kByteReach &&
           columns <= kPitch && rows <= kRows && (inside || (p.x_axis.padding != Padding::reflection && !p.fill));
  }

  // Of the taps of coordinate 0, counted from (u, v), in `words`.
  __device__ __forceinline__ int origin(int u, int v) const {
    return (v - top - int(kFirstCell)) * kPitch + (u - left - int(kFirstCell));
  }

  // W words at any address are shifted out of whole words of memory, one more unless Aligned. That one is read only if
  // it has some of the bytes.
  template <int W, bool Aligned>
  static __device__ __forceinline__ void load(uint8_t const* from, uint32_t (&to)[W + !Aligned]) {
    if constexpr (Aligned) {
#pragma unroll
      for (int i = 0; i < W; i += 2) {
        uint2 const two = __ldg(reinterpret_cast<uint2 const*>(from) + i / 2);
        to[i] = two.x, to[i + 1] = two.y;
      }
    } else {
      auto const address = reinterpret_cast<uintptr_t>(from);
      auto const* const words = reinterpret_cast<uint32_t const*>(address & ~uintptr_t(3));
#pragma unroll
      for (int i = 0; i < W; ++i) to[i] = __ldg(words + i);
      to[W] = 0;
      if (address & 3) to[W] = __ldg(words + W);
    }
  }
  // Those of a group as a word for each pixel.
  template <int N, bool Interleaved>
  static __device__ __forceinline__ void spread(uint32_t const (&from)[2 * N], uint32_t (&to)[kGroup]) {
    if constexpr (Interleaved) {
#pragma unroll
      for (int i = 0; i < 2; ++i) {
        to[4 * i] = from[3 * i];
        to[4 * i + 1] = __funnelshift_r(from[3 * i], from[3 * i + 1], 24);
        to[4 * i + 2] = __funnelshift_r(from[3 * i + 1], from[3 * i + 2], 16);
        to[4 * i + 3] = from[3 * i + 2] >> 8;
      }
    } else if constexpr (N == 3) {
#pragma unroll
      for (int i = 0; i < 2; ++i) {
        uint32_t const low = __byte_perm(from[i], from[2 + i], 0x5140),
                       high = __byte_perm(from[i], from[2 + i], 0x7362);
        to[4 * i] = __byte_perm(low, from[4 + i], 0x4410);
        to[4 * i + 1] = __byte_perm(low, from[4 + i], 0x5532);
        to[4 * i + 2] = __byte_perm(high, from[4 + i], 0x6610);
        to[4 * i + 3] = __byte_perm(high, from[4 + i], 0x7732);
      }
    } else {
      static_assert(N == 1);
#pragma unroll
      for (int i = 0; i < kGroup; ++i) to[i] = from[i / 4] >> 8 * (i % 4);
    }
  }

  // N channels from `first` on.
  template <int N>
  __device__ __forceinline__ void stage(Images<uint8_t const> const& x, int64_t image, int first,
                                        Axis<float> const& x_axis, Axis<float> const& y_axis) const {
    __syncthreads();  // before the current contents are overwritten
    uint8_t const* planes[N];
    uintptr_t bits = uintptr_t(x.row_stride) | uintptr_t(x_axis.size);
#pragma unroll
    for (int k = 0; k < N; ++k) {
      planes[k] = x.row(image, first + k, 0);
      if (k == 0 || x.step == 1) bits |= reinterpret_cast<uintptr_t>(planes[k]);
    }
    bool const aligned = bits % kGroup == 0;
    if (x.step == 1 && x_axis.size >= kGroup) {
      aligned ? stage_groups<N, true, false>(planes, int(x.row_stride), x_axis, y_axis)
              : stage_groups<N, false, false>(planes, int(x.row_stride), x_axis, y_axis);
    } else if (N == 3 && x.step == 3 && x.channel_stride == 1 && x_axis.size >= kGroup) {
      if constexpr (N == 3)
        aligned ? stage_groups<N, true, true>(planes, int(x.row_stride), x_axis, y_axis)
                : stage_groups<N, false, true>(planes, int(x.row_stride), x_axis, y_axis);
    } else {
      stage_pixels<N>(planes, int(x.row_stride), int(x.step), x_axis, y_axis);
    }
    __syncthreads();
  }

  // A thread takes groups of a column, as many threads side by side as the tile has columns of groups. A group that is
  // not all inside of the image is the outermost one that is, moved.
  template <int N, bool Aligned, bool Interleaved>
  __device__ __forceinline__ void stage_groups(uint8_t const* const (&planes)[N], int row_stride,
                                               Axis<float> const& x_axis, Axis<float> const& y_axis) const {
    constexpr int kLoads = Aligned ? 4 : 2;  // before the first of them is waited for
    constexpr int kSources = Interleaved ? 1 : N, kWords = 2 * N / kSources;
    int const across = (columns + kGroup - 1) / kGroup;
    int const first_row = int((float(threadIdx.x) + 0.5f) * __frcp_rn(float(across)));
    int const rows_at_once = int((float(kThreads) + 0.5f) * __frcp_rn(float(across)));
    if (first_row >= rows_at_once) return;
    int const column = (int(threadIdx.x) - first_row * across) * kGroup, from = left + column;
    bool const border = x_axis.padding == Padding::border;
    int const start = clamp(from, 0, x_axis.size - kGroup), past = from - start;
    int const offset = start * (Interleaved ? N : 1);
    uint32_t* to = words + (first_row * kPitch + column);
#pragma unroll 1
    for (int row = first_row; row < rows; row += kLoads * rows_at_once) {
      uint32_t loaded[kLoads][kSources][kWords + !Aligned];
      int at[kLoads];
#pragma unroll
      for (int i = 0; i < kLoads; ++i) {
        int const y = clamp(top + min(row + i * rows_at_once, rows - 1), 0, y_axis.size - 1);
        at[i] = y * row_stride + offset;
#pragma unroll
        for (int k = 0; k < kSources; ++k) load<kWords, Aligned>(planes[k] + at[i], loaded[i][k]);
      }
#pragma unroll
      for (int i = 0; i < kLoads; ++i) {
        int const own = row + i * rows_at_once;
        if (own >= rows) break;
        uint32_t bytes[2 * N], pixels[kGroup];
#pragma unroll
        for (int k = 0; k < kSources; ++k) {
          int const shift = int(reinterpret_cast<uintptr_t>(planes[k]) + unsigned(at[i])) * 8;
#pragma unroll
          for (int j = 0; j < kWords; ++j)
            if constexpr (Aligned)
              bytes[kWords * k + j] = loaded[i][k][j];
            else
              bytes[kWords * k + j] = __funnelshift_r(loaded[i][k][j], loaded[i][k][j + 1], shift);
        }
        spread<N, Interleaved>(bytes, pixels);
        bool const exists = border || unsigned(top + own) < unsigned(y_axis.size);
        if (past != 0 || !exists) move(pixels, exists ? past : kGroup, border);
        auto* const vectors = reinterpret_cast<uint4*>(to);
        vectors[0] = {pixels[0], pixels[1], pixels[2], pixels[3]};
        if (column + 4 < kPitch) vectors[1] = {pixels[4], pixels[5], pixels[6], pixels[7]};
        to += rows_at_once * kPitch;
      }
    }
  }
  // To the left, or all to the right.
  static __device__ __forceinline__ void move(uint32_t (&pixels)[kGroup], int by, bool border) {
    uint32_t const outside = !border ? 0 : by < 0 ? pixels[0] : pixels[kGroup - 1];
    if (by < 0 || by >= kGroup) {
#pragma unroll
      for (int i = 0; i < kGroup; ++i) pixels[i] = outside;
      return;
    }
#pragma unroll
    for (int step = kGroup / 2; step > 0; step /= 2)
      if (by & step)
#pragma unroll
        for (int i = 0; i < kGroup; ++i) pixels[i] = i + step < kGroup ? pixels[i + step] : outside;
  }

  template <int N>
  __device__ __forceinline__ void stage_pixels(uint8_t const* const (&planes)[N], int row_stride, int step,
                                               Axis<float> const& x_axis, Axis<float> const& y_axis) const {
#pragma unroll 1
    for (int i = threadIdx.x; i < columns * rows; i += kThreads) {
      int const row = i / columns, column = i - row * columns;
      int const y = pixel_at(y_axis, top + row), from = pixel_at(x_axis, left + column);
      uint32_t pixel = 0;
      if (unsigned(y) < unsigned(y_axis.size) && unsigned(from) < unsigned(x_axis.size)) {
        int const at = y * row_stride + from * step;
#pragma unroll
        for (int k = 0; k < N; ++k) pixel |= uint32_t(planes[k][at]) << 8 * k;
      }
      words[row * kPitch + column] = pixel;
    }
  }
};

// --- parts of tiles --------------------------------------------------------------------------------------------------

// Stores W words of each of eight threads, the next to those of the thread before, at any address: aligned words, each
// of two adjacent ones, and one by one the four bytes that are left, the first and the last of all.
template <int W>
__device__ __forceinline__ void store_words(uint8_t* to, uint32_t const (&words)[W]) {
  int const lane = threadIdx.x % 8, past = int(reinterpret_cast<uintptr_t>(to) & 3);
  if (past == 0) {
#pragma unroll
    for (int i = 0; i < W; ++i) reinterpret_cast<uint32_t*>(to)[i] = words[i];
    return;
  }
  unsigned const row = 0xffu << (threadIdx.x & 24);
  uint32_t const next = __shfl_down_sync(row, words[0], 1, 8);
  auto* const aligned = reinterpret_cast<uint32_t*>(to + (4 - past));
#pragma unroll
  for (int i = 0; i < W; ++i) {
    uint32_t const word = __funnelshift_rc(words[i], i + 1 < W ? words[i + 1] : next, 32 - 8 * past);
    if (i + 1 < W || lane < 7) aligned[i] = word;
  }
  bool const leads = lane < 4 - past;
  uint32_t const end = __shfl_sync(row, lane == 0 ? words[0] : words[W - 1], leads ? 0 : 7, 8);
  if (lane < 4) to[(leads ? lane : 32 * W - 4 + lane) - 4 * W * lane] = uint8_t(end >> 8 * lane);
}

// A thread has four pixels of the output: adjacent ones of a row if Wide, otherwise of a column. Coordinates count from
// the anchor, so that they are the same in parts of any size.
constexpr int kAnchor = kByteAnchor;

struct BytePart {
  int x, y, side;  // of the output
};

// Where a thread's four pixels of N channels go, in the rows of a part.
template <bool Wide, int N>
struct BytePixels {
  uint8_t* planes[N];
  int row_stride, step, x, width, height, turn;
  bool whole;  // the row of a warp

  // `left` is the first column of the warp.
  __device__ __forceinline__ BytePixels(Sample<uint8_t> const& p, int64_t b, int first, int left)
      : row_stride(int(p.y.row_stride)), step(int(p.y.step)), width(int(p.y.width)), height(int(p.y.height)) {
    int const lane = threadIdx.x % 32;
    x = left + (Wide ? lane % 8 * 4 : lane);
    // Those of the second row of a warp begin with the second of the four, and so on: taps are in different banks.
    turn = Wide ? lane / 8 : 0;
    whole = left + 32 <= width;
#pragma unroll
    for (int k = 0; k < N; ++k) planes[k] = p.y.row(b, first + k, 0);
  }
  __device__ __forceinline__ int column(int i) const { return min(x + (Wide ? (i + turn) & 3 : 0), width - 1); }
  __device__ __forceinline__ int row(int y, int i) const { return Wide ? y : min(y + i, height - 1); }

  // From the third byte of each mean.
  __device__ __forceinline__ void store(int y, uint32_t const (&means)[4][N]) const {
    if constexpr (!Wide) {
#pragma unroll
      for (int i = 0; i < 4; ++i)
        if (y + i < height)
#pragma unroll
          for (int k = 0; k < N; ++k) planes[k][(y + i) * row_stride + x * step] = uint8_t(means[i][k] >> 16);
    } else {
      int const to = y * row_stride + x * step;
      if constexpr (N == 3)
        if (step == 3) {
          uint32_t turned[4], pixels[4];
#pragma unroll
          for (int i = 0; i < 4; ++i)
            turned[i] = __byte_perm(__byte_perm(means[i][0], means[i][1], 0x7762), means[i][2], 0x3610);
#pragma unroll
          for (int i = 0; i < 4; ++i) {
            uint32_t const even = turn & 2 ? turned[(i + 2) % 4] : turned[i];
            uint32_t const odd = turn & 2 ? turned[(i + 1) % 4] : turned[(i + 3) % 4];
            pixels[i] = turn & 1 ? odd : even;
          }
          uint32_t const twelve[] = {pixels[0] | pixels[1] << 24, pixels[1] >> 8 | pixels[2] << 16,
                                     pixels[2] >> 16 | pixels[3] << 8};
          store_pixels(planes[0] + to, twelve);
          return;
        }
#pragma unroll
      for (int k = 0; k < N; ++k) {
        uint32_t const word = __byte_perm(__byte_perm(means[0][k], means[1][k], 0x0062),
                                          __byte_perm(means[2][k], means[3][k], 0x0062), 0x5410);
        uint32_t const four[] = {__funnelshift_l(word, word, 8 * turn)};
        store_pixels(planes[k] + to, four);
      }
    }
  }
  // W bytes each.
  template <int W>
  __device__ __forceinline__ void store_pixels(uint8_t* to, uint32_t const (&words)[W]) const {
    if (whole) {
      store_words(to, words);
      return;
    }
#pragma unroll
    for (int i = 0; i < 4 * W; ++i)
      if (x + i / W < width) to[i] = uint8_t(words[i / 4] >> 8 * (i % 4));
  }
};

// The means of N channels at a coordinate, in the third byte. `origin` has the taps of coordinate 0.
template <int N, bool Dyadic>
__device__ __forceinline__ void byte_means(uint32_t const* words, int origin, uint32_t u, uint32_t v,
                                           uint32_t (&means)[N]) {
  constexpr int kPitch = ByteSource::kPitch;
  uint32_t const* const taps = words + (int(v >> kCoordBits) * kPitch + int(u >> kCoordBits) + origin);
  uint32_t const a = taps[0], b = taps[1], c = taps[kPitch], d = taps[kPitch + 1];
  if constexpr (Dyadic) {
    constexpr float kUnit = 1.f / (1 << kCoordBits);
    constexpr uint32_t kFraction = (1 << kCoordBits) - 1;
    float const tx = float(int(u & kFraction)) * kUnit, ty = float(int(v & kFraction)) * kUnit;
#pragma unroll
    for (int k = 0; k < N; ++k) {
      float const four[] = {byte_of<float>(a, k), byte_of<float>(b, k), byte_of<float>(c, k), byte_of<float>(d, k)};
      float const above = four[0] + tx * (four[1] - four[0]), below = four[2] + tx * (four[3] - four[2]);
      means[k] = uint32_t(round_to_byte(above + ty * (below - above))) << 16;
    }
  } else {
    ByteWeights(u, v).means<N>(a, b, c, d, means);
  }
}

enum class ByteMap { affine, dyadic, homography };

template <bool Wide, int N, ByteMap Map>
__device__ __forceinline__ void sample_part(Sample<uint8_t> const& p, Tile<float> const& tile, BytePart const& part,
                                            ByteSource const& source, int first) {
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  int const twice = part.side == kAnchor ? 1 : 0;  // warps side by side
  int const first_row = (warp >> twice) * 4 + (Wide ? lane / 8 : 0), row_step = kTile >> twice;
  BytePixels<Wide, N> const pixels(p, tile.b, first, part.x + 32 * (warp & twice));
  float m[9], columns[4];
#pragma unroll
  for (int i = 0; i < 9; ++i) m[i] = tile.map.m[i];
#pragma unroll
  for (int i = 0; i < 4; ++i) columns[i] = float(pixels.column(i) - tile.x);
  if (pixels.x >= pixels.width) return;
  int const origin = source.origin(tile.u, tile.v);
#pragma unroll 1
  for (int row = first_row; row < part.side; row += row_step) {
    int const y = part.y + row;
    if (y >= pixels.height) break;
    uint32_t means[4][N];
#pragma unroll
    for (int i = 0; i < 4; ++i) {
      float const from_top = float(pixels.row(y, i) - tile.y), from_left = columns[i];
      float u = fmaf(from_left, m[0], fmaf(from_top, m[1], m[2])),
            v = fmaf(from_left, m[3], fmaf(from_top, m[4], m[5]));
      if constexpr (Map == ByteMap::homography) {
        float const scale = reciprocal(fmaf(from_left, m[6], fmaf(from_top, m[7], m[8])));
        u *= scale;
        v *= scale;
      }
      byte_means<N, Map == ByteMap::dyadic>(source.words, origin, near_fixed(u), near_fixed(v), means[i]);
    }
    pixels.store(y, means);
  }
}

// The blocks of an output: anchors, or, where these are few, the parts of them.
struct ByteGrid {
  unsigned across, down, first_block = 0;  // of those of a launch
  int side;

  KV_HD ByteGrid(int64_t height, int64_t width, int side)
      : across(unsigned(ceil_div(width, side))), down(unsigned(ceil_div(height, side))), side(side) {}
};

// What a block has: up to four parts of kTile x kTile, of one sample, in shared memory.
struct ByteBlock {
  static constexpr int kMost = 4;
  Tile<float> tiles[kMost];  // from the anchor of each part on
  TapBounds taps[kMost];     // relative to its tile's (u, v)
  BytePart parts[kMost];
  int count;

  // By all threads. The parts of an anchor become one if its source tile fits.
  template <class Matrix>
  __device__ __forceinline__ void prepare(Sample<uint8_t> const& p, void* memory, ByteGrid const& grid, Matrix matrix) {
    if (threadIdx.x < 32) {
      int const number = threadIdx.x / 4 % kMost, width = int(p.y.width), height = int(p.y.height);
      int const number_of_parts = grid.side == kAnchor ? kMost : 1;
      unsigned const block = blockIdx.x - grid.first_block, row = block / grid.across, b = row / grid.down;
      BytePart part{int(block - row * grid.across) * grid.side + number % 2 * kTile,
                    int(row - b * grid.down) * grid.side + number / 2 * kTile, kTile};
      Tile<float> tile;
      tile.b = b;
      tile.image = p.image_of(b);
      tile.x = part.x & -kAnchor;
      tile.y = part.y & -kAnchor;
      Homography<double> const map = homography(matrix(b), p.coords.use);
      double u, v;
      map.apply(double(tile.x), double(tile.y), u, v);
      tile.u = u > -1e6 && u < 1e6 ? int(u) : 0;
      tile.v = v > -1e6 && v < 1e6 ? int(v) : 0;
      tile.map = bind_to_tile<float>(map, tile.x, tile.y, tile.u, tile.v);
      TapBounds box = TapBounds::empty();
      float const right = float(min(part.x + kTile, width) - 1 - tile.x),
                  bottom = float(min(part.y + kTile, height) - 1 - tile.y);
      float const x = threadIdx.x & 1 ? right : float(part.x - tile.x);
      float const y = threadIdx.x & 2 ? bottom : float(part.y - tile.y);
      float to_u, to_v;
      tile.map.apply(x, y, to_u, to_v);
      box.add<2>(to_u, to_v, kCoordRounding, float(kFarCoord));
      box.merge_lanes<4>();
      unsigned const before = __ballot_sync(0xffffffffu, tile.map.weight(x, y) > 0) >> 4 * number & 15;
      if (before != 0 && before != 15) box = TapBounds::all();
      bool const exists = number < number_of_parts && part.x < width && part.y < height;
      int parts_left = number_of_parts;
      if (number_of_parts == kMost) {
        TapBounds whole = exists ? box : TapBounds::empty();
        whole.merge_lanes<4 * kMost>();
        if (ByteSource(memory, whole, tile.u, tile.v, p).fits) {
          parts_left = 1;
          box = whole;
          part.side = kAnchor;
        }
      }
      if (!exists) part.side = 0;
      if (threadIdx.x % 4 == 0 && threadIdx.x < 4 * kMost) {
        tiles[number] = tile;
        taps[number] = box;
        parts[number] = part;
        if (number == 0) count = parts_left;
      }
    }
    __syncthreads();
  }
  template <bool Wide>
  __device__ __forceinline__ void sample(Sample<uint8_t> const& p, void* memory) const {
#pragma unroll 1
    for (int number = 0; number < count; ++number) {
      BytePart const& part = parts[number];
      Tile<float> const& tile = tiles[number];
      if (part.side == 0) continue;
      ByteSource const source(memory, taps[number], tile.u, tile.v, p);
      for_each_channel_group<3>(p.x.channels, [&](int first, auto channels) {
        constexpr int N = channels.value;
        if (source.fits) {
          source.stage<N>(p.x, tile.image, first, p.x_axis, p.y_axis);
          if (!tile.map.affine)
            sample_part<Wide, N, ByteMap::homography>(p, tile, part, source, first);
          else if (is_dyadic(tile.map))
            sample_part<Wide, N, ByteMap::dyadic>(p, tile, part, source, first);
          else
            sample_part<Wide, N, ByteMap::affine>(p, tile, part, source, first);
          return;
        }
        int const x = part.x + int(threadIdx.x) % kTile;
        if (x < int(p.y.width))
#pragma unroll 1
          for (int y = part.y + int(threadIdx.x) / kTile; y < min(part.y + kTile, int(p.y.height));
               y += kThreads / kTile)
            sample_bytes_unstaged<N>(p, tile, first, y, x);
      });
    }
  }
};

// Whether the bytes of a row of results are adjacent, those that a block has at a time.
KV_HD bool rows_are_dense(Images<uint8_t> const& y) {
  return y.step == 1 || (y.step == 3 && y.channels == 3 && y.channel_stride == 1);
}

}  // namespace
}  // namespace kv::geometry::cuda
