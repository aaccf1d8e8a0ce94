// Requests and answers of HTTP, as Beast has them.
#pragma once

#include "server/http/beast.h"
#include "server/http/site.h"

#include <string>

namespace raynest::server {

/// A request whose body is a text; only logins have one.
using PageRequest = http::request<http::string_body>;
using PageResponse = http::response<http::string_body>;

[[nodiscard]] PageResponse to_response(const HttpReply& reply, unsigned version, bool only_header);

/// Returns an answer of one line.
[[nodiscard]] HttpReply refuse_request(unsigned status, std::string why);

}  // namespace raynest::server
