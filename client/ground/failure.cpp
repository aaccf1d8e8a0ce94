#include "client/ground/failure.h"

#include "client/ground/json.h"
#include "client/ground/text.h"
#include "client/ground/wording.h"

#include <iostream>

namespace raynest::client {
namespace {

/// First code of the client's own failures, above those of the protocol's table.
constexpr std::uint32_t own_codes = 1000;

const char* own_name(Exit exit) {
    switch (exit) {
        case Exit::usage:
            return "USAGE";
        case Exit::cannot_connect:
            return "CANNOT_CONNECT";
        case Exit::not_allowed:
            return "NOT_ALLOWED";
        case Exit::invalid:
            return "FILE_INVALID";
        case Exit::deadline:
            return "DEADLINE";
        case Exit::threshold:
            return "THRESHOLD";
        case Exit::partial:
            return "PARTIAL";
        case Exit::interrupted:
            return "INTERRUPTED";
        default:
            return "FAILED";
    }
}

}  // namespace

Failure failure(const protocol::Error& error) {
    const protocol::ErrorInfo& info = protocol::error_info(error.code);
    return {info.exit,
            static_cast<std::uint32_t>(info.code),
            std::string(info.name),
            localize_message(error.message.empty() ? info.remedy : error.message),
            error.retry_after_ms,
            {},
            error.code == protocol::Code::draining};
}

bool is_own(const Failure& failure) {
    return failure.code >= own_codes;
}

Failure failure(Exit exit, std::string message) {
    return {exit, own_codes + static_cast<std::uint32_t>(exit), own_name(exit), std::move(message),
            0};
}

Failure lost(Exit exit, std::string message) {
    Failure why = failure(exit, std::move(message));
    why.lost = true;
    return why;
}

namespace {

/// Returns the message as a terminal may show it: in one line, unless the client itself wrote more.
std::string shown_lines(const Failure& failure, std::string_view message) {
    if (!failure.has_lines) return shown_text(message);
    std::string lines;
    for (std::size_t end = 0; (end = message.find('\n')) != std::string_view::npos;) {
        lines += shown_text(message.substr(0, end)) + '\n';
        message.remove_prefix(end + 1);
    }
    return lines + shown_text(message);
}

}  // namespace

std::string describe(const Failure& failure, bool json) {
    std::string message = failure.message;
    if (failure.retry_after_ms != 0)
        message += " (try again in " + std::to_string(failure.retry_after_ms) + " ms)";
    if (!json)
        return "raynest: " + shown_lines(failure, message) +
               (failure.request.empty() ? "" : " [request " + failure.request + "]");
    Json error;
    error["code"] = failure.code;
    error["name"] = failure.name;
    error["message"] = message;
    if (!failure.request.empty()) error["request"] = failure.request;
    return json_text(Json{{"error", error}});
}

void print_note(std::string_view note) {
    std::cerr << "raynest: " << shown_text(note) << '\n';
}

}  // namespace raynest::client
