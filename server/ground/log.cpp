#include "server/ground/log.h"

#include "protocol/request_id.h"
#include "protocol/text.h"
#include "server/ground/journal.h"

#include <nlohmann/json.hpp>
#include <poll.h>
#include <spdlog/sinks/base_sink.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <climits>
#include <memory>
#include <mutex>

namespace raynest::server {
namespace {

constexpr const char* text_pattern = "%Y-%m-%dT%H:%M:%S.%e %l %v";
constexpr const char* json_pattern = R"({"time":"%Y-%m-%dT%H:%M:%S.%e%z","level":"%l",%v})";

std::atomic<LogFormat> current_format{LogFormat::text};
std::atomic<std::uint64_t> lost_lines{0};
thread_local RequestTag current_tag;

spdlog::level::level_enum to_spdlog(LogLevel level) {
    switch (level) {
        case LogLevel::error:
            return spdlog::level::err;
        case LogLevel::warn:
            return spdlog::level::warn;
        case LogLevel::info:
            return spdlog::level::info;
        case LogLevel::debug:
            return spdlog::level::debug;
    }
    return spdlog::level::info;
}

LogLevel from_spdlog(spdlog::level::level_enum level) {
    if (level >= spdlog::level::err) return LogLevel::error;
    if (level == spdlog::level::warn) return LogLevel::warn;
    return level == spdlog::level::info ? LogLevel::info : LogLevel::debug;
}

std::string to_line(std::string_view event, std::initializer_list<LogField> fields) {
    return current_format == LogFormat::json ? format_json_event(event, fields)
                                             : format_event(event, fields);
}

/// Writes lines to stderr, and counts those that cannot be written: spdlog's own sink forgets them.
class StderrSink final : public spdlog::sinks::base_sink<std::mutex> {
    void sink_it_(const spdlog::details::log_msg& line) override {
        if (missing_ != 0 && !write_notice(line)) return lose();
        if (!write_line(line)) lose();
    }
    void flush_() override {}

    bool write_notice(const spdlog::details::log_msg& next) {
        const RequestScope none({});
        const std::string text = to_line("log_lines_lost", {{"lines", std::to_string(missing_)}});
        const spdlog::details::log_msg notice(next.time, {}, next.logger_name, spdlog::level::err,
                                              text);
        if (!write_line(notice)) return false;
        missing_ = 0;
        return true;
    }
    bool write_line(const spdlog::details::log_msg& line) {
        spdlog::memory_buf_t text;
        // End the part of a line that was written last.
        if (cut_off_) text.push_back('\n');
        const std::string_view priority = journal_priority(from_spdlog(line.level));
        text.append(priority.data(), priority.data() + priority.size());
        formatter_->format(line, text);
        std::string_view left(text.data(), text.size());
        while (!left.empty()) {
            // A reader that stands still must not hold the io thread: to a pipe with room for
            // PIPE_BUF bytes as many can be written at once.
            constexpr int patience_ms = 20;
            pollfd room{STDERR_FILENO, POLLOUT, 0};
            if (::poll(&room, 1, missing_ == 0 ? patience_ms : 0) == 0) {
                cut_off_ = cut_off_ || left.size() != text.size();
                return false;
            }
            const ssize_t written =
                ::write(STDERR_FILENO, left.data(), std::min<std::size_t>(left.size(), PIPE_BUF));
            if (written < 0 && errno == EINTR) continue;
            if (written <= 0) {
                cut_off_ = cut_off_ || left.size() != text.size();
                return false;
            }
            left.remove_prefix(static_cast<std::size_t>(written));
        }
        cut_off_ = false;
        return true;
    }
    void lose() {
        ++missing_;
        ++lost_lines;
    }

    std::uint64_t missing_ = 0;  ///< lines lost since the last one that was written
    bool cut_off_ = false;       ///< a part of a line was written
};

spdlog::logger& logger() {
    static const std::shared_ptr<spdlog::logger> instance = [] {
        auto made = std::make_shared<spdlog::logger>("raynestd", std::make_shared<StderrSink>());
        made->set_pattern(text_pattern);
        made->flush_on(spdlog::level::trace);
        return made;
    }();
    return *instance;
}

/// True if byte i begins a control character U+0080..U+009F, which terminals obey too.
bool is_c1(std::string_view text, std::size_t i) {
    return text[i] == '\xC2' && i + 1 < text.size() && (text[i + 1] & '\xE0') == '\x80';
}

bool is_plain(char c) {
    return c > ' ' && c < 0x7F && c != '"' && c != '\\' && c != '=';
}

/// Passes the names and values of the request on whose behalf this thread works.
template <class Append>
void append_tag(const Append& append) {
    if (current_tag.connection != 0) append("connection", std::to_string(current_tag.connection));
    if (current_tag.request != 0) append("request_id", protocol::request_text(current_tag.request));
}

void append_value(std::string& line, std::string_view value) {
    if (!value.empty() && std::all_of(value.begin(), value.end(), is_plain)) {
        line += value;
        return;
    }
    constexpr std::string_view digits = "0123456789abcdef";
    const auto append_byte = [&](char c) {
        const auto byte = static_cast<unsigned char>(c);
        line += "\\x";
        line += digits[byte >> 4];
        line += digits[byte & 15];
    };
    line += '"';
    for (std::size_t i = 0; i < value.size(); ++i) {
        const char c = value[i];
        if (c == '"' || c == '\\') {
            line += '\\';
            line += c;
        } else if ((c >= 0 && c < 0x20) || c == 0x7F) {
            append_byte(c);
        } else if (is_c1(value, i)) {
            append_byte(c);
            append_byte(value[++i]);
        } else if (const std::size_t hidden = protocol::hidden_letter(value, i); hidden != 0) {
            for (const std::size_t end = i + hidden; i < end; ++i) append_byte(value[i]);
            --i;
        } else {
            line += c;
        }
    }
    line += '"';
}

}  // namespace

void set_log_level(LogLevel level) {
    logger().set_level(to_spdlog(level));
}

void set_log_format(LogFormat format) {
    current_format = format;
    logger().set_pattern(format == LogFormat::json ? json_pattern : text_pattern);
}

RequestScope::RequestScope(RequestTag tag) : outer_(std::exchange(current_tag, tag)) {}

RequestScope::~RequestScope() {
    current_tag = outer_;
}

std::uint64_t lost_log_lines() {
    return lost_lines;
}

RequestTag RequestScope::current() {
    return current_tag;
}

bool is_logged(LogLevel level) {
    return logger().should_log(to_spdlog(level));
}

std::string format_event(std::string_view event, std::initializer_list<LogField> fields) {
    std::string line(event);
    const auto append = [&](std::string_view key, std::string_view value) {
        line += ' ';
        line += key;
        line += '=';
        append_value(line, value);
    };
    for (const auto& [key, value] : fields) append(key, value);
    append_tag(append);
    return line;
}

std::string format_json_event(std::string_view event, std::initializer_list<LogField> fields) {
    // ASCII alone: control characters beyond it are escaped too. Bytes that are not UTF-8 are
    // replaced.
    const auto quoted = [](std::string_view text) {
        return nlohmann::json(text).dump(-1, ' ', true, nlohmann::json::error_handler_t::replace);
    };
    std::string members = "\"event\":" + quoted(event);
    const auto append = [&](std::string_view key, std::string_view value) {
        members += ',' + quoted(key) + ':' + quoted(value);
    };
    for (const auto& [key, value] : fields) append(key, value);
    append_tag(append);
    return members;
}

void log(LogLevel level, std::string_view event, std::initializer_list<LogField> fields) {
    if (!is_logged(level)) return;
    // The line is data, not a format string.
    const std::string line = to_line(event, fields);
    logger().log(to_spdlog(level), spdlog::string_view_t(line));
}

}  // namespace raynest::server
