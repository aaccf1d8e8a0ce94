#include "server/store/share_list.h"

#include "protocol/subject.h"

#include <algorithm>
#include <cstddef>

namespace raynest::server {
namespace {

constexpr std::size_t short_bytes_most = 1024;

std::string beginning(const std::vector<std::string_view>& names) {
    std::string text;
    std::size_t left = names.size();
    for (const std::string_view principal : names) {
        const std::string name = protocol::in_list(principal);
        if (!text.empty() && text.size() + name.size() > short_bytes_most)
            return text + ", and " + std::to_string(left) + " more";
        text.append(text.empty() ? "" : ",").append(name);
        --left;
    }
    return text;
}

}  // namespace

ShareList::ShareList(const std::vector<std::string>& names) {
    if (names.empty()) return;
    std::vector<std::string_view> sorted(names.begin(), names.end());
    std::ranges::sort(sorted);
    sorted.erase(std::unique(sorted.begin(), sorted.end()), sorted.end());
    const auto content = std::make_shared<Content>();
    std::size_t bytes = 0;
    for (const std::string_view name : sorted) bytes += name.size();
    content->text.reserve(bytes);
    for (const std::string_view name : sorted) content->text += name;
    content->names.reserve(sorted.size());
    std::size_t at = 0;
    for (const std::string_view name : sorted) {
        content->names.push_back(std::string_view(content->text).substr(at, name.size()));
        at += name.size();
    }
    content->short_text = beginning(content->names);
    content->is_public = std::ranges::binary_search(content->names, "public");
    content_ = content;
}

bool ShareList::contains(std::string_view name) const {
    return content_ != nullptr && std::ranges::binary_search(content_->names, name);
}

const std::vector<std::string_view>& ShareList::names() const {
    static const std::vector<std::string_view> none;
    return content_ ? content_->names : none;
}

std::string ShareList::text() const {
    std::string list;
    for (const std::string_view principal : names())
        list.append(list.empty() ? "" : ",").append(protocol::in_list(principal));
    return list;
}

const std::string& ShareList::short_text() const {
    static const std::string none;
    return content_ ? content_->short_text : none;
}

std::uint64_t ShareList::bytes() const {
    if (!content_) return 0;
    return sizeof(Content) + content_->text.capacity() + content_->short_text.capacity() +
           content_->names.capacity() * sizeof(std::string_view);
}

}  // namespace raynest::server
