#include <doctest/doctest.h>

#include <limits>

#include "detections.hpp"

using namespace duospacenet;

namespace {

Tensor tensor_of(Shape shape, const std::vector<float>& values) {
    Tensor tensor(std::move(shape), Dtype::float32);
    std::copy(values.begin(), values.end(), tensor.values<float>().begin());
    return tensor;
}

/// Boxes of queries whose x is the number of the query.
Tensor boxes_of(std::size_t num_queries) {
    const Tensor boxes = Tensor::zeros({num_queries, 9}, Dtype::float32);
    for (std::size_t query = 0; query < num_queries; ++query)
        boxes.values<float>()[9 * query] = static_cast<float>(query);
    return boxes;
}

}  // namespace

TEST_CASE("pairs are sorted by score, a query can have several classes, and ties keep the order of the array") {
    int dropped = 0;
    const auto found = select_detections(tensor_of({2, 2}, {0, 2, 2, -1}), boxes_of(2), dropped);
    REQUIRE(found.size() == 4);
    CHECK((found[0].class_index == 1 && found[0].box[0] == 0));
    CHECK((found[1].class_index == 0 && found[1].box[0] == 1));
    CHECK((found[2].class_index == 0 && found[2].box[0] == 0));
    CHECK(found[2].score == 0.5f);
    CHECK(found[3].class_index == 1);
    CHECK(dropped == 0);
}

TEST_CASE("different logits of the same float32 score are a tie") {
    int dropped = 0;
    const auto found = select_detections(tensor_of({1, 2}, {30, 40}), boxes_of(1), dropped);
    CHECK(found[0].score == 1.0f);
    CHECK(found[1].score == 1.0f);
    CHECK(found[0].class_index == 0);
}

TEST_CASE("a query with a number that is not finite is dropped with all its classes") {
    constexpr float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();
    const Tensor boxes = boxes_of(3);
    boxes.values<float>()[9 + 8] = infinity;
    int dropped = 0;
    const auto found = select_detections(tensor_of({3, 2}, {nan, 9, 8, 7, -200, 1}), boxes, dropped);
    REQUIRE(found.size() == 2);
    CHECK(dropped == 2);
    CHECK(found[0].box[0] == 2);
    CHECK(found[1].score == 0.0f);  // without overflow
}

TEST_CASE("at most 500 detections are kept") {
    int dropped = 0;
    CHECK(select_detections(Tensor::zeros({51, 10}, Dtype::float32), boxes_of(51), dropped).size() == 500);
}

TEST_CASE("a map cell that is not finite has the probability 0") {
    int dropped = 0;
    constexpr float nan = std::numeric_limits<float>::quiet_NaN();
    const Tensor mask = probabilities(tensor_of({1, 1, 1, 3}, {0, nan, 100}), dropped);
    CHECK(mask.values<float>()[0] == 0.5f);
    CHECK(mask.values<float>()[1] == 0.0f);
    CHECK(mask.values<float>()[2] == 1.0f);
    CHECK(dropped == 1);
}
