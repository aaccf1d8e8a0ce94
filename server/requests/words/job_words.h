// The words of a wire::Job, read once.
#pragma once

#include "engine/packs/registry.h"
#include "protocol/wire.h"
#include "server/execution/selected.h"
#include "server/requests/words/at_moment.h"

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

/// The words that are views lie in the message. A word that is not given is `auto`, but for
/// `priority`.
struct JobWords {
    std::string_view scene;
    std::uint64_t epoch = 0;
    std::string_view intersector;
    std::vector<std::string> settings;  ///< name=value
    std::vector<NamedTable> tables;
    std::string_view traversal;
    std::uint32_t mask = 0;
    std::string_view worker;
    std::string_view priority;  ///< normal where it is not given
    std::uint32_t deadline_ms = 0;
    bool detach = false;
    SelectionWords selection;
    MomentWords moment;
};

[[nodiscard]] JobWords job_words(const wire::Job& job);

}  // namespace raynest::server
