// Formats answers for stdout: aligned tables and plain numbers for people, JSON for programs.
#pragma once

#include "client/failure.h"
#include "protocol/text.h"

#include <nlohmann/json.hpp>

#include <cstdint>
#include <iostream>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

/// JSON whose keys keep the order in which they were added.
using Json = nlohmann::ordered_json;

/// After a failed write: ends this process silently if the reader of stdout, such as head, has gone.
void end_if_unread();

/// Fails if a write to stdout failed. A command that prints much calls this as it goes, so that it
/// stops when its reader does.
[[nodiscard]] Result<void> check_stdout();

/// Returns the value on one line. Control characters in its texts are escaped, DEL and U+0080 to U+009F
/// too, which JSON would allow as they are.
[[nodiscard]] std::string json_text(const Json& value);
void print_json(const Json& value, std::ostream& to = std::cout);

/// Returns the text as a terminal may show it: one line, '?' in the place of control characters.
[[nodiscard]] std::string shown_text(std::string_view text);
/// Returns the value with all its texts, and the names of members, so changed: documents of a daemon may
/// hold any.
[[nodiscard]] Json shown_json(const Json& value);
/// Prints "raynest: NOTE" on stderr, as shown_text().
void print_note(std::string_view note);

/// Prints columns as wide as their widest cell; columns of numbers are aligned to the right.
void print_table(const std::vector<std::vector<std::string>>& rows);

/// Returns "1,234,567".
[[nodiscard]] std::string grouped(std::uint64_t number);
using protocol::bytes_text;
/// Returns "0.412 s".
[[nodiscard]] std::string seconds_text(double seconds);
/// Returns "12s", "5m", "3h" or "2d", in the largest unit that gives at least 1.
[[nodiscard]] std::string age_text(double seconds);
/// Returns the shortest text of a float that reads back the same; "null" if it is not finite.
[[nodiscard]] std::string float_text(float value);
/// The same for a coordinate in the world, given relative to the scene's origin.
[[nodiscard]] std::string world_text(float relative, double origin);

}  // namespace raynest::client
