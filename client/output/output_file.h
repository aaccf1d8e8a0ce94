// The destination of -o: a file, the target of a link, a pipe, a device, or stdout.
//
// A complete new file replaces an old one and keeps its mode. A file is written in place if
// replacing it would change more than its bytes: if its folder cannot be written, if it belongs to
// another user, or if it has further names. Devices, pipes and targets of links are written in
// place; a link stays a link.
#pragma once

#include "client/ground/descriptor.h"
#include "client/ground/failure.h"

#include <sys/types.h>

#include <cstddef>
#include <optional>
#include <ostream>
#include <span>
#include <string>

namespace raynest::client {

/// True for "-" and for "-.exr", whose ending is the format.
[[nodiscard]] bool is_stdout(const std::string& path);

/// Returns the stream for a command's summary: stdout, or stderr if stdout has the bytes.
[[nodiscard]] std::ostream& summary_of(const std::string& path);

/// Fails for a path that write_file() could not write. Called before long work, whose result would
/// otherwise be lost.
Result<void> check_writable(const std::string& path);

/// A file that is written piece by piece. What was written of a new one goes with this, unless it is
/// finished.
class OutputFile {
public:
    /// `mode`: of a new file, less the umask.
    static Result<OutputFile> open(const std::string& path, mode_t mode = 0666);
    OutputFile(OutputFile&& other) noexcept;
    OutputFile& operator=(OutputFile&&) = delete;
    ~OutputFile();

    Result<void> write(std::span<const std::byte> bytes);
    /// Puts a new file in its place.
    Result<void> finish();
    /// The same, once the bytes are on the disk.
    Result<void> finish_on_disk();

private:
    OutputFile() = default;

    std::string path_;            ///< as messages name it
    std::string target_;          ///< with links resolved
    Descriptor file_;             ///< none: stdout
    std::string temporary_;       ///< empty: written in place
    std::optional<mode_t> mode_;  ///< the replaced file's
};

/// Writes a whole file. After a failure no part of a new file remains.
Result<void> write_file(const std::string& path, std::span<const std::byte> bytes);

}  // namespace raynest::client
