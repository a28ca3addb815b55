// The list of all formulas (formula.h), each with the name and the arguments of its operator. The Python references in
// python/kvision/geometry/{conversions,liegroup,linalg,quaternion,transform,epipolar,solvers} and
// python/kvision/feature define what each computes.
#pragma once

#include "feature/laf.h"
#include "geometry/conversions/euler.h"
#include "geometry/conversions/rotations.h"
#include "geometry/epipolar/matrices.h"
#include "geometry/liegroup/exponential_maps.h"
#include "geometry/linalg.h"
#include "geometry/quaternion.h"
#include "geometry/solvers/polynomials.h"
#include "geometry/transform/matrices.h"

namespace kv::geometry {

// --- the operators: name, formula, arguments -------------------------------------------------------------------------

// Formulas that kernels of image warps can compute, then those of volume warps.
#define KV_PLANE_FORMULAS(_)                                                                                 \
  _(affine_matrix2d, AffineMatrix2d,                                                                         \
    "Tensor degrees, Tensor? translation, Tensor? scale, Tensor? shear_x, Tensor? shear_y, Tensor? center, " \
    "float sign, float x, float y, int rows")                                                                \
  _(translation_matrix2d, TranslationMatrix2d, "Tensor translation, float x, float y, int rows")             \
  _(scale_matrix2d, ScaleMatrix2d, "Tensor scale, Tensor? center, float x, float y")                         \
  _(shear_factor_matrix2d, ShearFactorMatrix2d, "Tensor factors")                                            \
  _(crop_matrix, CropMatrix, "Tensor quads, Tensor? first, float across, float down")

#define KV_SPACE_FORMULAS(_)                                                                                       \
  _(affine_matrix3d, AffineMatrix3d,                                                                               \
    "Tensor x, Tensor y, Tensor z, Tensor? translation, Tensor? scale, Tensor? center, Tensor? xy, Tensor? xz, "   \
    "Tensor? yx, Tensor? yz, Tensor? zx, Tensor? zy, float sign, float center_x, float center_y, float center_z, " \
    "int rows")                                                                                                    \
  _(translation_matrix3d, TranslationMatrix3d, "Tensor translation, float x, float y, float z, int rows")          \
  _(perspective_matrix3d, PerspectiveMatrix3d, "Tensor points_src, Tensor? points_dst, float x, float y, float z")

// Rotations and quaternions.
#define KV_ROTATION_FORMULAS(_)                                                          \
  _(axis_angle_to_rotation_matrix, AxisAngleToRotationMatrix, "Tensor axis_angle")       \
  _(quaternion_exponential, QuaternionExponential, "Tensor vector, float part")          \
  _(quaternion_to_axis_angle, QuaternionToAxisAngle, "Tensor quaternion")                \
  _(quaternion_logarithm, QuaternionLogarithm, "Tensor quaternion")                      \
  _(quaternion_product, QuaternionProduct, "Tensor left, Tensor right")                  \
  _(normalize_quaternion, NormalizeQuaternion, "Tensor quaternion, float eps")           \
  _(quaternion_to_rotation_matrix, QuaternionToRotationMatrix, "Tensor quaternion")      \
  _(rotation_matrix_to_quaternion, RotationMatrixToQuaternion, "Tensor matrix")          \
  _(cross_matrix, CrossMatrix, "Tensor vector")                                          \
  _(rotation_matrix_to_axis_angle, RotationMatrixToAxisAngle, "Tensor matrix")           \
  _(angle_to_rotation_matrix, AngleToRotationMatrix, "Tensor degrees")                   \
  _(quaternion_from_euler, QuaternionFromEuler, "Tensor roll, Tensor pitch, Tensor yaw") \
  _(euler_from_quaternion, EulerFromQuaternion, "Tensor w, Tensor x, Tensor y, Tensor z")

// Poses, transforms of the plane and of space, two views.
#define KV_MATRIX_FORMULAS(_)                                                                                    \
  _(compose_poses, ComposePoses, "Tensor first, Tensor second")                                                  \
  _(invert_pose, InvertPose, "Tensor pose")                                                                      \
  _(relative_pose, RelativePose, "Tensor first, Tensor second")                                                  \
  _(shear_matrix2d, ShearMatrix2d, "Tensor center, Tensor? shear_x, Tensor? shear_y")                            \
  _(invert_affine2d, InvertAffine2d, "Tensor matrix")                                                            \
  _(shear_matrix3d, ShearMatrix3d,                                                                               \
    "Tensor center, Tensor? xy, Tensor? xz, Tensor? yx, Tensor? yz, Tensor? zx, Tensor? zy")                     \
  _(perspective_matrix, PerspectiveMatrix, "Tensor points_src, Tensor points_dst")                               \
  _(crop_box_checks, CropBoxChecks, "Tensor quads, Tensor others")                                               \
  _(essential_from_fundamental, EssentialFromFundamental, "Tensor fundamental, Tensor camera1, Tensor camera2")  \
  _(fundamental_from_essential, FundamentalFromEssential, "Tensor essential, Tensor camera1, Tensor camera2")    \
  _(fundamental_from_projections, FundamentalFromProjections, "Tensor projection1, Tensor projection2")          \
  _(normalize_line, NormalizeLine, "Tensor line")                                                                \
  _(camera_motion, CameraMotion, "Tensor rotation1, Tensor translation1, Tensor rotation2, Tensor translation2") \
  _(essential_from_motions, EssentialFromMotions,                                                                \
    "Tensor rotation1, Tensor translation1, Tensor rotation2, Tensor translation2")                              \
  _(decompose_projection, DecomposeProjection, "Tensor projection")                                              \
  _(product_of_linear, PolynomialProduct<QuadraticMonomials>, "Tensor a, Tensor b")                              \
  _(product_of_quadratic, PolynomialProduct<CubicMonomials>, "Tensor a, Tensor b")                               \
  _(determinant_to_polynomial, DeterminantToPolynomial, "Tensor A")

// Exponential maps of rigid motions.
#define KV_LIE_GROUP_FORMULAS(_)                                         \
  _(se2_exp, Se2Exp, "Tensor tangent")                                   \
  _(se2_log, Se2Log, "Tensor motion")                                    \
  _(so3_left_jacobian, So3LeftJacobian, "Tensor tangent")                \
  _(so3_left_jacobian_inverse, So3LeftJacobianInverse, "Tensor tangent") \
  _(se3_exp, Se3Exp, "Tensor tangent")                                   \
  _(se3_log, Se3Log, "Tensor motion")                                    \
  _(se3_left_jacobian, Se3LeftJacobian, "Tensor tangent")                \
  _(se3_left_jacobian_inverse, Se3LeftJacobianInverse, "Tensor tangent")

// Features: local affine frames and peaks of responses.
#define KV_FEATURE_FORMULAS(_)                                                                              \
  _(laf_scale, feature::LafScale, "Tensor laf")                                                             \
  _(rotate_laf, feature::RotateLaf, "Tensor laf, Tensor degrees")                                           \
  _(set_laf_orientation, feature::SetLafOrientation, "Tensor laf, Tensor degrees")                          \
  _(laf_from_parts, feature::LafFromParts, "Tensor center, Tensor? scale, Tensor? degrees")                 \
  _(scale_laf_parts, feature::ScaleLafParts, "Tensor laf, float shape, float x, float y")                   \
  _(laf_of_peak, feature::LafOfPeak, "Tensor peak, Tensor scale, float levels_of_octave, float x, float y") \
  _(make_upright, feature::MakeUpright, "Tensor laf, float eps")                                            \
  _(ellipse_to_laf, feature::EllipseToLaf, "Tensor ellipse")                                                \
  _(quadratic_peak2d, feature::QuadraticPeak2d, "Tensor values")                                            \
  _(perspective_transform_laf, feature::PerspectiveTransformLaf, "Tensor homography, Tensor laf")

#define KV_FORMULAS(_)    \
  KV_ROTATION_FORMULAS(_) \
  KV_MATRIX_FORMULAS(_) KV_LIE_GROUP_FORMULAS(_) KV_FEATURE_FORMULAS(_) KV_PLANE_FORMULAS(_) KV_SPACE_FORMULAS(_)

#define KV_NAME_FORMULA(name, Formula, inputs) name,
enum class WarpFormula : int { none, KV_PLANE_FORMULAS(KV_NAME_FORMULA) KV_SPACE_FORMULAS(KV_NAME_FORMULA) };
#undef KV_NAME_FORMULA

#define KV_INSTANTIATE_FORMULA(name, Formula, inputs) \
  KV_INSTANTIATE_ONE(formula, FormulaParams, Formula) \
  KV_INSTANTIATE_ONE(formula_backward, FormulaParams, Formula)

}  // namespace kv::geometry
