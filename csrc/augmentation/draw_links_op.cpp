// Random parameters, and the links of a chain that follow from them: matrices and displacements, as one operator.
// Several operators would cost the host several times: most of the time of a call on a small image is spent in torch's
// dispatcher.
#include "augmentation/drawn_glue.h"
#include "augmentation/elastic_glue.h"

namespace kv::augmentation {
namespace {

// The plan is written by DrawnLinks in drawn_links.py: the length of the plan of the draws, and that plan; how many of
// the numbers belong to the draws; the number of matrices, and the length and the plan of the chain of each; then for
// each field of displacements height and width, the source of the noise (four integers, see NoiseSource), and the
// window of the blur. The numbers of a field are the standard deviations of the blur and the scales. Of the images only
// the device and the size of the batch count. Returns the columns, the matrices (B, 3, 3) and the displacements (B, 2,
// H, W), all in float32.
std::vector<Tensor> draw_links(Tensor const& image, Tensor const& keys, std::optional<Tensor> const& seeds,
                               Tensor const& plan, Tensor const& numbers) {
  constexpr char const* op = "draw_links";
  PlanReader rest = read_plan(op, plan, numbers);
  auto const draws = rest.next_list();
  auto params = draws_of(image, keys, seeds, draws, rest.next_numbers(rest.next_count()));
  int64_t const matrices = rest.next();
  ChainPlan chain = matrices > 0 ? rest.next_chain() : ChainPlan{};
  auto const [columns, first] = draw_columns(op, image, params, chain);
  std::vector<Tensor> results{columns};
  for (int64_t i = 0; i < matrices; ++i) {
    if (i > 0) chain = rest.next_chain();
    results.push_back(i == 0 && first ? *first : chain_matrix(op, columns, chain.plan, chain.numbers));
  }
  while (!rest.plan().empty()) {
    auto const size = rest.next(2), source = rest.next(4), window = rest.next(2);
    auto const blur = rest.next_numbers(4);
    KV_CHECK(size[0] > 0 && size[1] > 0, op, ": expected a field of displacements with pixels");
    Tensor const field = empty({params.batch, 2, size[0], size[1]}, image, Layout::planar, ScalarType::Float);
    NoiseSource const noise{op, field, keys, seeds, source};
    write_displacements(op, nullptr, &noise, {window[0], window[1], blur[0], blur[1], {blur[2], blur[3]}}, field);
    results.push_back(field);
  }
  return results;
}

}  // namespace

KV_OPERATOR(draw_links, "(Tensor image, Tensor keys, Tensor? seeds, Tensor plan, Tensor numbers) -> Tensor[]")

}  // namespace kv::augmentation
