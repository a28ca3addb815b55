// Formulas: schemas and entries, for CPU and CUDA alike.
#include "formulas.h"
#include "glue/glue.h"

namespace kv {
namespace {

Numbers numbers_of(char const* op, Tensor const& x) {
  switch (x.scalar_type()) {
    case ScalarType::Float:
      return {x.const_data_ptr(), Stored::float32};
    case ScalarType::Double:
      return {x.const_data_ptr(), Stored::float64};
    case ScalarType::Half:
      return {x.const_data_ptr(), Stored::float16};
    case ScalarType::BFloat16:
      return {x.const_data_ptr(), Stored::bfloat16};
    default:
      KV_CHECK(false, op, ": no kernel for this dtype");
  }
  return {};
}

bool has_extent(Tensor const& x, Extent extent) {
  int const axes = (extent.rows > 0) + (extent.columns > 0);
  return x.dim() == 1 + axes && (axes < 1 || x.size(1) == extent.rows) && (axes < 2 || x.size(2) == extent.columns);
}

// Whether the numbers of a sample are next to each other.
bool is_packed_row(Tensor const& x) {
  int64_t step = 1;
  for (int64_t axis = x.dim() - 1; axis > 0; step *= x.size(axis--))
    if (x.stride(axis) != step) return false;
  return true;
}

std::string extent_text(Extent extent) {
  std::string text = "(B";
  if (extent.rows) text += ", " + std::to_string(extent.rows);
  if (extent.columns) text += ", " + std::to_string(extent.columns);
  return text + ")";
}

// The inputs of formula F, checked; one row serves a batch.
template <class F>
struct GivenNumbers {
  Formulas<F> params{};
  std::optional<Tensor> kept[F::kInputs];

  GivenNumbers(char const* op, Tensor const& first, std::initializer_list<std::optional<Tensor>> others,
               std::initializer_list<double> numbers, int64_t rows) {
    bool const is_double = first.scalar_type() == ScalarType::Double;
    params.settings = {is_double ? 0x1p-1022 : 0x1p-126, is_double ? 0x1p-52 : 0x1p-23, {}};
    params.batch = 1;
    std::copy(numbers.begin(), numbers.end(), params.settings.number);
    constexpr int columns = F::result.columns ? F::result.columns : F::result.count();
    KV_CHECK(rows == 0 || (rows > 0 && rows <= F::result.rows), op, ": expected rows from 1 to ", F::result.rows);
    params.outputs = rows ? int(rows) * columns : F::result.count();
    take(op, 0, first, first);
    int i = 1;
    for (auto const& x : others) {
      if (x) take(op, i, *x, first);
      ++i;
    }
  }

  void take(char const* op, int i, Tensor const& x, Tensor const& first) {
    Extent const extent = F::extent(i);
    KV_CHECK(has_extent(x, extent) && x.scalar_type() == first.scalar_type() && x.device() == first.device(), op,
             ": expected tensor ", i + 1, " of shape ", extent_text(extent), ", all of one type and device");
    KV_CHECK(params.batch == 1 || x.size(0) == 1 || x.size(0) == params.batch, op, ": expected tensor ", i + 1,
             " with 1 or ", params.batch, " rows, got ", x.size(0));
    if (x.size(0) != 1) params.batch = x.size(0);
    Tensor const rows = is_packed_row(x) ? x : dense(x);
    kept[i] = rows;
    params.inputs[i] = numbers_of(op, rows);
    params.strides[i] = x.size(0) == 1 ? 0 : rows.stride(0);
    params.given |= ((uint64_t(1) << extent.count()) - 1) << offset_of<F>(i);
  }
};

// The operator and its gradient, whose arguments are those of the formula.
template <class F, int I>
using FormulaInput = std::conditional_t<(I < F::kRequired), Tensor const&, std::optional<Tensor> const&>;
template <int>
using PlainNumber = double;
template <int>
using RowCount = int64_t;

template <class F, class Name, class Others = std::make_integer_sequence<int, F::kInputs - 1>,
          class Plain = std::make_integer_sequence<int, F::kPlain>,
          class Cut = std::make_integer_sequence<int, F::kCut>>
struct FormulaEntry;
template <class F, class Name, int... I, int... K, int... R>
struct FormulaEntry<F, Name, std::integer_sequence<int, I...>, std::integer_sequence<int, K...>,
                    std::integer_sequence<int, R...>> {
  static Tensor forward(Tensor const& first, FormulaInput<F, I + 1>... others, PlainNumber<K>... numbers,
                        RowCount<R>... rows) {
    GivenNumbers<F> given(Name::text, first, {others...}, {numbers...}, (0 + ... + rows));
    KV_CHECK(((rows > 0) && ...), Name::text, ": expected rows from 1 to ", F::result.rows);
    int64_t const batch = given.params.batch;
    Tensor const result = F::result.columns
                              ? empty({batch, F::kCut ? (0 + ... + rows) : F::result.rows, F::result.columns}, first)
                              : empty({batch, F::result.rows}, first);
    given.params.result = numbers_of(Name::text, result);
    KV_RUN(formula, result, given.params, batch, F::kNumbers + 4 * F::kOutputs);
    return result;
  }

  static Tensor backward(Tensor const& grad, Tensor const& first, FormulaInput<F, I + 1>... others,
                         PlainNumber<K>... numbers, RowCount<R>... rows) {
    constexpr char const* op = Name::backward;
    GivenNumbers<F> given(op, first, {others...}, {numbers...}, (0 + ... + rows));
    KV_CHECK(((rows > 0) && ...), op, ": expected rows from 1 to ", F::result.rows);
    int64_t const batch = grad.dim() > 0 ? grad.size(0) : 0;
    Extent const result{F::kCut ? int((0 + ... + rows)) : F::result.rows, F::result.columns};
    KV_CHECK((given.params.batch == 1 || given.params.batch == batch) && has_extent(grad, result) &&
                 grad.scalar_type() == first.scalar_type() && grad.device() == first.device(),
             op, ": expected grad of shape ", extent_text(result), ", all of one type and device");
    given.params.batch = batch;
    Tensor const dense_grad = dense(grad), slopes = empty({batch, __builtin_popcountll(given.params.given)}, grad);
    given.params.grad = numbers_of(op, dense_grad);
    given.params.slopes = numbers_of(op, slopes);
    KV_RUN(formula_backward, grad, given.params, batch, 2 * F::kNumbers * F::kOutputs);
    return slopes;
  }
};

}  // namespace

#define KV_FORMULA_OPERATOR(name, Formula, inputs)                                \
  namespace {                                                                     \
  struct name##_name {                                                            \
    static constexpr char const* text = #name;                                    \
    static constexpr char const* backward = #name "_backward";                    \
  };                                                                              \
  constexpr auto& name = FormulaEntry<Formula, name##_name>::forward;             \
  constexpr auto& name##_backward = FormulaEntry<Formula, name##_name>::backward; \
  }                                                                               \
  KV_OPERATOR(name, "(" inputs ") -> Tensor")                                     \
  KV_OPERATOR(name##_backward, "(Tensor grad, " inputs ") -> Tensor")

KV_FORMULAS(KV_FORMULA_OPERATOR)

#undef KV_FORMULA_OPERATOR

}  // namespace kv
