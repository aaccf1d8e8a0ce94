// Text and faults of a file from outside, as messages show them.
#pragma once

#include "engine/scene/description.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace raynest {

/// Returns at most the first `bytes_max` bytes of UTF-8 text, cut between characters.
[[nodiscard]] std::string_view front_of(std::string_view text, std::size_t bytes_max);

/// Returns foreign text for a message: shortened, with spaces for control characters.
[[nodiscard]] std::string one_line(std::string_view text, std::size_t length_max = 160);

/// Returns "mesh 7 ('leaf')", or "mesh 7" if it has no name.
[[nodiscard]] std::string label(std::string_view kind, std::uint64_t index, std::string_view name);

/// Returns "1 vertex" or "7 vertices".
[[nodiscard]] std::string counted(std::uint64_t count, std::string_view one, std::string_view many);

/// Harmless faults of a file by what is wrong, each with the first element that has it: a file with
/// a million of them gives one line.
class Oddities {
public:
    /// "node 3 ('a')" "alphaMode is no text; the default is used".
    void add(const std::string& where, const std::string& what, std::uint64_t more = 0);
    /// Appends "node 3 ('a') and 4 others: " + what.
    void append_to(std::vector<std::string>& warnings) const;

private:
    struct First {
        std::string where, what;
        std::uint64_t more;
    };
    std::vector<First> found_;
};

/// Counts one more part of `kind` that is left out. Only the first few cause a warning, so that a
/// file with millions of them gives a short list.
void leave_out(SceneDescription& scene, const std::string& kind, std::string why);

}  // namespace raynest
