#include <doctest/doctest.h>

#include "errors.hpp"
#include "json_file.hpp"
#include "printable.hpp"

using namespace duospacenet;

namespace {

JsonField parse(const std::string& text) { return JsonField::parse<InputError>("scene.json", text); }

}  // namespace

TEST_CASE("text that readers understand differently is refused") {
    for (const char* text : {"{\"a\": 1, \"a\": 2}", "{\"b\": {\"a\": 1, \"a\": 1}}", "[NaN]", "[1e400]", "[1,]", "{",
                             "", "\xef\xbb\xbf{}", "[\"\xff\"]", "[\"\\ud800\"]", "[Infinity]", "{} {}"}) {
        CAPTURE(text);
        CHECK_THROWS_AS(parse(text), InputError);
    }
    CHECK(parse("{\"a\": {\"a\": 1}, \"b\": [{\"a\": 1}, {\"a\": 2}]}").entries().size() == 2);
}

TEST_CASE("an error names the file, the field, what was expected and what was found") {
    const JsonField value = parse("{\"frames\": [{\"timestamp_s\": \"now\"}]}");
    CHECK_THROWS_WITH(value["frames"].items()[0]["timestamp_s"].number(),
                      "scene.json: field frames.0.timestamp_s: expected a number; got \"now\".");
}

TEST_CASE("values of other types are refused") {
    const JsonField value =
        parse("{\"flag\": true, \"real\": 2.5, \"text\": \"2\", \"null\": null, \"row\": [[1, 2]]}");
    CHECK_THROWS_AS(value["flag"].number(), InputError);
    CHECK_THROWS_AS(value["flag"].integer(0, 9), InputError);
    CHECK_THROWS_AS(value["real"].integer(0, 9), InputError);
    CHECK_THROWS_AS(value["text"].number(), InputError);
    CHECK_THROWS_AS(value["real"].text(), InputError);
    CHECK_THROWS_AS((value["row"].matrix<1, 3>()), InputError);
    CHECK_THROWS_AS((value["row"].matrix<2, 2>()), InputError);
    CHECK_THROWS_AS(value["other"], InputError);
    CHECK_THROWS_AS(value.allow_only({"flag"}), InputError);
    CHECK(!value.find("null"));
    CHECK((value["row"].matrix<1, 2>() == cv::Matx12d(1, 2)));
}

TEST_CASE("a value that is nested deeply is refused as any other") {
    const std::string nested = std::string(200'000, '[') + std::string(200'000, ']');
    CHECK_THROWS_AS(parse("{\"scene\": " + nested + "}")["scene"].text(), InputError);
}

TEST_CASE("an integer beyond the limits is refused, whatever its size") {
    const JsonField values = parse("[0, 257, -1, 18446744073709551615, 99999999999999999999999]");
    for (const JsonField& value : values.items()) CHECK_THROWS_AS(value.integer(1, 256), InputError);
    CHECK(values.items()[1].integer(1, 257) == 257);
}

TEST_CASE("control characters, bidirectional controls and wrong bytes are escaped in messages and refused in names") {
    CHECK(printable("stra\xc3\x9f"
                    "e") ==
          "stra\xc3\x9f"
          "e");
    CHECK(printable("a\x1b[2J\nb") == "a\\x1b[2J\\x0ab");
    CHECK(printable("\xe2\x80\xae") == "\\u202e");
    CHECK(printable("\xc2\x9b") == "\\x9b");
    CHECK(printable("\xff\xc3") == "\\xff\\xc3");
    CHECK_THROWS_AS(parse("[\"a\\u001bb\"]").items()[0].name(), InputError);
    CHECK_THROWS_AS(parse("{\"a\\u001bb\": 1}").entries(), InputError);
}
