// The targets that are tested, as far as this machine runs them.
#pragma once

#include "engine/packs/registry.h"

#include <cstdio>
#include <memory>

namespace raynest::conformance {

inline constexpr const char* targets[] = {"v2", "v3", "v4"};

/// The packs of one target; null, and a line that says so, where it does not run here.
inline std::shared_ptr<const Registry> registry_of(const char* target) {
    Registry::Options options;
    options.target = target;
    const auto registry = Registry::load(options);
    if (registry) return *registry;
    std::printf("skipped: target %s: %s\n", target, registry.error().message.c_str());
    return nullptr;
}

}  // namespace raynest::conformance
