// The import child: a process that lives for one file, a scene or a picture.
//
// Parsers of foreign formats are a common target of attacks. So they run where a crash, a hang or a
// memory bomb becomes an error message: with limits on address space, processor time, files and
// output, a watchdog in the parent, no inherited descriptors but the two memory files of
// import_wire.h, no privileges to gain, no file, socket, program or process to reach (sandbox.h),
// and death together with the parent.
#include "engine/assets/sandbox/import_child.h"

#include "engine/assets/images/exr_header.h"
#include "engine/assets/import.h"
#include "engine/assets/sandbox/import_wire.h"
#include "engine/assets/sandbox/picture_child.h"
#include "engine/assets/sandbox/sandbox.h"
#include "engine/system/child_memory.h"
#include "engine/system/child_process.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/capability.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <thread>
#include <utility>

namespace raynest {
namespace {

using Clock = std::chrono::steady_clock;

constexpr rlim_t child_files_max = 64;
constexpr rlim_t child_signals_max = 64;  ///< that wait
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
/// Sanitizers reserve terabytes of address space for their shadow memory, and run slowly.
constexpr bool limits_address_space = false;
constexpr int slowdown = 10;
#else
constexpr bool limits_address_space = true;
constexpr int slowdown = 1;
#endif

/// Reason why a child was killed.
enum class Killed { no, late, unwanted, crowded, hidden };

/// Maximum number of a child's threads. Its libraries start one or two for each core. Without a
/// maximum a hostile one could use up those that the system leaves to the daemon (TasksMax of its
/// unit).
std::uint64_t threads_max() {
    constexpr std::uint64_t others = 64;
    return 2 * std::uint64_t{std::thread::hardware_concurrency()} + others;
}

/// Waits until the child ends; kills it for one of these reasons, and what it has started in any
/// case. Returns its status. Polling needs no recent kernel and costs 1 ms of latency.
Result<int> wait_until(pid_t pid, const ChildMemory& memory, Clock::time_point deadline,
                       const StillWanted& wanted, Killed& killed) {
    killed = Killed::no;
    const std::uint64_t most = threads_max();
    const auto is_alive = [pid] {
        siginfo_t state{};
        // WNOWAIT: end_group() reaps it.
        return ::waitid(P_PID, static_cast<id_t>(pid), &state, WEXITED | WNOHANG | WNOWAIT) == 0 &&
               state.si_pid == 0;
    };
    while (killed == Killed::no && is_alive()) {
        const std::uint64_t threads = memory.threads();
        // Its memory would count as nothing.
        if (threads == 0)
            killed = Killed::hidden;
        else if (!wanted(memory.bytes()))
            killed = Killed::unwanted;
        else if (Clock::now() >= deadline)
            killed = Killed::late;
        else if (threads > most)
            killed = Killed::crowded;
        else
            std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    if (const auto status = end_group(pid)) return *status;
    return fail(ErrorCode::internal,
                fmt::format("the import process was lost: {}", std::strerror(errno)));
}

void limit(decltype(RLIMIT_AS) resource, rlim_t value) {
    const rlimit both{value, value};
    // A lower hard limit of the machine stays in force and is not an error.
    static_cast<void>(::setrlimit(resource, &both));
}

/// When memory runs out, the system ends this process, not the daemon.
void offer_to_oom_killer() {
    const Fd score(::open("/proc/self/oom_score_adj", O_WRONLY | O_CLOEXEC));
    static_cast<void>(write_all(score.get(), "1000", 4));
}

/// Erases the environment of the daemon, which may hold secrets.
void forget_environment() {
    for (char** variable = environ; variable != nullptr && *variable != nullptr; ++variable)
        ::explicit_bzero(*variable, std::strlen(*variable));
    ::clearenv();
}

/// Gives up capabilities: root in a container could raise the limits again. The package's unit
/// forbids the call, and has none.
void drop_capabilities() {
    __user_cap_header_struct header{_LINUX_CAPABILITY_VERSION_3, 0};
    const __user_cap_data_struct none[_LINUX_CAPABILITY_U32S_3] = {};
    static_cast<void>(::syscall(SYS_capset, &header, none));
}

/// Takes rights away and sets the limits, before any hostile byte is read. False if the sandbox
/// cannot be entered.
[[nodiscard]] bool confine(const ImportLimits& limits) {
    const auto threads = std::max(1U, std::thread::hardware_concurrency());
    // Before PR_SET_DUMPABLE, which makes the files of /proc/self root's.
    offer_to_oom_killer();
    ::prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0);
    ::prctl(PR_SET_DUMPABLE, 0);
    drop_capabilities();
    if (limits_address_space) {
        // Sanitizers read files and variables, and make calls of their own.
        forget_environment();
        if (!enter_sandbox()) return false;
    }
    limit(RLIMIT_NOFILE, child_files_max);
    limit(RLIMIT_FSIZE, limits.bytes_max);
    limit(RLIMIT_SIGPENDING, child_signals_max);  // the kernel counts them for all of the user
    // A second limit behind the parent's watchdog: more processor time than a child can use in its
    // time.
    limit(RLIMIT_CPU, static_cast<rlim_t>(limits.time_max.count() * slowdown) * threads);
    if (limits_address_space) limit(RLIMIT_AS, limits.bytes_max);
    return true;
}

std::string_view file_name(const std::string& source) {
    return std::string_view(source).substr(0, 200);
}

std::uint64_t bytes_in(const Fd& file) {
    struct stat status {};
    return ::fstat(file.get(), &status) == 0 ? static_cast<std::uint64_t>(status.st_size) : 0;
}

/// Locks or unlocks a memory file. The parent holds a lock on the request until it can measure the
/// child, and the child waits for it before it hides itself (PR_SET_DUMPABLE). The lock goes with the
/// parent.
bool lock(int file, int command, short kind) {
    struct flock whole {};
    whole.l_type = kind;
    whole.l_whence = SEEK_SET;
    return ::fcntl(file, command, &whole) == 0;
}

/// Makes the request final: a child that grew the file would take memory that nobody counts.
Result<void> seal(const Fd& memory_file) {
    constexpr int seals = F_SEAL_SEAL | F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_WRITE;
    if (::fcntl(memory_file.get(), F_ADD_SEALS, seals) == 0) return {};
    return fail(ErrorCode::io_failed,
                fmt::format("sealing a memory file: {}", std::strerror(errno)));
}

/// Runs a child over a request; returns the file with its result.
Result<Fd> run_child(wire::Work work, const ImportRequest& request, const ImportLimits& limits,
                     std::span<const std::string> child, const StillWanted& wanted) {
    const Clock::time_point deadline = Clock::now() + limits.time_max * slowdown;
    if (child.empty())
        return fail(ErrorCode::internal, "there is no command for the import process");
    const auto request_file = create_memory_file("raynest-import-request");
    auto result_file = create_memory_file("raynest-import-result");
    if (!request_file) return tl::unexpected<Error>(request_file.error());
    if (!result_file) return tl::unexpected<Error>(result_file.error());
    if (auto done = wire::write_request(request_file->get(), work, request, limits); !done) {
        return tl::unexpected<Error>(done.error());
    }
    if (auto done = seal(*request_file); !done) return tl::unexpected<Error>(done.error());
    if (!lock(request_file->get(), F_SETLK, F_WRLCK)) {
        return fail(ErrorCode::io_failed,
                    fmt::format("locking a memory file: {}", std::strerror(errno)));
    }
    const auto pid = spawn_child(child, std::array{request_file->get(), result_file->get()});
    if (!pid) {
        return fail(pid.error().code, "the import process " + pid.error().message);
    }
    const ChildMemory memory(*pid, *result_file, bytes_in(*request_file));
    static_cast<void>(lock(request_file->get(), F_SETLK, F_UNLCK));
    Killed killed = Killed::no;
    const auto status = wait_until(*pid, memory, deadline, wanted, killed);
    if (!status) return tl::unexpected<Error>(status.error());
    // The result is read into memory of this process, and may be longer than what it took the
    // child: a file may have holes.
    if (killed == Killed::no && !wanted(memory.bytes() + bytes_in(*result_file)))
        killed = Killed::unwanted;

    if (killed == Killed::unwanted) {
        return fail(ErrorCode::internal,
                    fmt::format("reading '{}' was abandoned", file_name(request.source)));
    }
    if (killed == Killed::late) {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("reading '{}' took longer than {} s and was stopped",
                                file_name(request.source), limits.time_max.count()));
    }
    if (killed == Killed::hidden) {
        return fail(ErrorCode::io_failed,
                    fmt::format("reading '{}' was stopped: the memory of the import process cannot "
                                "be read in /proc; mount /proc where the daemon runs",
                                file_name(request.source)));
    }
    if (killed == Killed::crowded) {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("reading '{}' started over {} threads and was stopped",
                                file_name(request.source), threads_max()));
    }
    // No parser ends itself like this, but the system does so to processes when memory runs out.
    if (WIFSIGNALED(*status) && WTERMSIG(*status) == SIGKILL) {
        return fail(ErrorCode::out_of_memory,
                    fmt::format("reading '{}': the import process was killed; the machine may be "
                                "short of memory",
                                file_name(request.source)));
    }
    if (WIFSIGNALED(*status)) {
        return fail(ErrorCode::scene_invalid,
                    fmt::format("reading '{}' ended the import process ({}); the file is damaged",
                                file_name(request.source), ::strsignal(WTERMSIG(*status))));
    }
    if (WEXITSTATUS(*status) != 0) {
        return fail(ErrorCode::internal,
                    fmt::format("the import process of '{}' failed with exit code {}",
                                file_name(request.source), WEXITSTATUS(*status)));
    }
    return std::move(*result_file);
}

/// A request with one file. `source` names it in messages.
ImportRequest picture_request(const char* source, std::span<const std::byte> file) {
    ImportRequest request;
    request.source = source;
    request.files.push_back({source, file});
    return request;
}

/// The child's work for a picture; returns its exit code.
int decode_picture(const wire::Message& message) {
    if (message.request.files.size() != 1) return 2;
    const std::span<const std::byte> file = message.request.files[0].bytes;
    const auto [side_max, bytes_max] =
        std::pair(message.limits.image_side_max, message.limits.image_bytes_max);
    const auto done =
        message.work == wire::Work::environment
            ? wire::write_result(wire::result_fd, decode_environment(file, side_max, bytes_max))
            : wire::write_result(wire::result_fd, decode_exr(file, side_max, bytes_max));
    return done ? 0 : 3;
}

}  // namespace

Result<std::shared_ptr<const Snapshot>> import_in_child(const ImportRequest& request,
                                                        const ImportLimits& limits,
                                                        std::span<const std::string> child,
                                                        const StillWanted& wanted) {
    const auto result = run_child(wire::Work::scene, request, limits, child, wanted);
    if (!result) return tl::unexpected<Error>(result.error());
    return wire::read_result(result->get(), limits.scene_bytes_max);
}

Result<LightPicture> decode_environment_in_child(std::span<const std::byte> file,
                                                 const ImportLimits& limits,
                                                 std::span<const std::string> child,
                                                 const StillWanted& wanted) {
    const auto result = run_child(wire::Work::environment, picture_request("the environment", file),
                                  limits, child, wanted);
    if (!result) return tl::unexpected<Error>(result.error());
    return wire::read_light(result->get(), limits);
}

Result<std::vector<std::vector<std::uint32_t>>> decode_exr_in_child(
    std::span<const std::byte> file, std::uint32_t width, std::uint32_t height,
    std::span<const ChannelType> channels, const ImportLimits& limits,
    std::span<const std::string> child, const StillWanted& wanted) {
    const auto header = read_exr_header(file);
    if (!header) return tl::unexpected<Error>(header.error());
    const auto places = find_channels(*header, width, height, channels);
    if (!places) return tl::unexpected<Error>(places.error());
    ImportLimits exact = limits;
    exact.image_side_max = std::max(width, height);
    exact.image_bytes_max = decoded_bytes(*header);
    const auto result =
        run_child(wire::Work::exr, picture_request("the EXR", file), exact, child, wanted);
    if (!result) return tl::unexpected<Error>(result.error());
    auto decoded = wire::read_planes(result->get(), width, height, channels.size());
    if (!decoded) return tl::unexpected<Error>(decoded.error());
    std::vector<std::vector<std::uint32_t>> planes;
    for (const std::size_t place : *places) planes.push_back(std::move(decoded->planes[place]));
    return planes;
}

int import_child_main(const Registry& registry, DescribeBuiltin builtin) {
    if (!lock(wire::request_fd, F_SETLKW, F_RDLCK)) return 2;
    const Mapping mapped(Fd(wire::request_fd), Mapping::Access::read);
    if (mapped.bytes().empty()) return 2;
    const auto message = wire::parse_request(mapped.bytes());
    if (!message) return 2;
    if (!bind_to_parent(message->parent)) return 2;
    if (!confine(message->limits)) return 2;
    if (message->work != wire::Work::scene) return decode_picture(*message);
    const auto result = import_arena(message->request, message->limits, registry, builtin);
    return wire::write_result(wire::result_fd, result) ? 0 : 3;
}

}  // namespace raynest
