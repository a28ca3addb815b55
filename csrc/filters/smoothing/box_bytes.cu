// Means of 3 x 3 and 5 x 5 bytes on CUDA: threads go down groups of columns (core/stencils/column_groups.cuh) and add
// pixels that are two columns apart as integers of 16 bits, which are exact.
#include "box.h"
#include "core/stencils/column_groups.cuh"

namespace kv::filters::cuda {
namespace {

constexpr int P = 16, kThreads = 128, kRows = 32;  // pixels of a group; of a block
constexpr int kAhead = 2;                          // rows in flight

// A row of a group: words of four pixels, from the first one that windows read on, and sums along the row.
template <int K, int Bytes>
struct BoxRows {
  static constexpr int R = K / 2, N = P / 4;
  using Rows = GroupRows<uint8_t, P, R, Bytes>;
  Rows rows;
  unsigned left, right;  // permutations that fill in the pixels out of bounds
  uint32_t left_kept, right_kept;

  __device__ __forceinline__ BoxRows(Planes<uint8_t const> const& x, int64_t plane, int column, Border border)
      : rows(x, plane, column, border) {
    bool const reflects = border == Border::reflect, fills = border != Border::circular,
               zero = border == Border::constant;
    constexpr unsigned kSame = 0x3210;
    left = !rows.left_end || !fills ? kSame : R == 1 ? (reflects ? 0x3212 : 0x3211) : (reflects ? 0x3234 : 0x3222);
    right = !rows.right_end || !fills ? kSame : R == 1 ? (reflects ? 0x3270 : 0x3200) : (reflects ? 0x7010 : 0x1110);
    left_kept = rows.left_end && zero ? 0xffffffffu << 8 * R : 0xffffffffu;
    right_kept = rows.right_end && zero ? 0xffffffffu >> 8 * (4 - R) : 0xffffffffu;
  }
  // Sums of the windows of pixels 4 i and 4 i + 2, 4 i + 1 and 4 i + 3.
  __device__ __forceinline__ void add_along(typename Rows::Fetched const& fetched, uint32_t (&sums)[2 * N]) const {
    uint32_t packed[Rows::kPacked], words[N + 1];
    Rows::pack(fetched, packed);
#pragma unroll
    for (int i = 0; i <= N; ++i)
      words[i] = Rows::kSkip == 0 ? packed[i]
                                  : __funnelshift_r(packed[i], packed[min(i + 1, Rows::kPacked - 1)], 8 * Rows::kSkip);
    words[0] = __byte_perm(words[0], words[1], left) & left_kept;
    words[N] = __byte_perm(words[N], words[N - 1], right) & right_kept;
    uint32_t even[N + 1], odd[N + 1], two[N + 1];  // pixels 0 and 2, 1 and 3, and the sums of 0 and 1, 2 and 3
#pragma unroll
    for (int i = 0; i <= N; ++i) {
      even[i] = words[i] & 0x00ff00ffu, odd[i] = __byte_perm(words[i], 0, 0x4341);
      two[i] = even[i] + odd[i];
    }
#pragma unroll
    for (int i = 0; i < N; ++i) {
      if constexpr (K == 3) {
        uint32_t const next = __funnelshift_r(even[i], even[i + 1], 16);  // pixels 2 and 4
        sums[2 * i] = two[i] + next;
        sums[2 * i + 1] = odd[i] + next + __funnelshift_r(odd[i], odd[i + 1], 16);
      } else {
        uint32_t const next = __funnelshift_r(two[i], two[i + 1], 16);  // the sums of 2 and 3, 4 and 5
        sums[2 * i] = two[i] + next + even[i + 1];
        sums[2 * i + 1] = odd[i] + next + two[i + 1];
      }
    }
  }
};

// The means of windows of these sums, rounded: the highest byte of a product.
template <int K>
__device__ __forceinline__ Vector<uint8_t, P> means(uint32_t const (&sums)[P / 2]) {
  constexpr uint32_t kReciprocal = (1 << 24) / (K * K) + 1, kHalf = K * K / 2 * kReciprocal;
  static_assert(255ll * K * K * kReciprocal + kHalf < 1ll << 32);
  auto const low = [](uint32_t two) { return (two & 0xffffu) * kReciprocal + kHalf; };
  auto const high = [](uint32_t two) { return (two >> 16) * kReciprocal + kHalf; };
  uint32_t words[P / 4];
#pragma unroll
  for (int i = 0; i < P / 4; ++i) {
    uint32_t const a = sums[2 * i], b = sums[2 * i + 1];
    words[i] = __byte_perm(__byte_perm(low(a), low(b), 0x0073), __byte_perm(high(a), high(b), 0x0073), 0x5410);
  }
  Vector<uint8_t, P> vector;
  __builtin_memcpy(&vector, words, sizeof(vector));
  return vector;
}

template <int K, int Bytes>
__global__ void __launch_bounds__(kThreads, 4)
    box_groups(__grid_constant__ Box<uint8_t> const p, __grid_constant__ ColumnGroups<P, kThreads> const groups) {
  constexpr int R = K / 2, N = P / 2;
  int64_t plane;
  int x, y0;
  groups.locate(plane, x, y0);
  BoxRows<K, Bytes> const box(p.x, plane, x, p.border);
  GroupStore<uint8_t, P, Bytes> out(p.y, plane, x, y0);
  int const height = int(p.x.height), y1 = min(y0 + groups.rows, height);
  using Fetched = typename BoxRows<K, Bytes>::Rows::Fetched;
  auto const fetch = [&](int y) {
    int const source = y < y1 + R ? border_index(p.border, y, height) : -1;
    return source < 0 ? Fetched{} : box.rows.fetch(source);
  };
  Fetched ahead[kAhead];
#pragma unroll
  for (int i = 0; i < kAhead; ++i) ahead[i] = fetch(y0 - R + i);
  uint32_t rows[K - 1][N] = {};  // the last rows of sums
#pragma unroll 1
  for (int first = y0 - R; first < y1 + R; first += K - 1)
#pragma unroll
    for (int k = 0; k < K - 1; ++k) {
      int const y = first + k;  // the row that is read; it completes row y - R
      if (k > 0 && y >= y1 + R) break;
      uint32_t row[N], sums[N];
      box.add_along(ahead[k % kAhead], row);
      ahead[k % kAhead] = fetch(y + kAhead);
#pragma unroll
      for (int i = 0; i < N; ++i) {
        sums[i] = row[i];
#pragma unroll
        for (int t = 0; t < K - 1; ++t) sums[i] += rows[t][i];
        rows[k][i] = row[i];
      }
      if (y >= y0 + R) out.put(means<K>(sums));
    }
}

template <int K>
bool launch(Box<uint8_t> const& p, CUstream_st* stream) {
  if (p.kx != K || p.ky != K || p.divisor != K * K || p.center != 0 || p.y.step != 1 || !supports_groups<P, K / 2>(p.x))
    return false;
  with_row_bytes<P>(
      [&](auto bytes) {
        auto* const kernel = box_groups<K, bytes.value>;
        static int const resident = resident_blocks(kernel, kThreads);
        ColumnGroups<P, kThreads> const groups(p.x.count(), p.x.height, p.x.width, kRows,
                                               GroupRows<uint8_t, P, K / 2, bytes.value>::kReach, K, resident);
        kernel<<<groups.blocks(), groups.threads, 0, stream>>>(p, groups);
      },
      p.x, p.y);
  return true;
}

}  // namespace

// Special case, H200: 1.8 (box5 of 336x512) times as fast as groups of separable filters.
bool box_of_bytes(Box<uint8_t> const& p, CUstream_st* stream) { return launch<3>(p, stream) || launch<5>(p, stream); }

}  // namespace kv::filters::cuda
