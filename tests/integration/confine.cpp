// Runs a program under the restrictions of a service: no new privileges, and no system calls but
// those of a list; the others fail with EPERM, as SystemCallErrorNumber=EPERM of the unit says.
//
//   confine FILE PROGRAM [ARGUMENT...]      FILE names a call per line
#include <seccomp.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <fstream>
#include <string>

int main(int count, char** words) {
    if (count < 3) return 2;
    const scmp_filter_ctx filter = seccomp_init(SCMP_ACT_ERRNO(EPERM));
    std::ifstream calls(words[1]);
    for (std::string name; std::getline(calls, name);) {
        const int call = seccomp_syscall_resolve_name(name.c_str());
        // RestrictSUIDSGID= takes this one away.
        if (name == "openat2") continue;
        // Names of other machines' calls are in the list, too.
        if (call >= 0) (void)seccomp_rule_add(filter, SCMP_ACT_ALLOW, call, 0);
    }
    (void)seccomp_rule_add(filter, SCMP_ACT_ERRNO(ENOSYS), SCMP_SYS(openat2), 0);
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0 || seccomp_load(filter) != 0) {
        std::perror("confine");
        return 3;
    }
    execv(words[2], words + 2);
    std::perror(words[2]);
    return 3;
}
