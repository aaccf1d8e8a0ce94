#include "server/documents/selection_text.h"

#include "protocol/control.h"

namespace raynest::server {
namespace {

template <class Number>
void append(std::string& text, const char* key, const flatbuffers::Vector<Number>* list) {
    if (list == nullptr) return;
    for (const Number number : *list)
        text.append(text.empty() ? "" : " ").append(key).append(std::to_string(number));
}

/// Texts of paths, in which a space is %20: spaces part them.
void append(std::string& text, const protocol::StringList* list) {
    for (const std::string& path : protocol::strings(list)) {
        if (!text.empty()) text += ' ';
        for (const char c : path) c == ' ' ? text += "%20" : text += c;
    }
}

}  // namespace

SelectionText selection_text(const wire::Job& job) {
    SelectionText text;
    append(text.hide, "inst=", job.hidden_instances());
    append(text.hide, "object=", job.hidden_objects());
    append(text.hide, "path=", job.hidden_path_ids());
    append(text.hide, job.hidden_paths());
    append(text.only, "inst=", job.only_instances());
    append(text.only, "object=", job.only_objects());
    append(text.only, "path=", job.only_path_ids());
    append(text.only, job.only_paths());
    return text;
}

void add_selection(const SelectionText& text, std::vector<Attribute>& attributes) {
    if (!text.hide.empty()) attributes.push_back({"raynest:hide", text.hide});
    if (!text.only.empty()) attributes.push_back({"raynest:only", text.only});
}

}  // namespace raynest::server
