// Rigid transforms in float64. `a_T_b` maps points of frame b to frame a [m].
#pragma once

#include <opencv2/core/matx.hpp>

namespace duospacenet {

cv::Matx33d rotation_of(const cv::Matx44d& a_T_b);
cv::Vec3d translation_of(const cv::Matx44d& a_T_b);
cv::Matx44d rigid_transform(const cv::Matx33d& rotation, const cv::Vec3d& translation_m);

/// `b_T_a` of a rigid transform `a_T_b`.
cv::Matx44d inverse(const cv::Matx44d& a_T_b);

/// `a_T_b` with its rotation replaced by the nearest orthonormal one, to remove rounding errors.
cv::Matx44d nearest_rigid(const cv::Matx44d& a_T_b);

/// The angle of a rotation about its axis [rad], from 0 to pi.
double rotation_angle(const cv::Matx33d& rotation);

}  // namespace duospacenet
