// The import child of the tests: `--import-child` is the real one, the other words misbehave as a
// crashed, hung or hijacked child would.
#include "engine/assets/import.h"
#include "engine/assets/import_wire.h"

#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <string_view>

namespace wire = raynest::wire;

int main(int count, char** words) {
    const std::string_view mode = count > 1 ? words[1] : "";
    if (mode == "--crash") {
        std::signal(SIGSEGV, SIG_DFL);  // a sanitizer would make an exit code of it
        std::raise(SIGSEGV);
    }
    if (mode == "--hang") ::pause();
    if (mode == "--fail") return 7;
    if (mode == "--junk") {
        for (int i = 0; i < 64; ++i) {
            if (::write(4, "this is no snapshot", 19) != 19) return 1;
        }
        return 0;
    }
    if (mode == "--list-descriptors") {
        // One bit per open descriptor, as the exit code: 0..4 and nothing else.
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
        const auto result = raynest::import_here(message->request, {}, **registry);
        return wire::write_result(wire::result_fd, result) ? 0 : 1;
    }
    if (mode != "--import-child") return 0;
    return registry ? raynest::import_child_main(**registry) : 9;
}
