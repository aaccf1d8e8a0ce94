// Reads text files of lines and words, without copies.
#pragma once

#include "engine/assets/input/messages.h"
#include "engine/result.h"

#include <fmt/format.h>

#include <charconv>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <string>
#include <string_view>

namespace raynest {

/// A place in a text. Lines end with LF, CR LF or CR; a backslash at a line's end joins the next
/// one. The mark that Windows programs write before UTF-8 is no part of the text.
class TextReader {
public:
    explicit TextReader(std::span<const std::byte> bytes)
        : begin_(reinterpret_cast<const char*>(bytes.data())),
          at_(begin_),
          end_(begin_ + bytes.size()) {
        constexpr std::string_view mark = "\xEF\xBB\xBF";
        if (std::string_view(begin_, bytes.size()).starts_with(mark)) at_ += mark.size();
    }

    [[nodiscard]] bool at_end() const { return at_ == end_; }
    /// True for UTF-16: every other byte is NUL, which counts as a blank, so numbers would fall apart.
    [[nodiscard]] bool is_utf16() const {
        const std::string_view text(begin_, static_cast<std::size_t>(end_ - begin_));
        return text.starts_with("\xFE\xFF") || text.starts_with("\xFF\xFE");
    }
    [[nodiscard]] std::size_t offset() const { return static_cast<std::size_t>(at_ - begin_); }

    /// Returns the next word of this line; empty at its end.
    std::string_view word() {
        skip_blanks();
        const char* const from = at_;
        while (at_ != end_ && !is_blank(*at_) && !is_break(*at_)) ++at_;
        return {from, static_cast<std::size_t>(at_ - from)};
    }
    /// The rest of this line without blanks around it, comments included.
    std::string_view rest() {
        skip_blanks();
        const char* const from = at_;
        while (at_ != end_ && !is_break(*at_)) ++at_;
        const char* last = at_;
        while (last != from && is_blank(last[-1])) --last;
        return {from, static_cast<std::size_t>(last - from)};
    }
    /// Goes to the beginning of the next line.
    void next_line() {
        while (at_ != end_ && !is_break(*at_)) ++at_;
        if (at_ != end_) at_ += *at_ == '\r' && at_ + 1 != end_ && at_[1] == '\n' ? 2 : 1;
    }
    /// Goes over empty lines, and comments that begin with `comment`.
    void skip_comments(char comment) {
        for (;;) {
            skip_blanks();
            if (at_ == end_ || (*at_ != comment && !is_break(*at_))) return;
            next_line();
        }
    }

    /// Reads a number of this line; false, and no step, where there is none.
    bool number(double& value) {
        skip_blanks();
        const char* const from = at_ != end_ && *at_ == '+' ? at_ + 1 : at_;
        const auto [next, error] = std::from_chars(from, end_, value);
        if (error == std::errc::invalid_argument || !is_word_end(next)) return false;
        if (error != std::errc{})
            value =
                is_tiny(from, next) ? 0 : std::numeric_limits<double>::infinity();  // refused later
        at_ = next;
        return true;
    }
    /// Reads a whole number that `end` bytes may follow: "3" of "3/4".
    bool whole(std::int64_t& value) {
        skip_blanks();
        const auto [next, error] = std::from_chars(at_, end_, value);
        if (error != std::errc{}) return false;
        at_ = next;
        return true;
    }
    /// Goes over a letter, if it is the next.
    bool take(char letter) {
        if (at_ == end_ || *at_ != letter) return false;
        ++at_;
        return true;
    }
    /// True if only blanks and a comment follow on this line.
    [[nodiscard]] bool is_line_end() {
        skip_blanks();
        return at_ == end_ || is_break(*at_) || *at_ == '#';
    }
    /// True if a word ends here.
    [[nodiscard]] bool is_word_end() const { return is_word_end(at_); }

    /// An error in this line: "line 7: " + what it is about.
    [[nodiscard]] Error error(const std::string& why) const {
        std::uint64_t line = 1;
        for (const char* c = begin_; c != at_; ++c) line += *c == '\n' ? 1U : 0U;
        return {ErrorCode::scene_invalid, fmt::format("line {}: {}", line, why)};
    }
    [[nodiscard]] tl::unexpected<Error> refuse(const std::string& why) const {
        return tl::unexpected<Error>(error(why));
    }
    /// The next word for a message: shortened and in quotes; "the end of the line".
    [[nodiscard]] std::string next_word() {
        const char* const from = at_;
        const std::string_view found = word();
        at_ = from;
        return found.empty() ? (at_end() ? "the end of the file" : "the end of the line")
                             : fmt::format("'{}'", one_line(found, 40));
    }

private:
    static bool is_blank(char c) {
        return c == ' ' || c == '\t' || c == '\0' || c == '\v' || c == '\f';
    }
    static bool is_break(char c) { return c == '\n' || c == '\r'; }
    /// A comment may follow at once; the '#' of "1.#QNAN" begins none.
    [[nodiscard]] bool is_word_end(const char* at) const {
        return at == end_ || is_blank(*at) || is_break(*at) ||
               (*at == '#' && at != begin_ && at[-1] != '.');
    }
    /// A number out of range is tiny if its exponent is negative.
    static bool is_tiny(const char* from, const char* to) {
        const std::string_view text(from, static_cast<std::size_t>(to - from));
        return text.find("e-") != std::string_view::npos ||
               text.find("E-") != std::string_view::npos;
    }
    void skip_blanks() {
        while (at_ != end_) {
            if (is_blank(*at_)) {
                ++at_;
            } else if (*at_ == '\\' && at_ + 1 != end_ && is_break(at_[1])) {
                ++at_;
                next_line();
            } else {
                return;
            }
        }
    }

    const char* begin_;
    const char* at_;
    const char* end_;
};

}  // namespace raynest
