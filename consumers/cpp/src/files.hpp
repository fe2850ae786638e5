// Whole files as bytes, and their hashes.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

#include "errors.hpp"

namespace duospacenet {

/// Why a file could not be read; empty if it could.
struct ReadResult {
    std::string content;
    std::string problem;
};

/// Reads a regular file of at most `max_bytes`. Other files, such as pipes and devices, are not opened.
ReadResult try_read_file(const std::filesystem::path& path, std::uintmax_t max_bytes);

/// As `try_read_file`. Throws `ErrorType`, naming the file.
template <typename ErrorType>
std::string read_file(const std::filesystem::path& path, std::uintmax_t max_bytes) {
    ReadResult result = try_read_file(path, max_bytes);
    if (!result.problem.empty()) throw ErrorType(path.string() + ": " + result.problem);
    return std::move(result.content);
}

/// The SHA-256 hash of bytes, as 64 hexadecimal digits.
std::string sha256(std::string_view bytes);

}  // namespace duospacenet
