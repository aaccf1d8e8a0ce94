#include "server/errors.h"

namespace raynest::server {
namespace {

// No default: a new engine code without a line here is a compiler warning.
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
            return Code::internal;
        case ErrorCode::out_of_memory:
            return Code::resource_exhausted;
        case ErrorCode::io_failed:  // of an import: no descriptor, process or memory file to be had
            return Code::resource_exhausted;
        case ErrorCode::internal:
            return Code::internal;
    }
    return Code::internal;
}

}  // namespace

protocol::Error to_wire(Error error) {
    return {wire_code(error.code), std::move(error.message), 0};
}

}  // namespace raynest::server
