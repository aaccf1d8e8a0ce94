#include "engine/assets/sandbox.h"

#include "engine/assets/child_process.h"

#include <fcntl.h>
#include <linux/landlock.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdint>
#include <filesystem>

#ifdef RAYNEST_SECCOMP
#include <seccomp.h>
#endif

namespace raynest {
namespace {

// ---- files --------------------------------------------------------------------------------------

/// All rights that the first version of Landlock (Linux 5.13) knows; later ones only add rights that
/// need one of these, or a descriptor that this process does not have.
constexpr std::uint64_t all_rights =
    LANDLOCK_ACCESS_FS_EXECUTE | LANDLOCK_ACCESS_FS_WRITE_FILE | LANDLOCK_ACCESS_FS_READ_FILE |
    LANDLOCK_ACCESS_FS_READ_DIR | LANDLOCK_ACCESS_FS_REMOVE_DIR | LANDLOCK_ACCESS_FS_REMOVE_FILE |
    LANDLOCK_ACCESS_FS_MAKE_CHAR | LANDLOCK_ACCESS_FS_MAKE_DIR | LANDLOCK_ACCESS_FS_MAKE_REG |
    LANDLOCK_ACCESS_FS_MAKE_SOCK | LANDLOCK_ACCESS_FS_MAKE_FIFO | LANDLOCK_ACCESS_FS_MAKE_BLOCK |
    LANDLOCK_ACCESS_FS_MAKE_SYM;

void allow_reading(int rules, const std::filesystem::path& folder) {
    const Fd opened(open(folder.c_str(), O_PATH | O_CLOEXEC));
    if (opened.get() < 0) return;
    landlock_path_beneath_attr rule{};
    rule.allowed_access =
        LANDLOCK_ACCESS_FS_READ_FILE | LANDLOCK_ACCESS_FS_READ_DIR | LANDLOCK_ACCESS_FS_EXECUTE;
    rule.parent_fd = opened.get();
    (void)syscall(SYS_landlock_add_rule, rules, LANDLOCK_RULE_PATH_BENEATH, &rule, 0);
}

/// Leaves the folders of shared libraries, which the image module needs when a file has textures.
void hide_files() {
    landlock_ruleset_attr handled{};
    handled.handled_access_fs = all_rights;
    const Fd rules(static_cast<int>(
        syscall(SYS_landlock_create_ruleset, &handled, sizeof handled, 0)));
    if (rules.get() < 0) return;
    for (const char* folder : {"/lib", "/lib64", "/usr/lib", "/usr/lib64", "/usr/local/lib",
                               "/etc/ld.so.cache", "/dev/null"})
        allow_reading(rules.get(), folder);
    std::error_code error;
    const auto program = std::filesystem::read_symlink("/proc/self/exe", error);
    // Kernel packs and the image module stand beside the program: ../lib.
    allow_reading(rules.get(), program.parent_path().parent_path() / "lib");
    (void)syscall(SYS_landlock_restrict_self, rules.get(), 0);
}

// ---- system calls -------------------------------------------------------------------------------

#ifdef RAYNEST_SECCOMP
/// Calls that no parser needs. They fail with EPERM.
constexpr std::array forbidden = {
    SCMP_SYS(socket),       SCMP_SYS(socketpair),     SCMP_SYS(connect),
    SCMP_SYS(bind),         SCMP_SYS(listen),         SCMP_SYS(accept),
    SCMP_SYS(accept4),      SCMP_SYS(sendto),         SCMP_SYS(sendmsg),
    SCMP_SYS(execve),       SCMP_SYS(execveat),       SCMP_SYS(fork),
    SCMP_SYS(vfork),        SCMP_SYS(ptrace),         SCMP_SYS(process_vm_readv),
    SCMP_SYS(process_vm_writev), SCMP_SYS(kill),      SCMP_SYS(tkill),
    SCMP_SYS(mount),        SCMP_SYS(umount2),        SCMP_SYS(pivot_root),
    SCMP_SYS(chroot),       SCMP_SYS(unshare),        SCMP_SYS(setns),
    SCMP_SYS(bpf),          SCMP_SYS(perf_event_open), SCMP_SYS(userfaultfd),
    SCMP_SYS(keyctl),       SCMP_SYS(add_key),        SCMP_SYS(request_key),
    SCMP_SYS(io_uring_setup), SCMP_SYS(open_by_handle_at), SCMP_SYS(name_to_handle_at),
    SCMP_SYS(init_module),  SCMP_SYS(finit_module),   SCMP_SYS(kexec_load),
    SCMP_SYS(pidfd_open),   SCMP_SYS(pidfd_getfd),    SCMP_SYS(memfd_create),
};

void forbid_calls() {
    const scmp_filter_ctx filter = seccomp_init(SCMP_ACT_ALLOW);
    if (filter == nullptr) return;
    (void)seccomp_attr_set(filter, SCMP_FLTATR_CTL_TSYNC, 1);
    for (const int call : forbidden)
        (void)seccomp_rule_add(filter, SCMP_ACT_ERRNO(EPERM), call, 0);
    (void)seccomp_load(filter);
    seccomp_release(filter);
}
#else
void forbid_calls() {}
#endif

}  // namespace

void enter_sandbox() {
    prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0);
    hide_files();
    forbid_calls();
}

}  // namespace raynest
