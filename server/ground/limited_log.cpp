#include "server/ground/limited_log.h"

#include <mutex>

namespace raynest::server {
namespace {

struct Event {
    LineLimit limit;
    LogLevel level = LogLevel::info;  ///< the last line's
};
using Events = std::map<std::string, Event, std::less<>>;

std::mutex mutex;

Events& events() {
    static Events by_name;
    return by_name;
}

void tell_left_out(const std::string& name, Event& event, LineLimit::Time now) {
    const LineLimit::LeftOut left_out = event.limit.take_left_out(now);
    if (left_out.lines == 0) return;
    const RequestScope none({});  // several requests have caused them
    log(event.level, name,
        {{"left_out", std::to_string(left_out.lines)},
         {"most_of", left_out.source},
         {"reason", "more than " + std::to_string(LineLimit::lines_max) +
                        " lines of a source in a second, or too many sources"}});
}

}  // namespace

void LineLimit::begin(Time now) {
    if (now - begin_ < period) return;
    begin_ = now;
    left_out_.lines += std::exchange(of_others_, 0);
    for (const auto& [source, lines] : lines_) {
        left_out_.lines += lines.left_out;
        if (lines.left_out <= left_out_.lines_of_source) continue;
        left_out_.source = source;
        left_out_.lines_of_source = lines.left_out;
    }
    lines_.clear();
}

bool LineLimit::admit(std::string_view source, Time now) {
    begin(now);
    auto found = lines_.find(source);
    if (found == lines_.end() && lines_.size() < sources_max)
        found = lines_.emplace(source, Lines()).first;
    if (found == lines_.end()) {
        ++of_others_;
        return false;
    }
    const bool admitted = found->second.written < lines_max;
    if (admitted)
        ++found->second.written;
    else
        ++found->second.left_out;
    return admitted;
}

LineLimit::LeftOut LineLimit::take_left_out(Time now) {
    begin(now);
    return std::exchange(left_out_, {});
}

void log_limited(LogLevel level, std::string_view event, std::string_view source,
                 std::initializer_list<LogField> fields) {
    if (!is_logged(level)) return;
    const std::scoped_lock lock(mutex);
    const auto now = std::chrono::steady_clock::now();
    auto found = events().find(event);
    if (found == events().end()) found = events().emplace(event, Event()).first;
    tell_left_out(found->first, found->second, now);
    found->second.level = level;
    if (found->second.limit.admit(source, now)) log(level, event, fields);
}

void log_left_out() {
    const std::scoped_lock lock(mutex);
    const auto now = std::chrono::steady_clock::now();
    for (auto& [name, event] : events()) tell_left_out(name, event, now);
}

}  // namespace raynest::server
