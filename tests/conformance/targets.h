// The targets to test, as far as this machine runs them.
#pragma once

#include "engine/packs/registry.h"

#include <cstdio>
#include <memory>

namespace raynest::conformance {

inline constexpr const char* targets[] = {"v2", "v3", "v4"};

/// Returns the packs of one target; prints a line and returns null if it does not run here.
inline std::shared_ptr<const Registry> registry_of(const char* target) {
    Registry::Options options;
    options.target = target;
    const auto registry = Registry::load(options);
    if (registry) return *registry;
    std::printf("skipped: target %s: %s\n", target, registry.error().message.c_str());
    return nullptr;
}

}  // namespace raynest::conformance
