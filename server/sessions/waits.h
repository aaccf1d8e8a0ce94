// Keeps what a request has met while it waited for the scenes that it needs.
#pragma once

#include "server/ground/errors.h"
#include "server/store/named_scene.h"

#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {

/// Two scenes that do not fit into memory together would drive each other out for ever, one request
/// that names both would never begin.
class Waits {
public:
    /// Counts one more wait for a scene, by its arena. Fails with RESOURCE_EXHAUSTED where it has been
    /// brought back too often.
    Reply<void> once_more(const std::string& arena) {
        if (++counts_[arena] <= most) return {};
        return refuse(protocol::Code::resource_exhausted,
                      "the scenes that this request needs do not stay in memory together; start "
                      "raynestd with a larger --memory");
    }

    /// Holds what it has of them already until it begins: others would drive it out meanwhile.
    void hold(std::vector<std::shared_ptr<const HeldScene>> scenes) { held_ = std::move(scenes); }

private:
    static constexpr unsigned most = 16;  ///< others may need the memory in between, too
    std::map<std::string, unsigned> counts_;
    std::vector<std::shared_ptr<const HeldScene>> held_;
};

}  // namespace raynest::server
