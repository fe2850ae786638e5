// Dense arrays, as graphs take and return them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

namespace duospacenet {

using Shape = std::vector<std::size_t>;

enum class Dtype { float32, uint8, boolean };

std::size_t size_in_bytes(Dtype dtype);
std::size_t num_elements(const Shape& shape);

/// Name, static shape and dtype of an input or output of a graph.
struct TensorSpec {
    std::string name;
    Shape shape;
    Dtype dtype = Dtype::float32;

    bool operator==(const TensorSpec&) const = default;
};

/// A specification as text, such as `float32 (6, 3, 4)`, for messages.
std::string describe(const Shape& shape, Dtype dtype);

/// A row-major array. Copies share their memory, so a cached value is passed on without copying it.
class Tensor {
  public:
    /// Allocates memory that is not initialised.
    Tensor(Shape shape, Dtype dtype);

    static Tensor zeros(Shape shape, Dtype dtype);

    const Shape& shape() const { return shape_; }
    Dtype dtype() const { return dtype_; }
    std::size_t size() const { return num_elements(shape_); }
    std::byte* bytes() const { return memory_.get(); }

    /// The elements. T is float, std::uint8_t or bool, as the dtype says; throws std::logic_error for another one.
    template <typename T>
    std::span<T> values() const {
        check_dtype(dtype_of(T{}));
        return {reinterpret_cast<T*>(memory_.get()), size()};
    }

    /// Whether shape, dtype and all bytes are equal.
    bool operator==(const Tensor& other) const;

  private:
    static constexpr Dtype dtype_of(float) { return Dtype::float32; }
    static constexpr Dtype dtype_of(std::uint8_t) { return Dtype::uint8; }
    static constexpr Dtype dtype_of(bool) { return Dtype::boolean; }
    void check_dtype(Dtype expected) const;

    Shape shape_;
    Dtype dtype_;
    std::shared_ptr<std::byte> memory_;
};

using Tensors = std::map<std::string, Tensor>;

}  // namespace duospacenet
