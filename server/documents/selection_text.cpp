#include "server/documents/selection_text.h"

#include <cstdint>

namespace raynest::server {
namespace {

void append(std::string& text, const char* key, const flatbuffers::Vector<std::uint32_t>* list) {
    if (list == nullptr) return;
    for (const std::uint32_t number : *list)
        text.append(text.empty() ? "" : " ").append(key).append(std::to_string(number));
}

}  // namespace

SelectionText selection_text(const wire::Job& job) {
    SelectionText text;
    append(text.hide, "inst=", job.hidden_instances());
    append(text.hide, "object=", job.hidden_objects());
    append(text.only, "inst=", job.only_instances());
    append(text.only, "object=", job.only_objects());
    return text;
}

void add_selection(const SelectionText& text, std::vector<Attribute>& attributes) {
    if (!text.hide.empty()) attributes.push_back({"raynest:hide", text.hide});
    if (!text.only.empty()) attributes.push_back({"raynest:only", text.only});
}

}  // namespace raynest::server
