// Qualities and tables of the JPEG approximation, for the entries of operators.
#pragma once

#include "glue/glue.h"
#include "jpeg.h"

namespace kv::enhance {

using OptionalTensor = std::optional<Tensor>;

// Contiguous and in the computing type, for one image or for all images.
inline Tensor jpeg_numbers(char const* op, char const* name, Tensor const& x, Tensor const& t, bool table) {
  bool const sizes = t.dim() == (table ? 3 : 1) && (t.size(0) == 1 || t.size(0) == x.size(0)) &&
                     (!table || (t.size(1) == 8 && t.size(2) == 8));
  KV_CHECK(sizes, op, ": expected ", name, " of shape ", table ? "(B, 8, 8)" : "(B,)", ", or B of 1");
  KV_CHECK(t.scalar_type() == compute_dtype(x) && t.device() == x.device(), op, ": expected ", name,
           " of the type that is computed in, on the device of input");
  return dense(t);
}

// The data pointers of the tables.
struct JpegNumbers {
  OptionalTensor quality, luma, chroma;
  double number;

  JpegNumbers(char const* op, Tensor const& x, OptionalTensor const& q, OptionalTensor const& y,
              OptionalTensor const& c, double number)
      : number(number) {
    if (q) quality = jpeg_numbers(op, "quality", x, *q, false);
    if (y) luma = jpeg_numbers(op, "table_y", x, *y, true);
    if (c) chroma = jpeg_numbers(op, "table_c", x, *c, true);
  }
  template <class F>
  JpegTables<F> tables() const {
    auto const data = [](OptionalTensor const& t) { return t ? data_ptr<F const>(*t) : nullptr; };
    auto const stride = [](OptionalTensor const& t, int64_t n) { return t && t->size(0) > 1 ? n : 0; };
    return {data(quality),    data(luma),         data(chroma), stride(quality, 1),
            stride(luma, 64), stride(chroma, 64), F(number)};
  }
};

}  // namespace kv::enhance
