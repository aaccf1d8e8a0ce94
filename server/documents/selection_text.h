// The instances, objects and paths that a job hides, as text for files and documents.
#pragma once

#include "engine/assets/images/image.h"
#include "server/execution/selected.h"

#include <string>
#include <vector>

namespace raynest::server {

/// "inst=1 object=2", as --hide and --only of the command line take it; empty: all is shown.
struct SelectionText {
    std::string hide, only;
};
[[nodiscard]] SelectionText selection_text(const SelectionWords& words);

/// Adds what is hidden to the attributes of a file; nothing where all is shown.
void add_selection(const SelectionText& text, std::vector<Attribute>& attributes);

}  // namespace raynest::server
