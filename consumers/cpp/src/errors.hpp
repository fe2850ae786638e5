// The errors that a user can cause, one class per exit code of the command. A message says what was expected, what was
// found, and what to do.
#pragma once

#include <stdexcept>
#include <string>

namespace duospacenet {

class Error : public std::runtime_error {
  public:
    int exit_code() const noexcept { return exit_code_; }

  protected:
    Error(int exit_code, const std::string& message) : std::runtime_error(message), exit_code_(exit_code) {}

  private:
    int exit_code_;
};

/// A check failed: the golden example gave other numbers.
struct CheckError : Error {
    explicit CheckError(const std::string& message) : Error(1, message) {}
};

/// A wrong command line.
struct UsageError : Error {
    explicit UsageError(const std::string& message) : Error(2, message) {}
};

/// A bad frame, image, calibration or scene file.
struct InputError : Error {
    explicit InputError(const std::string& message) : Error(3, message) {}
};

/// A bad bundle.
struct ArtifactError : Error {
    explicit ArtifactError(const std::string& message) : Error(4, message) {}
};

/// A file cannot be written, or exists already.
struct OutputError : Error {
    explicit OutputError(const std::string& message) : Error(5, message) {}
};

}  // namespace duospacenet
