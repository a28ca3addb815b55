// Maps of lenses, vortices, grids and splines: schemas and entries, for CPU and CUDA.
#include "augmentation/distortion/displacement_map.h"
#include "augmentation/lists/listed_maps_glue.h"

namespace kv::augmentation {
namespace {

// Of rows (B, n), float32 or float64, of n numbers that the kind asks for, and numbers of all samples.
template <class T>
DisplacementMap<T> map_parameters(Tensor const& rows, Tensor const& y, int64_t kind,
                                  std::vector<double> const& numbers) {
  DisplacementMap<T> params{
      data_ptr<T const>(rows), data_ptr<T>(y), rows.size(0), rows.size(1), 0, 0, MapKind(kind), {}};
  for (int i = 0; i < kMapNumbers; ++i) params.numbers[i] = T(numbers[size_t(i)]);
  return params;
}

void check_map(char const* op, Tensor const& rows, int64_t kind, std::vector<double> const& numbers) {
  KV_CHECK(rows.dim() == 2 && rows.scalar_type() == compute_dtype(rows), op,
           ": expected float32 or float64 rows of shape (B, n)");
  KV_CHECK(kind >= 0 && kind < kMapKinds, op, ": there is no kind of maps ", kind);
  KV_CHECK(int64_t(numbers.size()) == kMapNumbers, op, ": expected ", kMapNumbers, " numbers");
  int64_t const columns = rows.size(1);
  auto const fits = [&] {
    switch (MapKind(kind)) {
      case MapKind::camera:
        return columns == 2;
      case MapKind::fisheye_lens:
        return columns == 1;
      case MapKind::swirl:
        return columns == 4;
      case MapKind::cells:
        return columns >= 2 && columns % 2 == 0;
      case MapKind::triangles:
        return numbers[0] >= 2 && numbers[1] >= 2 && numbers[0] <= double(columns) && numbers[1] <= double(columns) &&
               columns == 3 + 2 * int64_t(numbers[0]) * int64_t(numbers[1]);
      case MapKind::fisheye:
        return columns == 3;
      default:
        return columns >= 10 && columns % 4 == 2;
    }
  };
  KV_CHECK(fits(), op, ": expected rows of as many numbers as the kind has, got ", columns);
}

template <class Run>
void dispatch_rows(Tensor const& rows, Run run) {
  rows.scalar_type() == ScalarType::Double ? run(Type<double>{}) : run(Type<float>{});
}

Tensor displacement_map(Tensor const& rows, int64_t kind, std::vector<double> const& numbers,
                        std::vector<int64_t> const& size) {
  constexpr char const* op = "displacement_map";
  check_map(op, rows, kind, numbers);
  KV_CHECK(size.size() == 2 && size[0] >= 0 && size[1] >= 0 && size[0] <= INT32_MAX / 2 && size[1] <= INT32_MAX / 2 &&
               (rows.is_cpu() || (rows.size(0) <= 65535 && size[0] <= 32 * 65535)),
           op, ": expected a size of sides below 2^30, and on CUDA at most 65535 rows of at most 2 million pixels");
  Tensor const own = dense(rows), y = empty({rows.size(0), 2, size[0], size[1]}, rows);
  dispatch_rows(rows, [&]<class T>(Type<T>) {
    auto params = map_parameters<T>(own, y, kind, numbers);
    params.height = size[0], params.width = size[1];
    KV_RUN(displacement_map, rows, params, y.numel() ? params.batch * params.height : 0, 40 * params.width);
  });
  return y;
}

// Maps (2, H, W) of a size each, height and width, one after the other in one tensor, each at a multiple of kMapUnit
// numbers; 0 where `chosen`, (B,) float32, is 0.
Tensor displacement_map_list(Tensor const& rows, std::optional<Tensor> const& chosen, int64_t kind,
                             std::vector<double> const& numbers, std::vector<int64_t> const& sides) {
  constexpr char const* op = "displacement_map_list";
  check_map(op, rows, kind, numbers);
  int64_t const count = rows.size(0);
  MapBlock const block(op, count, sides);
  KV_CHECK(!chosen || (chosen->dim() == 1 && chosen->size(0) == count && chosen->scalar_type() == ScalarType::Float &&
                       chosen->device() == rows.device()),
           op, ": expected chosen of shape (B,), float32, on the device of the rows");
  Tensor const own = dense(rows), y = block.empty_like(rows);
  dispatch_rows(rows, [&]<class T>(Type<T>) {
    DisplacementMapList<T> p;
    auto const all = map_parameters<T>(own, y, kind, numbers);
    block.for_each_table(p.list, [&](int64_t first) {
      p.all = all;
      p.all.rows += first * all.columns;
      p.chosen_stride = chosen ? chosen->stride(0) : 0;
      p.chosen = chosen ? data_ptr<float const>(*chosen) + first * p.chosen_stride : nullptr;
      KV_RUN(displacement_map_list, rows, p, p.list.items, 40 * kItemPixels);
    });
  });
  return y;
}

}  // namespace

KV_OPERATOR(displacement_map, "(Tensor rows, int kind, float[] numbers, SymInt[] size) -> Tensor")
KV_OPERATOR(displacement_map_list, "(Tensor rows, Tensor? chosen, int kind, float[] numbers, SymInt[] size) -> Tensor")

}  // namespace kv::augmentation
