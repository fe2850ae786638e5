#include "files.hpp"

#include <openssl/evp.h>

#include <cstdio>
#include <fstream>

namespace duospacenet {

namespace fs = std::filesystem;

ReadResult try_read_file(const fs::path& path, std::uintmax_t max_bytes) {
    std::error_code error;
    const fs::file_status status = fs::status(path, error);
    if (!fs::exists(status)) return {"", "expected a file; got no such file. Is the path right?"};
    if (!fs::is_regular_file(status)) return {"", "expected a regular file; got another kind. Copy the file itself."};
    const std::uintmax_t size = fs::file_size(path, error);
    if (error || size > max_bytes) {
        return {"", "expected at most " + std::to_string(max_bytes) + " bytes; got " + std::to_string(size) +
                        ". Is it the right file?"};
    }
    std::ifstream file(path, std::ios::binary);
    std::string content(size, '\0');
    file.read(content.data(), static_cast<std::streamsize>(size));
    if (!file) return {"", "expected a readable file; it cannot be read. Check its permissions, or copy it again."};
    return {std::move(content), ""};
}

std::string sha256(std::string_view bytes) {
    unsigned char digest[EVP_MAX_MD_SIZE];
    unsigned int size = 0;
    if (EVP_Digest(bytes.data(), bytes.size(), digest, &size, EVP_sha256(), nullptr) != 1) {
        throw std::runtime_error("OpenSSL could not compute a SHA-256 hash");
    }
    std::string text(2 * size, '\0');
    for (unsigned int index = 0; index < size; ++index) {
        static constexpr char kDigits[] = "0123456789abcdef";
        text[2 * index] = kDigits[digest[index] >> 4];
        text[2 * index + 1] = kDigits[digest[index] & 15];
    }
    return text;
}

}  // namespace duospacenet
