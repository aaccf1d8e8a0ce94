#include "server/documents/selection_text.h"

namespace raynest::server {
namespace {

template <class Number>
void append(std::string& text, const char* key, const std::vector<Number>& list) {
    for (const Number number : list)
        text.append(text.empty() ? "" : " ").append(key).append(std::to_string(number));
}

/// Texts of paths, in which a space is %20: spaces part them.
void append(std::string& text, const std::vector<std::string>& paths) {
    for (const std::string& path : paths) {
        if (!text.empty()) text += ' ';
        for (const char c : path) c == ' ' ? text += "%20" : text += c;
    }
}

}  // namespace

SelectionText selection_text(const SelectionWords& words) {
    SelectionText text;
    append(text.hide, "inst=", words.lists.hidden_instances);
    append(text.hide, "object=", words.lists.hidden_objects);
    append(text.hide, "path=", words.hidden.ids);
    append(text.hide, words.hidden.texts);
    append(text.only, "inst=", words.lists.only_instances);
    append(text.only, "object=", words.lists.only_objects);
    append(text.only, "path=", words.only.ids);
    append(text.only, words.only.texts);
    return text;
}

void add_selection(const SelectionText& text, std::vector<Attribute>& attributes) {
    if (!text.hide.empty()) attributes.push_back({"raynest:hide", text.hide});
    if (!text.only.empty()) attributes.push_back({"raynest:only", text.only});
}

}  // namespace raynest::server
