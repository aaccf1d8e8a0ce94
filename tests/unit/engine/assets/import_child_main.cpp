// The import child of the tests: `--import-child` is the real one, the other words misbehave as a
// crashed, hung or hijacked child would.
#include "engine/assets/import.h"

#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <string_view>

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
    if (mode != "--import-child") return 0;
    const auto registry = raynest::Registry::load({});
    return registry ? raynest::import_child_main(**registry) : 9;
}
