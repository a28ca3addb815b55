// Formulas: schemas and entries, for CPU and CUDA alike.
#include "geometry/formula_glue.h"

namespace kv {
namespace {

// The operator and its gradient, whose arguments are those of the formula.
template <class F, int I>
using FormulaInput = std::conditional_t<(I < F::kRequired || I == 0), Tensor const&, std::optional<Tensor> const&>;
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
  using Inputs = std::optional<Tensor>[F::kInputs];
  using Numbers = std::array<double, F::kPlain>;

  static Tensor forward(Tensor const& first, FormulaInput<F, I + 1>... others, PlainNumber<K>... numbers,
                        RowCount<R>... rows) {
    GivenNumbers<F> given(Name::text, first, first.scalar_type(), Inputs{first, others...}, Numbers{numbers...},
                          (0 + ... + rows));
    return given.result(Name::text, first);
  }

  static Tensor backward(Tensor const& grad, Tensor const& first, FormulaInput<F, I + 1>... others,
                         PlainNumber<K>... numbers, RowCount<R>... rows) {
    constexpr char const* op = Name::backward;
    GivenNumbers<F> given(op, first, first.scalar_type(), Inputs{first, others...}, Numbers{numbers...},
                          (0 + ... + rows));
    int64_t const batch = grad.dim() > 0 ? grad.size(0) : 0;
    KV_CHECK((given.params.batch == 1 || given.params.batch == batch) && has_extent(grad, given.extent()) &&
                 grad.scalar_type() == first.scalar_type() && grad.device() == first.device(),
             op, ": expected grad of shape ", extent_text(given.extent()), ", all of one type and device");
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
