// Names and messages from files, made safe for a terminal.
#pragma once

#include <string>
#include <string_view>

namespace duospacenet {

/// Returns a UTF-8 text with escapes in place of control characters, bidirectional controls and wrong bytes.
std::string printable(std::string_view text);

/// Whether `printable` would change the text.
bool has_control_character(std::string_view text);

}  // namespace duospacenet
