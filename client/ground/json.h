// JSON as answers are printed and read.
#pragma once

#include <nlohmann/json.hpp>

#include <string>

namespace raynest::client {

/// JSON whose keys keep the order in which they were added.
using Json = nlohmann::ordered_json;

/// Returns the value on one line. Control characters in its texts are escaped, DEL and U+0080 to
/// U+009F too, which JSON would allow as they are.
[[nodiscard]] std::string json_text(const Json& value);
/// Returns the value with all its texts, and the names of members, as shown_text() changes them:
/// documents of a daemon may hold any.
[[nodiscard]] Json shown_json(const Json& value);

}  // namespace raynest::client
