// The list of loaded scenes, as the daemon tells it page by page.
#pragma once

#include "client/connection.h"

#include <cstdint>
#include <string>
#include <vector>

namespace raynest::client {

struct ListedScene {
    std::string name, hash, owner;
    std::string share;  ///< "", "public", or principals joined by commas
    std::uint64_t epoch = 0, triangles = 0, bytes = 0;
    double age_seconds = 0;   ///< since the load
    double idle_seconds = 0;  ///< since a request last used it
    std::uint32_t holders = 0;  ///< connections that loaded or opened it
};
Result<std::vector<ListedScene>> list_scenes(Connection& connection);

}  // namespace raynest::client
