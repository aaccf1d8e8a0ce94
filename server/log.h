// The log: one line per event on stderr, `event key=value key="two words"`.
//
// Values may come from clients. Control characters and quotes are escaped, so that no value can
// forge a line or a field. Only log.cpp includes spdlog.
#pragma once

#include <initializer_list>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::server {

enum class LogLevel { error, warn, info, debug };

using LogField = std::pair<std::string_view, std::string>;

/// Sets the level below which events are dropped. Thread-safe.
void set_log_level(LogLevel level);

/// True if events of this level are written. Check it before composing an expensive line.
[[nodiscard]] bool is_logged(LogLevel level);
/// Writes an event. Thread-safe.
void log(LogLevel level, std::string_view event, std::initializer_list<LogField> fields = {});

/// Returns the line that log() writes, without time and level.
[[nodiscard]] std::string format_event(std::string_view event,
                                       std::initializer_list<LogField> fields);

}  // namespace raynest::server
