#include "server/scheduling/job_log.h"

#include "server/ground/limited_log.h"
#include "server/ground/log.h"

#include <new>
#include <string>
#include <string_view>

namespace raynest::server {
namespace {

constexpr std::chrono::seconds long_job{1};

LogLevel level_of(const JobRecord& record, Clock::time_point ended,
                  const std::optional<protocol::Error>& error) {
    if (error && error->code == Code::internal) return LogLevel::error;
    const bool was_cut =
        error && (error->code == Code::cancelled || error->code == Code::draining ||
                  error->code == Code::not_allowed);
    const bool matters = record.detached || ended - record.started > long_job || was_cut ||
                         (error && record.kind == "load");
    return matters ? LogLevel::info : LogLevel::debug;
}

/// Returns "done", or the error's name and message. Cuts off advice with words of the protocol,
/// which are in backticks: it is meant for the client.
std::string outcome(const std::optional<protocol::Error>& error) {
    if (!error) return "done";
    const std::string name(protocol::error_info(error->code).name);
    const std::string_view message = error->message;
    const std::size_t advice = message.rfind(';', message.find('`'));
    const bool is_plain = message.find('`') == message.npos || advice == message.npos;
    const std::string_view said = is_plain ? message : message.substr(0, advice);
    return said.empty() ? name : name + ": " + std::string(said);
}

}  // namespace

void log_job(const JobRecord& record, Clock::time_point ended,
             const std::optional<protocol::Error>& error) {
    const LogLevel level = level_of(record, ended, error);
    if (!is_logged(level)) return;
    try {
        const double seconds = std::chrono::duration<double>(ended - record.started).count();
        log_limited(level, "job", record.principal,
                    {{"number", std::to_string(record.number)},
                     {"principal", record.principal},
                     {"kind", record.kind},
                     {"scene", record.scene},
                     {"seconds", std::to_string(seconds)},
                     {"rays", std::to_string(record.rays)},
                     {"detached", record.detached ? "yes" : "no"},
                     {"outcome", outcome(error)}});
    } catch (const std::bad_alloc&) {
        // Skip the line without memory: the job must end anyway.
    }
}

}  // namespace raynest::server
