// Differences of two Gaussian blurs on CUDA.
//
// A block goes down its columns, four rows at a time. A thread has four columns, and the rows of their windows along y
// in registers. Both blurs weight the same sums of two pixels at equal distances. Their rows go to shared memory, from
// where the windows along x read the columns of adjacent threads.
//
// Along x the columns of a thread are adjacent. Along y they are so where rows are vectors. Otherwise they are every
// 32nd column of its warp, so that adjacent threads access adjacent pixels wherever rows begin.
#include "core/with_constant.cuh"
#include "responses.cuh"

namespace kv::feature::cuda {
namespace {

constexpr int R = kCoarseReach, P = kColumns;
constexpr int kRows = 4;    // completed together
constexpr int kReach = 8;   // columns of a block that are incomplete on either side
constexpr int kBlocks = 8;  // of a multiprocessor
constexpr int kApart = 32;  // columns of a thread along y, unless rows are vectors

// The weights at distances along an axis. In the transpose the first and the last pixel of an axis are multiplied by
// `end_in` before the windows and by `end_out` after them.
template <class F>
struct Blurs {
  F fine[kFineReach + 1], coarse[kCoarseReach + 1];
  bool transposed;
  static constexpr F end_in = 2, end_out = F(0.5);
};

// Rows of both blurs in shared memory, and one of results. Four columns of all lines are adjacent, in an odd number of
// vectors: threads access vectors of a line, or single elements, in different banks, and the size is proportional to
// the number of columns.
template <class F>
struct RowGroup {
  static constexpr int kFine = 0, kCoarse = kRows, kResult = 2 * kRows, kLines = kResult + 1;  // their first lines
  F* const memory;

  // Elements to the same line `columns` further, a multiple of four.
  static constexpr __host__ __device__ int distance(int columns) { return columns * kLines; }
  __device__ __forceinline__ F* at(int line, int column, int further = 0) const {
    return memory + (unsigned(column) / P * kLines * P + unsigned(column) % P) + (line * P + distance(further));
  }
  // N columns from `further` after `column` on, multiples of four.
  template <int N>
  __device__ __forceinline__ void read_window(int line, int column, int further, F (&v)[N]) const {
#pragma unroll
    for (int i = 0; i < N; i += P) {
      auto const vector = *reinterpret_cast<Vector<F, P> const*>(at(line, column, further + i));
#pragma unroll
      for (int e = 0; e < P; ++e) v[i + e] = vector.v[e];
    }
  }
  __device__ __forceinline__ void write_vector(int line, int column, F const (&v)[P]) const {
    *reinterpret_cast<Vector<F, P>*>(at(line, column, kReach)) = {v[0], v[1], v[2], v[3]};
  }
};

// The sums of two pixels at distances up to `Reach` from a pixel, itself at distance 0; at(i) is the pixel i further.
template <int Reach, class F, class At>
__device__ __forceinline__ void pairs_around(At at, F (&pairs)[Reach + 1]) {
  pairs[0] = at(0);
#pragma unroll
  for (int d = 1; d <= Reach; ++d) pairs[d] = at(-d) + at(d);
}
template <int N, int M, class F>
__device__ __forceinline__ F weighted_sum(F const (&weights)[N], F const (&pairs)[M]) {
  F sum = weights[0] * pairs[0];
#pragma unroll
  for (int d = 1; d < N; ++d) sum += weights[d] * pairs[d];
  return sum;
}

__device__ __forceinline__ bool is_end(int i, int n) { return i == 0 || i == n - 1; }

// The columns of a thread along y, from column `at` of the block on.
template <bool Vectors>
struct ColumnsDown {
  int const at, x, width;

  __device__ __forceinline__ explicit ColumnsDown(ColumnPosition const& p)
      : at(Vectors ? p.at : p.at - (P - 1) * int(threadIdx.x % 32)), x(p.left + at), width(p.width) {}

  __device__ __forceinline__ bool exist() const { return x < width; }  // some of them
  // Writes those that are not out of bounds to shared memory.
  template <class F>
  __device__ __forceinline__ void write(RowGroup<F> rows, int line, F const (&v)[P]) const {
    if constexpr (Vectors) {
      rows.write_vector(line, at, v);
    } else {
#pragma unroll
      for (int j = 0; j < P; ++j)
        if (x + kApart * j < width) *rows.at(line, at, kReach + kApart * j) = v[j];
    }
  }
  template <class F>
  __device__ __forceinline__ void read(RowGroup<F> rows, int line, F (&v)[P]) const {
#pragma unroll
    for (int j = 0; j < P; ++j) v[j] = *rows.at(line, at, kReach + kApart * j);
  }
};

// The ends of a row of the image, as far as a warp has them. After the threads of a warp have written their columns to
// shared memory, they write those near an end to the columns out of bounds: a thread has a row and a distance.
struct WarpEnds {
  int const last;  // the last column of the image, in the block
  bool const has_first, is_near_last;

  __device__ __forceinline__ explicit WarpEnds(ColumnPosition const& p)
      : last(p.width - 1 - p.left),
        has_first(p.left == 0 && threadIdx.x < 32),
        is_near_last(last < p.columns && begin() <= last && last - R < begin() + 32 * P) {}

  static __device__ __forceinline__ int begin() { return int(threadIdx.x) / 32 * (32 * P); }
  static __device__ __forceinline__ bool contains(int column) { return unsigned(column - begin()) < unsigned(32 * P); }

  // Multiplies the first and the last column by `factor`, unless it is 1, before it reflects the others.
  template <class F>
  __device__ __forceinline__ void reflect(RowGroup<F> rows, F factor) const {
    if (!has_first && !is_near_last) return;
    int const row = threadIdx.x % 32 / 8, d = threadIdx.x % 8;
    auto const for_both_blurs = [&](auto f) { f(rows.kFine + row), f(rows.kCoarse + row); };
    __syncwarp();
    if (factor != 1) {
      if (d == 0 && has_first) for_both_blurs([&](int line) { *rows.at(line, kReach) *= factor; });
      if (d == 0 && contains(last)) for_both_blurs([&](int line) { *rows.at(line, kReach + last) *= factor; });
      __syncwarp();
    }
    if (d == 0 || d > R) return;
    if (has_first) for_both_blurs([&](int line) { *rows.at(line, kReach - d) = *rows.at(line, kReach + d); });
    if (is_near_last && contains(last - d))
      for_both_blurs([&](int line) { *rows.at(line, kReach + last + d) = *rows.at(line, kReach + last - d); });
  }
};

// The pixels of these columns in one plane. It refers to the arguments of the kernel, which are constants and cost no
// registers.
template <class F, bool Vectors>
struct StoredColumns {
  Work<F> const& work;
  StoredPlanes const& planes;
  int const x;
  bool const are_adjacent;  // all pixels of the warp, which are in bounds
  uint8_t* const first;     // in row 0

  __device__ __forceinline__ StoredColumns(Work<F> const& work, StoredPlanes const& planes, int64_t plane, int x)
      : work(work),
        planes(planes),
        x(x),
        are_adjacent(Vectors || (x - int(threadIdx.x % 32) + 32 * P <= width() && planes.step == size_of(work.stored))),
        first(planes.plane(plane) + in_bounds(x) * planes.step) {}

  __device__ __forceinline__ int width() const { return int(work.x.width); }
  __device__ __forceinline__ int in_bounds(int x) const { return min(x, width() - (Vectors ? P : 1)); }
  __device__ __forceinline__ uint8_t* row(int y) const { return first + y * planes.row_stride; }

  // Starts to read `Rows` rows, of which row i begins at address_of(i). Until they are converted, values_of(i) has the
  // bits that are stored: converting them here would wait for them.
  template <int Rows, class AddressOf, class ValuesOf>
  __device__ __forceinline__ void fetch_rows(AddressOf address_of, ValuesOf values_of) const {
    auto const fetch = [&](auto type) {
      using T = decltype(type);
      auto const adjacent = [](int j) { return kApart * j * int(sizeof(T)); };
      auto const in_other_layouts = [&](int j) { return (in_bounds(x + kApart * j) - in_bounds(x)) * planes.step; };
      if (are_adjacent) {
#pragma unroll
        for (int i = 0; i < Rows; ++i) fetch_at<T>(address_of(i), values_of(i), adjacent);
      } else {
#pragma unroll
        for (int i = 0; i < Rows; ++i) fetch_at<T>(address_of(i), values_of(i), in_other_layouts);
      }
    };
    if (sizeof(F) == 8 || work.stored == DType::float32)
      fetch(F{});
    else
      fetch(uint16_t{});
  }
  template <int Rows, class ValuesOf>
  __device__ __forceinline__ void convert_rows(ValuesOf values_of) const {
    if constexpr (sizeof(F) == 4)
      if (work.stored != DType::float32)
        dispatch_floating_dtype(work.stored, [&](auto type) {
          using T = decltype(type);
          if constexpr (sizeof(T) == 2) {
#pragma unroll
            for (int i = 0; i < Rows; ++i) convert<T>(values_of(i));
          }
        });
  }
  // Writes the columns that the block owns.
  __device__ __forceinline__ void write(ColumnPosition const& position, uint8_t* at, F const (&values)[P]) const {
    dispatch_floating_dtype<F>(work.stored, [&](auto type) {
      using T = decltype(type);
      if constexpr (Vectors) {
        if (position.owns(x)) store_vector(reinterpret_cast<T*>(at), values);
      } else {
        auto const write_if_owned = [&](int j, int64_t ahead) {
          if (position.owns(x + kApart * j)) *reinterpret_cast<T*>(at + ahead) = round_to<T>(values[j]);
        };
        if (are_adjacent) {
#pragma unroll
          for (int j = 0; j < P; ++j) write_if_owned(j, kApart * j * int(sizeof(T)));
        } else {
#pragma unroll
          for (int j = 0; j < P; ++j) write_if_owned(j, kApart * j * planes.step);
        }
      }
    });
  }

 private:
  template <class T, class BytesAhead>
  __device__ __forceinline__ void fetch_at(uint8_t const* at, F (&values)[P], BytesAhead bytes_ahead) const {
    if constexpr (Vectors) {
      constexpr int kWords = P * sizeof(T) / sizeof(F);
      auto const words = *reinterpret_cast<Vector<F, kWords> const*>(at);
#pragma unroll
      for (int j = 0; j < kWords; ++j) values[j] = words.v[j];
    } else {
#pragma unroll
      for (int j = 0; j < P; ++j) {
        T const bits = *reinterpret_cast<T const*>(at + bytes_ahead(j));
        if constexpr (sizeof(T) == sizeof(F))
          values[j] = bits;
        else
          values[j] = bits_to_float(bits);
      }
    }
  }
  template <class T>
  __device__ __forceinline__ void convert(F (&values)[P]) const {
    T pixels[P];
#pragma unroll
    for (int j = 0; j < P; ++j)
      pixels[j].bits =
          Vectors ? uint16_t(float_to_bits(values[j / 2]) >> 16 * (j % 2)) : uint16_t(float_to_bits(values[j]));
#pragma unroll
    for (int j = 0; j < P; ++j) values[j] = kv::read(pixels[j]);
  }
};

// The rows of a thread's columns that windows along y read, for groups of kRows rows that are completed together. New
// rows take the registers of the oldest ones, so that no register moves.
template <class F, bool Vectors>
struct RowRing {
  static constexpr int kSize = kRows + 2 * R, kTurns = kSize / kRows;
  static_assert(kSize % kRows == 0);
  StoredColumns<F, Vectors> const columns;
  F const end;  // factor of the first and the last row of the image
  int next, turn = 0;
  F rows[kSize][P];

  // The first group begins with row `y`.
  __device__ __forceinline__ RowRing(Work<F> const& work, int64_t plane, int x, int y, F end)
      : columns(work, work.x, plane, x), end(end), next(y + R) {
    fetch<kSize, 0>(y - R);
    finish<2 * R, 0>(y - R);
  }
  // Calls use(row) for a group, where row(i) is row i of its windows. Starts to read the rows of the next one if
  // `more`.
  template <class Use>
  __device__ __forceinline__ void advance(bool more, Use use) {
    with_constant<kTurns>(turn, [&](auto turn) {
      constexpr int kFirst = kRows * decltype(turn)::value;
      finish<kRows, kFirst + 2 * R>(next);
      use([&](int i) -> F(&)[P] { return rows[(kFirst + i) % kSize]; });
      if (more) fetch<kRows, kFirst>(next + kRows);
    });
    next += kRows;
    turn = turn + 1 == kTurns ? 0 : turn + 1;
  }

 private:
  __device__ __forceinline__ int height() const { return int(columns.work.x.height); }
  __device__ __forceinline__ int source(int y) const { return border_index(Border::reflect, y, height()); }

  // N rows from `y` on, from index `First` of the ring on.
  template <int N, int First>
  __device__ __forceinline__ void fetch(int y) {
    auto const values_of = [&](int i) -> F(&)[P] { return rows[(First + i) % kSize]; };
    if (y > 0 && y + N < height()) {
      uint8_t const* const at = columns.row(y);
      columns.template fetch_rows<N>([&](int i) { return at + i * columns.planes.row_stride; }, values_of);
    } else {
      columns.template fetch_rows<N>([&](int i) { return columns.row(source(y + i)); }, values_of);
    }
  }
  template <int N, int First>
  __device__ __forceinline__ void finish(int y) {
    auto const values_of = [&](int i) -> F(&)[P] { return rows[(First + i) % kSize]; };
    columns.template convert_rows<N>(values_of);
    if (end != 1 && (y <= 0 || y + N >= height()))
#pragma unroll
      for (int i = 0; i < N; ++i)
        if (is_end(source(y + i), height()))
#pragma unroll
          for (int j = 0; j < P; ++j) values_of(i)[j] *= end;
  }
};

template <class F, bool Vectors>
__global__ void __launch_bounds__(kColumnThreads<F>, kBlocks)
    difference(__grid_constant__ Work<F> const work, __grid_constant__ Blurs<F> const blurs) {
  extern __shared__ __align__(16) unsigned char memory[];
  ColumnPosition const position(work, kReach, int(blockDim.x), int(threadIdx.x));
  int const height = position.height, width = position.width, y1 = position.y1;
  ColumnsDown<Vectors> const columns(position);
  StoredColumns<F, Vectors> const results(work, work.result, position.plane, columns.x);
  bool const transposed = blurs.transposed;
  // Unless rows are vectors, the threads of a warp exchange their results.
  bool const writes = Vectors ? position.owns_some() : __any_sync(0xffffffffu, position.owns_some());
  auto const group = [&](int i) {
    return RowGroup<F>{reinterpret_cast<F*>(memory) + i * RowGroup<F>::distance(position.columns + 2 * kReach)};
  };

  WarpEnds const ends(position);
  F const end_in = transposed ? blurs.end_in : F(1);
  RowRing<F, Vectors> ring(work, position.plane, columns.x, position.y0, end_in);
  uint8_t* out = results.row(position.y0);
  int now = 0;
#pragma unroll 1
  for (int y = position.y0; y < y1; y += kRows, now ^= 1) {
    RowGroup<F> const rows = group(now);
    ring.advance(y + kRows < y1, [&](auto row) {
      if (!columns.exist()) return;
#pragma unroll
      for (int r = 0; r < kRows; ++r) {
        F fine[P], coarse[P];
#pragma unroll
        for (int j = 0; j < P; ++j) {
          F pairs[R + 1];
          pairs_around<R>([&](int i) { return row(r + R + i)[j]; }, pairs);
          fine[j] = weighted_sum(blurs.fine, pairs);
          coarse[j] = weighted_sum(blurs.coarse, pairs);
        }
        columns.write(rows, rows.kFine + r, fine);
        columns.write(rows, rows.kCoarse + r, coarse);
      }
    });
    ends.reflect(rows, end_in);
    __syncthreads();

    if (writes) {
#pragma unroll
      for (int r = 0; r < kRows; ++r) {
        F along_fine[P + 2 * 4], along_coarse[P + 2 * kReach], result[P];
        rows.read_window(rows.kCoarse + r, position.at, 0, along_coarse);
        rows.read_window(rows.kFine + r, position.at, kReach - 4, along_fine);
#pragma unroll
        for (int j = 0; j < P; ++j) {
          F coarse_pairs[kCoarseReach + 1], fine_pairs[kFineReach + 1];
          pairs_around<kCoarseReach>([&](int i) { return along_coarse[kReach + j + i]; }, coarse_pairs);
          pairs_around<kFineReach>([&](int i) { return along_fine[4 + j + i]; }, fine_pairs);
          result[j] = weighted_sum(blurs.coarse, coarse_pairs);
#pragma unroll
          for (int d = 0; d <= kFineReach; ++d) result[j] -= blurs.fine[d] * fine_pairs[d];
        }
        if (transposed)
#pragma unroll
          for (int j = 0; j < P; ++j)
            result[j] *=
                (is_end(y + r, height) ? blurs.end_out : F(1)) * (is_end(position.x + j, width) ? blurs.end_out : F(1));
        if constexpr (!Vectors) {
          // Two lines take turns: a warp that writes to one has read the other.
          RowGroup<F> const lines = group(r % 2);
          lines.write_vector(lines.kResult, position.at, result);
          __syncwarp();
          columns.read(lines, lines.kResult, result);
        }
        if (y + r < y1) results.write(position, out, result);
        out += work.result.row_stride;
      }
    }
  }
}

}  // namespace

template <class T>
int difference_of_gaussians(DifferenceOfGaussians<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  Blurs<F> blurs{{}, {}, p.transposed};
  for (int d = 0; d <= kFineReach; ++d) blurs.fine[d] = p.fine[d];
  for (int d = 0; d <= kCoarseReach; ++d) blurs.coarse[d] = p.coarse[d];
  return run(difference<F, false>, difference<F, kHasVectors<F>>, work_of(p), 1, kReach, R, kBlocks, kRows,
             2 * RowGroup<F>::distance(1) * sizeof(F), stream, blurs);
}

KV_INSTANTIATE(difference_of_gaussians, DifferenceOfGaussians)

}  // namespace kv::feature::cuda
