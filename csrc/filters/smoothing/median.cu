// Median blur on CUDA. For 3x3 and 5x5 windows threads go down the image with the sorted rows of their pixels in
// registers and compute two output rows a step. Half types and bytes are sorted two pixels at a time, as they are
// stored, and read by groups of columns; narrow images and other types by strips. Other windows, and channels-last
// images, take a plain kernel with one thread for each element.
#include "core/stencils/column_groups.cuh"
#include "core/stencils/filter_list.cuh"
#include "core/stencils/pairs.cuh"
#include "median.h"

namespace kv::filters::cuda {
namespace {

// What a thread sorts.
template <class T>
constexpr int kPixelsOfValue = sizeof(T) < 4 ? 2 : 1;
template <class T>
using Value = std::conditional_t<kPixelsOfValue<T> == 2, Pair<T>, Compute<T>>;

constexpr int kRows = 32;

// One sorted row of the windows of each of a thread's N values. Adjacent windows share the first sorting step.
template <int K, int N, class V>
struct SortedRows {
  V v[N][K];
  __device__ __forceinline__ void sort(V const (&row)[N + K - 1]) {
#pragma unroll
    for (int i = 0; i < N; i += 2) {
#pragma unroll
      for (int k = 1; k < K; ++k) v[i][k] = row[i + k];
      sort_common<K>(v[i]);
#pragma unroll
      for (int k = 1; k < K; ++k) v[i + 1][k] = v[i][k];
      v[i][0] = row[i];
      v[i + 1][0] = row[i + K];
      insert_first<K>(v[i]);
      insert_first<K>(v[i + 1]);
    }
  }
};

// How a thread reads and writes the N values of a row and those on either side of them, where the pixels of a pair are
// N apart: of a strip, or of a group of columns.
template <int K, int N, class T, bool Aligned>
struct StripRows {
  static constexpr int P = N * kPixelsOfValue<T>, R = K / 2;
  using V = Value<T>;
  using Fetched = typename Strip<R, Aligned, P>::template FetchedRow<T>;
  Strip<R, Aligned, P> strip;
  char const* in;
  int64_t in_stride;  // bytes: nvcc multiplies once for a row's loads, by elements once for each of them
  T* out;
  int64_t out_stride;

  __device__ __forceinline__ StripRows(MedianBlur<T> const& p, int64_t plane, int column, int y0)
      : strip(column, int(p.x.width), p.border),
        in(reinterpret_cast<char const*>(p.x.plane(plane))),
        in_stride(p.x.row_stride * int64_t(sizeof(T))),
        out(p.y.row(plane, y0)),
        out_stride(p.y.row_stride) {}
  __device__ __forceinline__ Fetched fetch(int y) const {
    return strip.fetch(reinterpret_cast<T const*>(in + y * in_stride));
  }
  __device__ __forceinline__ void spread(Fetched const& fetched, V (&values)[N + 2 * R]) const {
    Compute<T> row[P + 2 * R];
    strip.spread(fetched, row);
#pragma unroll
    for (int i = 0; i < N + 2 * R; ++i)
      if constexpr (P > N)
        values[i] = V(row[i], row[i + N]);
      else
        values[i] = row[i];
  }
  __device__ __forceinline__ void store(V const (&values)[N]) {
    Compute<T> row[P];
#pragma unroll
    for (int i = 0; i < N; ++i)
      if constexpr (P > N)
        row[i] = values[i][0], row[i + N] = values[i][1];
      else
        row[i] = values[i];
    strip.store_in_stripes(out, row);
    out += out_stride;
  }
};

template <int K, int N, class T, int Bytes>
struct GroupedRows {
  static constexpr int P = 2 * N, R = K / 2;
  using V = Value<T>;
  using Rows = GroupRows<T, P, R, Bytes>;
  using Fetched = typename Rows::Fetched;
  Rows rows;
  GroupStore<T, P, Bytes> out;

  __device__ __forceinline__ GroupedRows(MedianBlur<T> const& p, int64_t plane, int x, int y0)
      : rows(p.x, plane, x, p.border), out(p.y, plane, x, y0) {}
  __device__ __forceinline__ Fetched fetch(int y) const { return rows.fetch(y); }
  __device__ __forceinline__ void spread(Fetched const& fetched, V (&values)[N + 2 * R]) const {
    uint32_t packed[Rows::kPacked];
    Rows::pack(fetched, packed);
#pragma unroll
    for (int i = 0; i < N + 2 * R; ++i) {
      int const a = i + Rows::kSkip, b = a + N;
      if constexpr (sizeof(T) == 1)
        values[i] = V(__byte_perm(packed[a / 4], packed[b / 4], a % 4 * 0x11 | (4 + b % 4) * 0x1100));
      else
        values[i] = V(__byte_perm(packed[a / 2], packed[b / 2], (a % 2 ? 0x32 : 0x10) | (b % 2 ? 0x7600 : 0x5400)));
    }
    // The border, of the first pixels of the first pairs and the second ones of the last.
    V filled[N + 2 * R];
#pragma unroll
    for (int i = 0; i < N + 2 * R; ++i) filled[i] = values[i];
    rows.template fill_border<N>(filled);
#pragma unroll
    for (int i = 0; i < R; ++i) {
      values[i] = V(__byte_perm(filled[i].bits, values[i].bits, 0x7610));
      values[R + N + i] = V(__byte_perm(values[R + N + i].bits, filled[R + N + i].bits, 0x7610));
    }
  }
  __device__ __forceinline__ void store(V const (&values)[N]) {
    constexpr int kWords = P * int(sizeof(T)) / 4;
    uint32_t words[kWords];
    if constexpr (sizeof(T) == 1) {
#pragma unroll
      for (int i = 0; i < N; i += 2)  // pixels i, i + 1, i + N, i + 1 + N
        words[i / 2] = __byte_perm(values[i].bits, values[i + 1].bits, 0x7351);
      if constexpr (N >= 4) {
        uint32_t pairs[kWords];
        __builtin_memcpy(pairs, words, sizeof(words));
#pragma unroll
        for (int i = 0; i < N / 4; ++i) {
          words[i] = __byte_perm(pairs[2 * i], pairs[2 * i + 1], 0x5410);
          words[N / 4 + i] = __byte_perm(pairs[2 * i], pairs[2 * i + 1], 0x7632);
        }
      }
    } else {
#pragma unroll
      for (int i = 0; i < N; i += 2) {
        words[i / 2] = __byte_perm(values[i].bits, values[i + 1].bits, 0x5410);
        words[(i + N) / 2] = __byte_perm(values[i].bits, values[i + 1].bits, 0x7632);
      }
    }
    Vector<T, P> pixels;
    __builtin_memcpy(&pixels, words, sizeof(pixels));
    out.put(pixels);
  }
};

// The middle one of three bytes, of which the lowest and the highest are known.
__device__ __forceinline__ BytePair middle_of(BytePair a, BytePair b, BytePair c, BytePair lowest, BytePair highest) {
  return BytePair(a.bits ^ b.bits ^ c.bits ^ lowest.bits ^ highest.bits);
}

// Rows y0 ... y1 - 1 of the medians of 3 x 3 bytes: columns of three are sorted, then the median is the middle one of
// the highest lowest, the middle middle and the lowest highest byte of three columns.
template <int N, class Rows>
__device__ __forceinline__ void medians_of_bytes(Rows& rows, int height, Border border, int y0, int y1) {
  using V = BytePair;
  using Fetched = typename Rows::Fetched;
  constexpr int kAhead = 2, kColumns = N + 2;
  auto const fetch = [&](int y) {
    int const source = y <= y1 ? border_index(border, y, height) : -1;
    return source < 0 ? Fetched{} : rows.fetch(source);
  };
  V last[2][kColumns];  // two rows
  Fetched ahead[kAhead];
  {
    Fetched const above = fetch(y0 - 1), at = fetch(y0);
#pragma unroll
    for (int i = 0; i < kAhead; ++i) ahead[i] = fetch(y0 + 1 + i);
    rows.spread(above, last[0]);
    rows.spread(at, last[1]);
  }
#pragma unroll 1
  for (int y = y0; y < y1; y += kAhead)
#pragma unroll
    for (int k = 0; k < kAhead; ++k) {
      if (k > 0 && y + k >= y1) break;
      V below[kColumns], lowest[kColumns], middle[kColumns], highest[kColumns], medians[N];
      rows.spread(ahead[k], below);
      ahead[k] = fetch(y + k + 1 + kAhead);
#pragma unroll
      for (int i = 0; i < kColumns; ++i) {
        V const a = last[k][i], b = last[1 - k][i], c = below[i];
        lowest[i] = lower(a, b, c), highest[i] = upper(a, b, c), middle[i] = middle_of(a, b, c, lowest[i], highest[i]);
        last[k][i] = c;
      }
      auto const middle_of_three = [](V a, V b, V c) { return middle_of(a, b, c, lower(a, b, c), upper(a, b, c)); };
#pragma unroll
      for (int i = 0; i < N; ++i)
        medians[i] = middle_of_three(upper(lowest[i], lowest[i + 1], lowest[i + 2]),
                                     middle_of_three(middle[i], middle[i + 1], middle[i + 2]),
                                     lower(highest[i], highest[i + 1], highest[i + 2]));
      rows.store(medians);
    }
}

// Rows y0 ... y1 - 1 of the medians.
template <int K, int N, class T, class Rows>
__device__ __forceinline__ void median_rows(Rows& rows, int height, Border border, int y0, int y1) {
  constexpr int R = K / 2;
  using V = Value<T>;
  using Sorted = SortedRows<K, N, V>;
  using Fetched = typename Rows::Fetched;
  auto const fetch = [&](int y) {
    int const source = border_index(border, y, height);
    return source < 0 ? Fetched{} : rows.fetch(source);
  };
  auto const sort = [&](Fetched const& fetched, Sorted& sorted) {
    V values[N + 2 * R];
    rows.spread(fetched, values);
    sorted.sort(values);
  };
  // The next two rows are fetched before the current two are processed.
  Fetched prefetched0 = fetch(y0 + R), prefetched1 = fetch(y0 + R + 1);
  auto const advance = [&](int y, Sorted& next0, Sorted& next1) {
    Fetched const fetched0 = prefetched0, fetched1 = prefetched1;
    if (y + 2 < y1) {
      prefetched0 = fetch(y + R + 2);
      prefetched1 = fetch(y + R + 3);
    }
    sort(fetched0, next0);
    sort(fetched1, next1);
  };
  auto const store = [&](V const(&first)[N], V const(&second)[N], int y) {
    rows.store(first);
    if (y + 1 < y1) rows.store(second);
  };

  if constexpr (K == 3) {
    Sorted a, b, c, d;  // rows y - 1 ... y + 2
    sort(fetch(y0 - 1), a);
    sort(fetch(y0), b);
    for (int y = y0; y < y1; y += 2) {
      advance(y, c, d);
      V first[N], second[N];
#pragma unroll
      for (int i = 0; i < N; ++i) {
        V middle[K + 1];
        middle_of_two<K>(b.v[i], c.v[i], middle);
        first[i] = median_of<K>(middle, a.v[i]);
        second[i] = median_of<K>(middle, d.v[i]);
      }
      store(first, second, y);
      a = c;
      b = d;
    }
  } else {
    Sorted before, same, after, next0, next1;  // rows y - 2, y, y + 1, y + 2, y + 3
    V above[N][2 * K], below[N][2 * K];        // rows y - 1 and y, y + 1 and y + 2, merged
    sort(fetch(y0 - 2), before);
    sort(fetch(y0 - 1), after);
    sort(fetch(y0), same);
#pragma unroll
    for (int i = 0; i < N; ++i) merge<K, K>(after.v[i], same.v[i], above[i]);
    sort(fetch(y0 + 1), after);
    for (int y = y0; y < y1; y += 2) {
      advance(y, next0, next1);
      V first[N], second[N];
#pragma unroll
      for (int i = 0; i < N; ++i) {
        merge<K, K>(after.v[i], next0.v[i], below[i]);
        V middle[K + 1];
        middle_of_two<K>(above[i], below[i], middle);
        first[i] = median_of<K>(middle, before.v[i]);
        second[i] = median_of<K>(middle, next1.v[i]);
#pragma unroll
        for (int k = 0; k < 2 * K; ++k) above[i][k] = below[i][k];
      }
      store(first, second, y);
      before = same;
      same = next0;
      after = next1;
    }
  }
}

template <class T, int K>
constexpr int kBlocks = sizeof(Compute<T>) == 8 ? 1
                        : K == 3                ? 3
                                                : 2;  // on a multiprocessor at once
constexpr int kThreads = 256;

// N: values of a thread, limited by its registers.
template <int K, int N, class T, bool Aligned>
__global__ void __launch_bounds__(kThreads, kBlocks<T, K>)
    median_strip(MedianBlur<T> p, Strips<N * kPixelsOfValue<T>> strips) {
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  StripRows<K, N, T, Aligned> rows(p, plane, x, y0);
  median_rows<K, N, T>(rows, int(p.x.height), p.border, y0, min(y0 + int(strips.rows), int(p.x.height)));
}
template <int K, int N, class T, int Bytes>
__global__ void __launch_bounds__(kThreads, kBlocks<T, K>)
    median_groups(__grid_constant__ MedianBlur<T> const p, __grid_constant__ ColumnGroups<2 * N> const groups) {
  int64_t plane;
  int x, y0;
  groups.locate(plane, x, y0);
  GroupedRows<K, N, T, Bytes> rows(p, plane, x, y0);
  int const height = int(p.x.height), y1 = min(y0 + groups.rows, height);
  if constexpr (K == 3 && sizeof(T) == 1)
    medians_of_bytes<N>(rows, height, p.border, y0, y1);
  else
    median_rows<K, N, T>(rows, height, p.border, y0, y1);
}

// The same of lists.
template <int K, int N, class T>
__global__ void __launch_bounds__(kThreads, kBlocks<T, K>)
    median_strip_of_list(__grid_constant__ MedianBlurList<T> const list) {
  unsigned block;
  MedianBlur<T> const* const p = sample_of_block(list, block);
  if (!p) return;
  Strips<N * kPixelsOfValue<T>> const strips(p->x.count(), p->x.height, p->x.width, kRows);
  int64_t plane;
  int x, y0;
  if (!strips.locate(block, plane, x, y0)) return;
  StripRows<K, N, T, false> rows(*p, plane, x, y0);
  median_rows<K, N, T>(rows, int(p->x.height), p->border, y0, min(y0 + int(strips.rows), int(p->x.height)));
}
template <int K, int N, class T>
__global__ void __launch_bounds__(kThreads, kBlocks<T, K>)
    median_groups_of_list(__grid_constant__ MedianBlurList<T> const list) {
  unsigned block;
  MedianBlur<T> const* const p = sample_of_block(list, block);
  if (!p) return;
  ColumnGroups<2 * N> const groups(p->x.count(), p->x.height, p->x.width, kRows, K / 2, kThreads);
  int64_t plane;
  int x, y0;
  groups.locate(block, plane, x, y0);
  GroupedRows<K, N, T, 0> rows(*p, plane, x, y0);
  int const height = int(p->x.height), y1 = min(y0 + groups.rows, height);
  if constexpr (K == 3 && sizeof(T) == 1)
    medians_of_bytes<N>(rows, height, p->border, y0, y1);
  else
    median_rows<K, N, T>(rows, height, p->border, y0, y1);
}

template <class T>
__device__ __forceinline__ void median_of_pixel(MedianBlur<T> const& p, unsigned block) {
  using Key = MedianKey<T>;
  int64_t const i = int64_t(block) * blockDim.x + threadIdx.x, size = p.x.row_size(), step = p.x.step;
  if (i >= p.x.rows() * size) return;
  int64_t const e = i % size, r = i / size, plane = r / p.x.height;
  int const y = int(r % p.x.height), x = int(e / step), channel = int(e % step);
  int const height = int(p.x.height), width = int(p.x.width);
  int const top = y - int(median_before(p.ky)), left = x - int(median_before(p.kx));
  int const bottom = y + int(median_after(p.ky)), right = x + int(median_after(p.kx));
  bool const interior = left >= 0 && right < width;
  T const* const in = p.x.plane(plane) + channel;

  auto const count = [&](auto counts) {
    Key n = 0;
    for (int yy = top; yy <= bottom; ++yy) {
      int const source = border_index(p.border, yy, height);
      if (source < 0) {
        n += counts(to_key(T{})) ? Key(p.kx) : Key(0);
        continue;
      }
      T const* const row = in + source * p.x.row_stride;
      if (interior)
        for (int xx = left; xx <= right; ++xx) n += counts(to_key(row[xx * step]));
      else
        for (int xx = left; xx <= right; ++xx) {
          int const at = border_index(p.border, xx, width);
          n += counts(to_key(at < 0 ? T{} : row[at * step]));
        }
    }
    return n;
  };
  Key median = kMedianKeyOfNan<T>;
  if (sizeof(T) == 1 || count([](Key key) { return key == kMedianKeyOfNan<T>; }) == 0)
    median = select_key<T>(kLowestMedianKey<T>, Key((p.ky * p.kx - 1) / 2),
                           [&](Key candidate) { return count([=](Key key) { return key < candidate; }); });
  p.y.row(plane, y)[e] = from_key<T>(median);
}

template <class T>
__global__ void median_any(MedianBlur<T> p) {
  median_of_pixel(p, blockIdx.x);
}
template <class T>
__global__ void median_any_of_list(__grid_constant__ MedianBlurList<T> const list) {
  unsigned block;
  MedianBlur<T> const* const p = sample_of_block(list, block);
  if (p) median_of_pixel(*p, block);
}

template <int K, int N, class T>
void launch_strips(MedianBlur<T> const& p, CUstream_st* stream) {
  constexpr int P = N * kPixelsOfValue<T>;
  if constexpr (P > 4)  // too few strips to occupy the GPU: narrower ones
    if (Strips<P>(p.x.count(), p.x.height, p.x.width, kRows).count < 8 * unsigned(multiprocessors()))
      return launch_strips<K, N / 2>(p, stream);
  with_alignment<T>(is_vectorizable<P>(p.x) && is_vectorizable<P>(p.y), [&](auto aligned) {
    Strips<P> strips(p.x.count(), p.x.height, p.x.width, kRows);
    if constexpr (K == 3) {  // 5 x 5 in waves: 0.93x
      static int const resident = resident_blocks(median_strip<K, N, T, aligned.value>, kThreads);
      strips = Strips<P>::near(kRows, p.x.count(), p.x.height, p.x.width, K, resident, kThreads / 32);
    }
    median_strip<K, N, T, aligned.value><<<strips.blocks(), kThreads, 0, stream>>>(p, strips);
  });
}

// Special case, H200: 1.5 to 2.4 (3 x 3) and 1.4 to 1.6 (5 x 5) times as fast as strips, bytes; 1.12 (335x513)
// to 1.75 (336x512), half types of 3 x 3.
template <int K, int N, class T>
bool launch_groups(MedianBlur<T> const& p, CUstream_st* stream) {
  constexpr int P = 2 * N, R = K / 2;
  if (p.ky != K || p.kx != K || !supports_groups<P, R>(p.x)) return false;
  with_row_bytes<P>(
      [&](auto bytes) {
        static int const resident = resident_blocks(median_groups<K, N, T, bytes.value>, kThreads);
        ColumnGroups<P> const groups(p.x.count(), p.x.height, p.x.width, kRows, GroupRows<T, P, R, bytes.value>::kReach,
                                     K, resident);
        median_groups<K, N, T, bytes.value><<<groups.blocks(), groups.threads, 0, stream>>>(p, groups);
      },
      p.x, p.y);
  return true;
}

template <int K, int N, class T>
int launch_strips(MedianBlurList<T> const& p, CUstream_st* stream) {
  constexpr int P = N * kPixelsOfValue<T>;
  return launch_list(
      p,
      [](MedianBlur<T> const& one) {
        return Strips<P>(one.x.count(), one.x.height, one.x.width, kRows).blocks(kThreads / 32);
      },
      [&](MedianBlurList<T> const& list, unsigned blocks) {
        median_strip_of_list<K, N><<<blocks, kThreads, 0, stream>>>(list);
      });
}

template <int K, int N, class T>
int launch_groups(MedianBlurList<T> const& p, CUstream_st* stream) {
  return launch_list(
      p,
      [](MedianBlur<T> const& one) {
        return ColumnGroups<2 * N>(one.x.count(), one.x.height, one.x.width, kRows, K / 2, kThreads).blocks();
      },
      [&](MedianBlurList<T> const& list, unsigned blocks) {
        median_groups_of_list<K, N><<<blocks, kThreads, 0, stream>>>(list);
      });
}

// By groups that serve all images, or by strips.
template <int K, int N, class T>
int launch_network(MedianBlurList<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) <= 2)
    if (all_samples(p, [](MedianBlur<T> const& one) { return supports_groups<2 * N, K / 2>(one.x); }))
      return launch_groups<K, N>(p, stream);
  return launch_strips<K, N>(p, stream);
}

}  // namespace

template <class T>
int median_blur_list(MedianBlurList<T> const& p, CUstream_st* stream) {
  bool const is_square = p.all.ky == p.all.kx && !p.list.interleaved;
  if (is_square && p.all.kx == 3) return launch_network<3, 4>(p, stream);
  if (is_square && p.all.kx == 5) return launch_network<5, 2>(p, stream);
  return launch_list(
      p, [](MedianBlur<T> const& one) { return ceil_div(one.x.rows() * one.x.row_size(), 256); },
      [&](MedianBlurList<T> const& list, unsigned blocks) { median_any_of_list<T><<<blocks, 256, 0, stream>>>(list); });
}

template <class T>
int median_blur(MedianBlur<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) == 1)
    if (launch_groups<3, 8>(p, stream)) return cudaGetLastError();
  if constexpr (sizeof(T) <= 2)
    if (launch_groups<3, 4>(p, stream) || launch_groups<5, 2>(p, stream)) return cudaGetLastError();
  // Special case, H200: 134 to 212 times as fast as a thread an element.
  if (p.ky == p.kx && p.kx == 3 && p.x.step == 1) launch_strips<3, 4>(p, stream);
  // Special case, H200: 126 to 151 times as fast as a thread an element.
  else if (p.ky == p.kx && p.kx == 5 && p.x.step == 1)
    launch_strips<5, 2>(p, stream);
  else
    median_any<<<unsigned(ceil_div(p.x.rows() * p.x.row_size(), 256)), 256, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(median_blur, MedianBlur)
KV_INSTANTIATE_WITH_BYTES(median_blur_list, MedianBlurList)

}  // namespace kv::filters::cuda
