#include "server/ground/errors.h"

#include <algorithm>
#include <string_view>

namespace raynest::server {
namespace {

// Has no default case, so that the compiler warns of an engine code without a case.
Code wire_code(ErrorCode code) {
    switch (code) {
        case ErrorCode::scene_invalid:
            return Code::scene_invalid;
        case ErrorCode::scene_unsupported:
            return Code::unsupported;
        case ErrorCode::limit_exceeded:
            return Code::limit_exceeded;
        case ErrorCode::variant_unknown:
            return Code::variant_unknown;
        case ErrorCode::param_invalid:
            return Code::invalid_param;
        case ErrorCode::field_invalid:
            return Code::invalid_field;
        case ErrorCode::pack_invalid:
            return Code::file_unusable;
        case ErrorCode::out_of_memory:
            return Code::resource_exhausted;
        case ErrorCode::io_failed:  // an import got no descriptor, process or memory file
            return Code::resource_exhausted;
        case ErrorCode::internal:
            return Code::internal;
    }
    return Code::internal;
}

}  // namespace

protocol::Error for_client(const protocol::Error& error) {
    if (error.code != Code::internal) return error;
    return {Code::internal,
            "a defect of the daemon; please report the lines of its log about this request", 0};
}

std::string without_folders(std::string text) {
    for (std::size_t at = 0; (at = text.find('/', at)) != std::string::npos; ++at) {
        const bool begins =
            at == 0 || std::string_view(" '\":").find(text[at - 1]) != std::string::npos;
        if (!begins || text.compare(at, 2, "//") == 0) continue;
        const std::size_t end = std::min(text.find_first_of(" ,;:'\"", at), text.size());
        text.erase(at, text.rfind('/', end - 1) + 1 - at);
    }
    return text;
}

protocol::Error to_wire(Error error) {
    // The client cannot do anything about the file, but its administrator learns which one it is.
    if (error.code == ErrorCode::pack_invalid) error.message = without_folders(error.message);
    return {wire_code(error.code), std::move(error.message), 0};
}

}  // namespace raynest::server
