#include "tensor.hpp"

#include <cstring>
#include <functional>
#include <new>
#include <numeric>
#include <stdexcept>

namespace duospacenet {
namespace {

constexpr std::align_val_t kAlignment{64};  // a cache line, as the engines prefer

std::shared_ptr<std::byte> allocate(std::size_t size) {
    const auto release = [](std::byte* memory) { ::operator delete(memory, kAlignment); };
    return {static_cast<std::byte*>(::operator new(size, kAlignment)), release};
}

}  // namespace

std::size_t size_in_bytes(Dtype dtype) { return dtype == Dtype::float32 ? sizeof(float) : 1; }

std::size_t num_elements(const Shape& shape) {
    return std::accumulate(shape.begin(), shape.end(), std::size_t{1}, std::multiplies<>());
}

std::string describe(const Shape& shape, Dtype dtype) {
    std::string text = dtype == Dtype::float32 ? "float32 (" : dtype == Dtype::uint8 ? "uint8 (" : "bool (";
    for (const std::size_t size : shape) text += (text.back() == '(' ? "" : ", ") + std::to_string(size);
    return text + ")";
}

Tensor::Tensor(Shape shape, Dtype dtype)
    : shape_(std::move(shape)), dtype_(dtype), memory_(allocate(num_elements(shape_) * size_in_bytes(dtype))) {}

Tensor Tensor::zeros(Shape shape, Dtype dtype) {
    Tensor tensor(std::move(shape), dtype);
    std::memset(tensor.bytes(), 0, tensor.size() * size_in_bytes(dtype));
    return tensor;
}

bool Tensor::operator==(const Tensor& other) const {
    return shape_ == other.shape_ && dtype_ == other.dtype_ &&
           std::memcmp(bytes(), other.bytes(), size() * size_in_bytes(dtype_)) == 0;
}

void Tensor::check_dtype(Dtype expected) const {
    if (expected != dtype_) throw std::logic_error("expected " + describe(shape_, expected) + "; got another dtype");
}

}  // namespace duospacenet
