#include "client/output/output_file.h"

#include "client/files/files.h"
#include "client/ground/descriptor.h"
#include "client/ground/interrupt.h"
#include "client/output/output.h"

#include <fcntl.h>
#include <sys/stat.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <optional>
#include <system_error>
#include <utility>

namespace raynest::client {
namespace {

/// Number of names to try for the unfinished file, in case some exist already.
constexpr int names_max = 100;

struct Destination {
    std::string path;            ///< with links resolved
    bool exists = false;         ///< there is a file, pipe or device
    bool in_place = false;       ///< write into it instead of replacing it
    std::optional<mode_t> mode;  ///< mode of the replaced file
};

tl::unexpected<Failure> cannot_write(const std::string& path, const std::string& why) {
    return fail(Exit::failed, "cannot write " + path + ": " + why);
}

std::string folder_of(const std::string& path) {
    const std::size_t slash = path.rfind('/');
    return slash == std::string::npos ? "./" : path.substr(0, slash + 1);
}

bool can_write(const std::string& path, int mode) {
    return ::faccessat(AT_FDCWD, path.c_str(), mode, AT_EACCESS) == 0;
}

Result<Destination> destination_of(const std::string& path) {
    struct stat status = {};
    if (::stat(path.c_str(), &status) != 0) {
        // Write a dangling link in place: that creates its target.
        if (::lstat(path.c_str(), &status) == 0) return Destination{path, false, true, {}};
        if (can_write(folder_of(path), W_OK | X_OK)) return Destination{path, false, false, {}};
        if (errno == ENOENT) return cannot_write(path, "there is no folder " + folder_of(path));
        return cannot_write(path, std::strerror(errno));
    }
    if (S_ISDIR(status.st_mode)) return cannot_write(path, "it is a folder");
    constexpr mode_t writable = S_IWUSR | S_IWGRP | S_IWOTH;
    // Respect a read-only mode: root could write the file all the same.
    if (S_ISREG(status.st_mode) && (status.st_mode & writable) == 0)
        return cannot_write(path, "it is read-only; chmod +w it, or give -o another name");
    if (!can_write(path, W_OK)) return cannot_write(path, std::strerror(errno));
    if (!S_ISREG(status.st_mode)) return Destination{path, true, true, {}};

    std::error_code unknown;
    const auto end = std::filesystem::canonical(path, unknown);
    const std::string real = unknown ? path : end.string();
    const bool replaceable = !unknown && status.st_uid == ::geteuid() && status.st_nlink == 1 &&
                             can_write(folder_of(real), W_OK | X_OK);
    return Destination{real, true, !replaceable, status.st_mode & 07777};
}

Result<void> write_all(int file, const std::string& path, std::span<const std::byte> bytes) {
    while (!bytes.empty()) {
        const ssize_t count = ::write(file, bytes.data(), bytes.size());
        if (count < 0 && errno == EINTR && !interrupted()) continue;
        if (count < 0 && interrupted()) return fail(Exit::interrupted, "interrupted");
        if (count < 0) return cannot_write(path, std::strerror(errno));
        bytes = bytes.subspan(static_cast<std::size_t>(count));
    }
    return {};
}

}  // namespace

Result<OutputFile> OutputFile::open(const std::string& path, mode_t mode) {
    OutputFile output;
    output.path_ = is_stdout(path) ? "stdout" : path;
    if (is_stdout(path)) return output;
    const auto to = destination_of(path);
    if (!to) return tl::unexpected<Failure>(to.error());
    output.target_ = to->path;
    output.mode_ = to->mode;
    if (to->in_place) {
        const int how = O_WRONLY | O_CLOEXEC | (to->exists ? O_TRUNC : O_CREAT);
        output.file_ = Descriptor(::open(to->path.c_str(), how, mode));
        if (output.file_) return output;
        if (interrupted()) return fail(Exit::interrupted, "interrupted");
        return cannot_write(path, std::strerror(errno));
    }
    // Leave out the file's own name, which may already have the maximum length.
    const std::string stem = folder_of(to->path) + ".raynest-" + std::to_string(::getpid()) + "-";
    for (int i = 0; i < names_max; ++i) {
        const std::string name = stem + std::to_string(i);
        constexpr int how = O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC;
        output.file_ = Descriptor(::open(name.c_str(), how, mode));
        if (!output.file_ && errno != EEXIST) return cannot_write(path, std::strerror(errno));
        if (!output.file_) continue;
        output.temporary_ = name;
        return output;
    }
    return cannot_write(path, "its folder is full of unfinished files");
}

OutputFile::OutputFile(OutputFile&& other) noexcept
    : path_(std::move(other.path_)),
      target_(std::move(other.target_)),
      file_(std::move(other.file_)),
      temporary_(std::exchange(other.temporary_, {})),
      mode_(other.mode_) {}

OutputFile::~OutputFile() {
    if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

Result<void> OutputFile::write(std::span<const std::byte> bytes) {
    auto written = write_all(file_ ? file_.number() : STDOUT_FILENO, path_, bytes);
    if (!written && !file_) end_if_unread();
    return written;
}

Result<void> OutputFile::finish() {
    if (temporary_.empty()) return {};
    if (mode_ && ::fchmod(file_.number(), *mode_) != 0)
        return cannot_write(path_, std::strerror(errno));
    if (std::rename(temporary_.c_str(), target_.c_str()) != 0)
        return cannot_write(path_, std::strerror(errno));
    temporary_.clear();
    return {};
}

Result<void> OutputFile::finish_on_disk() {
    // Pipes and devices have none.
    if (file_ && ::fsync(file_.number()) != 0 && errno != EINVAL && errno != EROFS)
        return cannot_write(path_, std::strerror(errno));
    return finish();
}

bool is_stdout(const std::string& path) {
    return path == standard_stream ||
           (path.starts_with("-.") && path.find_first_of("./", 2) == std::string::npos);
}

std::ostream& summary_of(const std::string& path) {
    return is_stdout(path) ? std::cerr : std::cout;
}

Result<void> check_writable(const std::string& path) {
    if (is_stdout(path)) {
        if (::isatty(STDOUT_FILENO) == 0) return {};
        return fail(Exit::usage,
                    "-o - would write bytes to the terminal; pipe them on, or name a file");
    }
    if (auto to = destination_of(path); !to) return tl::unexpected<Failure>(to.error());
    return {};
}

Result<void> write_file(const std::string& path, std::span<const std::byte> bytes) {
    auto file = OutputFile::open(path);
    if (!file) return tl::unexpected<Failure>(file.error());
    if (auto written = file->write(bytes); !written) return written;
    return file->finish();
}

}  // namespace raynest::client
