// The files that a URI in a scene may reach.
#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace raynest::gltf {

/// Returns the uploaded file that a URI names: percent-decoded once, with / for \, without empty
/// parts and "./", with "a/.." cancelled. Nothing if the URI has a scheme, is absolute, leaves the
/// scene's folder, or hides a separator, "." or ".." behind percent signs. Clients apply the same
/// rule (tests/golden/gltf_uris.json).
[[nodiscard]] std::optional<std::string> file_of_uri(std::string_view uri);

/// Returns why a URI names no file: "is an absolute path; ...".
[[nodiscard]] std::string_view why_no_file(std::string_view uri);

}  // namespace raynest::gltf
