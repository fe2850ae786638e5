#include "json_file.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <set>

#include "printable.hpp"

namespace duospacenet {

using Json = nlohmann::ordered_json;

struct JsonField::Document {
    std::string name;
    Raise raise;
    Json content;
};

namespace {

/// Parses a text, and refuses a key that occurs twice in an object. nlohmann-json would keep one of the two values.
Json parse_without_duplicates(std::string_view text) {
    std::vector<std::set<std::string>> keys;
    const auto check = [&keys](int, Json::parse_event_t event, Json& value) {
        if (event == Json::parse_event_t::object_start) keys.emplace_back();
        if (event == Json::parse_event_t::object_end) keys.pop_back();
        if (event == Json::parse_event_t::key && !keys.back().insert(value.get<std::string>()).second) {
            throw std::invalid_argument("the key '" + value.get<std::string>() + "' twice in an object");
        }
        return true;
    };
    return Json::parse(text, check);
}

/// A value as text of at most 60 bytes. Arrays and objects are counted, because they can be nested deeply.
std::string shortened(const Json& value) {
    if (value.is_array()) return "an array of " + std::to_string(value.size());
    if (value.is_object()) return "an object of " + std::to_string(value.size()) + " fields";
    const std::string text = value.dump(-1, ' ', true);  // ASCII only, so that no character is cut
    return text.size() <= 60 ? text : text.substr(0, 57) + "...";
}

}  // namespace

JsonField::JsonField(std::shared_ptr<const Document> document, const Json& value, std::string place)
    : document_(std::move(document)), value_(&value), place_(std::move(place)) {}

JsonField JsonField::parse(const std::string& name, std::string_view text, Raise raise) {
    auto document = std::make_shared<Document>(Document{name, raise, {}});
    try {
        if (text.starts_with("\xef\xbb\xbf")) throw std::invalid_argument("a byte order mark");
        document->content = parse_without_duplicates(text);
    } catch (const std::exception& error) {  // also those of nlohmann-json
        raise(name + ": expected UTF-8 JSON; got " + error.what() + ". Correct the file, or copy it again.");
    }
    const Json& content = document->content;
    return JsonField(std::move(document), content, "");
}

JsonField JsonField::operator[](std::string_view key) const {
    if (!value_->is_object()) refuse("an object");
    const auto found = value_->find(key);
    if (found == value_->end()) refuse("an object with the field " + std::string(key));
    return child(*found, std::string(key));
}

std::optional<JsonField> JsonField::find(std::string_view key) const {
    if (!value_->is_object()) refuse("an object");
    const auto found = value_->find(key);
    if (found == value_->end() || found->is_null()) return std::nullopt;
    return child(*found, std::string(key));
}

void JsonField::allow_only(std::initializer_list<std::string_view> keys) const {
    for (const auto& [key, field] : entries()) {
        if (std::find(keys.begin(), keys.end(), key) == keys.end()) {
            field.refuse("no such field", "Is its name right? See the page about this file.");
        }
    }
}

std::vector<std::pair<std::string, JsonField>> JsonField::entries() const {
    if (!value_->is_object()) refuse("an object");
    std::vector<std::pair<std::string, JsonField>> fields;
    for (const auto& item : value_->items()) {
        fields.emplace_back(item.key(), child(item.value(), item.key()));
        if (has_control_character(item.key())) fields.back().second.refuse("a key without control characters");
    }
    return fields;
}

std::vector<JsonField> JsonField::items() const {
    if (!value_->is_array()) refuse("an array");
    std::vector<JsonField> fields;
    fields.reserve(value_->size());
    for (const Json& value : *value_) fields.push_back(child(value, std::to_string(fields.size())));
    return fields;
}

bool JsonField::is_null() const { return value_->is_null(); }

bool JsonField::boolean() const {
    if (!value_->is_boolean()) refuse("true or false");
    return value_->get<bool>();
}

std::int64_t JsonField::integer(std::int64_t lowest, std::int64_t highest) const {
    // nlohmann-json compares an unsigned number with a signed one by converting it, so 2^64 - 1 would be -1.
    const bool is_small = value_->is_number_integer() &&
                          (!value_->is_number_unsigned() || value_->get<std::uint64_t>() <= std::uint64_t{INT64_MAX});
    if (!is_small || *value_ < lowest || *value_ > highest) {
        refuse("an integer from " + std::to_string(lowest) + " to " + std::to_string(highest));
    }
    return value_->get<std::int64_t>();
}

double JsonField::number() const {
    if (!value_->is_number()) refuse("a number");
    return value_->get<double>();
}

double JsonField::positive_number() const {
    if (const double value = number(); value > 0) return value;
    refuse("a number above 0");
}

std::string JsonField::text() const {
    if (!value_->is_string()) refuse("a text");
    return value_->get<std::string>();
}

std::string JsonField::name() const {
    std::string value = text();
    if (has_control_character(value)) refuse("a text without control characters", "Rename it.");
    return value;
}

std::vector<std::string> JsonField::names() const {
    std::vector<std::string> result;
    for (const JsonField& item : items()) result.push_back(item.name());
    return result;
}

void JsonField::read_matrix(double* values, int rows, int columns) const {
    const auto check_size = [](const JsonField& field, std::size_t found, int expected) {
        if (found != static_cast<std::size_t>(expected)) field.refuse("an array of " + std::to_string(expected));
    };
    const std::vector<JsonField> lines = items();
    check_size(*this, lines.size(), rows);
    for (const JsonField& line : lines) {
        const std::vector<JsonField> elements = line.items();
        check_size(line, elements.size(), columns);
        for (const JsonField& element : elements) *values++ = element.number();
    }
}

void JsonField::refuse(const std::string& expected, const std::string& remedy) const {
    document_->raise(document_->name + ": field " + (place_.empty() ? "(the whole file)" : place_) + ": expected " +
                     expected + "; got " + shortened(*value_) + "." + (remedy.empty() ? "" : " " + remedy));
    throw std::logic_error("unreachable: `raise` throws");
}

JsonField JsonField::child(const Json& value, const std::string& key) const {
    return JsonField(document_, value, place_.empty() ? key : place_ + "." + key);
}

}  // namespace duospacenet
