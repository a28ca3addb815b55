// Sums of Gaussians on the CPU. Compiled once per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "histogram.h"

namespace kv::enhance::KV_ISA {
namespace {

constexpr int kChunk = 512, kMaxCells = 1 << 16;
constexpr int64_t kFewSamples = 256;  // rows this short take less time without cells

// One pass over all samples for each center.
template <class T>
KV_HD void count_directly(Histogram<T> const& p, T const* x, T const* centers, T h, T* counts) {
  for (int64_t k = 0; k < p.bins; ++k) {
    T const center = centers[k];
    double total = 0;
    auto const gaussian = [&](auto width, int64_t i) {
      constexpr int N = decltype(width)::value;
      Lanes<T, N> const v = load<N>(x + i), u = (v - center) / h, g = vexp2<T, N>(u * u * T(-kHalfLog2E));
      return v == v ? g : broadcast<N>(T(0));
    };
    constexpr int N = kLanes<T>;
    int64_t i = 0;
    while (i + N <= p.samples) {
      Lanes<T, N> sum{};
      for (int64_t const end = min(i + 64 * N, p.samples); i + N <= end; i += N) sum = sum + gaussian(Width<N>{}, i);
      for (int k = 0; k < N; ++k) total += sum[k];
    }
    for (; i < p.samples; ++i) total += gaussian(Width<1>{}, i);
    counts[k] = T(total);
  }
}

// The cells of n <= kChunk samples and the offsets within them; samples outside the grid get the cell after the last
// one.
KV_HD void cells_of(MomentGrid const& grid, float const* x, int64_t n, int32_t* cell, float* t) {
  for_each_vector<float>(0, n, [&](auto width, int64_t i) {
    constexpr int N = decltype(width)::value;
    using V = Lanes<float, N>;
    V const position = load<N>(x + i) * grid.inverse, whole = vfloor(position), at = whole - float(grid.first);
    auto const inside = (at >= 0) & (at < float(grid.cells));
    V const cell_or_end = inside ? at : broadcast<N>(float(grid.cells));
    store<N>(t + i, inside ? V(position - whole - 0.5f) : broadcast<N>(0.f));
    if constexpr (N == 1)
      cell[i] = int32_t(cell_or_end);
    else
      write_lanes<N>(cell + i, __builtin_convertvector(cell_or_end, Lanes<int32_t, N>));
  });
}

// Adds samples to the moments of their cells; a cell's four moments are adjacent.
KV_HD void add_moments(MomentGrid const& grid, float const* x, int64_t n, float* moments) {
  int32_t cell[kChunk];
  float t[kChunk];
  for (int64_t begin = 0; begin < n; begin += kChunk) {
    int64_t const count = min(int64_t(kChunk), n - begin);
    cells_of(grid, x + begin, count, cell, t);
    for (int64_t i = 0; i < count; ++i) {
      float* const to = moments + 4 * cell[i];
      float const square = t[i] * t[i];
      store<4>(to, load<4>(to) + Lanes<float, 4>{1, t[i], square, square * t[i]});
    }
  }
}

KV_HD void count_cells(MomentGrid const& grid, float const* const (&m)[4], float const* centers, int64_t bins,
                       double* counts) {
  constexpr int N = kLanes<float>;
  using V = Lanes<float, N>;
  float const per = 1 / grid.bandwidth, w = grid.width * per;
  V step;
  for (int i = 0; i < N; ++i) step[i] = float(i) * grid.width;
  for (int64_t k = 0; k < bins; ++k) {
    V sum{};
    for (int i = grid.begin(centers[k]), end = grid.end(centers[k]); i < end;
         i += N) {  // cells out of reach add next to nothing
      V const u = (step + (grid.middle(i) - centers[k])) * per;
      sum = sum + vexp2<float, N>(u * u * float(-kHalfLog2E)) *
                      weighted(u, w, load<N>(m[0] + i), load<N>(m[1] + i), load<N>(m[2] + i), load<N>(m[3] + i));
    }
    for (int i = 0; i < N; ++i) counts[k] += sum[i];
  }
}

// The grid of a row; it has no cells if they do not fit or do not pay off.
KV_HD MomentGrid grid_of(Histogram<float> const& p, float const* centers, float h) {
  float lowest = centers[0], highest = centers[0];
  bool useful = p.samples > kFewSamples;
  for (int64_t k = 0; k < p.bins; ++k) {
    useful = useful && centers[k] - centers[k] == 0;
    lowest = centers[k] < lowest ? centers[k] : lowest;
    highest = centers[k] > highest ? centers[k] : highest;
  }
  return MomentGrid(lowest, highest, h, useful ? kMaxCells : 0);
}

// Four numbers for every cell, for the one after the last, and for a vector that extends beyond it; initially zero.
struct CellMemory {
  int64_t size;
  Scratch<float> memory;
  KV_HD CellMemory(MomentGrid const& grid) : size(grid.cells + 1 + kLanes<float>), memory(4 * size) { clear(); }
  KV_HD void clear() const {
    for (int64_t i = 0; i < 4 * size; ++i) memory.data[i] = 0;
  }
  KV_HD float* apart(int kind) const { return memory.data + kind * size; }
};

KV_HD void count_by_cells(Histogram<float> const& p, MomentGrid const& grid, float const* x, float const* centers,
                          float* counts) {
  CellMemory const moments(grid), apart(grid);
  Scratch<double> const sums(p.bins);
  for (int64_t k = 0; k < p.bins; ++k) sums.data[k] = 0;
  float* const m[4] = {apart.apart(0), apart.apart(1), apart.apart(2), apart.apart(3)};
  for (int64_t i = 0; i < p.samples; i += kMaxSamples) {
    if (i > 0) moments.clear();
    add_moments(grid, x + i, min(int64_t(kMaxSamples), p.samples - i), moments.memory.data);
    for (int64_t k = 0; k < grid.cells; ++k)
      for (int j = 0; j < 4; ++j) m[j][k] = moments.memory.data[4 * k + j];
    count_cells(grid, m, centers, p.bins, sums.data);
  }
  for (int64_t k = 0; k < p.bins; ++k) counts[k] = float(sums.data[k]);
}

// One pass over all centers for each sample.
template <class T>
KV_HD void differentiate_directly(Histogram<T> const& p, T const* x, T const* centers, T h, T const* grad, T* grad_x) {
  for_each_vector<T>(0, p.samples, [&](auto width, int64_t i) {
    constexpr int N = decltype(width)::value;
    Lanes<T, N> const v = load<N>(x + i);
    Lanes<T, N> sum{};
    for (int64_t k = 0; k < p.bins; ++k) {
      Lanes<T, N> const u = (v - centers[k]) / h;
      sum = sum - vexp2<T, N>(u * u * T(-kHalfLog2E)) * u * grad[k];
    }
    store<N>(grad_x + i, v == v ? Lanes<T, N>(sum / h) : broadcast<N>(T(0)));
  });
}

KV_HD void differentiate_by_cells(Histogram<float> const& p, MomentGrid const& grid, float const* x,
                                  float const* centers, float const* grad, float* grad_x) {
  constexpr int N = kLanes<float>;
  using V = Lanes<float, N>;
  CellMemory const apart(grid), table(grid);
  float const per = 1 / grid.bandwidth, w = grid.width * per;
  V step;
  for (int i = 0; i < N; ++i) step[i] = float(i) * grid.width;
  for (int64_t k = 0; k < p.bins; ++k)
    for (int i = grid.begin(centers[k]), end = grid.end(centers[k]); i < end; i += N) {
      V const u = (step + (grid.middle(i) - centers[k])) * per;
      V const g = vexp2<float, N>(u * u * float(-kHalfLog2E)) * (grad[k] * per);
      V c[4];
      derivative(u, w, c);
      for (int j = 0; j < 4; ++j) store<N>(apart.apart(j) + i, load<N>(apart.apart(j) + i) + g * c[j]);
    }
  for (int64_t i = 0; i < grid.cells; ++i)
    for (int j = 0; j < 4; ++j) table.memory.data[4 * i + j] = apart.apart(j)[i];

  int32_t cell[kChunk];
  float t[kChunk];
  for (int64_t begin = 0; begin < p.samples; begin += kChunk) {
    int64_t const count = min(int64_t(kChunk), p.samples - begin);
    cells_of(grid, x + begin, count, cell, t);
    for (int64_t i = 0; i < count; ++i) {
      float const* const c = table.memory.data + 4 * cell[i];
      grad_x[begin + i] = c[0] + t[i] * (c[1] + t[i] * (c[2] + t[i] * c[3]));
    }
  }
}

}  // namespace

template <class T>
void histogram(Histogram<T> const& p, int64_t begin, int64_t end) {
  for (int64_t row = begin; row < end; ++row) {
    T const *const x = p.x + row * p.samples, *const centers = p.centers + row * p.center_stride;
    T const h = p.bandwidth[row * p.bandwidth_stride];
    T* const counts = p.counts + row * p.bins;
    if constexpr (sizeof(T) == sizeof(float)) {
      MomentGrid const grid = grid_of(p, centers, h);
      if (grid.cells > 0) {
        count_by_cells(p, grid, x, centers, counts);
        continue;
      }
    }
    count_directly(p, x, centers, h, counts);
  }
}

template <class T>
void histogram_backward(HistogramBackward<T> const& b, int64_t begin, int64_t end) {
  Histogram<T> const& p = b.forward;
  for (int64_t row = begin; row < end; ++row) {
    T const *const x = p.x + row * p.samples, *const centers = p.centers + row * p.center_stride;
    T const h = p.bandwidth[row * p.bandwidth_stride];
    T const* const grad = b.grad + row * p.bins;
    T* const grad_x = b.grad_x + row * p.samples;
    if constexpr (sizeof(T) == sizeof(float)) {
      MomentGrid const grid = grid_of(p, centers, h);
      if (grid.cells > 0) {
        differentiate_by_cells(p, grid, x, centers, grad, grad_x);
        continue;
      }
    }
    differentiate_directly(p, x, centers, h, grad, grad_x);
  }
}

template <class T>
void normalize_counts(NormalizeCounts<T> const& p, int64_t begin, int64_t end) {
  for (int64_t row = begin; row < end; ++row) {
    T const* const counts = p.counts + row * p.bins;
    double sum = p.eps;
    for (int64_t k = 0; k < p.bins; ++k) sum += counts[k];
    for (int64_t k = 0; k < p.bins; ++k) p.y[row * p.bins + k] = counts[k] / T(sum);
  }
}

template <class T>
void normalize_counts_backward(NormalizeCountsBackward<T> const& p, int64_t begin, int64_t end) {
  for (int64_t row = begin; row < end; ++row) {
    T const *const counts = p.counts + row * p.bins, *const grad = p.grad + row * p.bins;
    double sum = p.eps, product = 0;
    for (int64_t k = 0; k < p.bins; ++k) sum += counts[k], product += double(grad[k]) * counts[k];
    T const mean = T(product / sum);
    for (int64_t k = 0; k < p.bins; ++k) p.grad_counts[row * p.bins + k] = (grad[k] - mean) / T(sum);
  }
}

KV_INSTANTIATE_COMPUTED(histogram, Histogram)
KV_INSTANTIATE_COMPUTED(histogram_backward, HistogramBackward)
KV_INSTANTIATE_COMPUTED(normalize_counts, NormalizeCounts)
KV_INSTANTIATE_COMPUTED(normalize_counts_backward, NormalizeCountsBackward)

}  // namespace kv::enhance::KV_ISA
