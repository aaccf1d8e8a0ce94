// One line per event on stderr: `event key=value key="two words"`.
//
// Values come from clients: control characters and quotes are escaped, so no value can forge a line
// or a field. spdlog stays in log.cpp.
#pragma once

#include <initializer_list>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::server {

enum class LogLevel { error, warn, info, debug };

using LogField = std::pair<std::string_view, std::string>;

/// Events below `level` are dropped from now on. Thread-safe, as is log().
void set_log_level(LogLevel level);

/// Is an event of this level written? Ask before a line costs something to make.
[[nodiscard]] bool is_logged(LogLevel level);
void log(LogLevel level, std::string_view event, std::initializer_list<LogField> fields = {});

/// The line that log() writes, without time and level.
[[nodiscard]] std::string format_event(std::string_view event,
                                       std::initializer_list<LogField> fields);

}  // namespace raynest::server
