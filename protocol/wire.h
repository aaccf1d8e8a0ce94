// The only file that includes the generated control messages, as namespace raynest::wire.
//
// The header is made by flatc in the build tree. The ...T types are for building messages only;
// what arrives is read in place and never unpacked (1.8 MB can unpack to 419 GB).
#pragma once

#include "protocol/messages_generated.h"

#include <cstdlib>
#include <string_view>

namespace raynest::protocol {

/// A nested table that validate() has found to be there, as every handler may rely on; ends the
/// process otherwise.
template <class Table>
[[nodiscard]] const Table& present(const Table* table) {
    if (table == nullptr) std::abort();
    return *table;
}

/// "" for an absent string.
[[nodiscard]] inline std::string_view text(const flatbuffers::String* string) {
    return string != nullptr ? string->string_view() : std::string_view{};
}

/// `otherwise` for an absent or empty string: an absent word means the default.
[[nodiscard]] inline std::string_view word(const flatbuffers::String* string,
                                           std::string_view otherwise) {
    const std::string_view given = text(string);
    return given.empty() ? otherwise : given;
}

}  // namespace raynest::protocol
