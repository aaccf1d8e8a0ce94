#include "tests/bench/answers.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace raynest::bench {
namespace {

bool close(float a, float b) {
    return a == b || std::abs(a - b) <= 1e-4F * (1 + std::min(a, b));
}

bool same_surface(const HitRecord& a, const HitRecord& b) {
    return a.path == b.path && a.triangle == b.triangle;
}

/// A miss has t = inf.
const HitRecord& nearer(const HitRecord& a, const HitRecord& b) {
    return a.t < b.t ? a : b;
}

}  // namespace

Differences compare(const Answers& a, const Answers& b, const AtMaskBorder& at_mask_border) {
    // Which surface an any-hit met is not known.
    const bool surfaces_known = a.query == query_closest;
    Differences found;
    for (std::size_t ray = 0; ray < a.counts.size(); ++ray) {
        const auto ours = a.of(ray);
        const auto theirs = b.of(ray);
        bool same = ours.size() == theirs.size();
        bool tied = false;
        for (std::size_t i = 0; same && i < ours.size(); ++i) {
            same = ours[i].hit == theirs[i].hit && close(ours[i].t, theirs[i].t);
            tied = tied || (ours[i].hit != 0 && !same_surface(ours[i], theirs[i]));
        }
        found.ties += same && tied && a.query != query_any ? 1 : 0;
        if (same) continue;
        const bool excused = at_mask_border && surfaces_known &&
                             at_mask_border(ray, nearer(ours.front(), theirs.front()));
        ++(excused ? found.mask_borders : found.mismatches);
    }
    return found;
}

Differences compare(const Answers& a, std::span<const Reference> b) {
    Differences found;
    for (std::size_t ray = 0; ray < a.counts.size(); ++ray) {
        const HitRecord& ours = a.of(ray).front();
        const Reference& theirs = b[ray];
        const bool hit = std::isfinite(theirs.t);
        const bool any = a.query == query_any;
        const bool same = (ours.hit != 0) == hit && (any || !hit || close(ours.t, theirs.t));
        const bool tied = hit && (ours.triangle != theirs.prim ||
                                  (theirs.inst != no_id && ours.path != theirs.inst));
        found.mismatches += same ? 0 : 1;
        found.ties += same && tied && !any ? 1 : 0;
    }
    return found;
}

std::uint64_t count_unequal(const Answers& a, const Answers& b) {
    std::uint64_t unequal = 0;
    for (std::size_t ray = 0; ray < a.counts.size(); ++ray) {
        const auto x = a.of(ray);
        const auto y = b.of(ray);
        const bool equal =
            x.size() == y.size() && std::memcmp(x.data(), y.data(), x.size_bytes()) == 0;
        unequal += equal ? 0 : 1;
    }
    return unequal;
}

}  // namespace raynest::bench
