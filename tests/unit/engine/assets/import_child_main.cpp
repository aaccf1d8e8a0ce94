// The tests' import child: `--import-child` is the real one; other arguments misbehave as a
// crashed, hung or hijacked child would.
#include "engine/assets/import.h"
#include "engine/assets/import_wire.h"
#include "engine/assets/sandbox.h"

#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>
#include <utility>
#include <vector>

namespace wire = raynest::wire;

namespace {

rlim_t limit_of(decltype(RLIMIT_AS) resource) {
    rlimit limit{};
    ::getrlimit(resource, &limit);
    return limit.rlim_cur;
}

/// Returns the limits of this process as the exit code, one bit each.
int report_limits() {
    return (::prctl(PR_GET_NO_NEW_PRIVS, 0, 0, 0, 0) == 1 ? 1 : 0) |
           (::prctl(PR_GET_DUMPABLE) == 0 ? 2 : 0) | (limit_of(RLIMIT_NOFILE) <= 64 ? 4 : 0) |
           (limit_of(RLIMIT_FSIZE) != RLIM_INFINITY ? 8 : 0) |
           (limit_of(RLIMIT_CPU) != RLIM_INFINITY ? 16 : 0) |
           (limit_of(RLIMIT_AS) != RLIM_INFINITY ? 32 : 0);
}

/// Returns what the sandbox still allows as the exit code, one bit each.
int report_sandbox() {
    raynest::enter_sandbox();
    const int socket = ::socket(AF_INET, SOCK_STREAM, 0);
    const int secret = ::open("/etc/passwd", O_RDONLY);
    const int created = ::open("/tmp/raynest-sandbox", O_WRONLY | O_CREAT, 0600);
    char* const words[] = {const_cast<char*>("true"), nullptr};
    const bool runs = ::execv("/usr/bin/true", words) == 0 || errno != EPERM;
    const int library = ::open("/usr/lib", O_RDONLY | O_DIRECTORY);
    return (socket >= 0 ? 1 : 0) | (runs ? 2 : 0) | (secret >= 0 ? 4 : 0) |
           (created >= 0 ? 8 : 0) | (library < 0 ? 16 : 0);
}

/// Decodes an EXR and answers with all its bytes, but false sizes.
int answer_falsely(std::string_view mode) {
    const raynest::Mapping mapped(raynest::Fd(wire::request_fd), raynest::Mapping::Access::read);
    const auto message = wire::parse_request(mapped.bytes());
    if (!message) return 1;
    auto exr = raynest::decode_exr(message->request.files.at(0).bytes,
                                   message->limits.image_side_max, message->limits.image_bytes_max);
    if (!exr) return 1;
    if (mode == "--transposed") {
        std::swap(exr->width, exr->height);
    } else {
        exr->width /= 2;
        std::vector<std::vector<std::uint32_t>> halves;
        for (const auto& plane : exr->planes) {
            const auto middle = plane.begin() + static_cast<std::ptrdiff_t>(plane.size() / 2);
            halves.emplace_back(plane.begin(), middle);
            halves.emplace_back(middle, plane.end());
        }
        exr->planes = std::move(halves);
    }
    return wire::write_result(wire::result_fd, exr) ? 0 : 1;
}

}  // namespace

int main(int count, char** words) {
    const std::string_view mode = count > 1 ? words[1] : "";
    if (mode == "--crash") {
        std::signal(SIGSEGV, SIG_DFL);  // otherwise a sanitizer turns the signal into an exit code
        std::raise(SIGSEGV);
    }
    if (mode == "--killed") std::raise(SIGKILL);
    if (mode == "--hang") ::pause();
    if (mode == "--fail") return 7;
    if (mode == "--sandbox") return 100 + report_sandbox();
    if (mode == "--junk") {
        for (int i = 0; i < 64; ++i) {
            if (::write(4, "this is no snapshot", 19) != 19) return 1;
        }
        return 0;
    }
    if (mode == "--list-descriptors") {
        // Report open descriptors as bits of the exit code: 0..4 and nothing else.
        int open = 0;
        for (int fd = 0; fd < 256; ++fd) {
            if (::lseek(fd, 0, SEEK_CUR) >= 0 || ::isatty(fd) != 0) ++open;
        }
        return 100 + open;
    }
    const auto registry = raynest::Registry::load({});
    if (mode == "--boundless" && registry) {
        const raynest::Mapping mapped(raynest::Fd(wire::request_fd),
                                      raynest::Mapping::Access::read);
        const auto message = wire::parse_request(mapped.bytes());
        if (!message) return 1;
        const auto result = raynest::import_arena(message->request, {}, **registry);
        return wire::write_result(wire::result_fd, result) ? 0 : 1;
    }
    if (mode == "--transposed" || mode == "--regrouped") return answer_falsely(mode);
    if (mode != "--import-child" && mode != "--report-limits") return 0;
    if (!registry) return 9;
    const int code = raynest::import_child_main(**registry);
    return mode == "--import-child" ? code : report_limits();
}
