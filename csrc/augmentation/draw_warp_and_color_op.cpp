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

// The numbers of the draws of the first request, for each image: those that draw windows in it have its size.
std::vector<double> listed_numbers(DrawParameters<float> const& p, Tensors const& images, size_t& width) {
  width = 0;
  int const end = draws_of_first(p);
  for (int i = 0; i < end; ++i) width += size_t(kDrawNumbers[int(p.draws[i].kind)]);
  std::vector<double> listed(images.size() * width);
  for (size_t b = 0; b < images.size(); ++b) {
    double* const own = listed.data() + b * width;
    std::copy_n(p.numbers + kFirstListed, width, own);
    for (int i = 0; i < end; ++i) {
      DrawKind const kind = p.draws[i].kind;
      if (kind != DrawKind::resized_crop && kind != DrawKind::rectangle) continue;
      double* const size = own + p.draws[i].number - kFirstListed + kDrawNumbers[int(kind)] - 2;
      size[0] = double(images[b].size(1));
      size[1] = double(images[b].size(2));
    }
  }
  return listed;
}

// The same of images (C, H, W) of different sizes, to which the warp gives one size. The first request draws for these.
std::tuple<Tensor, Tensor, Tensor> draw_list_warp_and_color(Tensors const& list, Tensor const& keys,
                                                            std::optional<Tensor> const& seeds, Tensor const& plan,
                                                            Tensor const& numbers) {
  constexpr char const* op = "draw_list_warp_and_color";
  PassImages const images(op, list);
  PlanReader rest = read_plan(op, plan, numbers);
  auto const draws = rest.next_list();
  auto const params = draws_of(images.like, keys, seeds, draws, rest.next_numbers(rest.next_count()));
  auto const size = rest.next_list();
  KV_CHECK(!size.empty(), op, ": expected a size of the results");
  PlanReader of_pass = rest;
  of_pass.next(kPassOptions);
  size_t width;
  auto const listed = listed_numbers(params, list, width);
  auto const [columns, drawn_matrix] = draw_list_columns(op, images.like, params, listed, width, of_pass.next_chain());
  auto const pass_plan = rest.plan();
  auto const pass_numbers = rest.numbers();
  auto const [y, matrix, means] =
      run_pass(images, columns, {}, drawn_matrix, {size.begin(), size.end()}, {pass_plan.begin(), pass_plan.end()},
               {pass_numbers.begin(), pass_numbers.end()});
  return {y, *matrix, columns};
}

}  // namespace

KV_OPERATOR(draw_list_warp_and_color,
            "(Tensor[] images, Tensor keys, Tensor? seeds, Tensor plan, Tensor numbers) -> (Tensor, Tensor, Tensor)")
KV_OPERATOR(draw_warp_and_color,
            "(Tensor image, Tensor keys, Tensor? seeds, Tensor plan, Tensor numbers) -> (Tensor, Tensor, Tensor)")

}  // namespace kv::augmentation
