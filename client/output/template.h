// Fills a text with the values of a JSON document: the report, whose one text the page fills by the
// same rules (server/web/template.js).
//
//   {{path}}             the value, with the letters replaced that HTML gives a meaning
//   {{#path}}…{{/path}}  for each item of a list; once for what is not null, false, "" or empty
//   {{^path}}…{{/path}}  where that is not so
//
// A path is "a.b.0", looked for in the innermost section first; "." is that section's value.
// "path|filter" changes a value: the filters stand in template.cpp.
#pragma once

#include "client/ground/json.h"

#include <string>
#include <string_view>

namespace raynest::client {

/// Sections of `text` must be closed, and its filters known: it is a text of this tree, not from
/// outside.
[[nodiscard]] std::string fill_template(std::string_view text, const Json& values);

/// Returns text with the letters replaced that HTML gives a meaning.
[[nodiscard]] std::string escape_html(std::string_view text);

}  // namespace raynest::client
