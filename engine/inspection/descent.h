// Which trees a ray is in, told from the steps of an observer.
#pragma once

#include "engine/geometry/views.h"
#include "engine/packs/observer.h"

#include <utility>
#include <vector>

namespace raynest {

/// The levels from the root's tree to the one that is walked. `Level` has the members `object` and
/// `instance`, and whatever else its user keeps.
///
/// Observers are told when a ray enters an instance, not when it leaves. But no object holds
/// itself, so the object of the next step says which level the ray is back in.
template <class Level>
class Descent {
public:
    /// A ray enters the scene.
    void begin(Level root) {
        levels_.clear();
        levels_.push_back(std::move(root));
    }
    /// A step has come: leaves the levels below its own, which it returns.
    Level& at(const Step& step) {
        while (levels_.size() > 1 && levels_.back().object != step.object) levels_.pop_back();
        return levels_.back();
    }
    /// A ray has entered an instance.
    void enter(Level level) { levels_.push_back(std::move(level)); }

    [[nodiscard]] const std::vector<Level>& levels() const { return levels_; }
    [[nodiscard]] std::vector<Level>& levels() { return levels_; }

private:
    std::vector<Level> levels_;
};

}  // namespace raynest
