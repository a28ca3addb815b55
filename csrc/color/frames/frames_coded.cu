// RGB to the codes of video frames on CUDA: a thread takes eight adjacent columns of a row of chroma, and its rows of
// luma. Rows at any address are read by words.
#include "frames.cuh"
#include "frames_coded.h"

namespace kv::color::cuda {
namespace {

// Which accesses are vectors; `packed`: y u y v.
struct CodedVectors {
  bool rgb, luma, chroma, packed;
};

// The colors of a thread's columns in a row.
template <class T>
struct OwnColors {
  static constexpr int kWords = kOwn * int(sizeof(T)) / 4;
  uint32_t words[kWords];

  __device__ __forceinline__ Compute<T> number(int j) const {
    if constexpr (sizeof(T) == 1) {
      return byte_of<float>(words[j / 4], j % 4);
    } else if constexpr (sizeof(T) == 2) {
      T stored;
      stored.bits = uint16_t(words[j / 2] >> 16 * (j % 2));
      return read(stored);
    } else if constexpr (sizeof(T) == 4) {
      return __uint_as_float(words[j]);
    } else {
      return __hiloint2double(int(words[2 * j + 1]), int(words[2 * j]));
    }
  }
};

// Codes of numbers. Bytes of floats are numbers in [0, 1].
template <class S, int N, class F>
__device__ __forceinline__ Vector<S, N> codes_of(F const (&numbers)[N]) {
  Vector<S, N> codes;
  if constexpr (__is_same(S, uint8_t) && sizeof(F) == 4) {
    uint32_t const* const words = levels_of(numbers).words;
    __builtin_memcpy(&codes, words, N);
  } else {
#pragma unroll
    for (int j = 0; j < N; ++j)
      if constexpr (__is_same(S, uint16_t))
        codes.v[j] = ten_bits(numbers[j]);
      else
        codes.v[j] = round_to<S>(Compute<S>(numbers[j]));
  }
  return codes;
}

// Stores the codes of each thread of a warp, those at x ... of a row of `width`. Called by all 32 threads.
template <class S, int N>
__device__ __forceinline__ void store_codes(S* to, Vector<S, N> const& codes, bool vectors, int x, int width) {
  if (vectors) {
    if (x < width) store_vector(to, codes);
  } else if constexpr (__is_same(S, uint16_t)) {
#pragma unroll
    for (int j = 0; j < N; ++j)
      if (x + j < width) to[j] = codes.v[j];
  } else {
    Compute<S> numbers[N];
#pragma unroll
    for (int j = 0; j < N; ++j) numbers[j] = read(codes.v[j]);
    store_words(to, numbers, x, width);
  }
}

template <class S, class T, bool Nearest>
__global__ void __launch_bounds__(kRowThreads)
    run_coded(__grid_constant__ CodedFrames<T> const p, CodedVectors const vectors) {
  using F = Compute<T>;
  int const x = int(blockIdx.x * 32 + threadIdx.x % 32) * kOwn, c = int(blockIdx.y) * kRowWarps + threadIdx.x / 32;
  int const width = p.x.size, height = p.y.size, rows = p.rows_of_chroma();
  if (int(blockIdx.x) * 32 * kOwn >= width || c >= p.y.chroma_size) return;
  bool const has_left = !Nearest && p.x.site == ChromaSite::cosited;
  int64_t const frame_stride = p.rgb.inner == 1 ? 3 * p.rgb.outer_stride : p.rgb.outer_stride;
  int64_t const channel_stride = p.rgb.inner == 1 ? p.rgb.outer_stride : p.rgb.inner_stride;
  for (int64_t frame = blockIdx.z; frame < p.rgb.count() / 3; frame += gridDim.z) {
    T const* const colors_of_frame = p.rgb.data + frame * frame_stride + x;
    // Of the rows, weighted: the colors of even columns, of odd ones, and of the column on the left.
    F even[3][kOwn / 2]{}, odd[3][kOwn / 2]{}, left[3]{};
    F luma[2][kOwn]{};
    constexpr int kAbove = Nearest ? 0 : 1;  // rows that are read above
    auto const is_read = [&](int at) {
      bool const is_own = at >= 0 && at < rows && c * rows + at < height;
      return x < width && (is_own || subsampling_weight<F>(p.y, at) != F(0));
    };
    // All are requested before the first one is used.
    OwnColors<T> requested[2 + kAbove][3];
    T beside[2 + kAbove][3];
#pragma unroll
    for (int at = -kAbove; at < 2; ++at) {
      if (!is_read(at)) continue;
      T const* const from = colors_of_frame + min(max(c * rows + at, 0), height - 1) * p.rgb.row_stride;
#pragma unroll
      for (int k = 0; k < 3; ++k) {
        auto const* const bytes = reinterpret_cast<char const*>(from + k * channel_stride);
        fetch_words(bytes, (width - x) * int(sizeof(T)), vectors.rgb, requested[at + kAbove][k].words);
        if (has_left) beside[at + kAbove][k] = from[k * channel_stride - (x > 0 ? 1 : 0)];
      }
    }
#pragma unroll
    for (int at = -kAbove; at < 2; ++at) {
      if (!is_read(at)) continue;
      F const weight = subsampling_weight<F>(p.y, at);
      OwnColors<T> const(&colors)[3] = requested[at + kAbove];
#pragma unroll
      for (int k = 0; k < 3; ++k)
        if (has_left) left[k] += weight * F(read(beside[at + kAbove][k]));
#pragma unroll
      for (int j = 0; j < kOwn; ++j) {
        F color[3];
#pragma unroll
        for (int k = 0; k < 3; ++k) {
          color[k] = colors[k].number(j);
          if constexpr (Nearest) {
            if (at == 0 && j % 2 == 0) even[k][j / 2] = color[k];
          } else {
            (j % 2 ? odd : even)[k][j / 2] += weight * color[k];
          }
        }
        if (at >= 0) luma[max(at, 0)][j] = p.code(0, color[0], color[1], color[2]);
      }
    }
    F pairs[kOwn];
#pragma unroll
    for (int i = 0; i < kOwn / 2; ++i) {
      F color[3];
#pragma unroll
      for (int k = 0; k < 3; ++k) {
        F const here = even[k][i], before = i > 0 ? odd[k][max(i - 1, 0)] : left[k];
        F const after = x + 2 * i + 1 < width ? odd[k][i] : here;  // the border repeats the last column
        color[k] = Nearest                           ? here
                   : p.x.site == ChromaSite::between ? (here + after) * F(0.5)
                                                     : here * F(0.5) + (before + after) * F(0.25);
      }
#pragma unroll
      for (int k = 0; k < 2; ++k) pairs[2 * i + k] = p.code(1 + k, color[0], color[1], color[2]);
    }
    CodeTarget const &y = p.planes[0], &u = p.planes[1], &v = p.planes[2];
    if (vectors.packed) {
      F packed[2 * kOwn];
#pragma unroll
      for (int j = 0; j < kOwn; ++j) packed[2 * j] = luma[0][j], packed[2 * j + 1] = pairs[j];
      S* const to = y.template row<S>(frame, c) + 2 * x;
      store_codes(to, codes_of<S>(packed), vectors.luma, 2 * x, 2 * width);
      continue;
    }
#pragma unroll
    for (int r = 0; r < 2; ++r)
      if (r < rows && c * rows + r < height)
        store_codes(y.template row<S>(frame, c * rows + r) + x, codes_of<S>(luma[r]), vectors.luma, x, width);
    if (u.column_stride == 2) {
      bool const is_swapped = v.data < u.data;
      F ordered[kOwn];
#pragma unroll
      for (int j = 0; j < kOwn; ++j) ordered[j] = is_swapped ? pairs[j ^ 1] : pairs[j];
      S* const to = (is_swapped ? v : u).template row<S>(frame, c) + x;
      store_codes(to, codes_of<S>(ordered), vectors.chroma, x, 2 * p.x.chroma_size);
    } else {
#pragma unroll
      for (int k = 0; k < 2; ++k) {
        F plane[kOwn / 2];
#pragma unroll
        for (int i = 0; i < kOwn / 2; ++i) plane[i] = pairs[2 * i + k];
        S* const to = p.planes[1 + k].template row<S>(frame, c) + x / 2;
        store_codes(to, codes_of<S>(plane), vectors.chroma, x / 2, p.x.chroma_size);
      }
    }
  }
}

template <class S, class T>
int run_codes(CodedFrames<T> p, CUstream_st* stream) {
  if constexpr (sizeof(S) == 1 && sizeof(Compute<T>) == 4) {
    for (float& x : p.matrix) x /= 255;
    for (float& x : p.offset) x /= 255;
  }
  auto const are_vectors = [](void const* data, int64_t row_stride, int64_t frame_stride, int count, int64_t size) {
    int64_t const bytes = min(count * size, int64_t(16));
    return (reinterpret_cast<intptr_t>(data) | row_stride * size | frame_stride * size) % bytes == 0;
  };
  CodeTarget const &y = p.planes[0], &u = p.planes[1], &v = p.planes[2];
  bool const is_packed = y.column_stride == 2, has_planes = u.column_stride == 1;
  bool const whole = p.x.size % kOwn == 0;
  CodedVectors const vectors{
      are_vectors(p.rgb.data, p.rgb.row_stride, p.rgb.outer_stride | p.rgb.inner_stride, kOwn, sizeof(T)),
      whole && are_vectors(y.data, y.row_stride, y.frame_stride, is_packed ? 2 * kOwn : kOwn, sizeof(S)),
      whole &&
          are_vectors(min(u.data, v.data), u.row_stride, u.frame_stride, has_planes ? kOwn / 2 : kOwn, sizeof(S)) &&
          (!has_planes || are_vectors(v.data, 0, 0, kOwn / 2, sizeof(S))),
      is_packed};
  dim3 const blocks(unsigned(ceil_div(p.x.size, 32 * kOwn)), unsigned(ceil_div(p.y.chroma_size, kRowWarps)),
                    unsigned(min(p.rgb.count() / 3, int64_t(65535))));
  bool const is_nearest = p.x.site == ChromaSite::nearest && p.y.site == ChromaSite::nearest;
  auto* const kernel = is_nearest ? run_coded<S, T, true> : run_coded<S, T, false>;
  kernel<<<blocks, kRowThreads, 0, stream>>>(p, vectors);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int coded_frames(CodedFrames<T> const& p, CUstream_st* stream) {
  return with_codes<T>(p.code_bytes, [&](auto code) { return run_codes<typename decltype(code)::type>(p, stream); });
}

KV_INSTANTIATE_WITH_BYTES(coded_frames, CodedFrames)

}  // namespace kv::color::cuda
