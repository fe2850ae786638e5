// Strict JSON files, read field by field. An error names the file and the field.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <initializer_list>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <opencv2/core/matx.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "files.hpp"

namespace duospacenet {

/// A value in a JSON document, with its place in it. Copies are cheap, and keep the document alive.
class JsonField {
  public:
    /// Parses UTF-8 text. Refuses a syntax error, a number beyond float64, and a key that occurs twice in an object.
    /// name: of the file, for messages. Throws `ErrorType`, as all later accesses do.
    template <typename ErrorType>
    static JsonField parse(const std::string& name, std::string_view text) {
        return parse(name, text, [](const std::string& message) { throw ErrorType(message); });
    }

    /// A field of an object. It must be there.
    JsonField operator[](std::string_view key) const;

    /// A field of an object, or nothing if it is absent or null.
    std::optional<JsonField> find(std::string_view key) const;

    /// Refuses keys that are not listed.
    void allow_only(std::initializer_list<std::string_view> keys) const;

    /// The keys and values of an object, in the order of the file.
    std::vector<std::pair<std::string, JsonField>> entries() const;

    /// The elements of an array.
    std::vector<JsonField> items() const;

    bool is_null() const;
    bool boolean() const;
    std::int64_t integer(std::int64_t lowest, std::int64_t highest) const;
    double number() const;
    double positive_number() const;
    std::string text() const;

    /// A text without control characters, such as a name or a path.
    std::string name() const;
    std::vector<std::string> names() const;

    template <int rows, int columns>
    cv::Matx<double, rows, columns> matrix() const {
        cv::Matx<double, rows, columns> result;
        read_matrix(result.val, rows, columns);
        return result;
    }

    /// Throws the error of this document: expected ...; got this value.
    [[noreturn]] void refuse(const std::string& expected, const std::string& remedy = "") const;

  private:
    struct Document;
    using Raise = void (*)(const std::string& message);

    JsonField(std::shared_ptr<const Document> document, const nlohmann::ordered_json& value, std::string place);
    static JsonField parse(const std::string& name, std::string_view text, Raise raise);
    void read_matrix(double* values, int rows, int columns) const;
    JsonField child(const nlohmann::ordered_json& value, const std::string& key) const;

    std::shared_ptr<const Document> document_;
    const nlohmann::ordered_json* value_;
    std::string place_;  // keys and indices, separated by dots
};

/// Reads and parses a file. Throws `ErrorType`.
template <typename ErrorType>
JsonField read_json(const std::filesystem::path& path, std::uintmax_t max_bytes) {
    return JsonField::parse<ErrorType>(path.string(), read_file<ErrorType>(path, max_bytes));
}

}  // namespace duospacenet
