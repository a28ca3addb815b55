// Suppression of boxes: schemas and entries, for CPU and CUDA.
#include "glue/batch.h"
#include "suppression.h"

namespace kv::geometry {
namespace {

constexpr int64_t kStripBytes = 64 << 20;  // of the pairs that are compared at once on CUDA

struct BoxSets {
  Tensor edges;
  std::optional<Tensor> labels;
  int64_t batch, n;

  int64_t const* label_data() const { return labels ? data_ptr<int64_t const>(*labels) : nullptr; }
};

// Any tensor may have a batch of 1, which serves all of the others'.
BoxSets check_boxes(char const* op, Tensor const& edges, std::optional<Tensor> const& labels, int64_t batch = 1) {
  KV_CHECK(edges.dim() == 3 && edges.size(1) == 4 && edges.scalar_type() == compute_dtype(edges), op,
           ": expected edges of shape (B, 4, N) of float32 or float64");
  int64_t const n = edges.size(2);
  KV_CHECK(n <= INT32_MAX / 64, op, ": expected less than 2^25 boxes of a sample, got ", n);
  if (edges.size(0) != 1) batch = edges.size(0);
  if (labels) {
    bool const fits = labels->dim() == 2 && labels->size(1) == n && labels->scalar_type() == ScalarType::Long &&
                      labels->device() == edges.device();
    KV_CHECK(fits, op, ": expected labels of shape (B, N) of int64");
    if (batch == 1) batch = labels->size(0);
    KV_CHECK(labels->size(0) == 1 || labels->size(0) == batch, op, ": expected labels of as many samples as edges");
  }
  KV_CHECK(batch <= INT32_MAX, op, ": expected less than 2^31 samples, got ", batch);
  return {expand_batch(edges, batch), labels ? std::optional(expand_batch(*labels, batch)) : std::nullopt, batch, n};
}

template <class Run>
void run_in_type(Tensor const& x, Run run) {
  x.scalar_type() == ScalarType::Double ? run(Type<double>{}) : run(Type<float>{});
}

Tensor suppress_boxes(Tensor const& edges, std::optional<Tensor> const& labels, double threshold) {
  BoxSets const sets = check_boxes("suppress_boxes", edges, labels);
  Tensor const kept = empty({sets.batch, sets.n}, sets.edges, Layout::planar, ScalarType::Byte);
  run_in_type(sets.edges, [&](auto type) {
    using F = typename decltype(type)::type;
    BoxSuppression<F> params{data_ptr<F const>(sets.edges), sets.label_data(), sets.batch, sets.n, F(threshold),
                             data_ptr<uint8_t>(kept),       nullptr,           nullptr,    sets.n};
#if defined(KV_CUDA)
    int64_t const row_bytes = sets.batch * params.words() * 8;
    int64_t const rows = kStripBytes / (row_bytes > 0 ? row_bytes : 1) / kBoxesOfWord * kBoxesOfWord;
    params.strip = min(max(rows, int64_t(kBoxesOfWord)), max(params.words(), int64_t(1)) * kBoxesOfWord);
    Tensor const overlaps = empty({params.strip * row_bytes / 8}, sets.edges, Layout::planar, ScalarType::Long);
    Tensor const removed = empty({row_bytes / 8}, sets.edges, Layout::planar, ScalarType::Long);
    params.overlaps = data_ptr<uint64_t>(overlaps);
    params.removed = data_ptr<uint64_t>(removed);
#endif
    KV_RUN(suppress_boxes, sets.edges, params, sets.n > 0 ? sets.batch : 0, sets.n * (1 + sets.n / 64));
  });
  return kept;
}

// The chosen boxes and their scores.
std::tuple<Tensor, Tensor> soft_suppress_boxes(Tensor const& edges, Tensor const& scores,
                                               std::optional<Tensor> const& labels, double threshold, double sigma,
                                               double min_score, int64_t decay) {
  constexpr char const* op = "soft_suppress_boxes";
  KV_CHECK(scores.dim() == 2, op, ": expected scores of shape (B, N)");
  BoxSets const sets = check_boxes(op, edges, labels, scores.size(0));
  check_sizes(op, "scores", scores, edges, {sets.batch, sets.n});
  KV_CHECK(decay == 0 || decay == 1, op, ": decay must be 0 (linear) or 1 (gaussian), got ", decay);
  Tensor const left = empty({sets.batch, sets.n}, sets.edges), result = empty({sets.batch, sets.n}, sets.edges);
  torch::stable::copy_(const_cast<Tensor&>(left), expand_batch(scores, sets.batch));
  Tensor const order = empty({sets.batch, sets.n}, sets.edges, Layout::planar, ScalarType::Long);
  run_in_type(sets.edges, [&](auto type) {
    using F = typename decltype(type)::type;
    SoftBoxSuppression<F> const params{data_ptr<F const>(sets.edges),
                                       sets.label_data(),
                                       sets.batch,
                                       sets.n,
                                       F(threshold),
                                       F(sigma),
                                       F(min_score),
                                       Decay(decay),
                                       data_ptr<F>(left),
                                       data_ptr<int64_t>(order),
                                       data_ptr<F>(result)};
    KV_RUN(soft_suppress_boxes, sets.edges, params, sets.n > 0 ? sets.batch : 0, sets.n * (1 + sets.n / 64));
  });
  return {order, result};
}

}  // namespace

KV_OPERATOR(suppress_boxes, "(Tensor edges, Tensor? labels, float threshold) -> Tensor")
KV_OPERATOR(soft_suppress_boxes,
            "(Tensor edges, Tensor scores, Tensor? labels, float threshold, float sigma, float min_score, int decay) "
            "-> (Tensor, Tensor)")

}  // namespace kv::geometry
