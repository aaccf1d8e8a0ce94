#include "protocol/limits.h"

#include <array>

namespace raynest::protocol {
namespace {

constexpr bool fixed = false;
constexpr bool policy = true;

constexpr std::array limits = {
#define RAYNEST_LIMIT(name, value, kind, text) LimitInfo{#name, &Limits::name, text, kind},
#include "protocol/lists/limits.def"
};

}  // namespace

std::span<const LimitInfo> limit_table() {
    return limits;
}

}  // namespace raynest::protocol
