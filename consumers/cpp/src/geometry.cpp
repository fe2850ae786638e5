#include "geometry.hpp"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>

namespace duospacenet {

cv::Matx33d rotation_of(const cv::Matx44d& a_T_b) { return a_T_b.get_minor<3, 3>(0, 0); }

cv::Vec3d translation_of(const cv::Matx44d& a_T_b) { return {a_T_b(0, 3), a_T_b(1, 3), a_T_b(2, 3)}; }

cv::Matx44d rigid_transform(const cv::Matx33d& rotation, const cv::Vec3d& translation_m) {
    cv::Matx44d a_T_b = cv::Matx44d::eye();
    for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column) a_T_b(row, column) = rotation(row, column);
        a_T_b(row, 3) = translation_m[row];
    }
    return a_T_b;
}

cv::Matx44d inverse(const cv::Matx44d& a_T_b) {
    // Transposing the rotation is exact. A general inverse would lose digits of poses far from the origin.
    const cv::Matx33d b_R_a = rotation_of(a_T_b).t();
    return rigid_transform(b_R_a, -(b_R_a * translation_of(a_T_b)));
}

cv::Matx44d nearest_rigid(const cv::Matx44d& a_T_b) {
    cv::Matx33d u, vt;
    cv::Matx31d singular_values;
    cv::SVD::compute(rotation_of(a_T_b), singular_values, u, vt);
    return rigid_transform(u * vt, translation_of(a_T_b));
}

double rotation_angle(const cv::Matx33d& rotation) {
    return std::acos(std::clamp((cv::trace(rotation) - 1) / 2, -1.0, 1.0));
}

}  // namespace duospacenet
