#include "server/net/descriptors.h"

#include "engine/system/child_process.h"

#include <fcntl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>

namespace raynest::server {
namespace {

/// Descriptors that are kept where the limit allows: the reserved ones, and three for each import.
constexpr rlim_t kept_max = 32;

rlim_t limit() {
    rlimit limit{};
    return getrlimit(RLIMIT_NOFILE, &limit) == 0 ? limit.rlim_cur : RLIM_INFINITY;
}

}  // namespace

Descriptors left_at(int descriptor) {
    const rlim_t most = limit();
    const rlim_t kept = std::min(kept_max, most / 4);
    const rlim_t reserved = std::min<rlim_t>(kept, 2 * reserved_places);
    const auto number = static_cast<rlim_t>(descriptor);
    if (number < most - kept) return Descriptors::free;
    return number < most - kept + reserved ? Descriptors::reserved : Descriptors::used_up;
}

std::string descriptors_text() {
    return "file descriptors are used up: the limit is " + std::to_string(limit()) +
           "; raise LimitNOFILE or ulimit -n for raynestd";
}

std::string descriptors_fault() {
    const Fd probe(fcntl(STDERR_FILENO, F_DUPFD_CLOEXEC, 0));
    if (probe.get() >= 0 && left_at(probe.get()) == Descriptors::free) return {};
    return descriptors_text();
}

}  // namespace raynest::server
