// Counts of labels: schema and entry, for CPU and CUDA alike.
#include "confusion.h"
#include "glue/glue.h"

namespace kv {
namespace {

constexpr int64_t kMostLabels = 1 << 15;  // their pairs fit 32 bits

Confused confused_of(std::string const& name) {
  if (name == "counts") return Confused::counts;
  if (name == "rates") return Confused::rates;
  KV_CHECK(name == "overlaps", "confusion: wanted must be one of counts, rates, overlaps; got '", name, "'");
  return Confused::overlaps;
}

Tensor confusion(Tensor const& pred, Tensor const& target, int64_t classes, std::string const& wanted, double eps) {
  constexpr char const* op = "confusion";
  KV_CHECK(pred.dim() == 2 && target.dim() == 2 && pred.size(0) == target.size(0) && pred.size(1) == target.size(1) &&
               pred.scalar_type() == target.scalar_type() && pred.device() == target.device(),
           op, ": expected pred and target (samples, pixels) of one type on one device");
  bool const bytes = pred.scalar_type() == ScalarType::Byte;
  KV_CHECK(bytes || pred.scalar_type() == ScalarType::Long, op, ": expected labels of int64 or uint8");
  KV_CHECK(classes >= 1 && classes <= kMostLabels, op, ": expected 1 to ", kMostLabels, " classes, got ", classes);
  KV_CHECK(pred.size(1) < int64_t(1) << 32, op, ": expected less than 2^32 pixels in a sample");
  Confused const kind = confused_of(wanted);
  Tensor const p = dense(pred), t = dense(target);
  int64_t const samples = pred.size(0);
  std::vector<int64_t> const sizes = kind == Confused::overlaps ? std::vector<int64_t>{samples, classes}
                                                                : std::vector<int64_t>{samples, classes, classes};
  Tensor const found = empty(sizes, pred, Layout::planar, ScalarType::Float);
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    Confusion<T> params{data_ptr<T const>(p), data_ptr<T const>(t),   samples, pred.size(1), int(classes), kind,
                        float(eps),           data_ptr<float>(found), nullptr};
#if defined(KV_CUDA)
    Tensor const counts = empty({samples, classes, classes}, pred, Layout::planar, ScalarType::Int);
    params.counts = data_ptr<uint32_t>(counts);
#endif
    KV_RUN(confusion, pred, params, samples, 4 * pred.size(1) + classes * classes);
  };
  bytes ? run(Type<uint8_t>{}) : run(Type<int64_t>{});
  return found;
}

}  // namespace

KV_OPERATOR(confusion, "(Tensor pred, Tensor target, int classes, str wanted, float eps) -> Tensor")

}  // namespace kv
