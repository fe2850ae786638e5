#include <doctest/doctest.h>

#include <filesystem>
#include <fstream>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "errors.hpp"
#include "image_file.hpp"

using namespace duospacenet;

namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<uchar>;

/// An image of 16x8 px with another value in every element.
cv::Mat numbered_image(int type = CV_8UC3) {
    cv::Mat image(8, 16, CV_8UC3);
    for (int index = 0; index < 8 * 16 * 3; ++index) image.data[index] = static_cast<uchar>(index);
    cv::Mat result;
    image.convertTo(result, type);
    return result;
}

Bytes encoded(const std::string& kind, const cv::Mat& image = numbered_image()) {
    Bytes bytes;
    cv::imencode(kind, image, bytes);
    return bytes;
}

/// A file in the folder for temporary files, which is removed at the end.
class TemporaryFile {
  public:
    explicit TemporaryFile(const Bytes& content) : path_(fs::temp_directory_path() / unique_name()) {
        std::ofstream file(path_, std::ios::binary);
        file.write(reinterpret_cast<const char*>(content.data()), static_cast<std::streamsize>(content.size()));
    }
    ~TemporaryFile() { fs::remove(path_); }
    TemporaryFile(const TemporaryFile&) = delete;
    TemporaryFile& operator=(const TemporaryFile&) = delete;

    const fs::path& path() const { return path_; }

  private:
    static std::string unique_name() { return "duospacenet-" + std::to_string(cv::getTickCount()) + ".image"; }

    fs::path path_;
};

cv::Mat read(const Bytes& content, int width_px = 16, int height_px = 8) {
    const TemporaryFile file(content);
    return read_image(file.path(), width_px, height_px);
}

}  // namespace

TEST_CASE("a PNG file has the same pixels, and bytes after its end are ignored") {
    Bytes png = encoded(".png");
    CHECK(cv::norm(read(png), numbered_image(), cv::NORM_INF) == 0);
    png.push_back(7);
    CHECK(cv::norm(read(png), numbered_image(), cv::NORM_INF) == 0);
}

TEST_CASE("a JPEG file has the pixels of OpenCV") {
    const Bytes jpeg = encoded(".jpg");
    CHECK(cv::norm(read(jpeg), cv::imdecode(jpeg, cv::IMREAD_COLOR), cv::NORM_INF) == 0);
}

TEST_CASE("a grey image becomes BGR") {
    const cv::Mat grey(8, 16, CV_8UC1, cv::Scalar(9));
    for (const char* kind : {".png", ".jpg"}) CHECK(read(encoded(kind, grey)).type() == CV_8UC3);
}

TEST_CASE("a damaged file is refused") {
    const Bytes png = encoded(".png"), jpeg = encoded(".jpg");
    Bytes flipped = png;
    flipped[60] ^= 1;
    const std::pair<const char*, Bytes> files[] = {
        {"a PNG file without its end", Bytes(png.begin(), png.end() - 20)},
        {"a PNG file with a wrong checksum", flipped},
        {"the start of a PNG file", Bytes(png.begin(), png.begin() + 20)},
        {"a JPEG file without its end", Bytes(jpeg.begin(), jpeg.end() - 40)},
        {"the start of a JPEG file", Bytes(jpeg.begin(), jpeg.begin() + 20)},
        {"an empty file", {}},
        {"a text", {'i', 'm', 'a', 'g', 'e'}},
    };
    for (const auto& [name, content] : files) {
        CAPTURE(name);
        CHECK_THROWS_AS(read(content), InputError);
    }
}

TEST_CASE("an image of another size or of 16 bits is refused, and so is a file that is missing") {
    CHECK_THROWS_AS(read(encoded(".png"), 8, 16), InputError);
    CHECK_THROWS_AS(read(encoded(".jpg"), 15, 8), InputError);
    CHECK_THROWS_AS(read(encoded(".png", numbered_image(CV_16UC3))), InputError);
    CHECK_THROWS_AS(read_image("missing.png", 16, 8), InputError);
    CHECK_THROWS_AS(read_image(fs::temp_directory_path(), 16, 8), InputError);
}
