// Confusion matrices: schema and entry, for CPU and CUDA.
#include "confusion_matrix.h"
#include "glue/glue.h"

namespace kv::metrics {
namespace {

constexpr int64_t kMaxLabels = 1 << 15;  // the index of a pair fits 32 bits

ConfusionStatistic check_statistic(int64_t statistic) {
  KV_CHECK(statistic >= 0 && statistic <= 2,
           "confusion_matrix: statistic must be one of 0 (counts), 1 (rates), 2 (iou); got ", statistic);
  return ConfusionStatistic(statistic);
}

Tensor confusion_matrix(Tensor const& pred, Tensor const& target, int64_t classes, int64_t statistic, double eps) {
  constexpr char const* op = "confusion_matrix";
  KV_CHECK(pred.dim() == 2 && target.dim() == 2 && pred.size(0) == target.size(0) && pred.size(1) == target.size(1) &&
               pred.scalar_type() == target.scalar_type() && pred.device() == target.device(),
           op, ": expected pred and target (samples, pixels) of one type on one device");
  bool const bytes = pred.scalar_type() == ScalarType::Byte;
  KV_CHECK(bytes || pred.scalar_type() == ScalarType::Long, op, ": expected labels of int64 or uint8");
  KV_CHECK(classes >= 1 && classes <= kMaxLabels, op, ": expected 1 to ", kMaxLabels, " classes, got ", classes);
  KV_CHECK(pred.size(1) < int64_t(1) << 32, op, ": expected less than 2^32 pixels in a sample");
  ConfusionStatistic const kind = check_statistic(statistic);
  Tensor const p = dense(pred), t = dense(target);
  int64_t const samples = pred.size(0);
  std::vector<int64_t> const sizes = kind == ConfusionStatistic::iou ? std::vector<int64_t>{samples, classes}
                                                                     : std::vector<int64_t>{samples, classes, classes};
  Tensor const result = empty(sizes, pred, Layout::planar, ScalarType::Float);
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    ConfusionMatrix<T> params{data_ptr<T const>(p), data_ptr<T const>(t),    samples, pred.size(1), int(classes), kind,
                              float(eps),           data_ptr<float>(result), nullptr};
#if defined(KV_CUDA)
    Tensor const counts = empty({samples, classes, classes}, pred, Layout::planar, ScalarType::Int);
    params.counts = data_ptr<uint32_t>(counts);
#endif
    KV_RUN(confusion_matrix, pred, params, samples, 4 * pred.size(1) + classes * classes);
  };
  bytes ? run(Type<uint8_t>{}) : run(Type<int64_t>{});
  return result;
}

}  // namespace

KV_OPERATOR(confusion_matrix, "(Tensor pred, Tensor target, int classes, int statistic, float eps) -> Tensor")

}  // namespace kv::metrics
