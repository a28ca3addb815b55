// The two nearest descriptors: schemas and entries, for CPU and CUDA.
#include "feature/matching.h"
#include "glue/batch.h"

namespace kv::feature {
namespace {

// Two sets of descriptors (B, N, D) and (B, M, D), checked; a batch of size 1 is expanded.
struct DescriptorPair {
  Tensor first, second;
  int64_t batch, width;

  DescriptorPair(char const* op, Tensor const& a, Tensor const& b) {
    KV_CHECK(a.dim() == 3 && b.dim() == 3 && a.size(2) > 0 && a.size(2) == b.size(2), op,
             ": expected desc1 (B, N, D) and desc2 (B, M, D)");
    KV_CHECK(a.scalar_type() == compute_dtype(a), op, ": expected float32 or float64");
    KV_CHECK(a.size(1) < INT32_MAX / 2 && b.size(1) < INT32_MAX / 2 && a.size(2) < INT32_MAX, op,
             ": expected fewer than 2^30 descriptors");
    batch = a.size(0) == 1 ? b.size(0) : a.size(0), width = a.size(2);
    check_sizes(op, "desc1", a, a, {batch, a.size(1), width});
    check_sizes(op, "desc2", b, a, {batch, b.size(1), width});
    first = expand_batch(a, batch), second = expand_batch(b, batch);
  }
};

std::optional<Tensor> checked_mask(char const* op, char const* name, std::optional<Tensor> const& mask,
                                   Tensor const& descriptors) {
  if (!mask) return {};
  int64_t const batch = descriptors.size(0), count = descriptors.size(1);
  KV_CHECK(mask->scalar_type() == ScalarType::Bool && mask->dim() == 2 && mask->device() == descriptors.device() &&
               (mask->size(0) == batch || mask->size(0) == 1) && mask->size(1) == count,
           op, ": expected ", name, " to be bool, one for each descriptor");
  return expand_batch(*mask, batch);
}

#if defined(KV_CUDA)
// Tiles of columns are divided over blocks such that there are this many, about 8 for every block that the largest GPU
// runs at a time.
constexpr int64_t kMatchingBlocks = 2048;
// So many pairs are compared by one kernel, which writes no candidates (docs/notes/features.md).
constexpr int64_t kFewPairs = 1 << 16;
#endif

// The neighbors of the first set, and if `both` is set, those of the second one. Or, as `pairs`, those of the nearest
// only.
std::tuple<Tensor, Tensor, Tensor, Tensor> find_neighbors(char const* op, Tensor const& desc1, Tensor const& desc2,
                                                          std::optional<Tensor> const& mask1,
                                                          std::optional<Tensor> const& mask2,
                                                          std::optional<Tensor> const& positions1,
                                                          std::optional<Tensor> const& positions2, double distance,
                                                          bool both, bool pairs) {
  DescriptorPair const x(op, desc1, desc2);
  int64_t const batch = x.batch, n = desc1.size(1), m = desc2.size(1), listed = both ? m : 0;
  auto const valid1 = checked_mask(op, "mask1", mask1, x.first), valid2 = checked_mask(op, "mask2", mask2, x.second);
  KV_CHECK(positions1.has_value() == positions2.has_value(), op, ": expected positions of both sets or none");
  std::optional<Tensor> at1, at2;
  if (positions1) {
    check_sizes(op, "positions1", *positions1, x.first, {batch, n, 2});
    check_sizes(op, "positions2", *positions2, x.first, {batch, m, 2});
    at1 = expand_batch(*positions1, batch), at2 = expand_batch(*positions2, batch);
  }
  int64_t const columns = pairs ? 1 : 2;
  Tensor const distances1 = empty({batch, n, columns}, x.first);
  Tensor const indices1 = empty({batch, n, 2}, x.first, Layout::planar, ScalarType::Long);
  Tensor distances2, indices2;  // pairs have none
  if (!pairs) {
    distances2 = empty({batch, listed, 2}, x.first);
    indices2 = empty({batch, listed, 2}, x.first, Layout::planar, ScalarType::Long);
  }
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    auto const set = [&](Tensor const& values, std::optional<Tensor> const& mask,
                         std::optional<Tensor> const& positions, Tensor const* distances, Tensor const* indices) {
      DescriptorSet<T> result{};
      result.values = data_ptr<T const>(values), result.count = int(values.size(1)), result.pairs = pairs;
      if (mask) result.mask = data_ptr<bool const>(*mask);
      if (positions) result.positions = data_ptr<T const>(*positions);
      if (distances) result.distances = data_ptr<T>(*distances), result.indices = data_ptr<int64_t>(*indices);
      return result;
    };
    TwoNearest<T> params{set(x.first, valid1, at1, &distances1, &indices1),
                         set(x.second, valid2, at2, both ? &distances2 : nullptr, both ? &indices2 : nullptr),
                         batch,
                         int(x.width),
                         both,
                         T(distance * distance)};
#if defined(KV_CUDA)
    torch::stable::accelerator::DeviceGuard const guard(x.first.get_device_index());
    int64_t const tile = kMatchingTile<T>, tiles1 = ceil_div(n, tile), tiles2 = ceil_div(m, tile);
    // Special case, H200: 0.84 (match small) to 3.1 (match_smnn10000) times as fast as all distances in float32.
    bool const by_candidates = sizeof(T) == 4 && !positions1 && n > 0 && m > 0 && cuda::has_matching_candidates();
    if (by_candidates && batch * n * m <= kFewPairs) {
      KV_RUN(two_nearest, x.first, params, batch, 0);
      return;
    }
    int64_t const blocks = batch * tiles1 < 1 ? 1 : batch * tiles1;
    int64_t const splits1 = clamp(ceil_div(kMatchingBlocks, blocks), int64_t(1), tiles2 < 1 ? 1 : tiles2);
    int64_t const splits2 = tiles1;
#else
    constexpr bool by_candidates = false;
    int64_t const splits1 = 1, splits2 = ceil_div(n, kMatchingCpuRows);
#endif
    int64_t const words = by_candidates ? 0 : sizeof(Neighbors<T>) / 4;
    Tensor const partial1 = empty({batch, splits1, n, words}, x.first, Layout::planar, ScalarType::Int);
    Tensor const partial2 = empty({batch, splits2, listed, words}, x.first, Layout::planar, ScalarType::Int);
    auto const set_partial = [](DescriptorSet<T>& set, int64_t splits, Tensor const& partial) {
      set.splits = int(splits), set.partial = static_cast<Neighbors<T>*>(partial.mutable_data_ptr());
    };
    set_partial(params.first, splits1, partial1);
    set_partial(params.second, splits2, partial2);
    if (!both) params.second.partial = nullptr;
#if defined(KV_CUDA)
    int64_t const candidates1 = by_candidates ? batch * n * tiles2 : 0;
    int64_t const candidates2 = by_candidates ? batch * listed * tiles1 : 0;
    Tensor const lists = empty({candidates1 + candidates2, 3}, x.first, Layout::planar, ScalarType::Int);
    Tensor const half_squares = empty({by_candidates ? batch * (n + m) : 0}, x.first);
    int64_t const split = split_width(int(x.width));
    Tensor const summands =
        empty({by_candidates ? batch * (n + m) : 0, split}, x.first, Layout::planar, ScalarType::BFloat16);
    if (by_candidates) {
      params.first.half_squares = data_ptr<T>(half_squares);
      params.second.half_squares = params.first.half_squares + batch * n;
      params.first.split = static_cast<BFloat16*>(summands.mutable_data_ptr());
      params.second.split = params.first.split + batch * n * split;
      params.first.candidates = static_cast<Candidates*>(lists.mutable_data_ptr());
      params.second.candidates = both ? params.first.candidates + candidates1 : nullptr;
    }
#endif
    KV_RUN(two_nearest, x.first, params, batch * splits2, kMatchingCpuRows * m * x.width);
    KV_RUN(two_nearest_merge, x.first, params, batch * (n + listed), 8);
  };
  x.first.scalar_type() == ScalarType::Double ? run(Type<double>{}) : run(Type<float>{});
  return {distances1, indices1, distances2, indices2};
}

std::tuple<Tensor, Tensor, Tensor, Tensor> two_nearest(
    Tensor const& desc1, Tensor const& desc2, std::optional<Tensor> const& mask1, std::optional<Tensor> const& mask2,
    std::optional<Tensor> const& positions1, std::optional<Tensor> const& positions2, double distance, bool both) {
  return find_neighbors("two_nearest", desc1, desc2, mask1, mask2, positions1, positions2, distance, both, false);
}

std::tuple<Tensor, Tensor> nearest_pairs(Tensor const& desc1, Tensor const& desc2) {
  auto const [distances, indices, _, __] =
      find_neighbors("nearest_pairs", desc1, desc2, {}, {}, {}, {}, 0, false, true);
  return {distances, indices};
}

// The gradients to both sets from those to the distances (B, N, neighbors) of the first set, and of the second one if
// these are given.
std::tuple<Tensor, Tensor> differentiate(char const* op, Tensor const& grad1, Tensor const* grad2, Tensor const& desc1,
                                         Tensor const& desc2, Tensor const& indices1, Tensor const* indices2,
                                         int64_t neighbors) {
  DescriptorPair const x(op, desc1, desc2);
  auto const check = [&](char const* name, Tensor const& grad, Tensor const& indices, Tensor const& descriptors) {
    KV_CHECK(grad.dim() == 3 && grad.size(0) == x.batch && grad.size(2) == neighbors &&
                 (grad.size(1) == descriptors.size(1) || grad.size(1) == 0) &&
                 grad.scalar_type() == descriptors.scalar_type() && grad.device() == descriptors.device(),
             op, ": expected ", name, " to be that of the distances");
    KV_CHECK(indices.dim() == 3 && indices.size(0) == x.batch && indices.size(1) == grad.size(1) &&
                 indices.size(2) == 2 && indices.scalar_type() == ScalarType::Long &&
                 indices.device() == descriptors.device(),
             op, ": expected indices like ", name);
  };
  check(grad2 ? "grad1" : "grad", grad1, indices1, x.first);
  if (grad2) check("grad2", *grad2, *indices2, x.second);
  Tensor const g1 = dense(grad1), i1 = dense(indices1);
  Tensor const g2 = grad2 ? dense(*grad2) : g1, i2 = grad2 ? dense(*indices2) : i1;
  int64_t const listed2 = grad2 ? grad2->size(1) : 0;
  Tensor const grad_desc1 = empty({x.batch, desc1.size(1), x.width}, x.first);
  Tensor const grad_desc2 = empty({x.batch, desc2.size(1), x.width}, x.first);
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    auto const set = [&](Tensor const& values, Tensor const& grad, Tensor const& indices, int64_t listed,
                         Tensor const& grad_values) {
      return NeighborGradient<T>{data_ptr<T const>(values),
                                 data_ptr<T const>(grad),
                                 data_ptr<int64_t const>(indices),
                                 int(values.size(1)),
                                 int(listed),
                                 int(neighbors),
                                 data_ptr<T>(grad_values)};
    };
    TwoNearestBackward<T> const params{set(x.first, g1, i1, g1.size(1), grad_desc1),
                                       set(x.second, g2, i2, listed2, grad_desc2), x.batch, int(x.width)};
    KV_RUN(two_nearest_backward, x.first, params, desc1.size(1) + desc2.size(1) > 0 ? x.batch : 0,
           (grad1.size(1) + listed2) * 2 * neighbors * x.width);
  };
  x.first.scalar_type() == ScalarType::Double ? run(Type<double>{}) : run(Type<float>{});
  return {grad_desc1, grad_desc2};
}

std::tuple<Tensor, Tensor> two_nearest_backward(Tensor const& grad1, Tensor const& grad2, Tensor const& desc1,
                                                Tensor const& desc2, Tensor const& indices1, Tensor const& indices2) {
  return differentiate("two_nearest_backward", grad1, &grad2, desc1, desc2, indices1, &indices2, 2);
}

std::tuple<Tensor, Tensor> nearest_pairs_backward(Tensor const& grad, Tensor const& desc1, Tensor const& desc2,
                                                  Tensor const& indices) {
  return differentiate("nearest_pairs_backward", grad, nullptr, desc1, desc2, indices, nullptr, 1);
}

std::tuple<Tensor, Tensor, Tensor> select_matches(Tensor const& distances1, Tensor const& indices1,
                                                  std::optional<Tensor> const& distances2,
                                                  std::optional<Tensor> const& indices2, int64_t count2, bool ratios,
                                                  double threshold) {
  constexpr char const* op = "select_matches";
  KV_CHECK(distances1.dim() == 3 && distances1.size(2) == 2 && distances1.scalar_type() == compute_dtype(distances1),
           op, ": expected distances1 (B, N, 2) of float32 or float64");
  KV_CHECK(distances2.has_value() == indices2.has_value(), op, ": expected distances and indices of a direction");
  int64_t const batch = distances1.size(0), n = distances1.size(1);
  KV_CHECK(count2 >= 0 && count2 < INT32_MAX / 2 && n < INT32_MAX / 2, op, ": expected fewer than 2^30 descriptors");
  auto const check = [&](char const* name, Tensor const& x, int64_t count, ScalarType type) {
    KV_CHECK(x.dim() == 3 && x.size(0) == batch && x.size(1) == count && x.size(2) == 2 && x.scalar_type() == type &&
                 x.device() == distances1.device(),
             op, ": expected ", name, " of shape (B, ", count, ", 2) and of its type");
  };
  check("indices1", indices1, n, ScalarType::Long);
  if (distances2) {
    check("distances2", *distances2, count2, distances1.scalar_type());
    check("indices2", *indices2, count2, ScalarType::Long);
  }
  Tensor const d1 = dense(distances1), i1 = dense(indices1);
  std::optional<Tensor> d2, i2;
  if (distances2) d2 = dense(*distances2), i2 = dense(*indices2);
  Tensor const scores = empty({batch, n}, d1), indices = empty({batch, n, 2}, i1), sizes = empty({batch}, i1);
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    SelectMatches<T> const params{data_ptr<T const>(d1),
                                  d2 ? data_ptr<T const>(*d2) : nullptr,
                                  data_ptr<int64_t const>(i1),
                                  i2 ? data_ptr<int64_t const>(*i2) : nullptr,
                                  batch,
                                  int(n),
                                  int(count2),
                                  ratios,
                                  T(threshold),
                                  data_ptr<T>(scores),
                                  data_ptr<int64_t>(indices),
                                  data_ptr<int64_t>(sizes)};
    KV_RUN(select_matches, d1, params, batch, 16 * n);
  };
  d1.scalar_type() == ScalarType::Double ? run(Type<double>{}) : run(Type<float>{});
  return {scores, indices, sizes};
}

std::tuple<Tensor, Tensor> select_matches_backward(Tensor const& grad, Tensor const& indices, Tensor const& distances1,
                                                   std::optional<Tensor> const& distances2, int64_t count2,
                                                   bool ratios) {
  constexpr char const* op = "select_matches_backward";
  KV_CHECK(grad.dim() == 2 && grad.scalar_type() == compute_dtype(grad), op,
           ": expected grad (B, N) of float32 or float64");
  int64_t const batch = grad.size(0), n = grad.size(1);
  KV_CHECK(count2 >= 0 && count2 < INT32_MAX / 2 && n < INT32_MAX / 2, op, ": expected fewer than 2^30 descriptors");
  auto const check = [&](char const* name, Tensor const& x, int64_t count, ScalarType type) {
    KV_CHECK(x.dim() == 3 && x.size(0) == batch && x.size(1) == count && x.size(2) == 2 && x.scalar_type() == type &&
                 x.device() == grad.device(),
             op, ": expected ", name, " of shape (B, ", count, ", 2) and of its type");
  };
  check("indices", indices, n, ScalarType::Long);
  check("distances1", distances1, n, grad.scalar_type());
  if (distances2) check("distances2", *distances2, count2, grad.scalar_type());
  Tensor const g = dense(grad), at = dense(indices), d1 = dense(distances1);
  std::optional<Tensor> d2;
  if (distances2) d2 = dense(*distances2);
  Tensor grad1 = empty({batch, n, 2}, g), grad2 = empty({batch, d2 ? count2 : 0, 2}, g);
  if (grad1.numel() > 0) torch::stable::zero_(grad1);
  if (grad2.numel() > 0) torch::stable::zero_(grad2);
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    SelectMatchesBackward<T> const params{data_ptr<T const>(g),
                                          data_ptr<int64_t const>(at),
                                          data_ptr<T const>(d1),
                                          d2 ? data_ptr<T const>(*d2) : nullptr,
                                          data_ptr<T>(grad1),
                                          data_ptr<T>(grad2),
                                          batch,
                                          int(n),
                                          int(count2),
                                          ratios};
    KV_RUN(select_matches_backward, g, params, batch * n, 8);
  };
  g.scalar_type() == ScalarType::Double ? run(Type<double>{}) : run(Type<float>{});
  return {grad1, grad2};
}

}  // namespace

KV_OPERATOR(select_matches_backward,
            "(Tensor grad, Tensor indices, Tensor distances1, Tensor? distances2, int count2, bool ratios) "
            "-> (Tensor, Tensor)")
// The matches of each sample, from the neighbors (B, N, 2) of the first set and, if matches are mutual, those of the
// second set, which has count2 descriptors: scores (B, N), indices (B, N, 2), and the count of matches (B,).
KV_OPERATOR(select_matches,
            "(Tensor distances1, Tensor indices1, Tensor? distances2, Tensor? indices2, int count2, bool ratios, "
            "float threshold) -> (Tensor, Tensor, Tensor)")
// The distances (B, N, 1) of the nearest descriptors, and the indices (B, N, 2) of a descriptor and its nearest one.
KV_OPERATOR(nearest_pairs, "(Tensor desc1, Tensor desc2) -> (Tensor, Tensor)")
KV_OPERATOR(nearest_pairs_backward, "(Tensor grad, Tensor desc1, Tensor desc2, Tensor indices) -> (Tensor, Tensor)")
KV_OPERATOR(two_nearest,
            "(Tensor desc1, Tensor desc2, Tensor? mask1, Tensor? mask2, Tensor? positions1, Tensor? positions2, "
            "float distance, bool both) -> (Tensor, Tensor, Tensor, Tensor)")
KV_OPERATOR(two_nearest_backward,
            "(Tensor grad1, Tensor grad2, Tensor desc1, Tensor desc2, Tensor indices1, Tensor indices2) "
            "-> (Tensor, Tensor)")

}  // namespace kv::feature
