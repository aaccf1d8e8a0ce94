// How answers read on stdout: aligned tables and plain numbers for people, JSON for programs.
#pragma once

#include "client/failure.h"
#include "protocol/text.h"

#include <nlohmann/json.hpp>

#include <cstdint>
#include <iostream>
#include <string>
#include <vector>

namespace raynest::client {

/// Keys stay in the order in which they were added.
using Json = nlohmann::ordered_json;

/// Fails where what was printed did not all go out. A command that prints much asks as it goes: its
/// work ends with its reader.
[[nodiscard]] Result<void> check_stdout();

void print_json(const Json& value, std::ostream& to = std::cout);

/// Columns as wide as their widest cell; cells that are numbers are set to the right.
void print_table(const std::vector<std::vector<std::string>>& rows);

/// "1,234,567".
[[nodiscard]] std::string grouped(std::uint64_t number);
using protocol::bytes_text;
/// "0.412 s".
[[nodiscard]] std::string seconds_text(double seconds);
/// "12s", "5m", "3h", "2d": in the largest unit that gives at least 1.
[[nodiscard]] std::string age_text(double seconds);
/// The shortest text that reads as the same float, as JSON wants it ("null" when not finite).
[[nodiscard]] std::string float_text(float value);
/// The same of a coordinate in the world, of which the scene's origin was subtracted.
[[nodiscard]] std::string world_text(float relative, double origin);

}  // namespace raynest::client
