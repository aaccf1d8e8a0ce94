#include "server/ground/io_turn.h"

#include "protocol/control.h"
#include "server/ground/limited_log.h"
#include "server/ground/log.h"

#include <time.h>

#include <chrono>
#include <string>

namespace raynest::server {
namespace {

constexpr std::chrono::microseconds logged_time{250};

std::chrono::nanoseconds processor_time() {
    timespec now{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return std::chrono::seconds(now.tv_sec) + std::chrono::nanoseconds(now.tv_nsec);
}

}  // namespace

void IoTurn::run_and_log(const std::function<bool()>& turn) {
    // Peers cause these lines, one as well as many together. The longest turns of each second are told.
    std::chrono::steady_clock::time_point second{};
    std::chrono::nanoseconds longest{};
    for (;;) {
        what_ = "";
        message_type_ = 0;
        const auto before = processor_time();
        if (!turn()) return;
        const auto took = processor_time() - before;
        if (took < logged_time) continue;
        const auto now = std::chrono::steady_clock::now();
        if (now - second > std::chrono::seconds(1)) second = now, longest = {};
        if (took <= longest) continue;
        longest = took;
        const auto us = std::chrono::duration_cast<std::chrono::microseconds>(took).count();
        log_limited(LogLevel::debug, "long_turn", "",
                    {{"cpu_us", std::to_string(us)},
                     {"message", message_type_ == 0 ? "" : protocol::message_name(message_type_)},
                     {"does", what_}});
    }
}

}  // namespace raynest::server
