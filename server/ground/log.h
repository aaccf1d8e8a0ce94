// The log: one line per event on stderr, as text `event key=value key="two words"` or as a JSON
// object.
//
// Values may come from clients. Control characters and quotes are escaped, so that no value can
// forge a line or a field. Lines that are written on behalf of a request say which one
// (RequestScope). Only log.cpp includes spdlog.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::server {

enum class LogLevel { error, warn, info, debug };
enum class LogFormat { text, json };

using LogField = std::pair<std::string_view, std::string>;

/// Sets the level below which events are dropped. Thread-safe.
void set_log_level(LogLevel level);
/// Sets the form of the lines. Thread-safe.
void set_log_format(LogFormat format);

/// True if events of this level are written. Check it before composing an expensive line.
[[nodiscard]] bool is_logged(LogLevel level);
/// Writes an event. Thread-safe.
void log(LogLevel level, std::string_view event, std::initializer_list<LogField> fields = {});

/// Returns the number of lines that could not be written, as on a full disk. The first line that
/// can be written again is `log_lines_lost`, with their number. Thread-safe.
[[nodiscard]] std::uint64_t lost_log_lines();

/// Names a request: its connection's number and the id that its client has given it. 0: none.
struct RequestTag {
    std::uint64_t connection = 0;
    std::uint64_t request = 0;
};

/// While it lives, log() adds `connection` and `request_id` to the lines of this thread. Scopes
/// nest; the innermost counts.
class RequestScope {
public:
    explicit RequestScope(RequestTag tag);
    ~RequestScope();
    RequestScope(const RequestScope&) = delete;
    /// Returns the tag of the innermost scope.
    [[nodiscard]] static RequestTag current();

private:
    const RequestTag outer_;
};

/// Returns the line that log() writes, without time and level.
[[nodiscard]] std::string format_event(std::string_view event,
                                       std::initializer_list<LogField> fields);
/// Returns the members of the JSON object that log() writes, without braces, time and level.
[[nodiscard]] std::string format_json_event(std::string_view event,
                                            std::initializer_list<LogField> fields);

}  // namespace raynest::server
