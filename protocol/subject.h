// Names of principals as people write them: subjects of certificates, and lists for `load --share`.
#pragma once

#include <tl/expected.hpp>

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::protocol {

/// Maximum bytes of a certificate's subject that names a principal.
inline constexpr std::size_t subject_bytes_max = 200;

/// True for a subject in the form of RFC 2253 without blanks around ',' and '=', as the daemon
/// names principals: "CN=robot,O=Lab". The order of its parts is not checked.
[[nodiscard]] bool is_subject(std::string_view text);

/// Splits a list of principals at its commas; "\," is a comma in a name, "\\" a backslash. Returns
/// the error text for an empty name, for a name with '=' that is no subject, and for two neighbours
/// with '=': they may be one subject whose commas were not escaped.
[[nodiscard]] tl::expected<std::vector<std::string>, std::string> split_principals(
    std::string_view list);

/// Returns a name as it stands in such a list.
[[nodiscard]] std::string in_list(std::string_view name);

}  // namespace raynest::protocol
