// Hausdorff loss on CUDA. Each erosion is one launch, whose blocks first reduce the minima and maxima that the blocks
// of the previous launch stored. The backward pass recomputes and stores all erosions, then traverses them in reverse,
// one launch each. Planes are processed in groups, so that the working memory is no larger than a map of the whole
// batch.
#include "core/row_sums.cuh"
#include "hausdorff.h"

namespace kv::losses::cuda {
namespace {

constexpr int kThreads = kSumThreads;

// Reduces the K numbers of every chunk of a plane.
template <int K, class F, class Op>
__device__ __forceinline__ void reduce_chunks(F (&v)[K], F const* numbers, unsigned chunks, Op op) {
  for (unsigned i = threadIdx.x; i < chunks; i += kThreads)
#pragma unroll
    for (int k = 0; k < K; ++k) v[k] = op(v[k], numbers[i * K + k]);
  block_reduce<kSumThreads>(v, op);
}

// The c_i of a plane, and the normalization from c_i to b_i. Blocks store -low and high.
template <class F>
struct Eroded {
  F const* c;
  ValueRange<F> span;
  F from, width;

  __device__ __forceinline__ Eroded(F const* c, F const* numbers, unsigned chunks) : c(c) {
    F ends[2] = {-F(INFINITY), -F(INFINITY)};
    reduce_chunks(ends, numbers, chunks, NanMax());
    span = {-ends[0], ends[1]}, from = span.from(), width = span.width();
  }
  __device__ __forceinline__ F b(int64_t i) const { return (c[i] - from) / width; }
};

// The mean of value(i) at pixel i and its direct neighbors.
template <class F, class Value>
__device__ __forceinline__ F mean_around(Extent const& e, unsigned i, Value value) {
  unsigned const width = unsigned(e.width), height = unsigned(e.height), row = i / width, x = i - row * width;
  unsigned const z = e.depth > 0 ? row / height : 0, y = row - z * height, slab = width * height;
  F sum = value(i);
  if (x > 0) sum += value(i - 1);
  if (x + 1 < width) sum += value(i + 1);
  if (y > 0) sum += value(i - width);
  if (y + 1 < height) sum += value(i + width);
  if (e.depth > 0) {
    if (z > 0) sum += value(i - slab);
    if (z + 1 < unsigned(e.depth)) sum += value(i + slab);
    return sum * F(1. / 7);
  }
  return sum * F(1. / 5);
}

// The chunk of a block, in one of the planes from `first` on.
template <class F>
struct Group {
  Differences<F> differences;
  int64_t first;
  unsigned chunks, size;

  __device__ __forceinline__ unsigned plane() const { return blockIdx.x / chunks; }
  // Calls f for the thread's pixels.
  template <class Call>
  __device__ __forceinline__ void for_each(Call f) const {
    unsigned const start = (blockIdx.x - plane() * chunks) * kErosionChunk;
    unsigned const end = min(start + kErosionChunk, size);
#pragma unroll 2
    for (unsigned i = start + threadIdx.x; i < end; i += kThreads) f(i);
  }
};

template <class F>
struct Erosion {
  Group<F> group;
  F const *from, *from_numbers;  // c_(i-1); null: the first erosion reads differences
  F *to, *to_numbers;            // c_i; null: only the loss is computed
  F weight;                      // of b_(i-1) in the loss
  bool begins;                   // sets the loss rather than adding to it
  F *map, *sums;                 // the loss per pixel of all planes, or per chunk of the group; or null
};

template <class F, bool First>
__global__ void __launch_bounds__(kThreads) erode(__grid_constant__ Erosion<F> const p) {
  Group<F> const& group = p.group;
  unsigned const plane = group.plane();
  F ends[2] = {-F(INFINITY), -F(INFINITY)}, loss[1] = {};
  F* const to = p.to + int64_t(plane) * group.size;
  auto const work = [&](auto value) {
    group.for_each([&](unsigned i) {
      if (p.to) {
        F const mean = mean_around<F>(group.differences.extent, i, value) - F(0.5), c = mean < 0 ? F(0) : mean;
        to[i] = c;
        ends[0] = NanMax()(ends[0], -c), ends[1] = NanMax()(ends[1], c);
      }
      if (First) return;
      if (!p.map && !p.sums) return;
      F const own = value(i) * p.weight;
      F* const map = p.map + (group.first + plane) * group.size + i;
      if (p.map)
        *map = p.begins ? own : *map + own;
      else
        loss[0] += own;
    });
  };
  if constexpr (First) {
    work([&](unsigned i) {
      F const d = group.differences.at(group.first + plane, i);
      return d * d;
    });
  } else {
    Eroded<F> const eroded(p.from + int64_t(plane) * group.size, p.from_numbers + plane * group.chunks * 2,
                           group.chunks);
    work([&](unsigned i) { return eroded.b(i); });
  }
  if (p.to) {
    block_reduce<kSumThreads>(ends, NanMax());
    if (threadIdx.x == 0) p.to_numbers[blockIdx.x * 2] = ends[0], p.to_numbers[blockIdx.x * 2 + 1] = ends[1];
  }
  if (First || !p.sums) return;
  block_reduce<kSumThreads>(loss, Sum());
  if (threadIdx.x == 0) p.sums[blockIdx.x] = p.begins ? loss[0] : p.sums[blockIdx.x] + loss[0];
}

// One step of the backward pass: from g of b_i to g of b_(i-1), or to the gradient of the prediction.
template <class F>
struct Growth {
  Group<F> group;
  F const *c, *numbers, *g, *sums;  // of step i; null: there is none
  F const *next_c, *next_numbers;   // of step i - 1; null: differences
  F *next_g, *next_sums;
  F weight;       // of b_(i-1) in the loss
  F const* grad;  // per pixel of all planes, or per plane if of_sums
  bool of_sums;
  F* out;  // the gradient of the prediction
};

template <class F, bool Last>
__global__ void __launch_bounds__(kThreads) grow(__grid_constant__ Growth<F> const p) {
  Group<F> const& group = p.group;
  unsigned const plane = group.plane(), chunks = group.chunks;
  int64_t const offset = int64_t(plane) * group.size, all = group.first * group.size + offset;
  F const of_sum = p.of_sums ? p.grad[group.first + plane] : F(0);
  F result[4] = {};
  auto const work = [&](auto grown) {
    auto const gradient_of = [&](unsigned i) {
      F const own = Last ? F(0) : (p.of_sums ? of_sum : p.grad[all + i]) * p.weight;
      return own + grown(i);
    };
    if constexpr (Last) {
      group.for_each(
          [&](unsigned i) { p.out[all + i] = gradient_of(i) * 2 * group.differences.at(group.first + plane, i); });
    } else {
      Eroded<F> const next(p.next_c + offset, p.next_numbers + plane * chunks * 2, chunks);
      group.for_each([&](unsigned i) {
        F const derivative = gradient_of(i), b = next.b(i);
        p.next_g[offset + i] = derivative;
        result[0] += derivative, result[1] += derivative * b, result[2] += b == 0, result[3] += b == 1;
      });
      block_reduce<kSumThreads>(result, Sum());
      if (threadIdx.x == 0)
        for (int k = 0; k < 4; ++k) p.next_sums[blockIdx.x * 4 + k] = result[k];
    }
  };
  if (!p.c) {
    work([](unsigned) { return F(0); });
    return;
  }
  Eroded<F> const eroded(p.c + offset, p.numbers + plane * chunks * 2, chunks);
  F sums[4] = {};
  reduce_chunks(sums, p.sums + plane * chunks * 4, chunks, Sum());
  auto const gradients = NormalizeVjp<F>::of(eroded.span, sums[0], sums[1], sums[2], sums[3]);
  F const* const g = p.g + offset;
  work([&](unsigned i) {
    return mean_around<F>(group.differences.extent, i, [&](unsigned at) { return gradients(g[at], eroded.b(at)); });
  });
}

// Calls f(group, planes) for all groups.
template <class F, class Call>
int for_each_group(Differences<F> const& d, int64_t at_once, Call f) {
  unsigned const size = unsigned(d.extent.size()), chunks = unsigned(ceil_div(size, kErosionChunk));
  for (int64_t first = 0; first < d.planes(); first += at_once)
    f(Group<F>{d, first, chunks, size}, min(at_once, d.planes() - first));
  return cudaGetLastError();
}

double weight_of(int64_t i, double alpha) { return ::pow(double(i), alpha); }

}  // namespace

template <class F>
int hausdorff(Hausdorff<F> const& p, CUstream_st* stream) {
  return for_each_group(p.differences, p.at_once, [&](Group<F> const& group, int64_t planes) {
    unsigned const blocks = unsigned(planes * group.chunks);
    F *const sums = p.numbers, *const numbers = sums + blocks;
    auto const map = [&](int64_t i) { return p.maps + i % 2 * planes * group.size; };
    auto const ends = [&](int64_t i) { return numbers + i % 2 * blocks * 2; };
    for (int64_t i = 1; i <= p.k + 1; ++i) {
      Erosion<F> e{group,  map(i - 1), ends(i - 1),           map(i), ends(i), F(weight_of(i - 1, p.alpha)),
                   i == 2, p.map,      p.map ? nullptr : sums};
      if (i > p.k) e.to = nullptr;
      if (i == 1)
        erode<F, true><<<blocks, kThreads, 0, stream>>>(e);
      else
        erode<F, false><<<blocks, kThreads, 0, stream>>>(e);
    }
    if (!p.map) sum_chunks(sums, planes, int64_t(group.chunks), p.sums + group.first, stream);
  });
}

template <class F>
int hausdorff_backward(HausdorffBackward<F> const& p, CUstream_st* stream) {
  return for_each_group(p.differences, p.at_once, [&](Group<F> const& group, int64_t planes) {
    unsigned const blocks = unsigned(planes * group.chunks);
    F *const sums = p.numbers, *const numbers = sums + 2 * 4 * int64_t(blocks);
    auto const map = [&](int64_t i) {
      return p.maps + (i - 1) * planes * group.size;
    };  // map i of 1 to k, and two more
    auto const ends = [&](int64_t i) { return numbers + (i - 1) * blocks * 2; };
    auto const sums_of = [&](int64_t i) { return sums + i % 2 * blocks * 4; };
    for (int64_t i = 1; i <= p.k; ++i) {
      Erosion<F> const e{
          group,  i > 1 ? map(i - 1) : nullptr, i > 1 ? ends(i - 1) : nullptr, map(i), ends(i), F(0), true, nullptr,
          nullptr};
      if (i == 1)
        erode<F, true><<<blocks, kThreads, 0, stream>>>(e);
      else
        erode<F, false><<<blocks, kThreads, 0, stream>>>(e);
    }
    for (int64_t i = p.k + 1; i >= 1; --i) {
      Growth<F> e{};
      e.group = group, e.grad = p.grad, e.of_sums = p.of_sums, e.out = p.grad_pred;
      if (i <= p.k) e.c = map(i), e.numbers = ends(i), e.g = map(p.k + 1 + i % 2), e.sums = sums_of(i);
      if (i == 1) {
        grow<F, true><<<blocks, kThreads, 0, stream>>>(e);
        continue;
      }
      e.next_c = map(i - 1), e.next_numbers = ends(i - 1), e.weight = F(weight_of(i - 1, p.alpha));
      e.next_g = map(p.k + 1 + (i - 1) % 2), e.next_sums = sums_of(i - 1);
      grow<F, false><<<blocks, kThreads, 0, stream>>>(e);
    }
  });
}

KV_INSTANTIATE_COMPUTED(hausdorff, Hausdorff)
KV_INSTANTIATE_COMPUTED(hausdorff_backward, HausdorffBackward)

}  // namespace kv::losses::cuda
