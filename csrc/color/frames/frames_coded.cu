// RGB to the codes of video frames on CUDA: a thread takes four adjacent columns of a row of chroma, and its rows of
// luma.
#include "core/launch.cuh"
#include "frames_coded.h"

namespace kv::color::cuda {
namespace {

constexpr int kColumns = 4, kThreads = 256, kWarps = kThreads / 32;

// Which accesses are vectors.
struct CodedVectors {
  bool rgb, luma, pairs;
};

template <class S, class F>
__device__ __forceinline__ S code_of(F x) {
  if constexpr (__is_same(S, uint16_t))
    return ten_bits(x);
  else
    return round_to<S>(Compute<S>(x));
}

template <class S, class T>
__global__ void __launch_bounds__(kThreads)
    run_coded(__grid_constant__ CodedFrames<T> const p, CodedVectors const vectors) {
  using F = Compute<T>;
  int const x = int(blockIdx.x * 32 + threadIdx.x % 32) * kColumns, c = int(blockIdx.y) * kWarps + threadIdx.x / 32;
  int const width = p.x.size, height = p.y.size, rows = p.rows_of_chroma();
  if (x >= width || c >= p.y.chroma_size) return;
  bool const is_halved = p.x.is_halved(), has_left = is_halved && p.x.site == ChromaSite::cosited;
  for (int64_t frame = blockIdx.z; frame < p.rgb.count() / 3; frame += gridDim.z) {
    F sums[3][kColumns + 1]{};  // of the colors of the rows, from the column on the left
    auto const add_row = [&](int at) {
      F const weight = subsampling_weight<F>(p.y, at);
      int const row = min(max(c * rows + at, 0), height - 1);
      bool const is_own = at >= 0 && at < rows && c * rows + at < height;
      if (weight == F(0) && !is_own) return;
      F colors[3][kColumns + 1];
#pragma unroll
      for (int k = 0; k < 3; ++k) {
        T const* const from = p.rgb.row(3 * frame + k, row);
        colors[k][0] = has_left ? F(read(from[max(x - 1, 0)])) : F(0);
        if (vectors.rgb) {
          auto const vector = *reinterpret_cast<Vector<T, kColumns> const*>(from + x);
#pragma unroll
          for (int j = 0; j < kColumns; ++j) colors[k][1 + j] = F(read(vector.v[j]));
        } else {  // the border repeats the last column
#pragma unroll
          for (int j = 0; j < kColumns; ++j) colors[k][1 + j] = F(read(from[min(x + j, width - 1)]));
        }
#pragma unroll
        for (int j = 0; j <= kColumns; ++j) sums[k][j] += weight * colors[k][j];
      }
      if (!is_own) return;
      Vector<S, kColumns> luma;
#pragma unroll
      for (int j = 0; j < kColumns; ++j)
        luma.v[j] = code_of<S>(colors[0][1 + j] * p.matrix[0] + colors[1][1 + j] * p.matrix[1] +
                               colors[2][1 + j] * p.matrix[2] + p.offset[0]);
      CodeTarget const& plane = p.planes[0];
      S* const to = plane.template row<S>(frame, row) + x * plane.column_stride;
      if (vectors.luma) {
        store_vector(to, luma);
      } else {
#pragma unroll
        for (int j = 0; j < kColumns; ++j)
          if (x + j < width) to[j * plane.column_stride] = luma.v[j];
      }
    };
#pragma unroll
    for (int at = -1; at < 2; ++at) add_row(at);

    int const samples = is_halved ? (min(width - x, kColumns) + 1) / 2 : min(width - x, kColumns);
    int const first = is_halved ? x / 2 : x;
    S codes[2][kColumns];
#pragma unroll
    for (int j = 0; j < kColumns; ++j) {
      F color[3];
#pragma unroll
      for (int k = 0; k < 3; ++k) {
        F const before = is_halved ? sums[k][j % 2 ? 2 : 0] : F(0), after = is_halved ? sums[k][j % 2 ? 4 : 2] : F(0);
        F const middle = is_halved ? sums[k][j % 2 ? 3 : 1] : sums[k][1 + j];
        color[k] = !is_halved || p.x.site == ChromaSite::nearest ? middle
                   : p.x.site == ChromaSite::between             ? (middle + after) * F(0.5)
                                                                 : middle * F(0.5) + (before + after) * F(0.25);
      }
#pragma unroll
      for (int k = 0; k < 2; ++k) {
        F const* const m = p.matrix + 3 + 3 * k;
        codes[k][j] = code_of<S>(color[0] * m[0] + color[1] * m[1] + color[2] * m[2] + p.offset[1 + k]);
      }
    }
    CodeTarget const &u = p.planes[1], &v = p.planes[2];
    if (vectors.pairs) {
      bool const swapped = v.data < u.data;
      Vector<S, 4> pairs;
#pragma unroll
      for (int j = 0; j < 4; ++j) pairs.v[j] = codes[(j % 2 == 1) != swapped][j / 2];
      store_vector((swapped ? v : u).template row<S>(frame, c) + 2 * first, pairs);
    } else {
#pragma unroll
      for (int k = 0; k < 2; ++k) {
        CodeTarget const& plane = p.planes[1 + k];
        S* const to = plane.template row<S>(frame, c) + first * plane.column_stride;
#pragma unroll
        for (int j = 0; j < kColumns; ++j)
          if (j < samples) to[j * plane.column_stride] = codes[k][j];
      }
    }
  }
}

template <class S, class T>
int run(CodedFrames<T> const& p, CUstream_st* stream) {
  auto const are_vectors = [](void const* data, int64_t row_stride, int64_t frame_stride, int64_t size) {
    return reinterpret_cast<uintptr_t>(data) % (kColumns * size) == 0 && (row_stride | frame_stride) % kColumns == 0;
  };
  CodeTarget const &y = p.planes[0], &u = p.planes[1], &v = p.planes[2];
  bool const whole = p.x.size % kColumns == 0;
  int64_t const apart = static_cast<S*>(v.data) - static_cast<S*>(u.data);
  CodeTarget const& first = apart < 0 ? v : u;
  CodedVectors const vectors{
      whole && p.rgb.step == 1 &&
          are_vectors(p.rgb.data, p.rgb.row_stride, p.rgb.outer_stride | p.rgb.inner_stride, sizeof(T)),
      whole && y.column_stride == 1 && are_vectors(y.data, y.row_stride, y.frame_stride, sizeof(S)),
      whole && p.x.is_halved() && (apart == 1 || apart == -1) && u.column_stride == 2 &&
          are_vectors(first.data, u.row_stride, u.frame_stride, sizeof(S))};
  dim3 const blocks(unsigned(ceil_div(p.x.size, 32 * kColumns)), unsigned(ceil_div(p.y.chroma_size, kWarps)),
                    unsigned(min(p.rgb.count() / 3, int64_t(65535))));
  run_coded<S><<<blocks, kThreads, 0, stream>>>(p, vectors);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int coded_frames(CodedFrames<T> const& p, CUstream_st* stream) {
  if (p.code_bytes == 1) return run<uint8_t>(p, stream);
  if (p.code_bytes == 2) return run<uint16_t>(p, stream);
  if constexpr (!__is_same(T, uint8_t))
    return run<T>(p, stream);
  else
    return cudaErrorInvalidValue;  // which the entry has refused
}

KV_INSTANTIATE_WITH_BYTES(coded_frames, CodedFrames)

}  // namespace kv::color::cuda
