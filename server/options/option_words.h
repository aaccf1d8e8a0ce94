// The words of option values: what is wrong with them, and what they mean.
#pragma once

#include "server/ground/log.h"

#include <filesystem>
#include <string>
#include <string_view>

namespace raynest::server {

// Return the error text of a value; empty if there is no error.
[[nodiscard]] std::string address_fault(const std::string& uri);
[[nodiscard]] std::string http_fault(const std::string& text);
[[nodiscard]] std::string http_host_fault(const std::string& text);
[[nodiscard]] std::string proxy_fault(const std::string& text);
// Check a size (size.h) and replace it by its number of bytes; --memory is 1M to 1P.
[[nodiscard]] std::string memory_fault(std::string& text);
[[nodiscard]] std::string bytes_fault(std::string& text);

[[nodiscard]] LogLevel to_log_level(const std::string& word);
/// Returns the kernel pack of the CUDA worker; empty: none.
[[nodiscard]] std::filesystem::path to_cuda_pack(const std::string& word);

/// Returns the spelling of an option: principal_jobs_max -> principal-jobs-max.
[[nodiscard]] std::string hyphened(std::string_view name);
/// Returns the environment variable of an option: log-level -> RAYNEST_LOG_LEVEL.
[[nodiscard]] std::string variable_of(const std::string& option);
/// True if the environment sets the option; an empty variable does not.
[[nodiscard]] bool is_in_environment(const std::string& option);

}  // namespace raynest::server
