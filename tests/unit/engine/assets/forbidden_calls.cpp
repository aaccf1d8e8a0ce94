#include "tests/unit/engine/assets/forbidden_calls.h"

#include <fcntl.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <unistd.h>

#include <csignal>
#include <cstdint>

namespace raynest::test {
namespace {

/// Ends the new process of a fork that was allowed.
long forked(long pid) {
    if (pid == 0) ::_exit(0);
    return pid;
}

/// The parent stands for the daemon. Signal 0 asks for the permission alone.
long parent() {
    return ::getppid();
}

template <class... Arguments>
long call(long number, Arguments... arguments) {
    return ::syscall(number, arguments...);
}

constexpr const char* victim = "/tmp/raynest-victim";
constexpr const char* other = "/tmp/raynest-other";

}  // namespace

#define RAYNEST_TRY(name, expression)                      \
    ForbiddenCall {                                        \
        name, [] { return static_cast<long>(expression); } \
    }

const std::vector<ForbiddenCall>& forbidden_calls() {
    static rlimit few{3, 3};
    static siginfo_t queued{};
    static const std::uint64_t clone_arguments[8] = {};
    static char* const words[] = {const_cast<char*>("true"), nullptr};
    static const std::vector<ForbiddenCall> all = {
        // Processes and threads.
        RAYNEST_TRY("fork", forked(call(SYS_fork))),
        RAYNEST_TRY("clone", forked(call(SYS_clone, SIGCHLD, 0, 0, 0, 0))),
        RAYNEST_TRY("clone with other flags",
                    forked(call(SYS_clone, CLONE_PARENT | SIGCHLD, 0, 0, 0, 0))),
        RAYNEST_TRY("clone with a namespace",
                    forked(call(SYS_clone, CLONE_NEWUSER | SIGCHLD, 0, 0, 0, 0))),
        RAYNEST_TRY("clone3", forked(call(SYS_clone3, clone_arguments, sizeof clone_arguments))),
        RAYNEST_TRY("execve", call(SYS_execve, "/usr/bin/true", words, nullptr)),
        RAYNEST_TRY("execveat", call(SYS_execveat, AT_FDCWD, "/usr/bin/true", words, nullptr, 0)),
        RAYNEST_TRY("setsid", call(SYS_setsid)),
        RAYNEST_TRY("setpgid", call(SYS_setpgid, 0, 0)),
        RAYNEST_TRY("unshare", call(SYS_unshare, CLONE_NEWUSER)),
        RAYNEST_TRY("setns", call(SYS_setns, 0, 0)),
        RAYNEST_TRY("ptrace", call(SYS_ptrace, 16 /* PTRACE_ATTACH */, parent(), 0, 0)),
        RAYNEST_TRY("process_vm_readv", call(SYS_process_vm_readv, parent(), 0, 0, 0, 0, 0)),
        RAYNEST_TRY("process_vm_writev", call(SYS_process_vm_writev, parent(), 0, 0, 0, 0, 0)),
        RAYNEST_TRY("process_madvise", call(SYS_process_madvise, 0, 0, 0, 0, 0)),
        RAYNEST_TRY("pidfd_open", call(SYS_pidfd_open, parent(), 0)),
        RAYNEST_TRY("kcmp", call(SYS_kcmp, parent(), ::getpid(), 0, 0, 0)),
        // Signals, limits and priorities of others; the death signal of this process.
        RAYNEST_TRY("kill", call(SYS_kill, parent(), 0)),
        RAYNEST_TRY("kill of a group", call(SYS_kill, 0, 0)),
        RAYNEST_TRY("kill of everybody", call(SYS_kill, -1, 0)),
        RAYNEST_TRY("tkill", call(SYS_tkill, parent(), 0)),
        RAYNEST_TRY("tgkill", call(SYS_tgkill, parent(), parent(), 0)),
        RAYNEST_TRY("rt_sigqueueinfo", call(SYS_rt_sigqueueinfo, parent(), 0, &queued)),
        RAYNEST_TRY("rt_tgsigqueueinfo",
                    call(SYS_rt_tgsigqueueinfo, parent(), parent(), 0, &queued)),
        RAYNEST_TRY("pidfd_send_signal", call(SYS_pidfd_send_signal, 0, 0, 0, 0)),
        RAYNEST_TRY("fcntl F_SETOWN", call(SYS_fcntl, 3, F_SETOWN, parent())),
        RAYNEST_TRY("fcntl F_SETSIG", call(SYS_fcntl, 3, F_SETSIG, SIGKILL)),
        RAYNEST_TRY("prlimit64", call(SYS_prlimit64, parent(), RLIMIT_CORE, 0, &few)),
        RAYNEST_TRY("setpriority", call(SYS_setpriority, PRIO_PROCESS, parent(), 0)),
        RAYNEST_TRY("sched_setaffinity", call(SYS_sched_setaffinity, parent(), 0, 0)),
        RAYNEST_TRY("sched_setscheduler", call(SYS_sched_setscheduler, 0, SCHED_OTHER, &few)),
        RAYNEST_TRY("ioprio_set", call(SYS_ioprio_set, 1, parent(), 0)),
        RAYNEST_TRY("prctl PR_SET_PDEATHSIG", call(SYS_prctl, PR_SET_PDEATHSIG, 0, 0, 0, 0)),
        RAYNEST_TRY("prctl PR_SET_DUMPABLE", call(SYS_prctl, PR_SET_DUMPABLE, 1, 0, 0, 0)),
        // Paths.
        RAYNEST_TRY("openat to write", call(SYS_openat, AT_FDCWD, "/dev/null", O_WRONLY, 0)),
        RAYNEST_TRY("openat to truncate",
                    call(SYS_openat, AT_FDCWD, "/dev/null", O_RDONLY | O_TRUNC, 0)),
        RAYNEST_TRY("openat to create", call(SYS_openat, AT_FDCWD, victim, O_RDWR | O_CREAT, 0600)),
        RAYNEST_TRY("openat of a secret", call(SYS_openat, AT_FDCWD, "/etc/passwd", O_RDONLY, 0)),
        RAYNEST_TRY("openat of another process",
                    call(SYS_openat, AT_FDCWD, "/proc/1/environ", O_RDONLY, 0)),
        RAYNEST_TRY("open", call(SYS_open, "/dev/null", O_RDONLY)),
        RAYNEST_TRY("creat", call(SYS_creat, victim, 0600)),
        RAYNEST_TRY("openat2", call(SYS_openat2, AT_FDCWD, "/dev/null", &clone_arguments, 24)),
        RAYNEST_TRY("truncate", call(SYS_truncate, victim, 0)),
        RAYNEST_TRY("ftruncate", call(SYS_ftruncate, 4, 0)),
        RAYNEST_TRY("fallocate", call(SYS_fallocate, 4, 0, 0, 1)),
        RAYNEST_TRY("chmod", call(SYS_chmod, victim, 0666)),
        RAYNEST_TRY("fchmod", call(SYS_fchmod, 4, 0666)),
        RAYNEST_TRY("fchmodat", call(SYS_fchmodat, AT_FDCWD, victim, 0666)),
        RAYNEST_TRY("chown", call(SYS_chown, victim, -1, -1)),
        RAYNEST_TRY("fchown", call(SYS_fchown, 4, -1, -1)),
        RAYNEST_TRY("fchownat", call(SYS_fchownat, AT_FDCWD, victim, -1, -1, 0)),
        RAYNEST_TRY("rename", call(SYS_rename, victim, other)),
        RAYNEST_TRY("renameat2", call(SYS_renameat2, AT_FDCWD, victim, AT_FDCWD, other, 0)),
        RAYNEST_TRY("unlink", call(SYS_unlink, victim)),
        RAYNEST_TRY("unlinkat", call(SYS_unlinkat, AT_FDCWD, victim, 0)),
        RAYNEST_TRY("rmdir", call(SYS_rmdir, "/tmp/raynest-victims")),
        RAYNEST_TRY("mkdir", call(SYS_mkdir, "/tmp/raynest-victims", 0700)),
        RAYNEST_TRY("mkdirat", call(SYS_mkdirat, AT_FDCWD, "/tmp/raynest-victims", 0700)),
        RAYNEST_TRY("link", call(SYS_link, victim, other)),
        RAYNEST_TRY("linkat", call(SYS_linkat, 4, "", AT_FDCWD, other, AT_EMPTY_PATH)),
        RAYNEST_TRY("symlink", call(SYS_symlink, "/etc/passwd", other)),
        RAYNEST_TRY("mknod", call(SYS_mknod, other, S_IFIFO | 0600, 0)),
        RAYNEST_TRY("utimensat", call(SYS_utimensat, 4, 0, 0, 0)),
        RAYNEST_TRY("utimes", call(SYS_utimes, victim, 0)),
        RAYNEST_TRY("setxattr", call(SYS_setxattr, victim, "user.x", "x", 1, 0)),
        RAYNEST_TRY("fsetxattr", call(SYS_fsetxattr, 4, "user.x", "x", 1, 0)),
        RAYNEST_TRY("chdir", call(SYS_chdir, "/")),
        RAYNEST_TRY("chroot", call(SYS_chroot, "/")),
        RAYNEST_TRY("umask", call(SYS_umask, 077)),
        RAYNEST_TRY("mount", call(SYS_mount, "none", "/tmp", "tmpfs", 0, 0)),
        RAYNEST_TRY("inotify_init1", call(SYS_inotify_init1, 0)),
        RAYNEST_TRY("open_by_handle_at", call(SYS_open_by_handle_at, 3, &queued, 0)),
        // Sockets and memory that outlive the process or reach another.
        RAYNEST_TRY("socket", call(SYS_socket, 2 /* AF_INET */, 1, 0)),
        RAYNEST_TRY("socket of a path", call(SYS_socket, 1 /* AF_UNIX */, 1, 0)),
        RAYNEST_TRY("socketpair", call(SYS_socketpair, 1, 1, 0, &few)),
        RAYNEST_TRY("shmget", call(SYS_shmget, 0, 1 << 20, 0600)),
        RAYNEST_TRY("msgget", call(SYS_msgget, 0, 0600)),
        RAYNEST_TRY("semget", call(SYS_semget, 0, 1, 0600)),
        RAYNEST_TRY("mq_open", call(SYS_mq_open, "raynest", O_CREAT | O_RDWR, 0600, 0)),
        RAYNEST_TRY(
            "mmap of pages that others may share",
            call(SYS_mmap, 0, 4096, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0)),
        RAYNEST_TRY("mmap of the result", call(SYS_mmap, 0, 4096, PROT_READ, MAP_SHARED, 4, 0)),
        RAYNEST_TRY("mmap of locked pages", call(SYS_mmap, 0, 4096, PROT_READ | PROT_WRITE,
                                                 MAP_PRIVATE | MAP_ANONYMOUS | MAP_LOCKED, -1, 0)),
        RAYNEST_TRY("mmap of huge pages", call(SYS_mmap, 0, 1 << 21, PROT_READ | PROT_WRITE,
                                               MAP_PRIVATE | MAP_ANONYMOUS | MAP_HUGETLB, -1, 0)),
        RAYNEST_TRY("mmap to write and run",
                    call(SYS_mmap, 0, 4096, PROT_READ | PROT_WRITE | PROT_EXEC,
                         MAP_PRIVATE | MAP_ANONYMOUS, -1, 0)),
        RAYNEST_TRY("memfd_create", call(SYS_memfd_create, "x", 0)),
        RAYNEST_TRY("pipe2", call(SYS_pipe2, &few, 0)),
        RAYNEST_TRY("mprotect to execute",
                    call(SYS_mprotect, &few, std::uintptr_t{0}, PROT_READ | PROT_EXEC)),
        RAYNEST_TRY("mmap to write and execute",
                    ::mmap(nullptr, 4096, PROT_READ | PROT_WRITE | PROT_EXEC,
                           MAP_PRIVATE | MAP_ANONYMOUS, -1, 0) == MAP_FAILED
                        ? -1
                        : 0),
        RAYNEST_TRY("ioctl TIOCSTI", call(SYS_ioctl, 0, 0x5412, "x")),
        RAYNEST_TRY("ioctl FIOSETOWN", call(SYS_ioctl, 0, 0x8901, &few)),
        // The kernel.
        RAYNEST_TRY("bpf", call(SYS_bpf, 0, clone_arguments, sizeof clone_arguments)),
        RAYNEST_TRY("perf_event_open", call(SYS_perf_event_open, clone_arguments, 0, -1, -1, 0)),
        RAYNEST_TRY("userfaultfd", call(SYS_userfaultfd, 0)),
        RAYNEST_TRY("io_uring_setup", call(SYS_io_uring_setup, 1, &queued)),
        RAYNEST_TRY("keyctl", call(SYS_keyctl, 0, -3, 0)),
        RAYNEST_TRY("add_key", call(SYS_add_key, "user", "x", "x", 1, -3)),
        RAYNEST_TRY("seccomp", call(SYS_seccomp, 2 /* SECCOMP_GET_ACTION_AVAIL */, 0, &few)),
        RAYNEST_TRY("personality", call(SYS_personality, -1)),
        RAYNEST_TRY("iopl", call(SYS_iopl, 0)),
        RAYNEST_TRY("modify_ldt", call(SYS_modify_ldt, 0, &queued, sizeof queued)),
        RAYNEST_TRY("reboot", call(SYS_reboot, 0, 0, 0, 0)),
    };
    return all;
}

#undef RAYNEST_TRY

}  // namespace raynest::test
