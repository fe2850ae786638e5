#include "printable.hpp"

#include <cstdint>
#include <cstdio>

namespace duospacenet {
namespace {

struct Character {
    std::uint32_t code;
    std::size_t size;  // in bytes; 0 for a byte that is not valid UTF-8
};

Character first_character(std::string_view text) {
    const auto byte = [&](std::size_t index) { return static_cast<std::uint8_t>(text[index]); };
    const std::uint8_t start = byte(0);
    if (start < 0x80) return {start, 1};
    const std::size_t size = start >= 0xf0 ? 4 : start >= 0xe0 ? 3 : 2;
    if (start < 0xc2 || start > 0xf4 || text.size() < size) return {start, 0};
    std::uint32_t code = start & (0xffu >> (size + 1));
    for (std::size_t index = 1; index < size; ++index) {
        if ((byte(index) & 0xc0) != 0x80) return {start, 0};
        code = code << 6 | (byte(index) & 0x3f);
    }
    return {code, size};
}

bool is_control(std::uint32_t code) {
    const bool is_ascii_or_c1 = code < 0x20 || (code >= 0x7f && code < 0xa0);
    // Line separators, embeddings, overrides and isolates; then lone surrogates.
    const bool reorders = (code >= 0x2028 && code <= 0x202e) || (code >= 0x2066 && code <= 0x2069);
    return is_ascii_or_c1 || reorders || (code >= 0xd800 && code < 0xe000);
}

}  // namespace

std::string printable(std::string_view text) {
    std::string safe;
    while (!text.empty()) {
        const auto [code, size] = first_character(text);
        if (size > 0 && !is_control(code)) {
            safe += text.substr(0, size);
        } else {
            char escape[16];
            std::snprintf(escape, sizeof escape, code < 0x100 ? "\\x%02x" : "\\u%04x", code);
            safe += escape;
        }
        text.remove_prefix(size > 0 ? size : 1);
    }
    return safe;
}

bool has_control_character(std::string_view text) { return printable(text) != text; }

}  // namespace duospacenet
