#include "server/http/json_tokens.h"

#include <cstddef>

namespace raynest::server {
namespace {

/// Takes what it is told to from the front of a text.
class Reader {
public:
    explicit Reader(std::string_view text) : rest_(text) {}

    [[nodiscard]] bool is_empty() const { return rest_.empty(); }
    /// For a text that is not empty.
    [[nodiscard]] char front() const { return rest_.front(); }
    void skip() { rest_.remove_prefix(1); }

    bool take(char one) {
        const bool is_there = !is_empty() && front() == one;
        if (is_there) skip();
        return is_there;
    }
    bool take(std::string_view word) {
        const bool is_there = rest_.starts_with(word);
        if (is_there) rest_.remove_prefix(word.size());
        return is_there;
    }
    /// With both of its quotes.
    bool take_text() {
        for (skip(); !is_empty(); skip()) {
            if (take('"')) return true;
            if (static_cast<unsigned char>(front()) < ' ') return false;
            if (take('\\') && is_empty()) return false;
        }
        return false;
    }
    /// A number, true, false or null.
    bool take_value() {
        switch (front()) {
            case 't':
                return take("true");
            case 'f':
                return take("false");
            case 'n':
                return take("null");
            default:
                return take_number();
        }
    }

private:
    bool take_number() {
        take('-');
        if (!take('0') && !take_digits()) return false;
        if (take('.') && !take_digits()) return false;
        if (!take('e') && !take('E')) return true;
        if (!take('+')) take('-');
        return take_digits();
    }
    bool take_digits() {
        const std::size_t before = rest_.size();
        while (!is_empty() && front() >= '0' && front() <= '9') skip();
        return rest_.size() != before;
    }

    std::string_view rest_;
};

}  // namespace

std::string_view fault_of_json(std::string_view text) {
    Reader reader(text);
    std::size_t objects = 0, marks = 0, items = 0;
    while (!reader.is_empty()) {
        switch (reader.front()) {
            case '{':
                ++objects;
                reader.skip();
                break;
            case '[':
                ++marks;
                reader.skip();
                break;
            case ',':
                ++items;
                reader.skip();
                break;
            case ' ':
            case '\t':
            case '\n':
            case '\r':
            case '}':
            case ']':
            case ':':
                reader.skip();
                break;
            case '"':
                marks += 2;
                if (!reader.take_text())
                    return "a text in it does not end, or holds a control character";
                break;
            default:
                if (!reader.take_value())
                    return "it holds something other than texts in double quotes, numbers, lists, "
                           "objects, true, false and null";
        }
        // 64 KiB of short texts or empty tables would take the parser milliseconds.
        if (objects > json_objects_max || marks > json_marks_max || items > json_items_max)
            return "it has too many strings or values";
    }
    return {};
}

}  // namespace raynest::server
