// The command: runs a bundle over a scene folder.
#include <chrono>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <future>
#include <iostream>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "errors.hpp"
#include "golden_example.hpp"
#include "pipeline.hpp"
#include "printable.hpp"
#include "results.hpp"
#include "scene_folder.hpp"

namespace {

namespace fs = std::filesystem;
using namespace duospacenet;
using Clock = std::chrono::steady_clock;

constexpr int kInternalError = 70, kInterrupted = 130;
constexpr const char* kUsage =
    "Usage: duospacenet_cpp BUNDLE SCENE_FOLDER --out results.jsonl [--threads N] [--verify]\n"
    "       duospacenet_cpp BUNDLE --verify\n"
    "\n"
    "Detect objects in the frames of a scene folder, and write one line of JSON per frame.\n"
    "\n"
    "  --out FILE    New file for the results.\n"
    "  --verify      First run the bundle's golden example. Exit code 1 if it gives other numbers.\n"
    "  --threads N   Threads of the engine; by default one per core.\n"
    "\n"
    "Exit codes: 0 success, 1 --verify found a difference, 2 wrong usage, 3 bad scene, 4 bad bundle,\n"
    "5 the output cannot be written, 70 a bug, 130 interrupted.\n";

volatile std::sig_atomic_t is_interrupted = 0;

struct Options {
    fs::path bundle, scene, out;
    int threads = static_cast<int>(std::thread::hardware_concurrency());
    bool verify = false, help = false;
};

int parse_threads(const std::string& text) {
    const bool is_number =
        !text.empty() && text.size() <= 3 && text.find_first_not_of("0123456789") == std::string::npos;
    const int threads = is_number ? std::stoi(text) : 0;
    if (threads < 1) throw UsageError("--threads: expected a number from 1 to 999; got '" + text + "'.");
    return threads;
}

Options parse_options(const std::vector<std::string>& arguments) {
    Options options;
    std::vector<std::string> positional;
    for (auto argument = arguments.begin(); argument != arguments.end(); ++argument) {
        const auto value = [&] {
            if (argument + 1 == arguments.end()) throw UsageError(*argument + ": expected a value; got none.");
            return *++argument;
        };
        if (*argument == "--help")
            options.help = true;
        else if (*argument == "--verify")
            options.verify = true;
        else if (*argument == "--out")
            options.out = value();
        else if (*argument == "--threads")
            options.threads = parse_threads(value());
        else if (argument->starts_with("-"))
            throw UsageError("no such option: " + *argument + ". See --help.");
        else
            positional.push_back(*argument);
    }
    if (options.help) return options;
    if (positional.empty() || positional.size() > 2) throw UsageError("expected BUNDLE and SCENE_FOLDER. See --help.");
    options.bundle = positional[0];
    if (positional.size() == 2) options.scene = positional[1];
    const bool has_scene = positional.size() == 2, has_out = !options.out.empty();
    if (has_scene != has_out) throw UsageError("expected SCENE_FOLDER and --out together. See --help.");
    if (!has_scene && !options.verify) throw UsageError("expected SCENE_FOLDER and --out, or --verify. See --help.");
    return options;
}

void check_output(const fs::path& path) {
    if (fs::exists(fs::symlink_status(path))) {
        throw OutputError(path.string() + ": expected a new file; it exists already. Remove it, or choose another.");
    }
    if (!fs::is_directory(fs::absolute(path).parent_path())) {
        throw OutputError(path.string() + ": expected a file in a folder that exists; got another. Create the folder.");
    }
}

/// A new file of lines. Every line is complete on disk, also if the run is interrupted.
class LineFile {
  public:
    explicit LineFile(const fs::path& path) : path_(path), file_(nullptr, &std::fclose) {
        check_output(path);
        file_.reset(std::fopen(path.c_str(), "wx"));
        if (!file_) throw OutputError(path.string() + ": cannot be written. Is its folder writable?");
    }

    void write(const std::string& line) {
        const bool is_written = std::fputs((line + "\n").c_str(), file_.get()) >= 0 && std::fflush(file_.get()) == 0;
        if (!is_written) throw OutputError(path_.string() + ": cannot be written to its end. Is the disk full?");
    }

  private:
    fs::path path_;
    std::unique_ptr<std::FILE, int (*)(std::FILE*)> file_;
};

double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

/// Runs all frames. Another thread reads the images of the next frame while the graphs run.
int run(Pipeline& pipeline, const SceneFolder& scene, LineFile& out) {
    Stream stream(pipeline);
    const auto start = Clock::now();
    double step_s = 0;
    const auto read = [&scene](std::size_t index) {
        return std::async(std::launch::async, [&scene, index] { return scene.frame(index); });
    };
    std::future<Frame> next = read(0);
    for (std::size_t index = 0; index < scene.size(); ++index) {
        const Frame frame = next.get();
        if (index + 1 < scene.size()) next = read(index + 1);
        const auto step_start = Clock::now();
        const Detections detections = stream.step(frame);
        step_s += seconds_since(step_start);
        out.write(result_line(frame, detections, pipeline.manifest()));
        if (is_interrupted) {
            std::cerr << "interrupted after frame " << index << "\n";
            return kInterrupted;
        }
    }
    const auto num_frames = static_cast<double>(scene.size());
    std::fprintf(stderr, "%zu frames: %.2f frames/s; the pipeline takes %.1f ms per frame\n", scene.size(),
                 num_frames / seconds_since(start), 1e3 * step_s / num_frames);
    return 0;
}

/// Checks the whole scene before the graphs are loaded, and creates the output when the graphs are loaded.
int run_command(const Options& options) {
    std::optional<SceneFolder> scene;
    if (!options.scene.empty()) {
        check_output(options.out);
        scene.emplace(options.scene);
    }
    Pipeline pipeline(options.bundle, options.threads);
    if (options.verify) {
        const std::size_t num_values = verify(options.bundle, pipeline);
        std::fprintf(stderr, "golden example: all %zu values agree (%s)\n", num_values, engine_name().c_str());
    }
    if (!scene) return 0;
    scene->check_rigs(pipeline.manifest().num_cameras);
    LineFile out(options.out);
    return run(pipeline, *scene, out);
}

}  // namespace

int main(int argc, char** argv) {
    std::signal(SIGINT, [](int) { is_interrupted = 1; });
    try {
        const Options options = parse_options({argv + 1, argv + argc});
        if (options.help) {
            std::cout << kUsage;
            return 0;
        }
        return run_command(options);
    } catch (const Error& error) {
        std::cerr << "error: " << printable(error.what()) << "\n";
        return error.exit_code();
    } catch (const std::exception& error) {
        std::cerr << "error: a bug in this program: " << printable(error.what()) << "\n";
        return kInternalError;
    }
}
