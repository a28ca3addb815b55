// Maps of lenses, vortices and grids: schema and entry, for CPU and CUDA.
#include "augmentation/distortion/displacement_map.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// Rows (B, n), float32 or float64, of n numbers that the kind asks for; numbers of all samples; height and width.
Tensor displacement_map(Tensor const& rows, int64_t kind, std::vector<double> const& numbers,
                        std::vector<int64_t> const& size) {
  constexpr char const* op = "displacement_map";
  KV_CHECK(rows.dim() == 2 && rows.scalar_type() == compute_dtype(rows), op,
           ": expected float32 or float64 rows of shape (B, n)");
  KV_CHECK(kind >= 0 && kind < kMapKinds, op, ": there is no kind of maps ", kind);
  KV_CHECK(int64_t(numbers.size()) == kMapNumbers, op, ": expected ", kMapNumbers, " numbers");
  KV_CHECK(size.size() == 2 && size[0] >= 0 && size[1] >= 0 && size[0] <= INT32_MAX / 2 && size[1] <= INT32_MAX / 2 &&
               (rows.is_cpu() || (rows.size(0) <= 65535 && size[0] <= 32 * 65535)),
           op, ": expected a size of sides below 2^30, and on CUDA at most 65535 rows of at most 2 million pixels");
  int64_t const batch = rows.size(0), columns = rows.size(1);
  bool fits = columns == (MapKind(kind) == MapKind::lens ? 2 : 4);
  if (MapKind(kind) == MapKind::cells) fits = columns >= 2 && columns % 2 == 0;
  if (MapKind(kind) == MapKind::triangles)
    fits = numbers[0] >= 2 && numbers[1] >= 2 && numbers[0] <= columns && numbers[1] <= columns &&
           columns == 3 + 2 * int64_t(numbers[0]) * int64_t(numbers[1]);
  KV_CHECK(fits, op, ": expected rows of as many numbers as the kind has, got ", columns);
  Tensor const own = dense(rows), y = empty({batch, 2, size[0], size[1]}, rows);
  auto const run = [&]<class T>(Type<T>) {
    DisplacementMap<T> params{
        data_ptr<T const>(own), data_ptr<T>(y), batch, columns, size[0], size[1], MapKind(kind), {}};
    for (int i = 0; i < kMapNumbers; ++i) params.numbers[i] = T(numbers[size_t(i)]);
    KV_RUN(displacement_map, rows, params, y.numel() ? batch * params.height : 0, 40 * params.width);
  };
  rows.scalar_type() == ScalarType::Double ? run(Type<double>{}) : run(Type<float>{});
  return y;
}

}  // namespace

KV_OPERATOR(displacement_map, "(Tensor rows, int kind, float[] numbers, SymInt[] size) -> Tensor")

}  // namespace kv::augmentation
