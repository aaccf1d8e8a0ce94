#include "server/ground/limited_log.h"

#include "server/ground/address.h"

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
                        " lines of a source in a second, " +
                        std::to_string(LineLimit::remote_lines_max) +
                        " of all remote addresses, or too many sources"}});
}

}  // namespace

void LineLimit::begin(Time now) {
    if (now - begin_ < period) return;
    begin_ = now;
    for (Group* group : {&known_, &remote_}) {
        left_out_.lines += group->of_others;
        for (const auto& [source, lines] : group->by_source) {
            left_out_.lines += lines.left_out;
            if (lines.left_out <= left_out_.lines_of_source) continue;
            left_out_.source = source;
            left_out_.lines_of_source = lines.left_out;
        }
        *group = {};
    }
}

bool LineLimit::admit(const std::string& source, Time now) {
    begin(now);
    const bool is_remote = is_remote_peer(source);
    Group& group = is_remote ? remote_ : known_;
    auto found = group.by_source.find(source);
    if (found == group.by_source.end() && group.by_source.size() < sources_max)
        found = group.by_source.emplace(source, Lines()).first;
    if (found == group.by_source.end()) {
        ++group.of_others;
        return false;
    }
    Lines& lines = found->second;
    const bool admitted =
        lines.written < lines_max && (!is_remote || group.written < remote_lines_max);
    ++(admitted ? lines.written : lines.left_out);
    group.written += admitted ? 1U : 0U;
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
    if (found->second.limit.admit(std::string(source), now)) log(level, event, fields);
}

void log_left_out() {
    const std::scoped_lock lock(mutex);
    const auto now = std::chrono::steady_clock::now();
    for (auto& [name, event] : events()) tell_left_out(name, event, now);
}

}  // namespace raynest::server
