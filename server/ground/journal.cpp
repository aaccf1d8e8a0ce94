#include "server/ground/journal.h"

#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cstddef>
#include <cstdlib>
#include <string>

namespace raynest::server {
namespace {

/// Compares stderr with the stream that systemd connects to the journal (systemd.exec(5)): stderr
/// may have been redirected since.
bool is_journal() {
    // NOLINT(concurrency-mt-unsafe): nobody sets it
    const char* stream = std::getenv("JOURNAL_STREAM");
    struct stat status {};
    return stream != nullptr && fstat(STDERR_FILENO, &status) == 0 &&
           stream == std::to_string(status.st_dev) + ':' + std::to_string(status.st_ino);
}

}  // namespace

std::string_view journal_priority(LogLevel level) {
    static const bool with_priority = is_journal();
    constexpr std::array<std::string_view, 4> priorities = {"<3>", "<4>", "<6>", "<7>"};
    return with_priority ? priorities[static_cast<std::size_t>(level)] : "";
}

}  // namespace raynest::server
