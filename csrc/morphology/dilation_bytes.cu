// Dilation and erosion of bytes on CUDA with centered windows of 3 x 3 pixels: threads go down groups of columns and
// compare two pixels at a time, those two columns apart, as numbers of 16 bits.
#include "core/stencils/column_groups.cuh"
#include "core/stencils/pairs.cuh"
#include "dilation.cuh"

namespace kv::morphology::cuda {
namespace {

constexpr int kThreads = 256, kRows = 32;  // of a block
constexpr int kAhead = 2;                  // rows in flight

template <int P, int Bytes>
__global__ void __launch_bounds__(kThreads)
    dilation_3x3_bytes(__grid_constant__ Dilation<uint8_t> const p, __grid_constant__ ColumnGroups<P> const groups) {
  constexpr int N = P / 4;  // words
  using Rows = GroupRows<uint8_t, P, 1, Bytes>;
  using V = Pair<Half>;  // the halves with the bits of bytes are in the same order
  int64_t plane;
  int x, y0;
  groups.locate(plane, x, y0);
  Rows const rows(p.x, plane, x, Border::constant);
  GroupStore<uint8_t, P, Bytes> out(p.y, plane, x, y0);
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
  if (!flat) {
    float const sign = p.window.sign(), outside = p.window.value * sign;
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

  // An erosion is a dilation of the complements.
  uint32_t const flip = p.window.erode ? 0xffffffffu : 0;
  V const outside((round_to<uint8_t>(p.window.value) * 0x00010001u) ^ (flip & 0x00ff00ffu));
  // The maxima of three adjacent pixels of row y.
  auto const along_x = [&](typename Rows::Fetched const& fetched, int y, V(&most)[2 * N]) {
    constexpr int kSkipped = 8 * Rows::kSkip;
    uint32_t packed[Rows::kPacked], around[N + 1];  // from the pixel before the group on
    Rows::pack(fetched, packed);
#pragma unroll
    for (int i = 0; i <= N; ++i)
      around[i] = flip ^ (kSkipped == 0 ? packed[i]
                                        : __funnelshift_r(packed[i], packed[min(i + 1, Rows::kPacked - 1)], kSkipped));
    if (rows.left_end) around[0] = __byte_perm(around[0], outside.bits, 0x3214);
    if (rows.right_end) around[N] = __byte_perm(around[N], outside.bits, 0x3240);
    // Pixels 4 i - 1 and 4 i + 1; 4 i and 4 i + 2.
    uint32_t odd[N + 1], even[N + 1];
#pragma unroll
    for (int i = 0; i <= N; ++i) odd[i] = around[i] & 0x00ff00ffu, even[i] = around[i] >> 8 & 0x00ff00ffu;
#pragma unroll
    for (int i = 0; i < N; ++i) {
      V const next(__funnelshift_r(odd[i], odd[i + 1], 16)), middle(even[i]);
      V const both = upper(middle, next);
      most[2 * i] = upper(V(odd[i]), both);
      most[2 * i + 1] = upper(both, V(__funnelshift_r(even[i], even[i + 1], 16)));
    }
    if (unsigned(y) >= unsigned(height)) {
#pragma unroll
      for (auto& m : most) m = outside;
    }
  };
  typename Rows::Fetched ahead[kAhead];
  V row[2 * N], two[2 * N];  // the maxima of the last row, and of the last two rows
  {
    auto const above = fetch(y0 - 1), at = fetch(y0);
#pragma unroll
    for (int i = 0; i < kAhead; ++i) ahead[i] = fetch(y0 + 1 + i);
    V first[2 * N];
    along_x(above, y0 - 1, first);
    along_x(at, y0, row);
#pragma unroll
    for (int i = 0; i < 2 * N; ++i) two[i] = upper(first[i], row[i]);
  }
#pragma unroll 1
  for (int y = y0; y < y1; y += kAhead)
#pragma unroll
    for (int k = 0; k < kAhead; ++k) {
      if (k > 0 && y + k >= y1) break;
      V below[2 * N];
      along_x(ahead[k], y + k + 1, below);
      ahead[k] = fetch(y + k + 1 + kAhead);
      uint32_t words[N];
#pragma unroll
      for (int i = 0; i < N; ++i) {
        V const even = upper(two[2 * i], below[2 * i]), odd = upper(two[2 * i + 1], below[2 * i + 1]);
        words[i] = flip ^ (even.bits | odd.bits << 8);
      }
#pragma unroll
      for (int i = 0; i < 2 * N; ++i) two[i] = upper(row[i], below[i]), row[i] = below[i];
      Vector<uint8_t, P> result;
      __builtin_memcpy(&result, words, sizeof(result));
      out.put(result);
    }
}

template <int P>
bool launch(Dilation<uint8_t> const& p, CUstream_st* stream) {
  if (!supports_groups<P, 1>(p.x)) return false;
  with_row_bytes<P>(
      [&](auto bytes) {
        static int const resident = resident_blocks(dilation_3x3_bytes<P, bytes.value>, 256);
        ColumnGroups<P> const groups(p.x.count(), p.x.height, p.x.width, kRows,
                                     GroupRows<uint8_t, P, 1, bytes.value>::kReach, 3, resident);
        dilation_3x3_bytes<P, bytes.value><<<groups.blocks(), groups.threads, 0, stream>>>(p, groups);
      },
      p.x, p.y);
  return true;
}

}  // namespace

// Special case, H200: 6.7 (299x299) to 15 (336x512) times as fast as the kernel of float32 with conversions.
bool dilation_3x3_of_bytes(Dilation<uint8_t> const& p, CUstream_st* stream) {
  return launch<16>(p, stream) || launch<8>(p, stream);
}

}  // namespace kv::morphology::cuda
