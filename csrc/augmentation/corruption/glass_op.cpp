// Pixels that read neighbors: schema and entry, for CPU and CUDA.
#include "augmentation/corruption/glass.h"
#include "augmentation/noise_glue.h"
#include "geometry/transform/lists/list_glue.h"
#include "geometry/transform/lists/list_numbers_glue.h"

namespace kv::augmentation {
namespace {

// Of images, of which a list has the largest.
void check_moves(NoiseSource const& source, int64_t max_delta, int64_t steps) {
  source.check();
  KV_CHECK(max_delta >= 1 && max_delta <= ReadNeighbors<float>::kMaxDelta && steps >= 0 && steps <= 65535, source.op,
           ": max_delta or steps out of range");
  int64_t const pixels = source.images.size(2) * source.images.size(3);
  KV_CHECK(pixels <= INT32_MAX / 2 && steps * ((pixels + 3) / 4) <= UINT32_MAX, source.op,
           ": expected at most 2^30 pixels, and 2^34 moves");
}

// Images; uniform (B, 2 steps, H, W) float32 in place of drawn numbers; the others as those of gaussian_noise.
Tensor read_neighbors(Tensor const& images, Tensor const& keys, std::optional<Tensor> const& seeds,
                      std::optional<Tensor> const& uniform, std::vector<int64_t> const& plan, int64_t max_delta,
                      int64_t steps) {
  constexpr char const* op = "read_neighbors";
  check_images(op, "images", images);
  int64_t const batch = images.size(0), height = images.size(2), width = images.size(3);
  NoiseSource const source{op, images, keys, seeds, plan};
  check_moves(source, max_delta, steps);
  if (uniform)
    KV_CHECK(uniform->dim() == 4 && uniform->size(0) == batch && uniform->size(1) == 2 * steps &&
                 uniform->size(2) == height && uniform->size(3) == width &&
                 uniform->scalar_type() == ScalarType::Float && uniform->device() == images.device(),
             op, ": expected float32 uniform of shape (B, 2 steps, H, W) on the device of images");
  Tensor const y = empty_like(images, layout_of(images));
  std::optional<Tensor> const u = uniform ? std::optional<Tensor>(dense(*uniform)) : std::nullopt;
  dispatch_floating_and_uint8(op, images, [&]<class T>(Type<T>) {
    ReadNeighbors<T> params{};
    source.set(params.noise);
    params.noise.pixels = height * width;
    params.noise.uniform = u ? data_ptr<float const>(*u) : nullptr, params.noise.uniform_planes = 2 * steps;
    params.x = data_ptr<T const>(images), params.y = data_ptr<T>(y);
    params.batch = batch, params.channels = images.size(1), params.height = height, params.width = width;
    for (int i = 0; i < 4; ++i) params.x_strides[i] = images.stride(i), params.y_strides[i] = y.stride(i);
    params.max_delta = int(max_delta), params.steps = int(steps);
    KV_RUN(read_neighbors, images, params, images.numel() ? batch * height : 0, width * (16 * steps + 1));
  });
  return y;
}

// What moves the pixels of images (C, H, W) of different sizes; those that are not `chosen`, (B,) float32, are copied.
struct ListedMoves {
  Tensor const& like;  // stands for a batch
  std::optional<Tensor> const& chosen;
  NoiseSource source;
  int64_t max_delta, steps;
  ListedNumbers numbers;

  ListedMoves(geometry::ListSides const& list, std::optional<Tensor> const& chosen, Tensor const& keys,
              std::optional<Tensor> const& seeds, std::optional<Tensor> const& uniform,
              std::vector<int64_t> const& plan, int64_t max_delta, int64_t steps)
      : like(list.largest),
        chosen(chosen),
        source{list.op, like, keys, seeds, plan},
        max_delta(max_delta),
        steps(steps),
        numbers(list.op, uniform, 2 * steps, like, list.sides) {
    check_chosen(list.op, chosen, like);
    check_moves(source, max_delta, steps);
  }
  // Of the samples from `first` on.
  template <class T>
  ReadNeighbors<T> params(size_t first) const {
    ReadNeighbors<T> all{};
    source.set(all.noise);
    set_chosen(all.noise, chosen);
    all.noise.skip(int64_t(first));
    numbers.set(all.noise, first);
    all.channels = like.size(1), all.max_delta = int(max_delta), all.steps = int(steps);
    return all;
  }
  int64_t cost() const { return 16 * steps + 1; }
};

Tensors read_neighbors_list(Tensors const& images, std::optional<Tensor> const& chosen, Tensor const& keys,
                            std::optional<Tensor> const& seeds, std::optional<Tensor> const& uniform,
                            std::vector<int64_t> const& plan, int64_t max_delta, int64_t steps) {
  geometry::KeptSizes const kept("read_neighbors_list", images);
  ListedMoves const moves(kept, chosen, keys, seeds, uniform, plan, max_delta, steps);
  dispatch_floating_and_uint8(kept.op, kept.largest, [&]<class T>(Type<T>) {
    ReadNeighborsList<T> p;
    auto const items_of = [](geometry::Size size) { return ceil_div(size.height, rows_of_item(size.width)); };
    kept.for_each_table(p.list, images, items_of, [&](size_t first) {
      p.all = moves.params<T>(first);
      KV_RUN(read_neighbors_list, kept.largest, p, p.list.items, kItemPixels * moves.cost());
    });
  });
  return kept.results;
}

// The gradients of images, for those of the results.
Tensors read_neighbors_list_backward(Tensors const& grads, std::optional<Tensor> const& chosen, Tensor const& keys,
                                     std::optional<Tensor> const& seeds, std::optional<Tensor> const& uniform,
                                     std::vector<int64_t> const& plan, int64_t max_delta, int64_t steps) {
  constexpr char const* op = "read_neighbors_list_backward";
  geometry::ListSides const sides(op, grads);
  ListedMoves const moves(sides, chosen, keys, seeds, uniform, plan, max_delta, steps);
  Tensor const& like = sides.largest;
  Tensors const sums = sides.empty(Layout::planar, compute_dtype(like));
  geometry::clear_sums(sums);
  dispatch_floating(op, like, [&]<class T>(Type<T>) {
    ReadNeighborsBackwardList<T> p;
    auto const one = [](geometry::Size) { return int64_t(1); };
    sides.for_each_table(p.list, grads, sums, Layout::planar, one, [&](size_t first) {
      p.all = moves.params<T>(first);
      KV_RUN(read_neighbors_list_backward, like, p, p.list.items, like.size(2) * like.size(3) * moves.cost());
    });
  });
  return geometry::sums_of_type(sums, like.scalar_type());
}

}  // namespace

KV_OPERATOR(read_neighbors,
            "(Tensor images, Tensor keys, Tensor? seeds, Tensor? uniform, int[] plan, int max_delta, int steps) "
            "-> Tensor")
KV_OPERATOR(read_neighbors_list,
            "(Tensor[] images, Tensor? chosen, Tensor keys, Tensor? seeds, Tensor? uniform, int[] plan, int max_delta, "
            "int steps) -> Tensor[]")
KV_OPERATOR(read_neighbors_list_backward,
            "(Tensor[] grads, Tensor? chosen, Tensor keys, Tensor? seeds, Tensor? uniform, int[] plan, int max_delta, "
            "int steps) -> Tensor[]")

}  // namespace kv::augmentation
