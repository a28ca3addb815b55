// Random parameters and the pass over images that reads them, as one operator. Two operators would cost the host twice:
// most of the time of a call on a small image is spent in torch's dispatcher.
#include "augmentation/drawn_glue.h"
#include "augmentation/warp_and_color_glue.h"

namespace kv::augmentation {
namespace {

// The plan is written by DrawnPass in drawn_pass.py: the length of the plan of the draws, and that plan; how many of
// the numbers belong to the draws; the length of the size of the result, and that size; the plan of the pass. Returns
// the result, the matrices of the warp, and the columns; without a warp the columns also stand for the matrices.
std::tuple<Tensor, Tensor, Tensor> draw_warp_and_color(Tensor const& image, Tensor const& keys,
                                                       std::optional<Tensor> const& seeds, Tensor const& plan,
                                                       Tensor const& numbers) {
  constexpr char const* op = "draw_warp_and_color";
  PlanReader rest = read_plan(op, plan, numbers);
  auto const draws = rest.next_list();
  auto params = draws_of(image, keys, seeds, draws, rest.next_numbers(rest.next_count()));
  auto const size = rest.next_list();
  ChainPlan chain;
  if (!size.empty()) {
    PlanReader of_pass = rest;
    of_pass.next(kPassOptions);
    chain = of_pass.next_chain();
  }
  auto const [columns, drawn_matrix] = draw_columns(op, image, params, chain);
  auto const of_pass = rest.plan();
  auto const pass_numbers = rest.numbers();
  auto const [y, matrix, means] =
      run_pass(image, columns, {}, drawn_matrix, {size.begin(), size.end()}, {of_pass.begin(), of_pass.end()},
               {pass_numbers.begin(), pass_numbers.end()});
  return {y, matrix ? *matrix : columns, columns};
}

// Lists the draws of the first request that draw windows in images of any size, and gives their numbers for each image.
std::vector<double> listed_windows(char const* op, DrawParameters<float>& p, Tensors const& images, size_t& width) {
  std::vector<int64_t> windows;
  std::vector<double> own;
  for (int i = 0; i < p.count && p.draws[i].probability == 0; ++i) {
    DrawKind const kind = p.draws[i].kind;
    if (kind != DrawKind::resized_crop && kind != DrawKind::rectangle) continue;
    windows.push_back(i);
    own.insert(own.end(), p.numbers + p.draws[i].number, p.numbers + p.draws[i].number + kDrawNumbers[int(kind)]);
  }
  width = list_draws(op, p, windows);
  std::vector<double> listed;
  listed.reserve(images.size() * width);
  for (Tensor const& x : images) {
    size_t end = 0;
    for (int64_t const i : windows) {
      end += size_t(kDrawNumbers[int(p.draws[i].kind)]);
      own[end - 2] = double(x.size(1)), own[end - 1] = double(x.size(2));  // their last numbers
    }
    listed.insert(listed.end(), own.begin(), own.end());
  }
  return listed;
}

// Heights and widths (B, 2) of images, like a tensor of integers.
Tensor sizes_of(Tensors const& images, Tensor const& like) {
  Tensor const sizes = empty({int64_t(images.size()), 2}, like);
  int64_t* to = data_ptr<int64_t>(sizes);
  for (Tensor const& x : images) *to++ = x.size(1), *to++ = x.size(2);
  return sizes;
}

// The same of images (C, H, W) of different sizes, to which the warp gives one size. The first request draws for these.
// The last results are heights and widths (B, 2), on the CPU: to ask each image takes Python longer than all else; and
// the means of contrast, without which the columns stand for them.
std::tuple<Tensor, Tensor, Tensor, Tensor, Tensor> draw_list_warp_and_color(Tensors const& list, Tensor const& keys,
                                                                            std::optional<Tensor> const& seeds,
                                                                            Tensor const& plan, Tensor const& numbers) {
  constexpr char const* op = "draw_list_warp_and_color";
  PassImages const images(op, list);
  PlanReader rest = read_plan(op, plan, numbers);
  auto const draws = rest.next_list();
  auto params = draws_of(images.like, keys, seeds, draws, rest.next_numbers(rest.next_count()));
  auto const size = rest.next_list();
  KV_CHECK(!size.empty(), op, ": expected a size of the results");
  PlanReader of_pass = rest;
  of_pass.next(kPassOptions);
  size_t width;
  auto const listed = listed_windows(op, params, list, width);
  auto const [columns, drawn_matrix] = draw_list_columns(op, images.like, params, listed, width, of_pass.next_chain());
  auto const pass_plan = rest.plan();
  auto const pass_numbers = rest.numbers();
  auto const [y, matrix, means] =
      run_pass(images, columns, {}, drawn_matrix, {size.begin(), size.end()}, {pass_plan.begin(), pass_plan.end()},
               {pass_numbers.begin(), pass_numbers.end()});
  return {y, *matrix, columns, sizes_of(list, plan), means ? *means : columns};
}

// The numbers of each image that are functions of its size, `linear` (3, N): a constant, and the factors of height and
// width.
std::vector<double> numbers_of_sizes(char const* op, Tensors const& list, Tensor const& linear) {
  KV_CHECK(linear.is_cpu() && linear.scalar_type() == ScalarType::Double && linear.is_contiguous() &&
               linear.dim() == 2 && linear.size(0) == 3,
           op, ": expected float64 numbers of shape (3, N) on the CPU");
  double const* const constant = data_ptr<double const>(linear);
  int64_t const width = linear.size(1);
  std::vector<double> own;
  own.reserve(list.size() * size_t(width));
  for (Tensor const& x : list) {
    double const h = double(x.size(1)), w = double(x.size(2));
    for (int64_t k = 0; k < width; ++k)
      own.push_back(constant[k] + h * constant[width + k] + w * constant[2 * width + k]);
  }
  return own;
}

// The columns alone, with numbers of the sizes of images, and these sizes (B, 2) on the CPU. The plan is that of the
// draws, how many numbers belong to them, and the draws that are listed.
std::tuple<Tensor, Tensor> draw_sized_parameters(Tensors const& list, Tensor const& keys,
                                                 std::optional<Tensor> const& seeds, Tensor const& linear,
                                                 Tensor const& plan, Tensor const& numbers) {
  constexpr char const* op = "draw_sized_parameters";
  PassImages const images(op, list);
  PlanReader rest = read_plan(op, plan, numbers);
  auto const draws = rest.next_list();
  auto params = draws_of(images.like, keys, seeds, draws, rest.next_numbers(rest.next_count()), op);
  std::vector<double> const own = numbers_of_sizes(op, list, linear);
  list_draws(op, params, rest.next_list(), own);
  auto const [columns, matrix] = draw_list_columns(op, images.like, params, own, size_t(linear.size(1)), ChainPlan{});
  return {columns, sizes_of(list, plan)};
}

// The numbers of each image, given by `linear` functions or as (B, N) on the CPU.
std::vector<double> numbers_of_images(char const* op, Tensors const& list, Tensor const& given, bool linear) {
  if (linear) return numbers_of_sizes(op, list, given);
  KV_CHECK(given.is_cpu() && given.scalar_type() == ScalarType::Double && given.is_contiguous() && given.dim() == 2 &&
               given.size(0) == int64_t(list.size()),
           op, ": expected float64 numbers of shape (B, N) on the CPU");
  double const* const data = data_ptr<double const>(given);
  return {data, data + given.numel()};
}

// Takes the last two of the `width` numbers of each image, which are height and width of its result.
std::vector<int64_t> taken_sizes(char const* op, std::vector<double>& numbers, size_t count, size_t width) {
  KV_CHECK(width >= 2, op, ": expected height and width of the results among the numbers");
  std::vector<int64_t> sides;
  sides.reserve(2 * count);
  auto to = numbers.begin();
  for (auto from = numbers.begin(); from != numbers.end(); from += 2) {
    for (size_t k = 2; k < width; ++k) *to++ = *from++;
    sides.push_back(int64_t(from[0])), sides.push_back(int64_t(from[1]));
  }
  numbers.resize(numbers.size() - sides.size());
  return sides;
}

// The same of images whose results are a list. `of_images` has the numbers of each, as `linear` functions or as they
// are. The plan has the listed draws behind the count of the draws' numbers, and one number instead of a size if there
// is a warp: 1 if the results have sizes of their own, which are behind the numbers of the draws. Behind the results
// are matrices, columns and sizes of images.
Tensors draw_warp_and_color_to_list(Tensors const& list, Tensor const& keys, std::optional<Tensor> const& seeds,
                                    Tensor const& of_images, bool linear, Tensor const& plan, Tensor const& numbers) {
  constexpr char const* op = "draw_warp_and_color_to_list";
  PassImages const images(op, list);
  PlanReader rest = read_plan(op, plan, numbers);
  auto const draws = rest.next_list();
  auto params = draws_of(images.like, keys, seeds, draws, rest.next_numbers(rest.next_count()));
  std::vector<double> own = numbers_of_images(op, list, of_images, linear);
  size_t width = size_t(of_images.size(1));
  auto const listed = rest.next_list(), warp = rest.next_list();
  bool const warps = !warp.empty();
  std::vector<int64_t> sides;
  if (warps && warp[0]) {
    sides = taken_sizes(op, own, list.size(), width);
    width -= 2;
  }
  list_draws(op, params, listed, own);
  PlanReader of_pass = rest;
  of_pass.next(kPassOptions);
  auto const [columns, drawn_matrix] =
      draw_list_columns(op, images.like, params, own, width, warps ? of_pass.next_chain() : ChainPlan{});
  auto const pass_plan = rest.plan();
  auto const pass_numbers = rest.numbers();
  auto [results, matrix, means] =
      run_pass_to_list(images, columns, {}, drawn_matrix, warps, sides, {pass_plan.begin(), pass_plan.end()},
                       {pass_numbers.begin(), pass_numbers.end()});
  results.push_back(matrix ? *matrix : columns);
  results.push_back(columns);
  results.push_back(sizes_of(list, plan));
  return results;
}

}  // namespace

KV_OPERATOR(
    draw_sized_parameters,
    "(Tensor[] images, Tensor keys, Tensor? seeds, Tensor linear, Tensor plan, Tensor numbers) -> (Tensor, Tensor)")
KV_OPERATOR(draw_warp_and_color_to_list,
            "(Tensor[] images, Tensor keys, Tensor? seeds, Tensor of_images, bool linear, Tensor plan, Tensor numbers) "
            "-> Tensor[]")
KV_OPERATOR(draw_list_warp_and_color,
            "(Tensor[] images, Tensor keys, Tensor? seeds, Tensor plan, Tensor numbers) -> "
            "(Tensor, Tensor, Tensor, Tensor, Tensor)")
KV_OPERATOR(draw_warp_and_color,
            "(Tensor image, Tensor keys, Tensor? seeds, Tensor plan, Tensor numbers) -> (Tensor, Tensor, Tensor)")

}  // namespace kv::augmentation
