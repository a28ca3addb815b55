// Random parameters: schema and entry, for CPU and CUDA.
#include "augmentation/draws_glue.h"

namespace kv::augmentation {
namespace {

int64_t number_from(char const* op, std::span<int64_t const> plan, size_t i, int64_t lowest, int64_t highest,
                    char const* name) {
  KV_CHECK(i < plan.size(), op, ": the plan ends within a request");
  KV_CHECK(plan[i] >= lowest && plan[i] <= highest, op, ": expected ", name, " from ", lowest, " to ", highest,
           ", got ", plan[i]);
  return plan[i];
}

// Reads the plan, as make_plan in draws.py writes it: the number of columns, then for each request its key, position in
// the chain, same_on_batch, the index of its first draw, their number, and their kinds. The numbers of a request are p,
// p_batch and those of its draws.
void read_plan(char const* op, std::span<int64_t const> plan, std::span<double const> numbers, Tensor const& keys,
               bool has_seeds, DrawParameters<float>& p) {
  KV_CHECK(numbers.size() <= kMaxDrawNumbers, op, ": expected at most ", kMaxDrawNumbers, " numbers, got ",
           numbers.size());
  p.columns = int(number_from(op, plan, 0, 0, UINT16_MAX, "columns"));
  int64_t const num_keys = has_seeds ? 1 : keys.size(0);
  int64_t const* const host_keys = has_seeds || p.keys ? nullptr : data_ptr<int64_t const>(keys);
  size_t number = 0;
  int column = 0;
  for (size_t at = 1; at < plan.size();) {
    int64_t const key = number_from(op, plan, at, 0, has_seeds ? INT64_MAX : num_keys - 1, "a key"),
                  position = number_from(op, plan, at + 1, 0, UINT32_MAX, "a position"),
                  same = number_from(op, plan, at + 2, 0, 1, "same_on_batch"),
                  first = number_from(op, plan, at + 3, 1, UINT16_MAX - kMaxDraws, "the index of a draw"),
                  count = number_from(op, plan, at + 4, 0, kMaxDraws - p.count, "the number of draws");
    uint16_t const probability = uint16_t(number);
    number += 2;
    at += 5;
    for (int64_t i = 0; i < count; ++i, ++at) {
      int64_t const kind = number_from(op, plan, at, 0, kDrawKinds - 1, "a kind of draw");
      size_t const next = number + size_t(kDrawNumbers[kind]);
      KV_CHECK(next <= numbers.size(), op, ": expected more numbers than ", numbers.size());
      int columns = kDrawColumns[kind];
      if (!columns) {
        KV_CHECK(numbers[number] >= 0 && numbers[number] <= p.columns, op, ": expected up to ", p.columns,
                 " columns of a draw, got ", numbers[number]);
        columns = int(numbers[number]);
      }
      KV_CHECK(column + columns <= p.columns, op, ": the draws have more columns than ", p.columns);
      p.draws[p.count++] = {host_keys ? host_keys[key * keys.stride(0)] : key,
                            uint32_t(position),
                            uint16_t(first + i),
                            uint16_t(column),
                            uint16_t(number),
                            probability,
                            DrawKind(kind),
                            same != 0};
      number = next;
      column += columns;
    }
  }
  KV_CHECK(number == numbers.size() && column == p.columns, op, ": the draws take ", number, " numbers and give ",
           column, " columns, got ", numbers.size(), " and ", p.columns);
  for (size_t i = 0; i < numbers.size(); ++i) p.numbers[i] = numbers[i];
}

}  // namespace

// Of the images only the device and the size of the batch count. Keys (K,) on the CPU are read here, on the stream of
// no device; those on the device of the images by the kernel, for replays of CUDA graphs.
DrawParameters<float> draws_of(Tensor const& images, Tensor const& keys, std::optional<Tensor> const& seeds,
                               std::span<int64_t const> plan, std::span<double const> numbers, char const* op) {
  KV_CHECK(images.dim() > 0, op, ": expected images of shape (B, ...)");
  int64_t const batch = images.size(0);
  KV_CHECK(keys.dim() == 1 && keys.scalar_type() == ScalarType::Long, op, ": expected int64 keys of shape (K,)");
  KV_CHECK(keys.is_cpu() || keys.device() == images.device(), op,
           ": expected keys on the CPU or on the device of the images");
  if (seeds)
    KV_CHECK(seeds->dim() == 1 && (seeds->size(0) == batch || seeds->size(0) == 1) &&
                 seeds->scalar_type() == ScalarType::Long && seeds->device() == images.device(),
             op, ": expected int64 seeds of shape (B,) on the device of the images");
  DrawParameters<float> params;
  params.batch = batch;
  params.keys = keys.is_cpu() ? nullptr : data_ptr<int64_t const>(keys);
  params.key_stride = keys.stride(0);
  params.seeds = seeds ? data_ptr<int64_t const>(*seeds) : nullptr;
  params.seed_stride = seeds && seeds->size(0) > 1 ? seeds->stride(0) : 0;
  params.count = 0;
  read_plan(op, plan, numbers, keys, seeds.has_value(), params);
  return params;
}

namespace {

Tensor draw_parameters(Tensor const& images, Tensor const& keys, std::optional<Tensor> const& seeds,
                       std::vector<int64_t> const& plan, std::vector<double> const& numbers) {
  auto params = draws_of(images, keys, seeds, plan, numbers);
  Tensor const result = columns_for(params, images);
  KV_RUN(draw_parameters, images, params, params.count ? params.batch : 0, 64 * params.count);
  return result;
}

Tensor draw_list_parameters(Tensor const& images, Tensor const& keys, std::optional<Tensor> const& seeds,
                            std::vector<int64_t> const& plan, std::vector<double> const& numbers,
                            std::vector<double> const& listed, std::vector<int64_t> const& draws) {
  constexpr char const* op = "draw_list_parameters";
  DrawListParameters<float> params;
  params.all = draws_of(images, keys, seeds, plan, numbers, op);
  size_t const width = list_draws(op, params.all, draws, listed);
  Tensor const result = columns_for(params.all, images);
  if (params.all.count)
    for_each_listed(params, listed, width,
                    [&] { KV_RUN(draw_list_parameters, images, params, params.count, 64 * params.all.count); });
  return result;
}

}  // namespace

KV_OPERATOR(draw_parameters, "(Tensor images, Tensor keys, Tensor? seeds, int[] plan, float[] numbers) -> Tensor")
// `listed` has the numbers of each sample of the draws that are listed, which replace those among `numbers`.
KV_OPERATOR(draw_list_parameters,
            "(Tensor images, Tensor keys, Tensor? seeds, int[] plan, float[] numbers, float[] listed, int[] draws) -> "
            "Tensor")

}  // namespace kv::augmentation
