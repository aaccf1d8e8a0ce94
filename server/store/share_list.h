// Those whom a scene is shared with. A list may have hundreds of long names, and requests look at
// the lists of all scenes: copies refer to one content, which is a few blocks of memory.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace raynest::server {

/// Names of principals, or "public"; each once, sorted. Immutable but for assignment.
class ShareList {
public:
    ShareList() = default;
    ShareList(const std::vector<std::string>& names);
    ShareList(std::initializer_list<std::string> names)
        : ShareList(std::vector<std::string>(names)) {}

    [[nodiscard]] bool empty() const { return content_ == nullptr; }
    [[nodiscard]] bool contains(std::string_view name) const;
    /// As contains("public"), which every request asks of every scene.
    [[nodiscard]] bool is_public() const { return content_ != nullptr && content_->is_public; }
    /// Valid as long as a copy of the list.
    [[nodiscard]] const std::vector<std::string_view>& names() const;
    /// The whole list as text (protocol/subject.h).
    [[nodiscard]] std::string text() const;
    /// Its beginning, of so few bytes that any list of scenes fits into a frame.
    [[nodiscard]] const std::string& short_text() const;
    /// Bytes of memory.
    [[nodiscard]] std::uint64_t bytes() const;

    /// Returns the same list, whose content is given to `last` with the last of its copies.
    template <class Last>
    [[nodiscard]] ShareList with_end(Last last) const {
        ShareList list;
        const Content* const content = content_.get();
        list.content_ = {content,
                         [kept = content_, last = std::move(last)](const Content*) mutable {
                             last(std::exchange(kept, nullptr));
                         }};
        return list;
    }
    [[nodiscard]] bool operator==(const ShareList& other) const { return names() == other.names(); }

private:
    struct Content {
        std::string text;                     ///< the names, one after the other
        std::vector<std::string_view> names;  ///< in `text`, sorted: no names make a search long
        std::string short_text;
        bool is_public = false;
    };
    std::shared_ptr<const Content> content_;  ///< null: nobody
};

}  // namespace raynest::server
