// The tests' import child: `--import-child` is the real one; other arguments misbehave as a
// crashed, hung or hijacked child would.
#include "engine/assets/builtin/builtin.h"
#include "engine/assets/import.h"
#include "engine/assets/sandbox/import_child.h"
#include "engine/assets/sandbox/import_wire.h"
#include "engine/assets/sandbox/sandbox.h"
#include "engine/system/child_process.h"
#include "tests/unit/engine/assets/forbidden_calls.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <linux/landlock.h>
#include <netinet/in.h>
#include <sched.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/mount.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

namespace wire = raynest::wire;

namespace {

rlim_t limit_of(decltype(RLIMIT_AS) resource) {
    rlimit limit{};
    ::getrlimit(resource, &limit);
    return limit.rlim_cur;
}

/// Files about this process, opened before it closes itself off, and its environment.
struct Facts {
    raynest::Fd score{::open("/proc/self/oom_score_adj", O_RDONLY)};
    raynest::Fd status{::open("/proc/self/status", O_RDONLY)};
    const char* secret = std::getenv("RAYNEST_TEST_SECRET");
};

bool says(const raynest::Fd& file, std::string_view part) {
    std::string text(4096, '\0');
    return ::read(file.get(), text.data(), text.size()) > 0 && text.find(part) != text.npos;
}

/// Returns the limits of this process as the exit code, one bit each.
int report_limits(const Facts& facts) {
    const bool goes_first = says(facts.score, "1000\n");
    const bool is_nobody = says(facts.status, "CapEff:\t0000000000000000\n");
    return (::prctl(PR_GET_NO_NEW_PRIVS, 0, 0, 0, 0) == 1 ? 1 : 0) |
           (::prctl(PR_GET_DUMPABLE) == 0 ? 2 : 0) | (limit_of(RLIMIT_NOFILE) <= 64 ? 4 : 0) |
           (limit_of(RLIMIT_FSIZE) != RLIM_INFINITY ? 8 : 0) |
           (limit_of(RLIMIT_CPU) != RLIM_INFINITY ? 16 : 0) |
           (limit_of(RLIMIT_AS) != RLIM_INFINITY ? 32 : 0) | (goes_first ? 64 : 0) |
           (is_nobody ? 128 : 0);
}

/// Tries all forbidden calls. Returns the number of the first that is not refused, counted from 1;
/// 0 if all are. EACCES is Landlock's answer about a file that the filter lets it judge.
int first_not_refused() {
    int number = 0;
    for (const auto& call : raynest::test::forbidden_calls()) {
        ++number;
        errno = 0;
        if (call.attempt() >= 0 || (errno != ENOSYS && errno != EACCES)) return number;
    }
    return 0;
}

/// Returns what Landlock alone still allows as the exit code, one bit each. `folder` holds a file
/// "victim" of this user. What this kernel's Landlock lacks is not tried.
int report_files(const std::string& folder) {
    const long version =
        ::syscall(SYS_landlock_create_ruleset, nullptr, 0, LANDLOCK_CREATE_RULESET_VERSION);
    const std::string victim = folder + "/victim";
    const std::string other = folder + "/other";
    if (!raynest::restrict_files()) return 255;
    sockaddr_in nobody{};
    nobody.sin_family = AF_INET;
    nobody.sin_port = htons(9);
    nobody.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const int socket = ::socket(AF_INET, SOCK_STREAM, 0);
    const bool connects =
        ::connect(socket, reinterpret_cast<sockaddr*>(&nobody), sizeof nobody) == 0 ||
        errno != EACCES;
    const bool changes_paths = ::rename(victim.c_str(), other.c_str()) == 0 ||
                               ::link(victim.c_str(), other.c_str()) == 0 ||
                               ::mkdir(other.c_str(), 0700) == 0 ||
                               ::symlink("x", other.c_str()) == 0 || ::unlink(victim.c_str()) == 0;
    const int library = ::open("/etc/ld.so.cache", O_RDONLY);
    char* const words[] = {const_cast<char*>("true"), nullptr};
    return (::open(victim.c_str(), O_RDONLY) >= 0 || ::open(victim.c_str(), O_WRONLY) >= 0 ? 1
                                                                                           : 0) |
           (::open(other.c_str(), O_WRONLY | O_CREAT, 0600) >= 0 || changes_paths ? 2 : 0) |
           (version >= 3 && ::truncate(victim.c_str(), 0) == 0 ? 4 : 0) |
           (version >= 4 && connects ? 8 : 0) |
           (version >= 6 && ::kill(::getppid(), 0) == 0 ? 16 : 0) |
           (::execv("/usr/bin/true", words) == 0 || errno != EACCES ? 32 : 0) |
           (library < 0 ? 64 : 0);
}

/// Changes the memory file of the request. Returns what succeeds as the exit code, one bit each.
int change_request() {
    const bool writes = ::pwrite(wire::request_fd, "x", 1, 0) >= 0;
    const bool grows = ::pwrite(wire::request_fd, "x", 1, 1 << 20) >= 0;
    const bool maps =
        ::mmap(nullptr, 1, PROT_READ | PROT_WRITE, MAP_SHARED, wire::request_fd, 0) != MAP_FAILED;
    return (writes ? 1 : 0) | (grows ? 2 : 0) | (maps ? 4 : 0);
}

/// Starts many threads that do nothing.
int start_threads() {
    std::vector<std::jthread> threads;
    for (int i = 0; i < 1000; ++i) threads.emplace_back([] { ::pause(); });
    return 0;
}

/// Leaves a process behind that holds a lock on a file until it ends.
int leave_a_process(const char* file) {
    std::array<int, 2> ready{};
    if (::pipe(ready.data()) != 0) return 1;
    if (::fork() == 0) {
        ::alarm(600);
        if (::flock(::open(file, O_RDWR | O_CREAT, 0600), LOCK_EX) != 0) return 1;
        if (::write(ready[1], "", 1) != 1) return 1;
        for (;;) ::pause();
    }
    char byte = 0;
    return ::read(ready[0], &byte, 1) == 1 ? 7 : 1;
}

/// Makes a system call by its number on i386, where 1 ends the process with this exit code.
void exit_as_i386([[maybe_unused]] int code) {
#ifdef __x86_64__
    __asm__ volatile("int $0x80" : : "a"(1), "b"(code) : "memory");
#endif
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

/// Answers with a scene of 256 MiB that takes no memory here: all but its header is a hole.
int answer_with_holes() {
    constexpr std::uint64_t scene_bytes = 256ULL << 20;
    constexpr off_t size_place = 16;  // in the header of the result
    const raynest::Result<raynest::BuiltArena> small{raynest::BuiltArena{raynest::Arena(64)}};
    if (!wire::write_result(wire::result_fd, small)) return 1;
    const off_t header_bytes = ::lseek(wire::result_fd, 0, SEEK_END) - 64;
    return ::ftruncate(wire::result_fd, header_bytes + static_cast<off_t>(scene_bytes)) == 0 &&
                   ::pwrite(wire::result_fd, &scene_bytes, sizeof scene_bytes, size_place) ==
                       sizeof scene_bytes
               ? 0
               : 1;
}

/// Imports a scene where nothing is in /proc, as where the child is hidden there. Returns 0 if the
/// import is refused, 1 if it is not, and 2 if /proc cannot be covered here.
int import_without_proc(const char* program) {
    if (::unshare(CLONE_NEWNS) != 0 && ::unshare(CLONE_NEWUSER | CLONE_NEWNS) != 0) return 2;
    if (::mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0) return 2;
    if (::mount("tmpfs", "/proc", "tmpfs", 0, nullptr) != 0) return 2;
    raynest::ImportRequest request;
    request.source = "builtin:flake?depth=2";
    const std::vector<std::string> child{program, "--import-child"};
    const auto scene = raynest::import_in_child(request, {}, child);
    return !scene && scene.error().message.find("mount /proc") != std::string::npos ? 0 : 1;
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
    if (mode == "--sandbox") return raynest::enter_sandbox() ? 100 + first_not_refused() : 1;
    if (mode == "--without-proc") return 100 + import_without_proc(words[0]);
    if (mode == "--calls") return raynest::restrict_calls() ? 100 + first_not_refused() : 1;
    if (mode == "--files") return 100 + report_files(words[2]);
    if (mode == "--change-request") return 100 + change_request();
    if (mode == "--threads") return start_threads();
    if (mode == "--holes") return answer_with_holes();
    if (mode == "--leave-a-process") return leave_a_process(words[2]);
    if (mode == "--other-architecture") {
        if (!raynest::restrict_calls()) return 1;
        exit_as_i386(7);
    }
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
        const auto result =
            raynest::import_arena(message->request, {}, **registry, raynest::describe_builtin);
        return wire::write_result(wire::result_fd, result) ? 0 : 1;
    }
    if (mode == "--transposed" || mode == "--regrouped") return answer_falsely(mode);
    const std::array imports{"--import-child", "--hijacked", "--report-limits", "--environment"};
    if (std::ranges::find(imports, mode) == imports.end()) return 0;
    if (!registry) return 9;
    const Facts facts;
    const int code = raynest::import_child_main(**registry, raynest::describe_builtin);
    if (mode == "--import-child") return code;
    if (mode == "--hijacked") return 100 + first_not_refused();
    if (mode == "--report-limits") return report_limits(facts);
    return facts.secret == nullptr ? 1
                                   : 100 + (*facts.secret != '\0') + (::environ != nullptr ? 2 : 0);
}
