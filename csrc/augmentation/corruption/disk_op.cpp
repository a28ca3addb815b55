// Disks: schema and entry, for CPU and CUDA.
#include "augmentation/corruption/disk.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// Deviations (B,), float32 or float64, and radii (B,) int64; the largest radius.
Tensor disk_kernels(Tensor const& deviations, Tensor const& radii, int64_t largest) {
  constexpr char const* op = "disk_kernels";
  KV_CHECK(deviations.dim() == 1 && deviations.scalar_type() == compute_dtype(deviations), op,
           ": expected float32 or float64 deviations of shape (B,)");
  int64_t const batch = deviations.size(0);
  KV_CHECK(radii.dim() == 1 && radii.size(0) == batch && radii.scalar_type() == ScalarType::Long &&
               radii.device() == deviations.device(),
           op, ": expected int64 radii of shape (B,) on the device of deviations");
  KV_CHECK(largest >= 0 && largest <= 4096, op, ": expected largest from 0 to 4096");
  int64_t const reach = largest < kDiskWindow ? largest + 1 : largest;
  Tensor const y = empty({batch, 2 * reach + 1, 2 * reach + 1}, deviations);
  auto const run = [&]<class T>(Type<T>) {
    DiskKernels<T> const params{data_ptr<T const>(deviations),
                                data_ptr<int64_t const>(radii),
                                data_ptr<T>(y),
                                batch,
                                deviations.stride(0),
                                radii.stride(0),
                                int(reach)};
    KV_RUN(disk_kernels, deviations, params, batch, 100 * params.side() * params.side());
  };
  deviations.scalar_type() == ScalarType::Double ? run(Type<double>{}) : run(Type<float>{});
  return y;
}

}  // namespace

KV_OPERATOR(disk_kernels, "(Tensor deviations, Tensor radii, int largest) -> Tensor")

}  // namespace kv::augmentation
