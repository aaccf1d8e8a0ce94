#include "server/diag/line_limit.h"

#include "server/log.h"

namespace raynest::server {
namespace {

LineLimit& handshakes() {
    static LineLimit limit;
    return limit;
}

}  // namespace

void log_left_out_handshakes() {
    const std::uint64_t left_out = handshakes().take_left_out(std::chrono::steady_clock::now());
    if (left_out != 0)
        log(LogLevel::info, "handshake_failed",
            {{"left_out", std::to_string(left_out)},
             {"reason", "more than " + std::to_string(LineLimit::lines_max) + " lines in a second"}});
}

void log_failed_handshake(const std::string& peer, const std::string& why) {
    log_left_out_handshakes();
    if (handshakes().admit(std::chrono::steady_clock::now()))
        log(LogLevel::info, "handshake_failed", {{"peer", peer}, {"reason", why}});
}

}  // namespace raynest::server
