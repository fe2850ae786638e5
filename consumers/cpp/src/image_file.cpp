#include "image_file.hpp"

#include <turbojpeg.h>
#include <zlib.h>

#include <cstdint>
#include <memory>
#include <opencv2/imgcodecs.hpp>

#include "errors.hpp"
#include "files.hpp"

namespace duospacenet {
namespace {

namespace fs = std::filesystem;

constexpr std::uintmax_t kMaxFileBytes = 800'000'000;
constexpr std::int64_t kMaxPixels = 100'000'000;
constexpr std::string_view kPngStart = "\x89PNG\r\n\x1a\n";
constexpr std::string_view kJpegStart = "\xff\xd8\xff";
constexpr int kColour = cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION;

[[noreturn]] void refuse(const fs::path& path, const std::string& expected, const std::string& got,
                         const std::string& remedy) {
    throw InputError(path.string() + ": expected " + expected + "; got " + got + ". " + remedy);
}

[[noreturn]] void refuse_damaged(const fs::path& path, const std::string& damage) {
    refuse(path, "an undamaged image", "one " + damage, "Copy the file again.");
}

void check_size(const fs::path& path, const cv::Size& expected, const cv::Size& found) {
    const auto text = [](const cv::Size& size) {
        return std::to_string(size.width) + "x" + std::to_string(size.height) + " px";
    };
    if (found != expected) {
        refuse(path, text(expected) + ", as the calibration says", text(found),
               "Correct width_px and height_px with the intrinsics, or use the original image.");
    }
    if (static_cast<std::int64_t>(found.width) * found.height > kMaxPixels) {
        refuse(path, "at most " + std::to_string(kMaxPixels) + " pixels", text(found), "Scale the image down.");
    }
}

std::uint32_t big_endian(std::string_view data, std::size_t offset) {
    std::uint32_t value = 0;
    for (const char byte : data.substr(offset, 4)) value = value << 8 | static_cast<std::uint8_t>(byte);
    return value;
}

/// Checks the checksum of each chunk up to the end of the image. libpng checks only the chunks that it needs.
void check_png_chunks(const fs::path& path, std::string_view data) {
    constexpr std::size_t kOverhead = 12;  // length, kind and checksum
    for (std::size_t offset = kPngStart.size(); offset + kOverhead <= data.size();) {
        const std::size_t end = offset + kOverhead + big_endian(data, offset);
        if (end > data.size()) break;
        const std::string_view chunk = data.substr(offset + 4, end - offset - 8);
        const auto checksum = crc32(0, reinterpret_cast<const Bytef*>(chunk.data()), static_cast<uInt>(chunk.size()));
        if (checksum != big_endian(data, end - 4)) refuse_damaged(path, "with a wrong checksum");
        if (chunk.starts_with("IEND")) return;
        offset = end;
    }
    refuse_damaged(path, "without its end");
}

cv::Mat decode_with_opencv(const fs::path& path, const std::string& data) {
    cv::Mat image;
    try {
        image = cv::imdecode(cv::Mat(1, static_cast<int>(data.size()), CV_8U, const_cast<char*>(data.data())), kColour);
    } catch (const cv::Exception&) {  // the image stays empty
    }
    if (image.empty()) refuse_damaged(path, "that cannot be decoded");
    return image;
}

cv::Mat decode_png(const fs::path& path, const std::string& data, const cv::Size& size) {
    constexpr std::size_t kHeaderEnd = 33;  // the first chunk has width, height and bits per channel
    if (data.size() < kHeaderEnd || data.compare(12, 4, "IHDR") != 0) refuse_damaged(path, "without its header");
    check_size(path, size, cv::Size(static_cast<int>(big_endian(data, 16)), static_cast<int>(big_endian(data, 20))));
    if (const int bits = data[24]; bits > 8) {
        refuse(path, "8 bits per channel", std::to_string(bits), "Scale the values to 0 to 255, and save it again.");
    }
    check_png_chunks(path, data);
    return decode_with_opencv(path, data);
}

/// libjpeg repairs damaged data with a warning, which OpenCV ignores. libjpeg-turbo's own interface reports it.
cv::Mat decode_jpeg(const fs::path& path, const std::string& data, const cv::Size& size) {
    const std::unique_ptr<void, int (*)(tjhandle)> decoder(tjInitDecompress(), tjDestroy);
    const auto* bytes = reinterpret_cast<const unsigned char*>(data.data());
    int width = 0, height = 0, subsampling = 0, colours = 0;
    const auto check = [&](int status) {
        if (status != 0)
            refuse_damaged(path, std::string("of which libjpeg reports '") + tjGetErrorStr2(decoder.get()) + "'");
    };
    check(tjDecompressHeader3(decoder.get(), bytes, data.size(), &width, &height, &subsampling, &colours));
    check_size(path, size, cv::Size(width, height));
    const bool is_cmyk = colours == TJCS_CMYK || colours == TJCS_YCCK;
    cv::Mat image(height, width, is_cmyk ? CV_8UC4 : CV_8UC3);
    check(tjDecompress2(decoder.get(), bytes, data.size(), image.data, width, static_cast<int>(image.step), height,
                        is_cmyk ? TJPF_CMYK : TJPF_BGR, TJFLAG_LIMITSCANS));
    return is_cmyk ? decode_with_opencv(path, data) : image;  // libjpeg does not convert CMYK to BGR
}

}  // namespace

cv::Mat read_image(const fs::path& path, int width_px, int height_px) {
    const std::string data = read_file<InputError>(path, kMaxFileBytes);
    const cv::Size size(width_px, height_px);
    if (data.starts_with(kPngStart)) return decode_png(path, data, size);
    if (data.starts_with(kJpegStart)) return decode_jpeg(path, data, size);
    refuse(path, "a JPEG or PNG image", "another file of " + std::to_string(data.size()) + " bytes", "Convert it.");
}

}  // namespace duospacenet
