// Dilation and erosion of bytes and half types on CUDA with centered windows of 3 x 3 pixels: threads go down groups of
// columns and compare two pixels at a time as numbers of 16 bits: bytes two columns apart, half types that are
// adjacent.
#include "core/stencils/column_groups.cuh"
#include "core/stencils/pairs.cuh"
#include "dilation.cuh"

namespace kv::morphology::cuda {
namespace {

constexpr int kThreads = 256, kRows = 32;  // of a block
constexpr int kAhead = 2;                  // rows in flight, and rows of the window that are kept
// Blocks on a multiprocessor. Loops of bytes would take 128 registers for windows that are not flat.
template <int P, int Bytes>
constexpr int kBlocks = P == 8 && Bytes > 0 ? 4 : 3;

// The maxima of three adjacent pixels of a group of P, by pairs. Pixels out of bounds are `outside`; all bits are
// changed by `flip` first, so that an erosion is a dilation.
template <class T, int P, class Rows>
struct PairsAlongX {
  using V = Pair<T>;
  static constexpr int N = P / 2;
  Rows const& rows;
  uint32_t const flip;
  V const outside;

  __device__ __forceinline__ PairsAlongX(Rows const& rows, StructuringElement<float> const& window)
      : rows(rows), flip(window.erode ? 0x80008000u : 0), outside(V(window.value, window.value).bits ^ flip) {}
  __device__ __forceinline__ void operator()(typename Rows::Fetched const& fetched, V (&most)[N]) const {
    uint32_t packed[Rows::kPacked], odd[N + 1], even[N];  // of them the pixels from 2 i - 1 and from 2 i on
    Rows::pack(fetched, packed);
#pragma unroll
    for (int i = 0; i < Rows::kPacked; ++i) packed[i] ^= flip;
#pragma unroll
    for (int i = 0; i <= N; ++i) {
      uint32_t const between = __funnelshift_r(packed[i], packed[min(i + 1, Rows::kPacked - 1)], 16);
      odd[i] = Rows::kSkip == 0 ? packed[i] : between;
      if (i < N) even[i] = Rows::kSkip == 0 ? between : packed[i + 1];
    }
    if (rows.left_end) odd[0] = __byte_perm(odd[0], outside.bits, 0x3254);
    if (rows.right_end) odd[N] = __byte_perm(odd[N], outside.bits, 0x7610);
#pragma unroll
    for (int i = 0; i < N; ++i) most[i] = upper(upper(V(odd[i]), V(even[i])), V(odd[i + 1]));
  }
  // The pixels of these pairs.
  __device__ __forceinline__ Vector<T, P> pixels(V const (&pairs)[N]) const {
    uint32_t words[N];
#pragma unroll
    for (int i = 0; i < N; ++i) words[i] = flip ^ pairs[i].bits;
    Vector<T, P> pixels;
    __builtin_memcpy(&pixels, words, sizeof(pixels));
    return pixels;
  }
};
template <int P, class Rows>
struct PairsAlongX<uint8_t, P, Rows> {
  using V = BytePair;
  static constexpr int N = P / 4;  // words
  Rows const& rows;
  uint32_t const flip;
  V const outside;

  __device__ __forceinline__ PairsAlongX(Rows const& rows, StructuringElement<float> const& window)
      : rows(rows),
        flip(window.erode ? 0xffffffffu : 0),
        outside((round_to<uint8_t>(window.value) * 0x01010101u) ^ flip) {}
  __device__ __forceinline__ void operator()(typename Rows::Fetched const& fetched, V (&most)[2 * N]) const {
    constexpr int kSkipped = 8 * Rows::kSkip;
    uint32_t packed[Rows::kPacked], around[N + 1];  // from the pixel before the group on
    Rows::pack(fetched, packed);
#pragma unroll
    for (int i = 0; i <= N; ++i)
      around[i] = flip ^ (kSkipped == 0 ? packed[i]
                                        : __funnelshift_r(packed[i], packed[min(i + 1, Rows::kPacked - 1)], kSkipped));
    if (rows.left_end) around[0] = __byte_perm(around[0], outside.bits, 0x3214);
    if (rows.right_end) around[N] = __byte_perm(around[N], outside.bits, 0x3240);
    // Pixels 4 i - 1 and 4 i + 1; 4 i and 4 i + 2, which are in the upper halves already.
    uint32_t odd[N + 1];
#pragma unroll
    for (int i = 0; i <= N; ++i) odd[i] = around[i] << 8;
#pragma unroll
    for (int i = 0; i < N; ++i) {
      V const middle(around[i]), next(__funnelshift_r(odd[i], odd[i + 1], 16));
      most[2 * i] = upper(V(odd[i]), middle, next);
      most[2 * i + 1] = upper(middle, next, V(__funnelshift_r(around[i], around[i + 1], 16)));
    }
  }
  __device__ __forceinline__ Vector<uint8_t, P> pixels(V const (&pairs)[2 * N]) const {
    uint32_t words[N];
#pragma unroll
    for (int i = 0; i < N; ++i) words[i] = flip ^ __byte_perm(pairs[2 * i].bits, pairs[2 * i + 1].bits, 0x7351);
    Vector<uint8_t, P> pixels;
    __builtin_memcpy(&pixels, words, sizeof(pixels));
    return pixels;
  }
};

template <class T, int P, int Bytes>
__global__ void __launch_bounds__(kThreads, kBlocks<P, Bytes>)
    dilation_3x3_groups(__grid_constant__ Dilation<T> const p, __grid_constant__ ColumnGroups<P> const groups) {
  using Rows = GroupRows<T, P, 1, Bytes>;
  int64_t plane;
  int x, y0;
  groups.locate(plane, x, y0);
  Rows const rows(p.x, plane, x, Border::constant);
  GroupStore<T, P, Bytes, kFewestStores> out(p.y, plane, x, y0);
  int const height = int(p.x.height), y1 = min(y0 + groups.rows, height);
  auto const fetch = [&](int y) {
    return unsigned(y) < unsigned(height) && y <= y1 ? rows.fetch(y) : typename Rows::Fetched{};
  };
  float offset[9];  // of the thread's own window: threads of a warp may be in different samples
  bool flat = true;
#pragma unroll
  for (int t = 0; t < 9; ++t) {
    offset[t] = p.window.offset(plane / p.planes, t);
    flat &= offset[t] == 0;
  }
  if (!__all_sync(~0u, flat)) {
    float const sign = p.window.sign();
    float const outside = (sizeof(T) == 1 ? p.window.value : read(round_to<T>(p.window.value))) * sign;
    float v[3][P + 2];
    auto const load = [&](int y, float(&v)[P + 2]) {
      Rows::unpack(fetch(y), v);
#pragma unroll
      for (int i = 0; i < P + 2; ++i) {
        bool const out_of_bounds =
            unsigned(y) >= unsigned(height) || (i == 0 && rows.left_end) || (i == P + 1 && rows.right_end);
        v[i] = out_of_bounds ? outside : v[i] * sign;
      }
    };
    load(y0 - 1, v[0]);
    load(y0, v[1]);
#pragma unroll 1
    for (int y = y0; y < y1; ++y) {
      load(y + 1, v[2]);
      float most[P];
#pragma unroll
      for (int j = 0; j < P; ++j) most[j] = minus_infinity<float>();
#pragma unroll
      for (int t = 0; t < 9; ++t)
        if (offset[t] != minus_infinity<float>()) {
#pragma unroll
          for (int j = 0; j < P; ++j) most[j] = combine(most[j], v[t / 3][j + t % 3] + offset[t]);
        }
#pragma unroll
      for (int j = 0; j < P; ++j) most[j] *= sign;
      out.put(most);
#pragma unroll
      for (int i = 0; i < P + 2; ++i) v[0][i] = v[1][i], v[1][i] = v[2][i];
    }
    return;
  }

  PairsAlongX<T, P, Rows> const along_x(rows, p.window);
  using V = typename PairsAlongX<T, P, Rows>::V;
  constexpr int N = P / 2;
  auto const maxima_of = [&](typename Rows::Fetched const& fetched, int y, V(&most)[N]) {
    along_x(fetched, most);
    if (unsigned(y) < unsigned(height)) return;
#pragma unroll
    for (auto& m : most) m = along_x.outside;
  };
  typename Rows::Fetched ahead[kAhead];
  V last[2][N];  // the maxima of the last two rows
  {
    auto const above = fetch(y0 - 1), at = fetch(y0);
#pragma unroll
    for (int i = 0; i < kAhead; ++i) ahead[i] = fetch(y0 + 1 + i);
    maxima_of(above, y0 - 1, last[0]);
    maxima_of(at, y0, last[1]);
  }
#pragma unroll 1
  for (int y = y0; y < y1; y += kAhead)
#pragma unroll
    for (int k = 0; k < kAhead; ++k) {
      if (k > 0 && y + k >= y1) break;
      V below[N], most[N];
      maxima_of(ahead[k], y + k + 1, below);
      ahead[k] = fetch(y + k + 1 + kAhead);
#pragma unroll
      for (int i = 0; i < N; ++i) most[i] = upper(last[k][i], last[1 - k][i], below[i]), last[k][i] = below[i];
      out.put(along_x.pixels(most));
    }
}

template <int P, class T>
bool launch(Dilation<T> const& p, CUstream_st* stream) {
  if (!supports_groups<P, 1>(p.x)) return false;
  with_row_bytes<P>(
      [&](auto bytes) {
        static int const resident = resident_blocks(dilation_3x3_groups<T, P, bytes.value>, kThreads);
        ColumnGroups<P> const groups(p.x.count(), p.x.height, p.x.width, kRows, GroupRows<T, P, 1, bytes.value>::kReach,
                                     3, resident);
        dilation_3x3_groups<T, P, bytes.value><<<groups.blocks(), groups.threads, 0, stream>>>(p, groups);
      },
      p.x, p.y);
  return true;
}

}  // namespace

// Special case, H200: 12 (299x299) to 18 (336x512) times as fast as the kernel of float32 with conversions, bytes; 1.36
// (336x512) to 1.43 (335x513) times as fast as strips, float16.
template <class T>
bool dilation_by_groups(Dilation<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) == 1)
    if (launch<16>(p, stream)) return true;
  return launch<8>(p, stream);
}

template bool dilation_by_groups(Dilation<uint8_t> const&, CUstream_st*);
template bool dilation_by_groups(Dilation<Half> const&, CUstream_st*);
template bool dilation_by_groups(Dilation<BFloat16> const&, CUstream_st*);

}  // namespace kv::morphology::cuda
