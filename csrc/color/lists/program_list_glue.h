// Color programs on lists of images of different sizes, for the entries of operators.
#pragma once

#include "color/lists/program_list.h"
#include "color/program_glue.h"
#include "glue/image_list.h"

namespace kv::color {

// The images (C, H, W), of which those are copied whose pixels are not one row of planes or of interleaved pixels.
inline Tensors in_pixel_rows(Tensors const& images, Layout layout) {
  Tensors rows;
  rows.reserve(images.size());
  for (Tensor const& x : images) {
    auto const sizes = x.sizes(), strides = x.strides();
    int64_t const channels = sizes[0], width = sizes[2], pixels = sizes[1] * width;
    bool const last = layout == Layout::channels_last;
    int64_t const step = last ? channels : 1;
    bool const fits = (channels == 1 || strides[0] == (last ? 1 : pixels)) && (width == 1 || strides[2] == step) &&
                      (sizes[1] == 1 || strides[1] == width * step);
    if (fits) {
      rows.push_back(x);
      continue;
    }
    Tensor const copy = as_layout(dense(as_batch(x)), layout);
    rows.push_back(view_of(copy, {channels, sizes[1], width}, {copy.stride(1), copy.stride(2), copy.stride(3)}));
  }
  return rows;
}

// Runs a program on images of a layout whose results exist already, and returns the means that contrast was taken
// around. `like` is a batch of as many images, in the layout of the results.
inline Tensor run_program_on_list(char const* op, Tensors const& images, Layout layout, Tensors const& results,
                                  Tensor const& like, ProgramArguments const& a, PlanArgument const& plan,
                                  std::vector<double> const& numbers) {
  int64_t const batch = int64_t(images.size()), channels = like.size(1);
  bool const around_mean = a.sequence.contrast >= 0;
  Tensor const means =
      around_mean ? empty({batch, 1}, like, Layout::planar, a.in_double ? ScalarType::Double : ScalarType::Float)
                  : like;
  Tensors const rows = in_pixel_rows(images, layout);
  a.dispatch_compute([&](auto type) {
    using F = typename decltype(type)::type;
    ProgramList<F> p;
    p.all = program_of<F>(a, {batch, 1, 0, a.per_value, false}, numbers, plan.columns);
    Layout const out = layout_of(like);
    auto const pixels_of = [&](Tensor const& x, Layout layout) -> Pixels {
      int64_t const count = x.size(0);
      return {nullptr, dtype_of(op, x), int(count), 1, 0, 0, 1, layout == Layout::planar ? 1 : count};
    };
    p.all.x = pixels_of(images[0], layout);
    p.all.y = pixels_of(results[0], out);
    p.samples = batch;
    if (around_mean) p.all.means = static_cast<F*>(means.mutable_data_ptr());
    // The table has the images that `is_in` says, of which items_of(pixels) is the number of items.
    int64_t parts = 0;
    auto const for_each_table = [&](auto is_in, auto items_of, auto run) {
      for (int64_t b = 0; b < batch;) {
        int64_t items = 0;
        parts = p.count = 0;
        for (; b < batch && p.count < kMaxListed; ++b) {
          Tensor const &x = rows[size_t(b)], &y = results[size_t(b)];
          int64_t const pixels = x.size(1) * x.size(2);
          bool const as_values = channels > 1 && a.samples(1, channels, pixels, layout == out).per_value;
          KV_CHECK(channels * pixels <= INT32_MAX, op, ": expected images of less than 2^31 elements");
          p.listed[p.count] = {x.const_data_ptr(), y.mutable_data_ptr(), int(b),    int(pixels),
                               int(items),         int(parts),           as_values, false};
          if (!is_in(p.count)) continue;
          int64_t const of_sample = as_values ? channels * pixels : pixels;
          items += items_of(of_sample);
          parts += mean_parts_of<F>(batch, of_sample);
          KV_CHECK(items <= INT32_MAX, op, ": expected less than 2^31 chunks of pixels");
          ++p.count;
        }
        p.items = int(items);
        if (p.count) run();
      }
    };
    // The samples of the table: by one launch, and where the compute type has no kernel for lists, by one for each.
    auto const run_table = [&] {
#if defined(KV_CUDA)
      if constexpr (sizeof(F) > sizeof(float)) {
        for (int i = 0; i < p.count; ++i) KV_RUN(program, like, program_at(p, i), 1, 0);
        return;
      }
#endif
      KV_RUN(program_list, like, p, p.items, 3 * kChunk<F>);
    };
    auto const blocks_of = [&](int64_t pixels) { return blocks_per_sample<F>(batch, pixels); };
    auto const all = [](int) { return true; };
    if (!around_mean) return for_each_table(all, blocks_of, run_table);
    auto const in_two_runs = [&]([[maybe_unused]] int i) {
#if defined(KV_CUDA)
      if constexpr (sizeof(F) == sizeof(float)) return !cuda::takes_clusters(p, i);
#endif
      return true;
    };
#if defined(KV_CUDA)
    if constexpr (sizeof(F) == sizeof(float))
      for_each_table([&](int i) { return !in_two_runs(i); }, [](int64_t) { return 1; },
                     [&] { KV_RUN(program_list_by_clusters, like, p, p.items, 0); });
#endif
    for_each_table(
        in_two_runs, [&](int64_t pixels) { return mean_parts_of<F>(batch, pixels); },
        [&] {
          Tensor const memory = empty({parts}, means);
          p.all.parts = static_cast<F*>(memory.mutable_data_ptr());
          p.all.measures_mean = true;
          run_table();
          p.all.measures_mean = false;
          int64_t items = 0;
          for (int i = 0; i < p.count; ++i) {
            p.listed[i].first = int(items);
            items += blocks_of(p.listed[i].pixels);
          }
          p.items = int(items);
          run_table();
        });
  });
  return means;
}

}  // namespace kv::color
