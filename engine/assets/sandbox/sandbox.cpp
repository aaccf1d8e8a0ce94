#include "engine/assets/sandbox/sandbox.h"

#include "engine/system/child_process.h"

#include <fcntl.h>
#include <linux/landlock.h>
#include <linux/seccomp.h>
#include <sched.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <initializer_list>

#ifdef RAYNEST_SECCOMP
#include <seccomp.h>
#endif

namespace raynest {
namespace {

// ---- Landlock -----------------------------------------------------------------------------------

/// The kernel's landlock_ruleset_attr of version 6: older headers lack its end.
struct Ruleset {
    std::uint64_t files = 0;
    std::uint64_t network = 0;
    std::uint64_t scoped = 0;
};

/// Rights that the kernel knows from a version on. Each is taken away.
struct Rights {
    int version;
    std::uint64_t Ruleset::*kind;
    std::uint64_t bits;
};
constexpr Rights rights[] = {
    {1, &Ruleset::files, (1ULL << 13) - 1},   // to execute, read, write, make and remove files
    {2, &Ruleset::files, 1ULL << 13},         // to move files between folders
    {3, &Ruleset::files, 1ULL << 14},         // to truncate
    {4, &Ruleset::network, (1ULL << 2) - 1},  // to bind and connect TCP
    {5, &Ruleset::files, 1ULL << 15},         // ioctl of devices
    {6, &Ruleset::scoped, (1ULL << 2) - 1},   // abstract sockets and signals of other processes
};

/// Returns the version of Landlock; 0 without it.
int landlock_version() {
    const long version =
        syscall(SYS_landlock_create_ruleset, nullptr, 0, LANDLOCK_CREATE_RULESET_VERSION);
    return version > 0 ? static_cast<int>(version) : 0;
}

/// Keeps the right to read files below a path. Without the rule less can be read, which is safe.
void allow_reading(int rules, const std::filesystem::path& path) {
    const Fd opened(open(path.c_str(), O_PATH | O_CLOEXEC));
    if (opened.get() < 0) return;
    landlock_path_beneath_attr rule{};
    rule.allowed_access = LANDLOCK_ACCESS_FS_READ_FILE;
    rule.parent_fd = opened.get();
    (void)syscall(SYS_landlock_add_rule, rules, LANDLOCK_RULE_PATH_BENEATH, &rule, 0);
}

// ---- seccomp ------------------------------------------------------------------------------------

#ifdef RAYNEST_SECCOMP
bool has_filters() {
    const std::uint32_t action = SECCOMP_RET_ERRNO;
    return syscall(SYS_seccomp, SECCOMP_GET_ACTION_AVAIL, 0, &action) == 0;
}

/// Calls that are allowed with any argument: none names a path but newfstatat and statx, which only
/// look, and none reaches another process.
constexpr int free_calls[] = {
    // Memory.
    SCMP_SYS(brk),
    SCMP_SYS(munmap),
    SCMP_SYS(mremap),
    SCMP_SYS(madvise),
    SCMP_SYS(mincore),
    // Open files.
    SCMP_SYS(read),
    SCMP_SYS(readv),
    SCMP_SYS(pread64),
    SCMP_SYS(write),
    SCMP_SYS(writev),
    SCMP_SYS(pwrite64),
    SCMP_SYS(lseek),
    SCMP_SYS(close),
    SCMP_SYS(fstat),
    SCMP_SYS(newfstatat),
    SCMP_SYS(statx),
    SCMP_SYS(getdents64),
    // Threads.
    SCMP_SYS(futex),
    SCMP_SYS(set_robust_list),
    SCMP_SYS(rseq),
    SCMP_SYS(sched_yield),
    SCMP_SYS(sched_getaffinity),
    SCMP_SYS(getcpu),
    SCMP_SYS(exit),
    SCMP_SYS(exit_group),
    // Signal handlers.
    SCMP_SYS(rt_sigaction),
    SCMP_SYS(rt_sigprocmask),
    SCMP_SYS(rt_sigreturn),
    SCMP_SYS(sigaltstack),
    SCMP_SYS(restart_syscall),
    // Clocks, and facts about this process and the machine.
    SCMP_SYS(clock_gettime),
    SCMP_SYS(clock_getres),
    SCMP_SYS(clock_nanosleep),
    SCMP_SYS(nanosleep),
    SCMP_SYS(gettimeofday),
    SCMP_SYS(time),
    SCMP_SYS(getrandom),
    SCMP_SYS(getpid),
    SCMP_SYS(gettid),
    SCMP_SYS(getppid),
    SCMP_SYS(getuid),
    SCMP_SYS(geteuid),
    SCMP_SYS(getgid),
    SCMP_SYS(getegid),
    SCMP_SYS(getrusage),
    SCMP_SYS(sysinfo),
    SCMP_SYS(uname),
};

/// A call that is allowed where `mask` of an argument has this value. Several rules for a call:
/// any.
struct Rule {
    int call;
    unsigned argument;
    std::uint64_t mask;
    std::uint64_t value;
};

constexpr std::uint64_t all_bits = ~std::uint64_t{0};
/// Numbers of processes and commands have 32 bits; the rest of the register is undefined.
constexpr std::uint64_t low_bits = 0xFFFF'FFFF;

bool allow(scmp_filter_ctx filter, const Rule& rule) {
    const scmp_arg_cmp compared{rule.argument, SCMP_CMP_MASKED_EQ, rule.mask, rule.value};
    return seccomp_rule_add_array(filter, SCMP_ACT_ALLOW, rule.call, 1, &compared) == 0;
}

bool allow_calls(scmp_filter_ctx filter) {
    for (const int call : free_calls)
        if (seccomp_rule_add_array(filter, SCMP_ACT_ALLOW, call, 0, nullptr) != 0) return false;
    const auto self = static_cast<std::uint64_t>(getpid());
    constexpr std::uint64_t thread_flags = CLONE_VM | CLONE_FS | CLONE_FILES | CLONE_SIGHAND |
                                           CLONE_THREAD | CLONE_SYSVSEM | CLONE_SETTLS |
                                           CLONE_PARENT_SETTID | CLONE_CHILD_CLEARTID;
    const std::initializer_list<Rule> rules = {
        // A thread, as glibc starts it. clone3 keeps its flags in memory, which no filter can read.
        {SCMP_SYS(clone), 0, all_bits, thread_flags},
        // Signals, such as that of abort(), and limits: to this process.
        {SCMP_SYS(tgkill), 0, low_bits, self},
        {SCMP_SYS(kill), 0, low_bits, self},
        {SCMP_SYS(prlimit64), 0, low_bits, 0},
        // As with mmap below.
        {SCMP_SYS(mprotect), 2, PROT_EXEC, 0},
        {SCMP_SYS(openat), 2, O_ACCMODE | O_CREAT | O_TRUNC, O_RDONLY},
        // Not F_SETOWN and F_SETSIG: they let the kernel send a signal to any process of the user.
        {SCMP_SYS(fcntl), 1, low_bits, F_GETFD},
        {SCMP_SYS(fcntl), 1, low_bits, F_SETFD},
        {SCMP_SYS(fcntl), 1, low_bits, F_GETFL},
        {SCMP_SYS(ioctl), 1, low_bits, TCGETS},  // isatty()
        // Not PR_SET_PDEATHSIG: the process would outlive the daemon.
        {SCMP_SYS(prctl), 0, low_bits, PR_SET_NAME},
        {SCMP_SYS(prctl), 0, low_bits, PR_GET_NAME},
        {SCMP_SYS(prctl), 0, low_bits, PR_GET_DUMPABLE},
        {SCMP_SYS(prctl), 0, low_bits, PR_GET_NO_NEW_PRIVS},
    };
    for (const Rule& rule : rules)
        if (!allow(filter, rule)) return false;
    // No mapping is writable and executable at once; libraries are mapped from files. The child can
    // still write code into its result file and map that: calls are what holds it. Pages of a mapping
    // that is shared, locked or huge would not count in ChildMemory.
    constexpr std::uint64_t kinds = MAP_TYPE | MAP_LOCKED | MAP_HUGETLB;
    for (const std::uint64_t left_out : {std::uint64_t{PROT_EXEC}, std::uint64_t{PROT_WRITE}}) {
        const std::array<scmp_arg_cmp, 2> compared{
            {{2, SCMP_CMP_MASKED_EQ, left_out, 0}, {3, SCMP_CMP_MASKED_EQ, kinds, MAP_PRIVATE}}};
        if (seccomp_rule_add_array(filter, SCMP_ACT_ALLOW, SCMP_SYS(mmap), compared.size(),
                                   compared.data()) != 0)
            return false;
    }
    return true;
}
#endif

}  // namespace

std::string sandbox_gaps() {
    std::string gaps;
#ifndef RAYNEST_SECCOMP
    gaps = "this build has no libseccomp";
#else
    if (!has_filters()) gaps = "no seccomp filter can be set here";
#endif
    if (landlock_version() == 0)
        gaps += std::string(gaps.empty() ? "" : ", and ") + "the kernel offers no Landlock";
    return gaps;
}

bool restrict_files() {
    prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0);
    const int version = landlock_version();
    if (version == 0) return true;
    Ruleset taken;
    for (const Rights& each : rights)
        if (version >= each.version) taken.*each.kind |= each.bits;
    const std::size_t size = version >= 6   ? sizeof taken
                             : version >= 4 ? offsetof(Ruleset, scoped)
                                            : offsetof(Ruleset, network);
    const Fd rules(static_cast<int>(syscall(SYS_landlock_create_ruleset, &taken, size, 0)));
    if (rules.get() < 0) return false;
    std::error_code error;
    const auto program = std::filesystem::read_symlink("/proc/self/exe", error);
    // Shared libraries: the modules for pictures and Draco load with the first file that needs
    // them. They stand beside the program, in ../lib.
    allow_reading(rules.get(), program.parent_path().parent_path() / "lib");
    for (const char* path : {"/lib", "/lib64", "/usr/lib", "/usr/lib64", "/usr/local/lib",
                             "/etc/ld.so.cache", "/dev/null"})
        allow_reading(rules.get(), path);
    return syscall(SYS_landlock_restrict_self, rules.get(), 0) == 0;
}

bool restrict_calls() {
#ifdef RAYNEST_SECCOMP
    if (!has_filters()) return true;
    const scmp_filter_ctx filter = seccomp_init(SCMP_ACT_ERRNO(ENOSYS));
    if (filter == nullptr) return false;
    // Calls by the numbers of another architecture end the process.
    const bool done =
        seccomp_attr_set(filter, SCMP_FLTATR_ACT_BADARCH, SCMP_ACT_KILL_PROCESS) == 0 &&
        seccomp_attr_set(filter, SCMP_FLTATR_CTL_TSYNC, 1) == 0 && allow_calls(filter) &&
        seccomp_load(filter) == 0;
    seccomp_release(filter);
    return done;
#else
    return true;
#endif
}

bool enter_sandbox() {
    return restrict_files() && restrict_calls();
}

}  // namespace raynest
