// Texts from outside, made into what may be sent and named.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace raynest::protocol {

/// `text` as validate() accepts it: UTF-8 on one line, cut to `bytes_max` bytes between two
/// letters. Blanks stand for ends of lines and tabs, '?' for what cannot be printed or is hidden.
[[nodiscard]] std::string clean_text(std::string_view text, std::size_t bytes_max);

/// Returns the bytes of the letter that begins at `at` if it is hidden: one that is invisible by
/// Unicode's tables, looks like a blank, turns the order of its neighbours, or ends a line. Else 0.
[[nodiscard]] std::size_t hidden_letter(std::string_view text, std::size_t at);
/// True if the text has such a letter: a name with one looks like another name.
[[nodiscard]] bool has_hidden_letter(std::string_view text);
/// True if the text has a letter that Unicode has not assigned, or leaves to private use: fonts draw
/// different ones alike.
[[nodiscard]] bool has_unassigned_letter(std::string_view text);
/// The text without blanks at its ends, and with single ones elsewhere.
[[nodiscard]] std::string single_blanks(std::string_view text);

/// The byte that a "%XX" at the beginning of `text` stands for; none where there is no such code.
[[nodiscard]] std::optional<char> percent_code(std::string_view text);

/// A size as people read it: "17 B", "32.8 MiB".
[[nodiscard]] std::string bytes_text(std::uint64_t bytes);

}  // namespace raynest::protocol
