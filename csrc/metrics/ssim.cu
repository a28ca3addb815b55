// Structural similarity on CUDA for planar images and windows of 3 to 11 pixels, with one launch each way. ssim.cuh
// lists the files of the other cases.
//
// A block traverses its columns downwards, four rows at a time. Along y each thread has one column, with running sums
// in registers: a new row adds to the sums of all rows whose windows contain it, and completes the first of them.
// Completed rows go to shared memory. Along x each thread has four columns of one of the four rows, so that it loads
// vectors and shares them between its windows. Pixels that windows read out of bounds are filled in when the rows are
// written. The gradient does both steps twice: for the means, and for the derivatives by them. Only loads and stores
// depend on the dtype and the layout of the pixels, which are therefore run-time arguments.
#include "core/column_grid.cuh"
#include "core/row_prefetcher.cuh"
#include "ssim.cuh"

namespace kv::metrics::cuda {
namespace {

constexpr int kThreads = 256;         // per block, at most
constexpr int kRows = 4;              // processed together; also the columns of a thread along x
constexpr int kLine = kThreads + 16;  // elements of a row in shared memory

// Row and column indices are those of the images; a 'valid' similarity starts at `offset`.
template <int K>
struct Work {
  StoredPlanes x, y, result,
      other_result;        // the similarity; or the gradients of x and y, the latter without data if not needed
  StoredPlanes grad;       // of the similarity
  int x_stride, y_stride;  // of rows, in bytes
  Border border;
  int offset;
  DType stored;
  bool vectors;  // results and gradients of the similarity are accessed in vectors of kRows
  SsimConstants<float> constants;
  SsimLoss<float> loss;
  float* partial;
  float const* of_loss;
  unsigned across, down;  // blocks per plane
  int rows;               // per block
  float weights[K];       // kernel arguments are constants, which cost no registers
};

// The position of a thread, and the columns near the ends of the rows.
template <int K>
struct BlockPosition : RowGroupPosition<kRows> {
  using RowGroupPosition<kRows>::RowGroupPosition;

  __device__ __forceinline__ bool owns(int c, int offset = 0) const {
    return c >= max(first, offset) && c < min(last, width - offset);
  }
  // Calls f(index in the block's row) for every reflection of column `c` at the two ends of an image row.
  template <class F>
  __device__ __forceinline__ void for_each_mirror(int c, F f) const {
    constexpr int R = K / 2;
    int const n = width - 1;
    if (c > 0 && c <= R && left == 0) f(-c);
    if (c < n && n - c <= R && 2 * n - c < left + int(blockDim.x) + R) f(2 * n - c - left);
  }
  __device__ __forceinline__ bool is_near_end(int c, int count) const {
    return c < width && (c <= K / 2 || c + count + K / 2 >= width);
  }
};

// The running sums along y of a column, for the K - 1 rows that are incomplete; a new row completes the first.
template <int M, int K>
struct RunningSums {
  float sums[M][K - 1] = {};

  __device__ __forceinline__ float add(int m, float x, float const (&weights)[K]) {
    float const complete = fmaf(weights[0], x, sums[m][0]);
#pragma unroll
    for (int t = 1; t < K; ++t) sums[m][t - 1] = t < K - 1 ? fmaf(weights[t], x, sums[m][t]) : weights[t] * x;
    return complete;
  }
};

// Four rows of M values per column.
template <int M>
using Rows = float[kRows][M][kLine];

// The sums over the windows around kRows columns; the first one is at line[m][at + Left], and `at` is a multiple of
// kRows.
template <int K, int Left, int M>
__device__ __forceinline__ void sum_across(float const (&line)[M][kLine], int at, float const (&weights)[K],
                                           float (&sums)[M][kRows]) {
  constexpr int kSkip = (Left - K / 2) % 4, kFirst = Left - K / 2 - kSkip;
#pragma unroll
  for (int m = 0; m < M; ++m)
#pragma unroll
    for (int i = 0; i < kSkip + kRows + K - 1; i += 4) {
      Vector<float, 4> const vector = *reinterpret_cast<Vector<float, 4> const*>(&line[m][at + kFirst + i]);
#pragma unroll
      for (int e = 0; e < 4; ++e)
#pragma unroll
        for (int j = 0; j < kRows; ++j) {
          int const t = i + e - kSkip - j;
          if (t == 0) sums[m][j] = weights[0] * vector.v[e];
          if (t > 0 && t < K) sums[m][j] = fmaf(weights[t], vector.v[e], sums[m][j]);
        }
    }
}

// Rows of both images in shared memory. Each group of four is copied while the one before it is processed, by vectors
// of 16 bytes. Unless all rows are made of such vectors, each comes with the bytes that precede it in its first vector.
constexpr int kPitch = kThreads * 4 + 16;  // bytes
struct alignas(16) PixelGroup {
  uint8_t pixels[2][kRows][kPitch];
  int preceding[2][kRows];
};

template <int K, bool Aligned>
struct PixelRows {
  Work<K> const& work;
  uint8_t const *x, *y;    // the vectors of row 0 that the thread copies
  uint32_t to;             // where they go in the first group
  int row, bytes, height;  // its row of a group; bytes from the vector to the end of the row
  int next, last;          // its row of the next group; rows after `last` are not needed
  int unsafe_from = 0;     // the first row whose last vector may reach behind an image

  __device__ __forceinline__ PixelRows(Work<K> const& work, BlockPosition<K> const& position, PixelGroup& group,
                                       int first, int last)
      : work(work), row(position.r), height(position.height), next(first + position.r), last(last) {
    int const size = work.stored == DType::float32 ? 4 : 2, offset = 16 / kRows * (position.x - position.left);
    bytes = min(int(blockDim.x), position.width - position.left) * size - offset;
    if (Aligned && bytes <= 0) this->last = INT_MIN;
    x = work.x.plane(position.plane) + int64_t(position.left) * size + offset;
    y = work.y.plane(position.plane) + int64_t(position.left) * size + offset;
    to = uint32_t(__cvta_generic_to_shared(&group)) + row * kPitch + offset;
    if constexpr (!Aligned) {
      auto const unsafe_row_of = [&](StoredPlanes const& image) {
        return first_unsafe_row<16>(image, image.plane(position.plane), image.width * size);
      };
      unsafe_from = min(unsafe_row_of(work.x), unsafe_row_of(work.y));
    }
  }

  // Starts the copy of the next group, to `groups[at]`.
  __device__ __forceinline__ void copy(PixelGroup* groups, int at) {
    int source_row = next;
    if (source_row < 0 || source_row >= height) source_row = border_index(work.border, source_row, height);
    bool const zero = source_row < 0, needed = next <= last;
    uint8_t const* const of_x = row_at(x, source_row, work.x_stride);
    uint8_t const* const of_y = row_at(y, source_row, work.y_stride);
    uint32_t const group = to + at * uint32_t(sizeof(PixelGroup));
    if constexpr (Aligned) {
      copy_async_if<16>(group, of_x, needed, zero);
      copy_async_if<16>(group + kRows * kPitch, of_y, needed, zero);
    } else {
      // Rows that end where an image does are copied by loads.
      auto const copy_row = [&](int image, uint8_t const* from, auto unsafe) {
        int const preceding = int(reinterpret_cast<uintptr_t>(from) % 16);
        auto const copy_vector = [&](int i) {
          int const size = bytes + preceding - i;
          uint32_t const to = group + image * kRows * kPitch + i;
          bool const enabled = needed && size > 0;
          if constexpr (!decltype(unsafe)::value)
            copy_part_async_if<16>(to, from - preceding + i, enabled, zero ? 0 : min(size, 16));
          else if (enabled)
            copy_start<8>(to, reinterpret_cast<uint16_t const*>(from - preceding + i), min(size, 16) / 2);
        };
        copy_vector(0);
        if (threadIdx.x % (blockDim.x / kRows) > 0) return;
        copy_vector(16 / kRows * int(blockDim.x));  // float32 may take one vector more than threads
        groups[at].preceding[image][row] = preceding;
      };
      if (source_row < unsafe_from) {
        copy_row(0, of_x, std::false_type{});
        copy_row(1, of_y, std::false_type{});
      } else {
        copy_row(0, of_x, std::true_type{});
        copy_row(1, of_y, std::true_type{});
      }
    }
    next += kRows;
    __pipeline_commit();
  }
  // The pixels of the thread's column; those out of bounds are undefined.
  __device__ __forceinline__ void read_column(PixelGroup const& group, float (&a)[kRows], float (&b)[kRows]) const {
    dispatch_floating_dtype(work.stored, [&](auto type) {
      using T = decltype(type);
      auto const read_at = [&](int image, int r) {
        int const preceding = Aligned ? 0 : group.preceding[image][r];
        return read(*reinterpret_cast<T const*>(group.pixels[image][r] + threadIdx.x * sizeof(T) + preceding));
      };
#pragma unroll
      for (int r = 0; r < kRows; ++r) a[r] = read_at(0, r), b[r] = read_at(1, r);
    });
  }
};

// A column of both images, read row by row; out of bounds columns read the last one, and their results are dropped.
struct Pixels {
  uint8_t const *x, *y;  // in row `next`
  int64_t const x_stride, y_stride;
  int const height, last;
  Border const border;
  DType const stored;
  int next;

  // Starts at row `first`; rows after `last` are not needed.
  template <int K>
  __device__ __forceinline__ Pixels(Work<K> const& work, BlockPosition<K> const& position, int first, int last)
      : x_stride(work.x.row_stride),
        y_stride(work.y.row_stride),
        height(position.height),
        last(last),
        border(work.border),
        stored(work.stored),
        next(first) {
    int64_t const offset = int64_t(min(position.column, position.width - 1)) * (stored == DType::float32 ? 4 : 2);
    x = work.x.plane(position.plane) + offset + first * x_stride;
    y = work.y.plane(position.plane) + offset + first * y_stride;
  }
  __device__ __forceinline__ Pixels from(int row) const {
    Pixels moved = *this;
    moved.x += (row - next) * x_stride, moved.y += (row - next) * y_stride, moved.next = row;
    return moved;
  }
  __device__ __forceinline__ void fetch(float (&a)[kRows], float (&b)[kRows]) {
    if (next >= 0 && next + kRows <= height) {
      dispatch_floating_dtype(stored, [&](auto type) {
        using T = decltype(type);
#pragma unroll
        for (int r = 0; r < kRows; ++r) {
          a[r] = read(*reinterpret_cast<T const*>(x));
          b[r] = read(*reinterpret_cast<T const*>(y));
          x += x_stride, y += y_stride;
        }
      });
      next += kRows;
      return;
    }
#pragma unroll 1
    for (int r = 0; r < kRows; ++r) {
#pragma unroll
      for (int i = 0; i + 1 < kRows; ++i) a[i] = a[i + 1], b[i] = b[i + 1];
      int const from = border_index(border, min(next, last), height);
      dispatch_floating_dtype(stored, [&](auto type) {
        using T = decltype(type);
        a[kRows - 1] = from < 0 ? 0.f : read(*reinterpret_cast<T const*>(x + (from - next) * x_stride));
        b[kRows - 1] = from < 0 ? 0.f : read(*reinterpret_cast<T const*>(y + (from - next) * y_stride));
      });
      x += x_stride, y += y_stride, ++next;
    }
  }
};

// Writes a thread's columns of a row along x, of which only those that the block owns and that are in the result.
template <int K>
__device__ __forceinline__ void write_row(Work<K> const& work, BlockPosition<K> const& position, uint8_t* row,
                                          float const (&values)[kRows]) {
  dispatch_floating_dtype(work.stored, [&](auto type) {
    using T = decltype(type);
    T* const to = reinterpret_cast<T*>(row) + (position.x - work.offset);
    if (work.vectors && position.x >= position.first && position.x + kRows <= position.last) {
      store_vector(to, values);
      return;
    }
#pragma unroll
    for (int j = 0; j < kRows; ++j)
      if (position.owns(position.x + j, work.offset)) to[j] = round_to<T>(values[j]);
  });
}

// Reads the same part of a row of gradients, which has `offset` columns less on either side; other elements stay.
template <int K>
__device__ __forceinline__ void read_row(Work<K> const& work, BlockPosition<K> const& position, uint8_t const* row,
                                         float (&values)[kRows]) {
  dispatch_floating_dtype(work.stored, [&](auto type) {
    using T = decltype(type);
    T const* const from = reinterpret_cast<T const*>(row) + (position.x - work.offset);
    if (work.vectors && position.x + kRows <= position.width) {
      auto const vector = *reinterpret_cast<Vector<T, kRows> const*>(from);
#pragma unroll
      for (int j = 0; j < kRows; ++j) values[j] = read(vector.v[j]);
      return;
    }
#pragma unroll
    for (int j = 0; j < kRows; ++j)
      if (position.x + j >= work.offset && position.x + j < position.width - work.offset) values[j] = read(from[j]);
  });
}

// Along y: adds four rows of pixels and writes the rows that they complete.
template <int K>
__device__ __forceinline__ void take_rows(float const (&xs)[kRows], float const (&ys)[kRows], Work<K> const& work,
                                          BlockPosition<K> const& position, bool near_end, RunningSums<4, K>& down,
                                          Rows<4>& rows) {
  if (position.column >= position.width) return;
  int const at = int(threadIdx.x) + K / 2;
#pragma unroll
  for (int r = 0; r < kRows; ++r) {
    float const a = xs[r], b = ys[r], d = a - b, values[4] = {a, b, fmaf(a, a, b * b), d * d};
#pragma unroll
    for (int m = 0; m < 4; ++m) rows[r][m][at] = down.add(m, values[m], work.weights);
  }
  if (near_end)
    position.for_each_mirror(position.column, [&](int to) {
#pragma unroll
      for (int r = 0; r < kRows; ++r)
#pragma unroll
        for (int m = 0; m < 4; ++m) rows[r][m][K / 2 + to] = rows[r][m][at];
    });
}

// Incomplete columns on either side of a block whose windows are applied along x once.
template <int K>
constexpr int kReach = (K / 2 + kRows - 1) / kRows * kRows;
template <int K>
constexpr int kReachOfGradients = (K - 1 + kRows - 1) / kRows * kRows;

struct ForwardRows {
  Rows<4> summed[2];  // sums along y for the means
  PixelGroup pixels[2];
};

template <int K, bool Aligned>
__global__ void __launch_bounds__(kThreads, 3) ssim_forward(__grid_constant__ Work<K> const work) {
  constexpr int R = K / 2;
  extern __shared__ __align__(16) float shared[];
  ForwardRows& memory = *reinterpret_cast<ForwardRows*>(shared);
  BlockPosition<K> const position(work, kReach<K>);
  PixelRows<K, Aligned> pixels(work, position, memory.pixels[0], position.y0 - R, position.y1 - 1 + R);
  pixels.copy(memory.pixels, 0);
  pixels.copy(memory.pixels, 1);
  for (int i = threadIdx.x; i < int(sizeof(memory.summed) / 4); i += blockDim.x) shared[i] = 0;
  RunningSums<4, K> down;
  bool const near_end = work.border == Border::reflect && position.is_near_end(position.column, 1);
  bool const owns_column = position.owns(position.column);
  bool const whole = position.owns(position.x, work.offset) && position.owns(position.x + kRows - 1, work.offset);
  uint8_t* const out = work.result.data ? work.result.plane(position.plane) : nullptr;
  float apart = 0, unlike = 0;
  __pipeline_wait_prior(1);
  __syncthreads();
#pragma unroll 1
  for (int y = position.y0 - 2 * R, now = 0; y < position.y1; y += kRows, now ^= 1) {  // y: the rows that are completed
    Rows<4>& rows = memory.summed[now];
    float a[kRows], b[kRows];
    pixels.read_column(memory.pixels[now], a, b);
    if (work.loss.absolute != 0 && owns_column) {
#pragma unroll
      for (int r = 0; r < kRows; ++r)
        if (y + R + r >= position.y0 && y + R + r < position.y1) apart += fabsf(a[r] - b[r]);
    }
    take_rows(a, b, work, position, near_end, down, rows);
    __pipeline_wait_prior(0);
    __syncthreads();
    pixels.copy(memory.pixels, now);
    int const q = y + position.r;
    if (q < max(position.y0, work.offset) || q >= min(position.y1, position.height - work.offset)) continue;
    float means[4][kRows], result[kRows];
    sum_across<K, R>(rows[position.r], position.x - position.left, work.weights, means);
#pragma unroll
    for (int j = 0; j < kRows; ++j) {
      SsimTerms<float> const terms({means[0][j], means[1][j], means[2][j], means[3][j]}, work.constants);
      result[j] = terms.numerator * fast_reciprocal(terms.denominator);
    }
    if (whole) {
      unlike += (result[0] + result[1]) + (result[2] + result[3]);
    } else {
#pragma unroll 1  // an unrolled loop would take instructions of all threads
      for (int j = 0; j < kRows; ++j)
        if (position.owns(position.x + j, work.offset))
          unlike += j == 0 ? result[0] : j == 1 ? result[1] : j == 2 ? result[2] : result[3];
    }
    if (!out) continue;
    float similarity[kRows];
#pragma unroll
    for (int j = 0; j < kRows; ++j) similarity[j] = 1 - result[j];
    write_row(work, position, out + (q - work.offset) * work.result.row_stride, similarity);
  }
  if (!out) {
    float const sum = warp_reduce(work.loss.structure * unlike + work.loss.absolute * apart, Sum());
    if (threadIdx.x % 32 == 0) work.partial[blockIdx.x * (blockDim.x / 32) + threadIdx.x / 32] = sum;
  }
}

// Shared memory of the gradient, double-buffered: everything between two barriers reads what was written before the
// first one.
template <int M>
struct GradientRows {
  Rows<4> summed[2];       // sums along y for the means
  Rows<M> derivatives[2];  // by the means
  Rows<M> across[2];       // sums of derivatives along x
};

// What a thread of the gradient does in the stages of a group of four rows.
template <int K, int M>
struct GradientStages {
  Work<K> const& work;
  BlockPosition<K> const& position;
  bool mirrored, group_near_end, special, owns_column;  // special: some columns are first or last ones of the result
  float column_scale, of_loss;
  uint8_t const* g;
  uint8_t *to_x, *to_y;

  __device__ __forceinline__ GradientStages(Work<K> const& work, BlockPosition<K> const& position)
      : work(work),
        position(position),
        mirrored(work.border == Border::reflect),
        group_near_end(mirrored && position.is_near_end(position.x, kRows)),
        special(position.x <= work.offset || position.x + kRows >= position.width - work.offset),
        owns_column(position.owns(position.column)),
        column_scale(mirrored && at_end(position.column, position.width) ? 0.5f : 1.f),
        g(work.grad.data ? work.grad.plane(position.plane) : nullptr),
        to_x(work.result.plane(position.plane)),
        to_y(M == 4 ? work.other_result.plane(position.plane) : nullptr) {
    of_loss = g ? 0.f : work.of_loss[position.plane / work.loss.planes];
  }
  static __device__ __forceinline__ bool at_end(int i, int n) { return i == 0 || i == n - 1; }

  // The derivatives by the means in row q, from the sums along y.
  __device__ __forceinline__ void differentiate(int q, float const (&summed)[4][kLine],
                                                float (&derivatives)[M][kLine]) const {
    int const width = position.width, height = position.height;
    int const from = border_index(work.border, q, height), at = position.x - position.left;
    float result[M][kRows] = {};
    if (from >= work.offset && from < height - work.offset) {
      float means[4][kRows], of_pixels[kRows];
      sum_across<K, K / 2>(summed, at, work.weights, means);
#pragma unroll
      for (int j = 0; j < kRows; ++j) of_pixels[j] = -work.loss.structure * of_loss;
      if (g) read_row(work, position, g + (from - work.offset) * work.grad.row_stride, of_pixels);
      float const twice = mirrored && at_end(q, height) ? 2.f : 1.f;
#pragma unroll
      for (int j = 0; j < kRows; ++j) {
        Means<float> const m{means[0][j], means[1][j], means[2][j], means[3][j]};
        SsimTerms<float> const terms(m, work.constants);
        Means<float> const d = ssim_of_means_vjp(m, terms, fast_reciprocal(terms.denominator), twice * of_pixels[j],
                                                 work.constants.luminance);
        result[0][j] = d.x, result[1][j] = d.squares, result[2][j] = d.apart;
        if (M == 4) result[M - 1][j] = d.y;
      }
      if (special)
#pragma unroll
        for (int j = 0; j < kRows; ++j) {
          int const x = position.x + j;
          float const scale = mirrored && at_end(x, width) ? 2.f : 1.f;
          bool const in_bounds = x >= work.offset && x < width - work.offset;
#pragma unroll
          for (int m = 0; m < M; ++m) result[m][j] = in_bounds ? scale * result[m][j] : 0.f;
        }
    }
#pragma unroll
    for (int m = 0; m < M; ++m)
      if (position.x + kRows <= width)
        *reinterpret_cast<Vector<float, 4>*>(&derivatives[m][at + kReach<K>]) = {result[m][0], result[m][1],
                                                                                 result[m][2], result[m][3]};
      else
#pragma unroll
        for (int j = 0; j < kRows; ++j)
          if (position.x + j < width) derivatives[m][at + kReach<K> + j] = result[m][j];
    if (group_near_end)
#pragma unroll
      for (int j = 0; j < kRows; ++j)
        if (position.x + j < width)
          position.for_each_mirror(position.x + j, [&](int to) {
#pragma unroll
            for (int m = 0; m < M; ++m) derivatives[m][kReach<K> + to] = result[m][j];
          });
  }

  // Rows of the gradients from y on, from the pixels and from the sums along x of the derivatives in the rows that
  // complete them.
  __device__ __forceinline__ void finish(int y, float (&a)[kRows], float (&b)[kRows], Rows<M> const& across,
                                         RunningSums<M, K>& back_down) const {
    int const height = position.height, y0 = position.y0, y1 = position.y1;
    float signs[kRows] = {};
    if (work.loss.absolute != 0) {
#pragma unroll
      for (int r = 0; r < kRows; ++r) {
        float const d = a[r] - b[r];
        signs[r] = work.loss.absolute * of_loss * (d > 0 ? 1.f : d < 0 ? -1.f : d);
      }
    }
#pragma unroll
    for (int r = 0; r < kRows; ++r) {
      float gradients[M];
#pragma unroll
      for (int m = 0; m < M; ++m) gradients[m] = back_down.add(m, across[r][m][threadIdx.x], work.weights);
      float const d = a[r] - b[r];
      a[r] = fmaf(d, gradients[2], fmaf(a[r], gradients[1], gradients[0]));
      if (M == 4) b[r] = fmaf(-d, gradients[2], fmaf(b[r], gradients[1], gradients[M - 1]));
    }
    if (mirrored && (column_scale != 1 || y <= 0 || y + kRows >= height)) {
#pragma unroll
      for (int r = 0; r < kRows; ++r) {
        float const scale = at_end(y + r, height) ? 0.5f * column_scale : column_scale;
        a[r] *= scale, b[r] *= scale;
      }
    }
#pragma unroll
    for (int r = 0; r < kRows; ++r) a[r] += signs[r], b[r] -= signs[r];
    if (!owns_column) return;
    dispatch_floating_dtype(work.stored, [&](auto type) {
      using T = decltype(type);
      uint8_t *x = to_x + y * work.result.row_stride + position.column * sizeof(T),
              *other = to_y + y * work.other_result.row_stride + position.column * sizeof(T);
      auto const store = [&](float a, float b) {
        *reinterpret_cast<T*>(x) = round_to<T>(a);
        if (M == 4) *reinterpret_cast<T*>(other) = round_to<T>(b);
      };
      if (y >= y0 && y + kRows <= y1) {
#pragma unroll
        for (int r = 0; r < kRows; ++r) {
          store(a[r], b[r]);
          x += work.result.row_stride, other += work.other_result.row_stride;
        }
        return;
      }
#pragma unroll 1
      for (int r = 0; r < kRows; ++r) {
        if (y + r >= y0 && y + r < y1) store(a[0], b[0]);
#pragma unroll
        for (int i = 0; i + 1 < kRows; ++i) a[i] = a[i + 1], b[i] = b[i + 1];
        x += work.result.row_stride, other += work.other_result.row_stride;
      }
    });
  }

  // The sums of derivatives along x.
  __device__ __forceinline__ void sum_derivatives(float const (&derivatives)[M][kLine],
                                                  float (&across)[M][kLine]) const {
    int const at = position.x - position.left;
    float sums[M][kRows];
    sum_across<K, kReach<K>>(derivatives, at, work.weights, sums);
#pragma unroll
    for (int m = 0; m < M; ++m)
      *reinterpret_cast<Vector<float, 4>*>(&across[m][at]) = {sums[m][0], sums[m][1], sums[m][2], sums[m][3]};
  }
};

// M: 3 for the gradient of x, 4 for both. Groups of four rows are pipelined through the stages: while one group is in
// the first stage, the previous group is in the second one.
template <int K, int M>
__global__ void __launch_bounds__(kThreads, 2) ssim_gradients(__grid_constant__ Work<K> const work) {
  constexpr int R = K / 2;
  extern __shared__ __align__(16) float shared[];
  GradientRows<M>& memory = *reinterpret_cast<GradientRows<M>*>(shared);
  for (int i = threadIdx.x; i < int(sizeof(memory) / 4); i += blockDim.x) shared[i] = 0;
  __syncthreads();
  BlockPosition<K> const position(work, kReachOfGradients<K>);
  int const y0 = position.y0, y1 = position.y1;
  Pixels pixels(work, position, y0 - 2 * R, y1 - 1 + 2 * R);
  RunningSums<4, K> down;
  RunningSums<M, K> back_down;
  GradientStages<K, M> const stages(work, position);
  bool const near_end = stages.mirrored && position.is_near_end(position.column, 1);

  float a[kRows], b[kRows];
  pixels.fetch(a, b);
  int const steps = (y1 - y0 + 4 * R + kRows - 1) / kRows;
#pragma unroll 1
  for (int i = 0; i < steps + 3; ++i) {
    // The first row of means enters the first stage. Rows before y0 - R are not needed, and their results are never
    // read.
    int const q = y0 - 3 * R + kRows * i, now = i % 2, before = 1 - now;
    int const complete = q - 3 * kRows - R;
    float own_a[kRows], own_b[kRows];
    if (complete + kRows > y0 - 2 * R) pixels.from(complete).fetch(own_a, own_b);
    if (i < steps) take_rows<K>(a, b, work, position, near_end, down, memory.summed[now]);
    if (complete + kRows > y0 - 2 * R) stages.finish(complete, own_a, own_b, memory.across[before], back_down);
    if (i + 1 < steps) pixels.fetch(a, b);
    auto const is_needed = [&](int row) { return row >= y0 - R && row < y1 + R; };
    if (int const row = q - kRows + position.r; is_needed(row))
      stages.differentiate(row, memory.summed[before][position.r], memory.derivatives[before][position.r]);
    if (int const row = q - 2 * kRows + position.r; is_needed(row))
      stages.sum_derivatives(memory.derivatives[now][position.r], memory.across[now][position.r]);
    __syncthreads();
  }
}

// Whether all rows of images are aligned to vectors.
template <class T>
bool has_vectors(Planes<T> const& p) {
  constexpr int64_t size = sizeof(T), bytes = kRows * size;
  return reinterpret_cast<uintptr_t>(p.data) % bytes == 0 && p.outer_stride * size % bytes == 0 &&
         p.inner_stride * size % bytes == 0 && p.row_stride * size % bytes == 0;
}

template <int K, class T>
Work<K> work_of(SsimImages<T> const& images, ColumnGrid const& grid) {
  Work<K> work{};
  work.x = stored_planes(images.x), work.y = stored_planes(images.y);
  work.x_stride = int(work.x.row_stride), work.y_stride = int(work.y.row_stride);
  work.border = images.border, work.offset = images.valid ? K / 2 : 0;
  work.stored = kDType<T>;
  work.constants = images.constants;
  work.across = grid.across, work.down = grid.down, work.rows = grid.rows;
  for (int t = 0; t < K; ++t) work.weights[t] = images.weights[t];
  return work;
}

// Calls f with whether all rows of the images are vectors of 16 bytes, as a constant.
template <class T, class F>
int with_aligned_rows(SsimImages<T> const& p, F f) {
  constexpr int kSize = 16 / sizeof(T);
  return is_vectorizable<kSize>(p.x) && is_vectorizable<kSize>(p.y) ? f(std::true_type{}) : f(std::false_type{});
}

template <int K>
int run(void (*kernel)(Work<K>), int bytes, Work<K> const& work, ColumnGrid const& grid, CUstream_st* stream) {
  if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes)) return error;
  kernel<<<grid.blocks, grid.columns, bytes, stream>>>(work);
  return cudaGetLastError();
}

template <int K, class T>
int launch(Ssim<T> const& p, CUstream_st* stream) {
  Planes<T const> const& x = p.images.x;
  ColumnGrid const grid(x.count(), x.height, x.width, kThreads, kReach<K>, K - 1, 3, sizeof(ForwardRows));
  Work<K> work = work_of<K>(p.images, grid);
  work.result = stored_planes(p.similarity), work.vectors = work.offset == 0 && has_vectors(p.similarity);
  work.loss = p.loss, work.partial = p.partial;
  if (int const error = with_aligned_rows(p.images, [&](auto aligned) {
        return run(ssim_forward<K, aligned.value>, sizeof(ForwardRows), work, grid, stream);
      }))
    return error;
  if (p.similarity.data) return 0;
  int64_t const rows = x.count() / p.loss.planes, chunks = grid.blocks / rows * (grid.columns / 32);
  return sum_chunks(p.partial, rows, chunks, p.sums, stream);
}

template <int K, class T>
int launch(SsimBackward<T> const& p, CUstream_st* stream) {
  Planes<T const> const& x = p.images.x;
  ColumnGrid const grid(x.count(), x.height, x.width, kThreads, kReachOfGradients<K>, 2 * K + 10, 2,
                        sizeof(GradientRows<3>));
  Work<K> work = work_of<K>(p.images, grid);
  work.result = stored_planes(p.grad_x), work.other_result = stored_planes(p.grad_y);
  work.grad = stored_planes(p.grad), work.vectors = work.offset == 0 && has_vectors(p.grad);
  work.loss = p.loss, work.of_loss = p.of_loss;
  return p.grad_y.data ? run(ssim_gradients<K, 4>, sizeof(GradientRows<4>), work, grid, stream)
                       : run(ssim_gradients<K, 3>, sizeof(GradientRows<3>), work, grid, stream);
}

static_assert(sizeof(ForwardRows) <= kSsimStripBytes[0] && sizeof(GradientRows<3>) <= kSsimStripBytes[1] &&
              sizeof(GradientRows<4>) <= kSsimStripBytes[2]);

// One kernel per window size; float64 takes other kernels.
template <class T, class Params>
int launch_size(Params const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) < 8) {
    switch (p.images.size) {
      case 3:
        return launch<3>(p, stream);
      case 5:
        return launch<5>(p, stream);
      case 7:
        return launch<7>(p, stream);
      case 9:
        return launch<9>(p, stream);
      case 11:
        return launch<11>(p, stream);
    }
  }
  return cudaErrorInvalidValue;
}

}  // namespace

template <class T>
int ssim(Ssim<T> const& p, CUstream_st* stream) {
  if (has_ssim_strips(p.images, 0)) return launch_size<T>(p, stream);
  if (has_ssim_tiles(p.images)) return ssim_in_tiles(p, stream);
  return has_ssim_volume_tiles(p.images) ? ssim_of_volumes(p, stream) : ssim_any(p, stream);
}

template <class T>
int ssim_backward(SsimBackward<T> const& p, CUstream_st* stream) {
  if (has_ssim_strips(p.images, p.grad_y.data ? 2 : 1)) return launch_size<T>(p, stream);
  if (has_ssim_tiles(p.images)) return ssim_in_tiles_backward(p, stream);
  return has_ssim_volume_tiles(p.images) ? ssim_of_volumes_backward(p, stream) : ssim_any_backward(p, stream);
}

KV_INSTANTIATE(ssim, Ssim)
KV_INSTANTIATE(ssim_backward, SsimBackward)

}  // namespace kv::metrics::cuda
